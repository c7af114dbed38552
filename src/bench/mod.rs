//! Speed against error, measured: what `coseg bench` prints.
//!
//! A [`Bench`] holds the scene and how much work to spend; [`Bench::measure`] runs one [`Section`] and gives its
//! [`Findings`]: figures as medians with their spread, each beside the bar that the design sets for it where it sets one.
//! Warm-up runs are not counted. Nothing here decides whether a build is good: timings depend on the machine.

mod building;
mod channels;
mod curve;
mod encoding;
mod export;
mod figures;
mod machine;
mod memory;
mod raster;
mod resample;
mod roofline;
mod samples;
mod segmentation;
mod subject;
mod surfels;
mod unprojection;

pub use self::figures::{Bar, Figure, Findings, Layout};
pub use self::machine::{Machine, reset_peak_memory};
pub use self::resample::resampled;
pub use self::samples::Samples;
pub use self::subject::{Source, Subject};
pub use self::surfels::Surfaces;

use crate::config::Config;
use crate::error::{Error, Result};
use burn::tensor::Device;
use serde::Serialize;
use std::time::Duration;

/// A part of the pipeline that is measured on its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Section {
    /// The rasterizer, forward and backward, as the number of Gaussians grows.
    Raster,
    /// The rasterizer, as the number of channels grows.
    Channels,
    /// Time against error of the rasterizer's settings.
    Curve,
    /// An iteration of stage one.
    Building,
    /// Lifting feature maps onto Gaussians.
    Unprojection,
    /// The point encoder.
    Encoding,
    /// An iteration of stage two.
    Segmentation,
    /// Memory of an iteration of stage two.
    Memory,
    /// What the device could do at most, and how much of it rendering and lifting reach.
    Roofline,
}

impl Section {
    /// All sections, in the order in which they run.
    pub const ALL: [Self; 9] = [
        Self::Raster,
        Self::Channels,
        Self::Curve,
        Self::Building,
        Self::Unprojection,
        Self::Encoding,
        Self::Segmentation,
        Self::Memory,
        Self::Roofline,
    ];

    /// Its name on the command line and in JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::Raster => "raster",
            Self::Channels => "channels",
            Self::Curve => "curve",
            Self::Building => "building",
            Self::Unprojection => "unprojection",
            Self::Encoding => "encoding",
            Self::Segmentation => "segmentation",
            Self::Memory => "memory",
            Self::Roofline => "roofline",
        }
    }

    /// What it measures, in a few words.
    pub fn title(self) -> &'static str {
        match self {
            Self::Raster => "colour, forward and backward, as the number of Gaussians grows",
            Self::Channels => "colour and labels in one pass, forward and backward",
            Self::Curve => "time against error of the rasterizer's settings",
            Self::Building => "an iteration of stage one, everything included",
            Self::Unprojection => "4 x 64 feature channels lifted onto the Gaussians",
            Self::Encoding => "the RandLA point encoder",
            Self::Segmentation => "an iteration of stage two, row `ours`",
            Self::Memory => {
                "peak memory of stage two against Gaussians decoded together (segmentation.decoder_chunk)"
            }
            Self::Roofline => {
                "the least that rendering and lifting could take on this device, and what they take"
            }
        }
    }
}

impl std::fmt::Display for Section {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.key())
    }
}

impl std::str::FromStr for Section {
    type Err = Error;
    fn from_str(name: &str) -> Result<Self> {
        Self::ALL
            .into_iter()
            .find(|section| section.key() == name)
            .ok_or_else(|| {
                let all = Self::ALL.map(Self::key).join(", ");
                Error::argument(
                    "--only",
                    name,
                    all,
                    "name one or more of these, with commas between",
                )
            })
    }
}

/// Memory in which a million Gaussians can be measured with room to spare.
pub const LARGE_BYTES: u64 = 3_000_000_000;

/// How much work measurements may be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Measured passes behind a median.
    pub repeats: usize,
    /// Numbers of Gaussians that the rasterizer is measured at, ascending.
    pub sizes: Vec<usize>,
    /// Gaussians of sections that name one number: the curve, unprojection, encoding.
    pub gaussians: usize,
    /// Gaussians that a building iteration is measured at.
    pub building: Vec<usize>,
    /// Gaussians of stage two where the scene is not trained.
    pub segmentation: usize,
    /// Numbers of Gaussians that channels, the memory of stage two and the roofline are measured at, ascending.
    pub memory: Vec<usize>,
    /// Image width and height of what is rendered, pixels.
    pub size: [usize; 2],
    /// Another one, of the channels.
    pub channels_size: [usize; 2],
    /// Views of a pass of the rasterizer.
    pub views: usize,
    /// Views of an unprojection.
    pub lifted_views: usize,
    /// Training views of stage two.
    pub labelled_views: usize,
    /// Iterations before those that count, of stage one.
    pub settle: usize,
    /// Counted iterations of either stage, a repeat.
    pub steps: usize,
    /// Largest buffer that is copied to see how fast memory is, bytes; far more than caches hold.
    pub copied_bytes: usize,
    /// What a measurement of what the device could do takes at least.
    pub probe: Duration,
}

impl Effort {
    /// What the bars are set for; `large` adds a million Gaussians, which take [`LARGE_BYTES`].
    pub fn full(repeats: usize, large: bool) -> Self {
        let sizes = [10_000, 100_000, 1_000_000];
        Self {
            repeats,
            sizes: sizes[..if large { 3 } else { 2 }].to_vec(),
            gaussians: 100_000,
            building: vec![15_000, 50_000],
            segmentation: 25_000,
            memory: vec![100_000],
            size: [480, 360],
            channels_size: [1920, 1080],
            views: 6,
            lifted_views: 80,
            labelled_views: 12,
            settle: 100,
            steps: 20,
            copied_bytes: 256 << 20,
            probe: Duration::from_millis(100),
        }
    }

    /// Seconds of work in all, to see that everything runs; the figures mean nothing.
    pub fn quick(repeats: usize) -> Self {
        Self {
            repeats,
            sizes: vec![300, 1_200],
            gaussians: 1_000,
            building: vec![400],
            segmentation: 600,
            memory: vec![600],
            size: [64, 48],
            channels_size: [96, 64],
            views: 2,
            lifted_views: 3,
            labelled_views: 2,
            settle: 2,
            steps: 4,
            copied_bytes: 4 << 20,
            probe: Duration::from_millis(2),
        }
    }
}

/// A scene, a device, and how much work to spend on them.
pub struct Bench {
    /// Settings of rasterizer, stages and encoder.
    pub config: Config,
    /// The scene.
    pub subject: Subject,
    /// Where tensors live; without autodiff.
    pub device: Device,
    /// How much work.
    pub effort: Effort,
}

impl Bench {
    /// Measures one section.
    ///
    /// # Errors
    /// Those of the part that is measured.
    pub fn measure(&self, section: Section) -> Result<Findings> {
        match section {
            Section::Raster => raster::measure(self),
            Section::Channels => channels::measure(self),
            Section::Curve => curve::measure(self),
            Section::Building => building::measure(self),
            Section::Unprojection => unprojection::measure(self),
            Section::Encoding => encoding::measure(self),
            Section::Segmentation => segmentation::measure(self),
            Section::Memory => memory::measure(self),
            Section::Roofline => roofline::measure(self),
        }
    }

    /// Whether sizes are those that the bars were set for.
    fn is_full(&self) -> bool {
        self.effort.size == [480, 360]
    }

    /// `480x360, 6 views of ...`
    fn views_in_words(&self, views: usize) -> String {
        let [w, h] = self.effort.size;
        format!("{w}x{h}, {views} views of {}", self.subject.description)
    }
}

/// `100,000 Gaussians`.
fn gaussians_in_words(count: usize) -> String {
    format!("{} Gaussians", figures::thousands(count as f64))
}

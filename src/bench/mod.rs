//! Measurements that `coseg bench` prints: speed against error, times of the stages, memory.
//!
//! A [`Bench`] holds the scene and the amount of work. [`Bench::measure`] runs one [`Section`] and returns its [`Findings`]:
//! medians with their spread. Warm-up runs are not counted.

mod building;
mod curve;
mod figures;
mod machine;
mod raster;
mod resample;
mod samples;
mod segmentation;
mod subject;
mod unprojection;

pub use self::figures::{Figure, Findings};
pub use self::machine::Machine;
pub use self::resample::resampled;
pub use self::samples::Samples;
pub use self::subject::{Source, Subject};

use crate::config::Config;
use crate::error::{Error, Result};
use crate::report::{peak_memory_bytes, thousands};
use burn::tensor::Device;
use serde::Serialize;

/// A part of the pipeline that is measured on its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Section {
    /// The rasterizer, forward and backward.
    Raster,
    /// Time against error of the rasterizer's settings.
    Curve,
    /// A step of stage one.
    Building,
    /// Lifting of feature maps onto Gaussians.
    Unprojection,
    /// A step of stage two.
    Segmentation,
}

impl Section {
    /// All sections, in the order in which they run.
    pub const ALL: [Self; 5] = [
        Self::Raster,
        Self::Curve,
        Self::Building,
        Self::Unprojection,
        Self::Segmentation,
    ];

    /// Its name on the command line and in JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::Raster => "raster",
            Self::Curve => "curve",
            Self::Building => "building",
            Self::Unprojection => "unprojection",
            Self::Segmentation => "segmentation",
        }
    }

    /// What it measures, in a few words.
    pub fn title(self) -> &'static str {
        match self {
            Self::Raster => "rendering, forward and backward",
            Self::Curve => "time against error of the rasterizer's settings",
            Self::Building => "a step of stage one",
            Self::Unprojection => "4 x 64 feature channels lifted onto the Gaussians",
            Self::Segmentation => "a step of stage two, row `ours`",
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
        let found = Self::ALL.into_iter().find(|section| section.key() == name);
        found.ok_or_else(|| {
            let all = Self::ALL.map(Self::key).join(", ");
            Error::argument("--only", name, all, "separate sections by commas")
        })
    }
}

/// How much work the measurements do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Measured passes behind a median.
    pub repeats: usize,
    /// Numbers of Gaussians that every section is measured at, ascending.
    pub gaussians: Vec<usize>,
    /// Width and height of rendered images, pixels.
    pub size: [usize; 2],
    /// A second, larger size for section `raster`.
    pub large_size: [usize; 2],
    /// Rendered views in a pass.
    pub views: usize,
    /// Views that are lifted.
    pub lifted_views: usize,
    /// Labelled training views in stage two.
    pub labelled_views: usize,
    /// Steps of stage one before those that count.
    pub settle: usize,
    /// Steps of either stage that count, per repeat.
    pub steps: usize,
}

impl Effort {
    /// Enough work for figures that can be trusted.
    pub fn full(repeats: usize, gaussians: Vec<usize>) -> Self {
        Self {
            repeats,
            gaussians,
            size: [480, 360],
            large_size: [1920, 1080],
            views: 6,
            lifted_views: 80,
            labelled_views: 12,
            settle: 100,
            steps: 20,
        }
    }

    /// A few seconds of work, to see that everything runs. The figures mean nothing.
    pub fn quick(repeats: usize, gaussians: Vec<usize>) -> Self {
        Self {
            repeats,
            gaussians,
            size: [64, 48],
            large_size: [96, 64],
            views: 2,
            lifted_views: 3,
            labelled_views: 2,
            settle: 2,
            steps: 4,
        }
    }
}

/// A scene, a device, and how much work to do.
pub struct Bench {
    /// Settings of the rasterizer and of both stages.
    pub config: Config,
    /// The scene.
    pub subject: Subject,
    /// Where tensors live; without autodiff.
    pub device: Device,
    /// How much work.
    pub effort: Effort,
}

impl Bench {
    /// Measures one section at each number of Gaussians. Where the system reports memory, each has its peak too.
    ///
    /// # Errors
    /// Those of the part that is measured. A number of Gaussians that the device cannot hold becomes a note instead.
    pub fn measure(&self, section: Section) -> Result<Findings> {
        let mut findings = Findings::new(section, &self.subject.description);
        for &count in &self.effort.gaussians {
            let gaussians = self.subject.gaussians(count);
            let case = format!("{} Gaussians", thousands(gaussians.len() as u64));
            let peak = if machine::reset_peak_memory() {
                "peak memory of the process"
            } else {
                "peak memory of the process so far"
            };
            let measured = match section {
                Section::Raster => raster::measure(self, &gaussians, &case, &mut findings),
                Section::Curve => curve::measure(self, &gaussians, &case, &mut findings),
                Section::Building => building::measure(self, &gaussians, &case, &mut findings),
                Section::Unprojection => {
                    unprojection::measure(self, &gaussians, &case, &mut findings)
                }
                Section::Segmentation => {
                    segmentation::measure(self, &gaussians, &case, &mut findings)
                }
            };
            match measured {
                Err(error @ Error::Limit { .. }) => {
                    findings.note(format!("{case}: left out, {error}"));
                }
                other => other?,
            }
            let bytes = peak_memory_bytes().filter(|_| section != Section::Curve);
            if let Some(bytes) = bytes {
                findings.counted(&case, peak, "MB", bytes as f64 / 1e6);
            }
        }
        Ok(findings)
    }
}

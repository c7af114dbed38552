//! `coseg from-photos`: a scene folder from photos without poses, or from a video.

use super::data::check;
use super::label::{BEST, SegmenterArgs};
use super::progress::Bars;
use super::{interrupt, terminal};
use clap::Args;
use clap::builder::RangedU64ValueParser;
use coseg::capture::Capture;
use coseg::config::Config;
use coseg::data::LoadOptions;
use coseg::error::Result;
use coseg::files::lock::locked;
use coseg::files::shell_word;
use std::path::{Path, PathBuf};

/// The folder of the labels, in the scene folder.
const LABELS: &str = "labels_segmenter";

const HELP: &str = "\
Copies the photos, without their EXIF orientation, or takes the sharpest frames of a video with ffmpeg; finds their poses with
COLMAP, which assumes one lens for all photos; checks the result as `coseg data check` does. COLMAP is the program `colmap` or
the package pycolmap of python3; if both are there, the program if it has CUDA. The photos themselves stay as they are.
Writes into a new folder
  images/           the photos or frames
  masks/            with --masks: a mask for each photo, white for a photo without one
  sparse/           COLMAP's models
  labels_segmenter/ with --segmenter: label maps, as `coseg label` writes them
  from-photos.json  what it was made from
Ctrl-C stops; the same command continues. Finished steps are not repeated, but the photos must still be there.

Examples:
  coseg from-photos photos --out scenes/living
  coseg from-photos photos --out scenes/street --masks people
  coseg from-photos walk.mp4 --frames 200 --out scenes/living
  coseg from-photos photos --out scenes/living --python venv/bin/python --segmenter net.onnx --classes mine.toml
  coseg train --data scenes/living --out runs/living";

/// Arguments of `coseg from-photos`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct FromPhotosArgs {
    /// Folder of photos (PNG or JPEG), or a video
    #[arg(value_name = "DIR|VIDEO")]
    source: PathBuf,
    /// Scene folder to write; new, or one that this command began
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Folder of masks, a.png or a.jpg.png for a.jpg: black where a photo is to be left out
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    /// Frames to take from a video: the sharpest of each of N windows
    #[arg(long, value_name = "N", default_value_t = 120, value_parser = RangedU64ValueParser::<usize>::new().range(2..=1000))]
    frames: usize,
    /// The Python whose pycolmap finds the poses [default: python3, or the program colmap]
    #[arg(long, value_name = "FILE")]
    python: Option<PathBuf>,
    /// Label the photos too, by this segmenter; see `coseg label --help`
    #[arg(long, value_name = "FILE.onnx")]
    segmenter: Option<PathBuf>,
    #[command(flatten)]
    labelling: SegmenterArgs,
}

impl FromPhotosArgs {
    /// Makes the scene folder.
    pub fn run(self) -> Result<()> {
        if self.segmenter.is_none() {
            self.labelling.expect_none()?;
        }
        interrupt::watch(interrupt::SAME_COMMAND);
        locked(&self.out, || self.make())
    }

    fn make(&self) -> Result<()> {
        let capture = Capture {
            source: &self.source,
            masks: self.masks.as_deref(),
            frames: self.frames,
            python: self.python.as_deref(),
        };
        let made = capture.make(&self.out, &mut Bars::default())?;
        let out = &self.out;
        let solver = made.poses.unwrap_or_default();
        let masks = match made.masks {
            0 => String::new(),
            some => format!(" ({some} with masks)"),
        };
        terminal::say(&format!(
            "{}: {} photos{masks}, poses by {solver}",
            out.display(),
            made.photos
        ));
        let config = Config::load_for(Some(out), None, &[])?;
        let options = LoadOptions::from(&config);
        check(out, &options, false)?;
        if let Some(model) = &self.segmenter {
            let scene = (out.as_path(), &options);
            let labels = out.join(LABELS);
            self.labelling.label(scene, model, BEST, &labels)?;
        }
        next(out, self.segmenter.is_some());
        Ok(())
    }
}

/// Prints the commands that may follow.
fn next(out: &Path, labelled: bool) {
    let data = shell_word(out);
    let train = format!("coseg train --data {data}");
    let lines = if labelled {
        vec![format!("{train} --set data.raw_labels={LABELS}")]
    } else {
        vec![
            format!(
                "{train} --segmenter FILE.onnx      labels by a segmenter; docs/from-photos.md has other ways"
            ),
            format!("coseg data suggest {data}      names photos to label by hand"),
            format!("{train}      the Gaussians alone"),
        ]
    };
    terminal::say("next:");
    for line in lines {
        terminal::say(&format!("  {line}"));
    }
}

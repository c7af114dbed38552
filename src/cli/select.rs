//! `coseg select`: a thing that a few pixels show becomes an object with a name.

use super::object_scene::EditedSceneArgs;
use super::{terminal, values};
use clap::Args;
use coseg::data::NamedCamera;
use coseg::error::{Result, ensure, invalid};
use coseg::objects::{Growth, Regions, seed};
use coseg::raster::{Projected, Settings};
use coseg::runs::{
    CAMERAS, Cameras, ObjectScene, cameras_for, cameras_path, features_beside, frame_with_pixel,
    rendering_beside,
};
use std::path::PathBuf;

const HELP: &str = "\
Point at a thing in one or more views. The selection begins at the Gaussian that contributes most to each pixel and grows over its
neighbours, those that are most alike in colour, surface and image features first (features of a run that lifted some). It
ends where it stands out most from the rest, or at --threshold: a lower one takes fewer Gaussians. Give --frame and --pixel once
for each pixel, in the same order. Points far apart on the thing help most. The scene needs neither labels nor its photos.

The Gaussians become an object called --name. Where the scene has an object or a class of that name, they join it. Gaussians of
other objects change over. classes.json and the cameras that were used are written beside the new file.

Examples:
  coseg select --scene runs/fox --frame 0007 --pixel 150,100 --name fox --out labelled
  coseg select --scene runs/fox --frame 0007 --pixel 150,100 --frame 0030 --pixel 110,290 --name fox --out labelled
  coseg select --scene labelled --frame 0007 --pixel 50,160 --name board --threshold 9 --out labelled --force";

/// Arguments of `coseg select`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct SelectArgs {
    #[command(flatten)]
    scene: EditedSceneArgs,
    /// Cameras, as `coseg render` takes them [default: cameras.json beside the scene]
    #[arg(long, value_name = "FILE.json|DIR")]
    cameras: Option<PathBuf>,
    /// Frame of a pixel: its name or the path of its photo, with or without extension; may be repeated
    #[arg(long = "frame", value_name = "STEM", required = true)]
    frames: Vec<String>,
    /// Column and row of a pixel, from 0 at the top left; one for each --frame
    #[arg(long = "pixel", value_name = "X,Y", required = true, value_parser = values::pixel, allow_hyphen_values = true)]
    pixels: Vec<[usize; 2]>,
    /// Name of the object
    #[arg(long, value_name = "NAME", value_parser = values::name)]
    name: String,
    /// How far the selection grows, 0 or more [default: proposed, and printed]
    #[arg(long, value_name = "T", value_parser = parse_threshold, allow_negative_numbers = true)]
    threshold: Option<f32>,
}

fn parse_threshold(text: &str) -> std::result::Result<f32, String> {
    values::number(text, "a number of 0 or more", |t: &f32| {
        t.is_finite() && *t >= 0.0
    })
}

impl SelectArgs {
    /// Selects and writes.
    pub fn run(self) -> Result<()> {
        ensure!(self.frames.len() == self.pixels.len(), argument "--pixel"; found "{} pixels", self.pixels.len();
            expected "one for each --frame, of which there are {}", self.frames.len();
            help "give --frame and --pixel once for each pixel");
        let scene = self.scene.from.read_or_unlabelled()?;
        let file = cameras_path(self.cameras.as_deref(), &scene.path)?;
        let frames = cameras_for(&scene.path, &file, None)?;
        let seeds = self.seeds(&scene, &frames)?;
        terminal::note("dividing the scene into regions");
        let features = features_beside(&scene.path, scene.labels.len());
        let regions = Regions::new(&scene.ply.gaussians, &features)?;
        let growth = Growth::new(&regions, &seeds);
        let threshold = self.threshold.unwrap_or(growth.proposed);
        let rows = growth.rows(threshold);
        let (ids, edited) = scene.named(&[(&self.name, &rows)], "--name")?;
        let id = ids[0].unwrap_or(scene.classes.ignore);
        let cameras = if file == scene.path.with_file_name(CAMERAS) {
            Cameras::Beside(&scene.path)
        } else {
            Cameras::Used(&frames)
        };
        let out = self.scene.write(&scene, &edited, cameras)?;
        let changes_over = |row: &&u32| {
            let label = scene.labels[**row as usize];
            label != id && label != scene.classes.ignore
        };
        terminal::say(&format!(
            "{}: {} of {} Gaussians are now {} (label {id}), {} of them had another label; threshold {threshold}",
            out.display(),
            rows.len(),
            scene.labels.len(),
            self.name,
            rows.iter().filter(changes_over).count(),
        ));
        Ok(())
    }

    /// The Gaussian under each pixel.
    fn seeds(&self, scene: &ObjectScene, frames: &[NamedCamera]) -> Result<Vec<u32>> {
        let settings = Settings::from(&rendering_beside(&scene.path).raster);
        let gaussian_below = |(frame, &pixel): (&String, &[usize; 2])| {
            let NamedCamera { name, camera, .. } = frame_with_pixel(frames, frame, pixel)?;
            let camera = camera.moved(-scene.ply.origin);
            let projected = Projected::new(&scene.ply.gaussians.splats(), &camera, &settings)?;
            let [x, y] = pixel;
            seed(pixel, &projected).ok_or_else(|| {
                invalid!(argument "--pixel"; found "{x},{y} of {name}, which shows the background";
                    expected "a pixel at least half covered by Gaussians"; help "point at the middle of the thing")
            })
        };
        let pixels = self.frames.iter().zip(&self.pixels);
        pixels.map(gaussian_below).collect()
    }
}

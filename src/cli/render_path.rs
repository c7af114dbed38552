//! Camera paths of `coseg render`.

use super::values::number;
use clap::builder::RangedU64ValueParser;
use clap::{Args, ValueEnum};
use coseg::data::{NamedCamera, Split};
use coseg::error::{Result, bail, ensure};
use coseg::files::{atomic, names, own};
use coseg::runs::{CAMERAS, ObjectScene};
use coseg::splat::camera::Camera;
use coseg::splat::camera_path::{CameraPath, Orbit, is_front_facing, sway};
use coseg::splat::ply::PlyScene;
use glam::DVec3;
use std::path::Path;

/// Frames of a path by default.
const FRAMES: usize = 120;
/// The name of a frame of a path before its number.
const PREFIX: &str = "path_";
/// Their colours in PNG files, for ffmpeg.
pub const PATTERN: &str = "path_%04d.rgb.png";

/// Arguments of a path.
#[derive(Args, Debug)]
pub struct PathArgs {
    /// New views along a path of this kind [default: sway where the cameras look one way, else orbit]
    #[arg(long, value_enum, value_name = "KIND", num_args = 0..=1, default_missing_value = "auto")]
    path: Option<PathKind>,
    /// Frames of the path, evenly spaced [default: 120]
    #[arg(long, value_name = "N", requires = "path", value_parser = RangedU64ValueParser::<usize>::new().range(1..=65_536))]
    frames: Option<usize>,
    /// Orbit this object, an id or a name as `coseg objects` lists them
    #[arg(long, value_name = "OBJECT", requires = "path")]
    object: Option<String>,
    /// Write the frames as film.mp4 too, 30 a second; needs ffmpeg
    #[arg(long, requires = "path")]
    pub film: bool,
    /// Radius of the orbit, world units [default: from the cameras, or from the object's size]
    #[arg(long, value_name = "X", requires = "path", value_parser = parse_radius, allow_negative_numbers = true)]
    radius: Option<f64>,
}

/// Kinds of paths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PathKind {
    // Sway where the cameras look one way, else orbit.
    Auto,
    Interpolate,
    Orbit,
    Sway,
}

fn parse_radius(text: &str) -> std::result::Result<f64, String> {
    number(text, "a number above 0", |radius: &f64| {
        radius.is_finite() && *radius > 0.0
    })
}

impl PathArgs {
    /// Refuses options of an orbit for another path, and a folder `out` with the cameras or frames of something else.
    pub fn check(&self, out: &Path, cameras: &Path) -> Result<()> {
        let Some(kind) = self.path else { return Ok(()) };
        for (flag, is_given) in [
            ("--object", self.object.is_some()),
            ("--radius", self.radius.is_some()),
        ] {
            let orbits = matches!(kind, PathKind::Auto | PathKind::Orbit);
            ensure!(!is_given || orbits, argument "{flag}"; found "a path that is not an orbit";
                expected "--path orbit"; help "leave one of them out");
        }
        let file = out.join(CAMERAS);
        ensure!(!atomic::same_file(&file, cameras), argument "--out"; found "{}", file.display();
            expected "a folder without cameras.json: the cameras of the path go there"; help "name another folder");
        own::check_argument("--out", &file)?;
        // A film of the frames would end with those of the longer path.
        let next = format!("{PREFIX}{:04}.", self.frames.unwrap_or(FRAMES));
        if let Some(left) = names(out, |name, _| name.starts_with(&next)).first() {
            bail!(argument "--out"; found "{}", out.join(left).display();
                expected "a folder without frames of a longer path"; help "remove them, or name another folder");
        }
        Ok(())
    }

    /// The path made from `keys`, if one is wanted, in the scene read from `path`.
    pub fn cameras(
        &self,
        keys: &[NamedCamera],
        path: &Path,
        scene: &PlyScene,
    ) -> Result<Option<Vec<NamedCamera>>> {
        let count = self.frames.unwrap_or(FRAMES);
        let keys: Vec<Camera> = keys.iter().map(|key| key.camera.clone()).collect();
        let Some(kind) = self.path else {
            return Ok(None);
        };
        let center = || {
            let center = scene.gaussians.median_center().unwrap_or_default();
            DVec3::from(center.map(f64::from)) + scene.origin
        };
        let is_orbit = self.object.is_some() || self.radius.is_some() || !is_front_facing(&keys);
        let cameras = match kind {
            PathKind::Interpolate => CameraPath::through(&keys)?.frames(count),
            PathKind::Sway => sway(&keys, center(), count)?,
            PathKind::Auto if !is_orbit => sway(&keys, center(), count)?,
            PathKind::Auto | PathKind::Orbit => {
                let orbit = if let Some(object) = &self.object {
                    let scene = ObjectScene::new(path.to_owned(), scene.clone(), None)?;
                    let (low, high) = scene.bounds(object, "--object")?;
                    Orbit::of_box(&keys, low, high)?
                } else {
                    Orbit::of_cameras(&keys, center())?
                };
                let radius = self.radius.unwrap_or(orbit.radius);
                Orbit { radius, ..orbit }.frames(&keys[0], count)?
            }
        };
        let numbered = |(i, camera)| NamedCamera {
            name: format!("{PREFIX}{i:04}"),
            split: Split::Train,
            camera,
        };
        Ok(Some(
            cameras.into_iter().enumerate().map(numbered).collect(),
        ))
    }
}

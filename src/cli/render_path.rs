//! Paths of cameras that `coseg render` makes from given ones.

use super::object_scene::ObjectScene;
use clap::builder::RangedU64ValueParser;
use clap::{Args, ValueEnum};
use coseg::data::formats::transforms;
use coseg::data::{NamedCamera, Split, atomic};
use coseg::error::{Error, Result};
use coseg::splat::camera::Camera;
use coseg::splat::camera_path::{CameraPath, Orbit};
use glam::DVec3;
use std::path::Path;

/// Frames of a path unless said otherwise.
const FRAMES: usize = 120;
/// What the frames of a path are called, before their number.
const PREFIX: &str = "path_";

/// Arguments that name a path.
#[derive(Args, Debug)]
pub struct PathArgs {
    /// New views: through the cameras, or around what they look at
    #[arg(long, value_enum, value_name = "KIND")]
    pub path: Option<PathKind>,
    /// Frames of the path, evenly spaced [default: 120]
    #[arg(long, value_name = "N", requires = "path", value_parser = RangedU64ValueParser::<usize>::new().range(1..=65_536))]
    frames: Option<usize>,
    /// Orbit this object, an id or a name as `coseg objects` lists them
    #[arg(long, value_name = "OBJECT", requires = "path")]
    pub object: Option<String>,
    /// Radius of the orbit, world units [default: from the cameras, or from the object's size]
    #[arg(long, value_name = "X", requires = "path", value_parser = parse_radius)]
    radius: Option<f64>,
}

/// Kinds of paths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PathKind {
    Interpolate,
    Orbit,
}

fn parse_radius(text: &str) -> std::result::Result<f64, String> {
    let radius = text
        .trim()
        .parse()
        .ok()
        .filter(|radius: &f64| radius.is_finite() && *radius > 0.0);
    radius.ok_or_else(|| "expected a number above 0".into())
}

impl PathArgs {
    /// Neither takes what only an orbit has, nor writes over the cameras of something else in `out`.
    pub fn check(&self, out: &Path, cameras: &Path) -> Result<()> {
        let Some(kind) = self.path else { return Ok(()) };
        for (flag, is_there) in [
            ("--object", self.object.is_some()),
            ("--radius", self.radius.is_some()),
        ] {
            if is_there && kind != PathKind::Orbit {
                return Err(Error::argument(
                    flag,
                    "--path interpolate",
                    "--path orbit",
                    "leave one of them out",
                ));
            }
        }
        let file = out.join("cameras.json");
        let of_path =
            |cameras: &[NamedCamera]| cameras.iter().all(|camera| camera.name.starts_with(PREFIX));
        // A path that this command wrote is a transforms.json.
        let ours = || transforms::load_cameras(&file, None).is_ok_and(|cameras| of_path(&cameras));
        if file.exists() && (atomic::same_file(&file, cameras) || !ours()) {
            let expected =
                "a folder without cameras of its own: those of the path are written there";
            return Err(Error::argument(
                "--out",
                file.display().to_string(),
                expected,
                "name another folder",
            ));
        }
        // A video of the pictures would end with those of the longer path.
        let next = format!("{PREFIX}{:04}.", self.frames.unwrap_or(FRAMES));
        let names = std::fs::read_dir(out).into_iter().flatten().flatten();
        let mut names = names.filter_map(|entry| entry.file_name().into_string().ok());
        if let Some(left) = names.find(|name| name.starts_with(&next)) {
            let expected = "a folder without frames of a longer path";
            let help = "remove them, or name another folder";
            return Err(Error::argument(
                "--out",
                out.join(left).display().to_string(),
                expected,
                help,
            ));
        }
        Ok(())
    }

    /// The path made from `keys`, if there is to be one; `center` is the scene's. `scene` is needed for an object.
    pub fn cameras(
        &self,
        keys: &[NamedCamera],
        center: DVec3,
        scene: Option<&ObjectScene>,
    ) -> Result<Option<Vec<NamedCamera>>> {
        let count = self.frames.unwrap_or(FRAMES);
        let keys: Vec<Camera> = keys.iter().map(|key| key.camera.clone()).collect();
        let cameras = match self.path {
            None => return Ok(None),
            Some(PathKind::Interpolate) => CameraPath::through(&keys)?.frames(count),
            Some(PathKind::Orbit) => {
                let orbit = match (&self.object, scene) {
                    (Some(object), Some(scene)) => {
                        let (low, high) = scene.bounds(object, "--object")?;
                        Orbit::of_box(&keys, low, high)?
                    }
                    _ => Orbit::of_cameras(&keys, center)?,
                };
                let radius = self.radius.unwrap_or(orbit.radius);
                Orbit { radius, ..orbit }.frames(&keys[0], count)?
            }
        };
        let named = |(i, camera)| NamedCamera {
            name: format!("{PREFIX}{i:04}"),
            split: Split::Train,
            camera,
        };
        Ok(Some(cameras.into_iter().enumerate().map(named).collect()))
    }
}

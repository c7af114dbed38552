//! The Gaussians and cameras that are measured.

use super::{Effort, resampled};
use crate::config::Config;
use crate::data::builtin::{self, BuiltinOptions};
use crate::data::formats::transforms::write_cameras;
use crate::data::{Limits, NamedCamera, Scene, Split, read_cameras};
use crate::error::{Error, Result};
use crate::pipeline::load_scene;
use crate::reconstruction::Trainer;
use crate::splat::camera::Camera;
use crate::splat::{Gaussians, ply};
use burn::tensor::Device;
use glam::DVec3;
use std::path::{Path, PathBuf};

/// Where Gaussians and cameras come from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Source {
    /// The scene that the settings name, with the Gaussians that training would start from.
    #[default]
    Untrained,
    /// The scene that the settings name, with these trained Gaussians, a 3DGS PLY.
    Trained(PathBuf),
    /// Trained Gaussians and cameras, without photos.
    Files {
        /// The Gaussians, a 3DGS PLY.
        scene: PathBuf,
        /// The cameras, as [`read_cameras`] reads them; those of split `train` are used.
        cameras: PathBuf,
    },
}

/// Opacity logit of Gaussians that are not trained: 0.9, so that surfaces hide what is behind them.
const UNTRAINED_OPACITY: f32 = 2.2;

/// What is measured.
pub struct Subject {
    /// In words, for tables.
    pub description: String,
    /// Photos and labels; absent with [`Source::Files`].
    pub scene: Option<Scene>,
    /// Training cameras, in the coordinates of the Gaussians.
    pub cameras: Vec<Camera>,
    /// Whether the Gaussians are trained.
    pub trained: bool,
    /// The Gaussians, of any number.
    pub own: Gaussians,
    seed: u64,
}

impl Subject {
    /// Loads what `source` and `config` name. `small` replaces the built-in room by a few tiny views of it.
    ///
    /// # Errors
    /// Those of the loaders; [`Error::Input`] for a PLY without Gaussians.
    pub fn load(source: &Source, config: &Config, small: bool, device: &Device) -> Result<Self> {
        let (scene, own, cameras) = match source {
            Source::Untrained => {
                let scene = load(config, small)?;
                let mut own = Trainer::new(&scene, config, device)?.gaussians()?;
                own.opacity_logits.fill(UNTRAINED_OPACITY);
                let cameras = training_cameras(&scene);
                (Some(scene), own, cameras)
            }
            Source::Trained(path) => {
                let (own, origin) = trained(path)?;
                let scene = load(config, small)?.with_origin(origin);
                let cameras = training_cameras(&scene);
                (Some(scene), own, cameras)
            }
            Source::Files { scene, cameras } => {
                let (own, origin) = trained(scene)?;
                let named = read_cameras(cameras, Some(Split::Train))?;
                let moved = named.into_iter().map(|named| Camera {
                    center: named.camera.center - origin,
                    ..named.camera
                });
                (None, own, moved.collect())
            }
        };
        if cameras.is_empty() {
            let expected = "a scene with training views";
            let help = "mark some views as `train`";
            return Err(Error::argument("data", "no training views", expected, help));
        }
        let description = match (source, &scene) {
            (Source::Trained(path) | Source::Files { scene: path, .. }, _) => {
                format!("{}, {} trained Gaussians", path.display(), own.len())
            }
            (_, Some(scene)) => format!("{}, not trained: initial Gaussians", scene.name),
            _ => String::new(),
        };
        Ok(Self {
            description,
            scene,
            cameras,
            trained: *source != Source::Untrained,
            own,
            seed: config.seed,
        })
    }

    /// The scene with about `count` Gaussians, in spatial order: see [`resampled`].
    pub fn gaussians(&self, count: usize) -> Gaussians {
        resampled(&self.own, count, self.seed)
    }

    /// `count` of the cameras, evenly chosen and cycled where there are fewer, cut and scaled to `width` x `height`.
    pub fn cameras(&self, count: usize, [width, height]: [usize; 2]) -> Vec<Camera> {
        let n = self.cameras.len();
        let place = |i: usize| if count < n { i * n / count } else { i % n };
        (0..count)
            .map(|i| fitted(&self.cameras[place(i)], width, height))
            .collect()
    }

    /// Writes what section `raster` renders into `dir`, for other renderers: `gaussians_N.ply` for each number N in
    /// `effort`, `cameras_WxH.json` for each size. Returns the paths.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn export(&self, dir: &Path, effort: &Effort) -> Result<Vec<PathBuf>> {
        let mut written = Vec::new();
        for &count in &effort.gaussians {
            let gaussians = self.gaussians(count);
            let path = dir.join(format!("gaussians_{}.ply", gaussians.len()));
            ply::write(&path, &gaussians, DVec3::ZERO, None)?;
            written.push(path);
        }
        for [width, height] in [effort.size, effort.large_size] {
            let cameras = self.cameras(effort.views, [width, height]);
            let named = cameras
                .into_iter()
                .enumerate()
                .map(|(i, camera)| NamedCamera {
                    name: format!("view_{i}"),
                    split: Split::Train,
                    camera,
                });
            let path = dir.join(format!("cameras_{width}x{height}.json"));
            write_cameras(&path, &named.collect::<Vec<_>>())?;
            written.push(path);
        }
        Ok(written)
    }
}

fn load(config: &Config, small: bool) -> Result<Scene> {
    if small && config.data.dir.is_none() {
        builtin::scene_with(&BuiltinOptions {
            width: 64,
            height: 48,
            train_views: 6,
            test_views: 1,
            points: 400,
            ..Default::default()
        })
    } else {
        load_scene(config)
    }
}

fn training_cameras(scene: &Scene) -> Vec<Camera> {
    scene
        .split(Split::Train)
        .map(|view| view.camera.clone())
        .collect()
}

fn trained(path: &Path) -> Result<(Gaussians, DVec3)> {
    let scene = ply::read(path, &Limits::default())?;
    if scene.gaussians.is_empty() {
        let help = "give a trained scene";
        return Err(Error::input(
            path,
            "element vertex",
            "no Gaussians",
            "at least one",
            help,
        ));
    }
    Ok((scene.gaussians, scene.origin))
}

/// The camera with its image scaled and cut to `width` x `height`, so that pixels keep their shape.
fn fitted(camera: &Camera, width: usize, height: usize) -> Camera {
    let (w, h) = (camera.width.max(1) as f64, camera.height.max(1) as f64);
    let scale = (width as f64 / w).max(height as f64 / h);
    Camera {
        fx: camera.fx * scale,
        fy: camera.fy * scale,
        cx: camera.cx * scale - (w * scale - width as f64) / 2.0,
        cy: camera.cy * scale - (h * scale - height as f64) / 2.0,
        width,
        height,
        ..camera.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    #[test]
    fn cameras_are_cut_not_stretched() {
        let (rotation, center) = (DMat3::IDENTITY, DVec3::ZERO);
        let tall = Camera {
            rotation,
            center,
            fx: 300.0,
            fy: 300.0,
            cx: 135.0,
            cy: 240.0,
            width: 270,
            height: 480,
        };
        let wide = fitted(&tall, 480, 360);
        assert!((wide.fx - wide.fy).abs() < 1e-9);
        assert!((wide.cx - 240.0).abs() < 1e-9 && (wide.cy - 180.0).abs() < 1e-9);
        assert_eq!(fitted(&tall, 270, 480), tall);
    }
}

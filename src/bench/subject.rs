//! The Gaussians and cameras that are measured.

use super::resample::resampled;
use super::surfels::Surfaces;
use crate::config::Config;
use crate::data::builtin::{self, BuiltinOptions};
use crate::data::{Limits, Scene, Split, read_cameras};
use crate::error::{Error, Result};
use crate::pipeline::load_scene;
use crate::reconstruction::BuildingStage;
use crate::splat::camera::{Camera, level_up};
use crate::splat::{Gaussians, ply};
use burn::tensor::Device;
use glam::DVec3;
use std::path::{Path, PathBuf};

/// Where Gaussians and cameras come from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Source {
    /// The scene that the settings name, its Gaussians made without training.
    #[default]
    Untrained,
    /// The scene that the settings name and these trained Gaussians of it, a 3DGS PLY.
    Trained(PathBuf),
    /// Trained Gaussians and cameras, without photos: a 3DGS PLY and what [`read_cameras`] reads.
    Files {
        /// The Gaussians.
        scene: PathBuf,
        /// The cameras; those of split `train` are used.
        cameras: PathBuf,
    },
}

enum Origin {
    Trained(Gaussians),
    Cloud(Gaussians),
    Room(Surfaces),
}

/// What is measured.
pub struct Subject {
    /// In words, for tables.
    pub description: String,
    /// Photos and labels; absent when only Gaussians and cameras were given.
    pub scene: Option<Scene>,
    /// Training cameras, in the coordinates of the Gaussians.
    pub cameras: Vec<Camera>,
    /// Direction that points up.
    pub up: DVec3,
    origin: Origin,
    sh_degree: usize,
    seed: u64,
}

impl Subject {
    /// Loads what `source` and `config` name. `small` replaces the built-in room by a few tiny views of it.
    ///
    /// # Errors
    /// Those of the loaders; [`Error::Input`] for a PLY without Gaussians.
    pub fn load(source: &Source, config: &Config, small: bool, device: &Device) -> Result<Self> {
        if let Source::Files { scene, cameras } = source {
            return Self::of_files(scene, cameras, config);
        }
        let mut scene = match &config.data.dir {
            None if small => {
                let options = BuiltinOptions {
                    width: 64,
                    height: 48,
                    train_views: 6,
                    test_views: 1,
                    ..Default::default()
                };
                builtin::scene_with(&BuiltinOptions {
                    points: 400,
                    ..options
                })?
            }
            _ => load_scene(config)?,
        };
        let (description, origin) = match source {
            Source::Trained(path) => {
                let (gaussians, origin) = trained(path)?;
                scene = scene.with_origin(origin);
                (of_trained(path, &gaussians), Origin::Trained(gaussians))
            }
            _ if config.data.dir.is_none() => {
                let text = "the built-in room, surfels on its surfaces, made without training";
                (text.to_owned(), Origin::Room(Surfaces::new(&scene)))
            }
            _ => {
                let gaussians = BuildingStage::new(&scene, config, device)?.gaussians()?;
                let text = format!(
                    "{}, its initial {} Gaussians, not trained",
                    scene.name,
                    gaussians.len()
                );
                (text, Origin::Cloud(gaussians))
            }
        };
        let cameras: Vec<Camera> = scene
            .split(Split::Train)
            .map(|v| v.camera.clone())
            .collect();
        if cameras.is_empty() {
            let found = format!("{} without training views", scene.name);
            return Err(Error::argument(
                "data",
                found,
                "a scene with training views",
                "mark some views as `train`",
            ));
        }
        let (up, sh_degree) = (scene.up, config.building.sh_degree);
        Ok(Self {
            description,
            scene: Some(scene),
            cameras,
            up,
            origin,
            sh_degree,
            seed: config.seed,
        })
    }

    fn of_files(scene: &Path, cameras: &Path, config: &Config) -> Result<Self> {
        let named = read_cameras(cameras, Some(Split::Train))?;
        let (gaussians, origin) = trained(scene)?;
        let cameras: Vec<Camera> = named
            .into_iter()
            .map(|n| Camera {
                center: n.camera.center - origin,
                ..n.camera
            })
            .collect();
        let up = level_up(&cameras);
        Ok(Self {
            description: of_trained(scene, &gaussians),
            scene: None,
            cameras,
            up,
            sh_degree: gaussians.sh_degree,
            origin: Origin::Trained(gaussians),
            seed: config.seed,
        })
    }

    /// Number of the trained Gaussians, where they are trained.
    pub fn trained(&self) -> Option<usize> {
        match &self.origin {
            Origin::Trained(gaussians) => Some(gaussians.len()),
            _ => None,
        }
    }

    /// `count` Gaussians of the scene; trained ones are resampled to that number.
    ///
    /// # Errors
    /// [`Error::Limit`] beyond what a scene can hold.
    pub fn gaussians(&self, count: usize) -> Result<Gaussians> {
        let gaussians = match &self.origin {
            Origin::Room(surfaces) => surfaces.gaussians(count, self.sh_degree, self.seed)?,
            Origin::Trained(gaussians) | Origin::Cloud(gaussians) => {
                resampled(gaussians, count, self.seed)
            }
        };
        Ok(gaussians.select(&gaussians.spatial_order()))
    }

    /// `count` of the cameras, evenly chosen and cycled where there are fewer, cut and scaled to `width` x `height`.
    pub fn cameras(&self, count: usize, [width, height]: [usize; 2]) -> Vec<Camera> {
        let n = self.cameras.len();
        let place = |i: usize| if count < n { i * n / count } else { i % n };
        (0..count)
            .map(|i| fitted(&self.cameras[place(i)], width, height))
            .collect()
    }

    /// Largest distance of a camera from the mean camera, world units.
    pub fn extent(&self) -> f64 {
        let mean =
            self.cameras.iter().map(|c| c.center).sum::<DVec3>() / self.cameras.len().max(1) as f64;
        self.cameras
            .iter()
            .map(|c| c.center.distance(mean))
            .fold(0.0, f64::max)
    }
}

fn of_trained(path: &Path, gaussians: &Gaussians) -> String {
    format!(
        "{}, {} trained Gaussians, resampled where another number is stated",
        path.display(),
        gaussians.len()
    )
}

fn trained(path: &Path) -> Result<(Gaussians, DVec3)> {
    let scene = ply::read(path, &Limits::default())?;
    if scene.gaussians.is_empty() {
        return Err(Error::input(
            path,
            "element vertex",
            "no Gaussians",
            "at least one",
            "give a trained scene",
        ));
    }
    Ok((scene.gaussians, scene.origin))
}

/// The camera with the middle of its image scaled to fill `width` x `height`; pixels stay square where they are.
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

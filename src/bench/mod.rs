//! Measurements that `coseg bench` prints: speed against error, times of the stages, memory.
//!
//! A [`Bench`] holds the scene. [`Bench::curve`] and [`Bench::stages`] measure it with any number of Gaussians.

mod curve;
mod figures;
mod machine;
mod resample;
mod stages;

pub use self::figures::{Figure, Figures};
pub use self::machine::Machine;
pub use self::resample::resampled;

use crate::config::Config;
use crate::data::{Scene, Split};
use crate::error::{Result, ensure};
use crate::pipeline::load_scene;
use crate::reconstruction::Trainer;
use crate::splat::Gaussians;
use crate::splat::ply::PlyScene;
use burn::tensor::Device;

/// Opacity logit of Gaussians that are not trained: 0.9, so that surfaces hide what is behind them.
const UNTRAINED_OPACITY: f32 = 2.2;

/// The scene to measure, and the number of repetitions.
pub struct Bench {
    /// Settings of the rasterizer and of both stages.
    pub config: Config,
    /// The training views.
    pub scene: Scene,
    /// The trained Gaussians, or those that training starts from.
    pub gaussians: Gaussians,
    /// Whether the Gaussians are trained.
    pub trained: bool,
    /// Where tensors live; without autodiff.
    pub device: Device,
    /// Measured passes behind a median.
    pub repeats: usize,
}

impl Bench {
    /// Loads the scene that `config` names. Without `trained` Gaussians it takes those that training starts from.
    ///
    /// # Errors
    /// Those of the loader; [`crate::Error::Argument`] for a scene without training views.
    pub fn load(
        config: Config,
        trained: Option<PlyScene>,
        device: Device,
        repeats: usize,
    ) -> Result<Self> {
        let mut scene = load_scene(&config)?;
        scene.views.retain(|view| view.split == Split::Train);
        ensure!(!scene.views.is_empty(), argument "data"; found "no training view"; expected "one or more";
            help "mark some views as `train`");
        let is_trained = trained.is_some();
        let gaussians = match trained {
            Some(ply) => {
                scene = scene.with_origin(ply.origin);
                ply.gaussians
            }
            None => {
                let mut initial = Trainer::new(&scene, &config, &device)?.gaussians()?;
                initial.opacity_logits.fill(UNTRAINED_OPACITY);
                initial
            }
        };
        Ok(Self {
            config,
            scene,
            gaussians,
            trained: is_trained,
            device,
            repeats,
        })
    }

    /// The scene in a few words.
    pub fn subject(&self) -> String {
        let kind = if self.trained { "trained" } else { "initial" };
        let name = &self.scene.name;
        let count = self.gaussians.len();
        format!("{name}, {count} {kind} Gaussians")
    }

    /// Time against error of the rasterizer's settings, with about `count` Gaussians: forward, and forward and backward.
    ///
    /// # Errors
    /// Those of rendering; [`crate::Error::Limit`] for more Gaussians than the device holds.
    pub fn curve(&self, count: usize) -> Result<Vec<Figures>> {
        curve::measure(self, &resampled(&self.gaussians, count, self.config.seed))
    }

    /// Times and peak memory of both stages, with about `count` Gaussians.
    ///
    /// # Errors
    /// Those of the stages; [`crate::Error::Limit`] for more Gaussians than the device holds.
    pub fn stages(&self, count: usize) -> Result<Figures> {
        stages::measure(self, &resampled(&self.gaussians, count, self.config.seed))
    }
}

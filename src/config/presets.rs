//! The named sets of defaults.

use super::{Blend, Config, Encode, LabelLoss, LabelSource, Normalisation, Preset, Prior, Resolution};

/// What the built-in scene needs to be done in five minutes on two cores, as `--set` would give it.
pub const BUILTIN_SCENE: [&str; 4] = [
    "building.iterations=2400",
    "building.max_gaussians=25000",
    "segmentation.iterations=2000",
    "segmentation.pixel_share=0.25",
];

impl Config {
    /// All settings of a preset; a config file and `--set` override single keys of it.
    pub fn preset(preset: Preset) -> Self {
        let mut config = Self { preset, ..Self::default() };
        match preset {
            Preset::Default => {}
            Preset::Paper => {
                config.raster.alpha_max = 0.99;
                config.building.iterations = 6_000;
                config.building.random_background = false;
                config.building.absgrad = false;
                config.unprojection.normalisation = Normalisation::Count;
                config.unprojection.resolution = Resolution::Feature;
                config.unprojection.attendance_pixels = 0.0;
                config.spatial.encode = Encode::View;
                config.segmentation.iterations = 6_000;
                config.segmentation.blend = Blend::Logits;
                config.segmentation.prior = Prior::None;
                config.segmentation.loss = LabelLoss::Js;
                config.segmentation.pi_rl = 0.9;
                config.segmentation.warmup = 0.0;
                config.segmentation.least_recall = 0.0;
                config.segmentation.average = false;
                config.segmentation.render = LabelSource::Scores;
                config.segmentation.standardise = false;
                config.segmentation.lr_decay = false;
                config.segmentation.lr = 1e-3;
            }
            Preset::Fast => {
                config.segmentation.pixel_share = 0.25;
                config.segmentation.weight_cache_mb = 8_192;
            }
        }
        config
    }
}

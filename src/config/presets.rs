//! The named sets of defaults.

use super::{
    Blend, Budget, Config, Encode, FeatureSource, LabelLoss, LabelSource, Normalisation, Preset,
    Prior, Reduction, SCALES, SizeRule,
};

impl Config {
    /// All settings of a preset; a config file and `--set` override single keys of it.
    pub fn preset(preset: Preset) -> Self {
        Self::default().changed_by(preset)
    }

    /// The same for the built-in scene, whose first stage is shorter. The paper's preset is the same for every scene.
    pub fn builtin_preset(preset: Preset) -> Self {
        let mut config = Self::default();
        if preset != Preset::Paper {
            config.building.iterations = 2_400;
        }
        config.changed_by(preset)
    }

    /// Where `preset` departs from defaults.
    fn changed_by(self, preset: Preset) -> Self {
        let mut config = Self { preset, ..self };
        match preset {
            Preset::Default => {}
            Preset::Paper => {
                config.raster.alpha_max = 0.99;
                config.building.iterations = 6_000;
                config.building.max_gaussians = Budget::Unlimited;
                config.building.random_background = false;
                config.building.absgrad = false;
                config.building.size_limit = SizeRule::Extent;
                config.features.source = FeatureSource::Dino;
                config.features.scales = Some(SCALES);
                config.unprojection.normalisation = Normalisation::Count;
                config.unprojection.attendance_pixels = 0.0;
                config.spatial.encode = Encode::View;
                config.segmentation.iterations = 6_000;
                config.segmentation.blend = Blend::Logits;
                config.segmentation.prior = Some(Prior::None);
                config.segmentation.loss = Some(LabelLoss::Js { pi_rl: 0.9 });
                config.segmentation.reduction = Reduction::Sum;
                config.segmentation.warmup = 0.0;
                config.segmentation.average = false;
                config.segmentation.render = LabelSource::Scores;
                config.segmentation.standardise = false;
                config.segmentation.lr_decay = false;
                config.segmentation.lr = 1e-3;
                config.segmentation.pixel_share = Some(1.0);
            }
        }
        config
    }
}

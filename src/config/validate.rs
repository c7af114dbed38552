//! Allowed ranges of every setting.

use super::{
    Blend, BuildingConfig, Config, FeatureSource, GCE_EXPONENTS, NO_MASKS, Prior, SpatialSource,
    Strategy, same_folder,
};
use crate::error::{Error, Result};

/// Collects the checks of one config; the first failure wins.
struct Check(Result<()>);

impl Check {
    fn that(
        &mut self,
        ok: bool,
        key: &str,
        found: impl std::fmt::Display,
        expected: &str,
        help: &str,
    ) {
        if self.0.is_ok() && !ok {
            self.0 = Err(Error::config(key, found.to_string(), expected, help));
        }
    }

    fn positive(&mut self, key: &str, value: usize) {
        self.that(
            value > 0,
            key,
            value,
            "a whole number above 0",
            "give at least 1",
        );
    }

    /// Above zero and finite.
    fn rate(&mut self, key: &str, value: f64) {
        let help = "leave the key out for the default";
        self.that(
            value > 0.0 && value.is_finite(),
            key,
            value,
            "a finite number above 0",
            help,
        );
    }

    /// Finite and not negative.
    fn amount(&mut self, key: &str, value: f64) {
        let help = "leave the key out for the default";
        self.that(
            value >= 0.0 && value.is_finite(),
            key,
            value,
            "a finite number of 0 or more",
            help,
        );
    }

    /// `low` to `high`, both allowed.
    fn within(&mut self, key: &str, value: f64, low: f64, high: f64) {
        let (expected, help) = (
            format!("a number from {low} to {high}"),
            "leave the key out for the default",
        );
        self.that(value >= low && value <= high, key, value, &expected, help);
    }

    /// Strictly between 0 and 1.
    fn open_share(&mut self, key: &str, value: f64) {
        let help = "leave the key out for the default";
        self.that(
            value > 0.0 && value < 1.0,
            key,
            value,
            "a number above 0 and below 1",
            help,
        );
    }

    /// Above 0, 1 allowed.
    fn share(&mut self, key: &str, value: f64) {
        let help = "leave the key out for the default";
        self.that(
            value > 0.0 && value <= 1.0,
            key,
            value,
            "a number above 0, at most 1",
            help,
        );
    }
}

impl Config {
    /// Checks that every value is in its allowed range and that values that need each other are there.
    ///
    /// # Errors
    /// [`Error::Config`] for the first value that is not.
    pub fn validate(&self) -> Result<()> {
        let mut check = Check(Ok(()));
        let largest_seed = i64::MAX as u64;
        check.that(
            self.seed <= largest_seed,
            "seed",
            self.seed,
            "at most 2^63 - 1",
            "choose a smaller seed",
        );
        check.positive("data.stride", self.data.stride);
        let help = "leave the key out for the default";
        let most = "whole megabytes, at most 2^24";
        check.that(
            self.data.decoded_mb <= 1 << 24,
            "data.decoded_mb",
            self.data.decoded_mb,
            most,
            help,
        );
        self.validate_masks(&mut check);
        self.building.check(&mut check);
        self.validate_raster(&mut check);
        self.validate_association(&mut check);
        self.validate_features(&mut check);
        self.validate_segmentation(&mut check);
        check.0
    }

    /// Photos and label maps would pass for masks.
    fn validate_masks(&self, check: &mut Check) {
        let d = &self.data;
        let given = !d.masks.is_empty() && d.masks != NO_MASKS;
        let same = given
            && [&d.images, &d.raw_labels]
                .into_iter()
                .any(|other| same_folder(other, &d.masks));
        let expected = "a folder other than data.images and data.raw_labels";
        check.that(
            !same,
            "data.masks",
            &d.masks,
            expected,
            "name the folder of masks, or leave the key out",
        );
    }

    fn validate_raster(&self, check: &mut Check) {
        let r = &self.raster;
        check.share("raster.alpha_max", r.alpha_max);
        check.within("raster.alpha_min", r.alpha_min, 0.0, 1.0);
        check.within("raster.t_min", r.t_min, 0.0, 1.0);
        check.rate("raster.near", r.near);
        check.amount("raster.low_pass", r.low_pass);
        for channel in r.background {
            check.within("raster.background", channel.into(), 0.0, 1.0);
        }
    }

    fn validate_association(&self, check: &mut Check) {
        let a = &self.association;
        check.positive("association.sweeps", a.sweeps);
        check.share("association.min_overlap", a.min_overlap);
        check.within("association.merge_above", a.merge_above, 0.0, 1.0);
        check.within("association.min_weight", a.min_weight, 0.0, 1.0);
    }

    fn validate_features(&self, check: &mut Check) {
        let f = &self.features;
        check.positive("features.dimensions", f.dimensions);
        for (source, expected) in [
            (
                FeatureSource::Mobilenetv2,
                "a path to MobileNetV2 weights, because features.source = \"mobilenetv2\"",
            ),
            (
                FeatureSource::Dino,
                "a path to DINO weights, because features.source = \"dino\"",
            ),
        ] {
            let needs_weights = f.source == source && f.weights.is_none();
            let help = "give it, or set features.source = \"auto\"";
            check.that(
                !needs_weights,
                "features.weights",
                "nothing",
                expected,
                help,
            );
        }
        let needs_maps = f.source == FeatureSource::Import && f.import_dir.is_none();
        let expected = "a folder of feature maps, because features.source = \"import\"";
        check.that(
            !needs_maps,
            "features.import_dir",
            "nothing",
            expected,
            "give it, or set features.source = \"auto\"",
        );
        let u = &self.unprojection;
        check.within("unprojection.attendance", u.attendance, 0.0, 1.0);
        check.amount("unprojection.attendance_pixels", u.attendance_pixels);
        let s = &self.spatial;
        check.amount("spatial.scale", s.scale);
        let needs_weights = s.source == SpatialSource::Pretrained && s.weights.is_none();
        let expected = "a path to RandLA-Net weights, because spatial.source = \"pretrained\"";
        check.that(
            !needs_weights,
            "spatial.weights",
            "nothing",
            expected,
            "give it, or set spatial.source = \"builtin\"",
        );
    }

    fn validate_segmentation(&self, check: &mut Check) {
        let s = &self.segmentation;
        check.positive("segmentation.iterations", s.iterations);
        for (i, row) in s.rows().iter().enumerate() {
            let twice = s.rows()[..i].contains(row);
            check.that(
                !twice,
                "segmentation.rows",
                format!("{row} twice"),
                "each row once",
                "leave the second one out",
            );
        }
        check.rate("segmentation.lr", s.lr);
        check.rate("segmentation.lr_per_gaussian", s.lr_per_gaussian);
        check.that(
            s.prior == Prior::None || s.blend == Blend::Probabilities,
            "segmentation.prior",
            "votes",
            "none where logits are blended",
            "set segmentation.blend = \"probabilities\", or segmentation.prior = \"none\"",
        );
        check.within(
            "segmentation.gce_exponent",
            s.gce_exponent,
            GCE_EXPONENTS[0],
            GCE_EXPONENTS[1],
        );
        check.open_share("segmentation.pi_rl", s.pi_rl);
        check.open_share("segmentation.gjs_dropout", s.gjs_dropout);
        check.amount("segmentation.lambda_pix", s.lambda_pix);
        check.amount("segmentation.lambda_reg", s.lambda_reg);
        check.within("segmentation.warmup", s.warmup, 0.0, 1.0);
        check.within("segmentation.least_recall", s.least_recall, 0.0, 1.0);
        check.within("segmentation.min_coverage", s.min_coverage, 0.0, 1.0);
        check.share("segmentation.pixel_share", s.pixel_share);
        check.positive("segmentation.reg_samples", s.reg_samples);
        check.positive("segmentation.reg_neighbours", s.reg_neighbours);
    }
}

impl BuildingConfig {
    /// [`Config::validate`] of stage one alone.
    ///
    /// # Errors
    /// [`Error::Config`] for the first value that is out of range.
    pub fn validate(&self) -> Result<()> {
        let mut check = Check(Ok(()));
        self.check(&mut check);
        check.0
    }

    fn check(&self, check: &mut Check) {
        if self.gaussians.is_none() {
            check.positive("building.iterations", self.iterations);
        }
        let most = u32::MAX as usize;
        check.that(
            self.iterations <= most,
            "building.iterations",
            self.iterations,
            "fewer than 2^32",
            "give fewer",
        );
        check.that(
            self.sh_degree <= 3,
            "building.sh_degree",
            self.sh_degree,
            "0, 1, 2 or 3",
            "3 is the usual choice",
        );
        check.within("building.ssim_weight", self.ssim_weight.into(), 0.0, 1.0);
        for (key, rate) in [
            ("building.lr_means", self.lr_means),
            ("building.lr_sh_dc", self.lr_sh_dc),
            ("building.lr_sh_rest", self.lr_sh_rest),
            ("building.lr_opacity", self.lr_opacity),
            ("building.lr_scales", self.lr_scales),
            ("building.lr_rotations", self.lr_rotations),
        ] {
            check.amount(key, rate);
        }
        // The end of an exponential.
        check.rate("building.lr_means_final", self.lr_means_final);
        check.positive("building.densify_every", self.densify_every);
        check.within(
            "building.densify_until",
            self.densify_until().into(),
            0.0,
            1.0,
        );
        check.amount(
            "building.densify_threshold",
            self.densify_threshold().into(),
        );
        check.amount("building.clone_below", self.clone_below.into());
        check.within(
            "building.prune_opacity",
            self.prune_opacity.into(),
            0.0,
            1.0,
        );
        check.rate("building.prune_scale", self.prune_scale.into());
        check.positive("building.reset_every", self.reset_every);
        check.positive("building.random_points", self.random_points);
        self.check_strategy(check);
    }

    fn check_strategy(&self, check: &mut Check) {
        let m = &self.mcmc;
        check.that(
            self.strategy != Strategy::Mcmc || self.max_gaussians > 0,
            "building.max_gaussians",
            self.max_gaussians,
            "the number of Gaussians to grow to, because building.strategy = \"mcmc\"",
            "give it, such as 100_000",
        );
        check.amount("building.mcmc.noise", m.noise);
        check.amount("building.mcmc.noise_sharpness", m.noise_sharpness);
        check.within("building.mcmc.noise_opacity", m.noise_opacity, 0.0, 1.0);
        check.amount("building.mcmc.growth", m.growth);
        check.amount("building.mcmc.opacity_reg", m.opacity_reg);
        check.amount("building.mcmc.scale_reg", m.scale_reg);
        check.open_share("building.mcmc.init_opacity", m.init_opacity.into());
        check.rate("building.mcmc.init_scale", m.init_scale.into());
    }
}

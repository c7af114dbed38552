//! Settings that somebody gave and that nothing reads, because another one says so.

use super::{
    Association, BuildingConfig, Config, FeatureSource, LabelLoss, Layout, Resolution,
    SpatialSource, Strategy, Variant,
};
use serde_json::Value;
use std::collections::BTreeMap;

/// Keys that nothing reads where `unread` holds. One that ends in a dot is a whole section.
struct Rule {
    unread: bool,
    why: &'static str,
    keys: &'static [&'static str],
}

fn rule(unread: bool, why: &'static str, keys: &'static [&'static str]) -> Rule {
    Rule { unread, why, keys }
}

impl Rule {
    fn covers(&self, key: &str) -> bool {
        self.keys
            .iter()
            .any(|covered| key == *covered || covered.ends_with('.') && key.starts_with(covered))
    }
}

impl Config {
    /// Sentences on the settings that no part of a run reads, as far as other settings tell, one for each cause. A setting that
    /// has the default of its preset is not told of: the `config.toml` of a run lists what nobody gave.
    pub fn unread(&self) -> Vec<String> {
        let mut given = self.given();
        let mut told = Vec::new();
        for rule in [
            self.of_data(),
            self.of_building(),
            self.of_features(),
            self.of_segmentation(),
        ]
        .into_iter()
        .flatten()
        {
            if !rule.unread {
                continue;
            }
            let unread: Vec<String> = given
                .extract_if(.., |key, _| rule.covers(key))
                .map(|(key, value)| format!("{key} = {value}"))
                .collect();
            let verb = if unread.len() == 1 { "is" } else { "are" };
            if !unread.is_empty() {
                told.push(format!(
                    "{} {verb} not read: {}",
                    unread.join(", "),
                    rule.why
                ));
            }
        }
        if let (Some(factor), [_]) = (
            given.get("segmentation.lr_trials"),
            &self.segmentation.lr_trials[..],
        ) {
            told.push(format!(
                "segmentation.lr_trials = {factor} tries nothing: one factor multiplies the learning rates of all rows; give \
                 two or more, or set segmentation.lr"
            ));
        }
        told
    }

    /// The settings that have another value than in their preset, for the built-in scene or others.
    fn given(&self) -> BTreeMap<String, String> {
        let mut given = values(self, &self.building);
        for usual in [Self::preset(self.preset), Self::builtin_preset(self.preset)] {
            let usual = values(&usual, &self.building);
            given.retain(|key, value| usual.get(key) != Some(value));
        }
        // What others are not read for.
        given.remove("segmentation.rows");
        // Goes with Gaussians of a file, which all come back.
        if self.building.gaussians.is_some() && self.unprojection.attendance == 0.0 {
            given.remove("unprojection.attendance");
        }
        given
    }

    fn of_data(&self) -> Vec<Rule> {
        let d = &self.data;
        let other = |layout| d.layout != Layout::Auto && d.layout != layout;
        vec![
            rule(
                d.dir.is_none(),
                "the run is of the built-in scene, as neither --data nor data.dir names a folder",
                &[
                    "data.layout",
                    "data.transforms",
                    "data.images",
                    "data.raw_labels",
                    "data.masks",
                    "data.raw_format",
                    "data.stride",
                    "data.max_frames",
                    "data.max_side",
                    "data.decoded_mb",
                    "data.scannet_classes",
                    "data.scannet_labels",
                ],
            ),
            rule(
                other(Layout::Transforms),
                "data.layout is not transforms",
                &["data.transforms"],
            ),
            rule(
                other(Layout::Colmap),
                "data.layout is not colmap",
                &["data.images"],
            ),
            rule(
                other(Layout::Scannet),
                "data.layout is not scannet",
                &["data.scannet_classes", "data.scannet_labels"],
            ),
            rule(
                d.association == Association::None,
                "data.association is none",
                &["association."],
            ),
        ]
    }

    fn of_building(&self) -> Vec<Rule> {
        let b = &self.building;
        vec![
            rule(
                b.iterations == 0,
                "the Gaussians are taken as they are, as building.iterations is 0",
                // All of the section but where they come from.
                &[
                    "building.sh_degree",
                    "building.ssim_weight",
                    "building.lr_means",
                    "building.lr_means_final",
                    "building.lr_sh_dc",
                    "building.lr_sh_rest",
                    "building.lr_opacity",
                    "building.lr_scales",
                    "building.lr_rotations",
                    "building.strategy",
                    "building.densify_every",
                    "building.densify_from",
                    "building.densify_until",
                    "building.densify_threshold",
                    "building.absgrad",
                    "building.random_background",
                    "building.clone_below",
                    "building.prune_opacity",
                    "building.prune_scale",
                    "building.reset_every",
                    "building.max_gaussians",
                    "building.random_points",
                    "building.eval_every",
                    "building.checkpoint_every",
                    "building.mcmc.",
                ],
            ),
            rule(
                b.strategy == Strategy::Mcmc,
                "building.strategy is mcmc",
                &[
                    "building.absgrad",
                    "building.densify_threshold",
                    "building.clone_below",
                    "building.prune_scale",
                    "building.reset_every",
                ],
            ),
            rule(
                b.strategy == Strategy::Adc,
                "building.strategy is adc",
                &["building.mcmc."],
            ),
            rule(
                b.mcmc.noise == 0.0,
                "building.mcmc.noise is 0",
                &[
                    "building.mcmc.noise_sharpness",
                    "building.mcmc.noise_opacity",
                ],
            ),
            rule(
                b.gaussians.is_some(),
                "the run begins with building.gaussians",
                &[
                    "building.random_points",
                    "building.mcmc.init_opacity",
                    "building.mcmc.init_scale",
                ],
            ),
            rule(
                self.data.dir.is_none(),
                "the built-in scene has points",
                &["building.random_points"],
            ),
        ]
    }

    fn of_features(&self) -> Vec<Rule> {
        let (f, u) = (&self.features, &self.unprojection);
        vec![
            rule(
                matches!(f.source, FeatureSource::Descriptor | FeatureSource::Import),
                "features.source is descriptor or import",
                &["features.weights"],
            ),
            rule(
                f.source != FeatureSource::Import,
                "features.source is not import",
                &["features.import_dir"],
            ),
            rule(
                f.source == FeatureSource::Import,
                "features.source is import",
                &["features.cache_dir"],
            ),
            rule(
                f.source != FeatureSource::Dino,
                "features.source is not dino",
                &["features.final_norm"],
            ),
            rule(
                self.spatial.source != SpatialSource::Pretrained,
                "spatial.source is not pretrained",
                &["spatial.weights"],
            ),
            rule(
                u.solve_iterations == 0,
                "unprojection.solve_iterations is 0",
                &["unprojection.solve_ridge"],
            ),
            rule(
                u.attendance == 0.0,
                "unprojection.attendance is 0",
                &["unprojection.attendance_pixels"],
            ),
        ]
    }

    fn of_segmentation(&self) -> Vec<Rule> {
        let (s, u) = (&self.segmentation, &self.unprojection);
        let any = |is: fn(&Variant) -> bool| s.rows().iter().any(is);
        let decodes = any(|row| row.is_fused());
        // Under `loss`, and with Eq. 9: the others are under cross-entropy without it.
        let robust = any(|row| row.is_fused() && *row != Variant::OursCe);
        let trains = decodes || any(|row| *row == Variant::PerGaussian);
        let counts_cells = u.resolution == Resolution::Feature && u.attendance > 0.0;
        let warms_up = robust && s.loss != LabelLoss::Ce || decodes && s.average;
        vec![
            rule(
                s.rows().is_empty(),
                "segmentation.rows is empty",
                &["segmentation.", "features.", "unprojection.", "spatial."],
            ),
            rule(
                !trains,
                "no row of segmentation.rows is trained",
                &[
                    "segmentation.iterations",
                    "segmentation.lr_trials",
                    "segmentation.lr_decay",
                    "segmentation.blend",
                    "segmentation.lambda_pix",
                    "segmentation.pixel_share",
                    "segmentation.weight_cache_mb",
                    "segmentation.eval_every",
                    "segmentation.checkpoint_every",
                ],
            ),
            rule(
                !any(|row| *row == Variant::PerGaussian),
                "segmentation.rows has no per_gaussian",
                &["segmentation.lr_per_gaussian"],
            ),
            rule(
                !decodes,
                "no row of segmentation.rows has a decoder",
                &[
                    "segmentation.lr",
                    "segmentation.standardise",
                    "segmentation.layer_norm",
                    "segmentation.prior",
                    "segmentation.average",
                    "segmentation.decoder_chunk",
                    "segmentation.warmup",
                    "spatial.",
                ],
            ),
            rule(
                !(decodes || s.diffusion_steps > 0 || counts_cells),
                "no row of segmentation.rows has a decoder, and nothing is diffused",
                &[
                    "features.",
                    "unprojection.normalisation",
                    "unprojection.solve_iterations",
                    "unprojection.solve_ridge",
                ],
            ),
            rule(
                !robust,
                "segmentation.rows has neither ours nor an ablation of it",
                &[
                    "segmentation.loss",
                    "segmentation.gce_exponent",
                    "segmentation.least_recall",
                    "segmentation.pi_rl",
                    "segmentation.gjs_dropout",
                    "segmentation.lambda_reg",
                    "segmentation.reg_samples",
                    "segmentation.reg_neighbours",
                ],
            ),
            rule(
                s.loss != LabelLoss::Gce,
                "segmentation.loss is not gce",
                &["segmentation.gce_exponent", "segmentation.least_recall"],
            ),
            rule(
                !matches!(s.loss, LabelLoss::Js | LabelLoss::Gjs),
                "segmentation.loss is neither js nor gjs",
                &["segmentation.pi_rl"],
            ),
            rule(
                s.loss != LabelLoss::Gjs,
                "segmentation.loss is not gjs",
                &["segmentation.gjs_dropout"],
            ),
            rule(
                s.lambda_reg == 0.0,
                "segmentation.lambda_reg is 0",
                &["segmentation.reg_samples", "segmentation.reg_neighbours"],
            ),
            rule(
                !warms_up,
                "training begins with cross-entropy and stays there, and segmentation.average is false",
                &["segmentation.warmup"],
            ),
            rule(
                s.diffusion_steps == 0,
                "segmentation.diffusion_steps is 0",
                &[
                    "segmentation.diffusion_strength",
                    "segmentation.diffusion_temperature",
                ],
            ),
        ]
    }
}

/// The settings of `config` by dotted key; of those that stand for something where they are absent, what that is under the
/// strategy of `building`.
fn values(config: &Config, building: &BuildingConfig) -> BTreeMap<String, String> {
    let mut config = config.clone();
    let b = &mut config.building;
    let like = BuildingConfig {
        strategy: building.strategy,
        absgrad: building.absgrad,
        ..b.clone()
    };
    (b.densify_until, b.densify_threshold) =
        (Some(like.densify_until()), Some(like.densify_threshold()));
    // Settings are plain data: they always have a JSON form. By way of text, so that an f32 keeps its short form.
    let text = serde_json::to_string(&config).unwrap_or_default();
    let mut values = BTreeMap::new();
    collect(
        "",
        serde_json::from_str(&text).unwrap_or_default(),
        &mut values,
    );
    values
}

/// Adds what `value`, which lies at `key`, holds; no value is none.
fn collect(key: &str, value: Value, out: &mut BTreeMap<String, String>) {
    let mut add = |value| _ = out.insert(key.to_owned(), value);
    match value {
        Value::Null => {}
        Value::String(text) => add(text),
        Value::Object(section) => {
            let dot = if key.is_empty() { "" } else { "." };
            section
                .into_iter()
                .for_each(|(name, value)| collect(&format!("{key}{dot}{name}"), value, out));
        }
        other => add(other.to_string()),
    }
}

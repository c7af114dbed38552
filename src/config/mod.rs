//! Every setting of a run, as plain data. `config.toml` in a run folder is this structure as it ran.
//!
//! Sections follow the pipeline. Unknown keys are errors. `--set section.key=value` overrides one key.
//! [`Config::load`] and [`Config::load_for`] read files and overrides, [`Config::preset`] holds the named sets of defaults,
//! [`Config::validate`] the allowed ranges.

mod association;
mod building;
mod data;
mod features;
mod load;
mod presets;
mod validate;
mod variant;

pub use self::association::{Association, AssociationConfig};
pub use self::building::{BuildingConfig, McmcConfig, RasterConfig, Strategy};
pub(crate) use self::data::same_folder;
pub use self::data::{DataConfig, Layout, NO_MASKS, RawFormat, ScannetClasses};
pub use self::features::{
    Encode, FeatureConfig, FeatureSource, Normalisation, Resolution, SpatialConfig, SpatialSource,
    UnprojectionConfig,
};

use serde::{Deserialize, Serialize};

/// All settings of `coseg train`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Named set of defaults that the other keys override.
    pub preset: Preset,
    /// Seed of every random choice.
    pub seed: u64,
    /// Where the scene comes from.
    pub data: DataConfig,
    /// Stage one: Gaussians from photos.
    pub building: BuildingConfig,
    /// Blending constants.
    pub raster: RasterConfig,
    /// Association of raw labels whose ids differ from view to view.
    pub association: AssociationConfig,
    /// 2D image features.
    pub features: FeatureConfig,
    /// Lifting 2D features onto Gaussians.
    pub unprojection: UnprojectionConfig,
    /// The frozen point encoder.
    pub spatial: SpatialConfig,
    /// Stage two: segmentation identities.
    pub segmentation: SegmentationConfig,
}

/// Named sets of defaults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Our choices, all pixels.
    #[default]
    Default,
    /// The paper's choices where this crate departs from them.
    Paper,
    /// A quarter of the pixels a step, cached blending weights.
    Fast,
}

/// Loss on rendered labels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LabelLoss {
    /// Jensen-Shannon with a one-hot label (Eq. 8): the paper.
    Js,
    /// Cross-entropy.
    Ce,
    /// Generalised cross-entropy (Zhang and Sabuncu 2018), (1 - p^q) / q of the label.
    #[default]
    Gce,
    /// Half the absolute error, 1 - p of the label.
    Mae,
    /// Normalised cross-entropy and reverse cross-entropy, added with equal weights (Ma et al. 2020).
    NceRce,
    /// Generalised Jensen-Shannon of the label and two predictions under dropout (Englesson and Azizpour 2021).
    Gjs,
}

/// A row of the results table; all but `raw` and `vote` are trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Variant {
    /// Raw labels of the test views, as they are.
    Raw,
    /// Each Gaussian takes the class with the largest summed alpha' T.
    Vote,
    /// Identities learned per Gaussian with CE (ablation row 1 of the paper).
    PerGaussian,
    /// The decoder with CE.
    OursCe,
    /// The decoder with [`SegmentationConfig::loss`].
    Ours,
    /// `Ours` without image features.
    NoImageFeatures,
    /// `Ours` without spatial features.
    NoSpatial,
    /// `Ours` with one scale.
    SingleScale,
    /// `Ours` with a random point encoder.
    RandomSpatial,
}

/// What is blended along a ray to give a pixel its classes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Blend {
    /// Logits, softmax after blending (Eq. 3 and 8 of the paper).
    Logits,
    /// Class probabilities of each Gaussian: a convex mixture, so one confident Gaussian cannot outvote those in front.
    Probabilities,
}

/// What label maps are rendered from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LabelSource {
    /// One label a Gaussian, that of its largest score: what `label` in the PLY says.
    Labels,
    /// The class scores, blended (Eq. 3): the paper.
    Scores,
}

/// What the decoder starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Prior {
    /// Nothing (the paper): the features have to say everything.
    None,
    /// The votes of each Gaussian's raw labels, as log-shares: the decoder learns what to correct in them.
    Votes,
}

/// Smallest and largest [`SegmentationConfig::gce_exponent`]; at the first the loss is cross-entropy within f32's digits.
pub const GCE_EXPONENTS: [f64; 2] = [1e-6, 1.0];

/// Stage two: segmentation identities.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SegmentationConfig {
    /// Optimiser steps of each trained row.
    pub iterations: usize,
    /// Which rows are trained and scored; the scene stores `ours` where present, else the last. Absent: [`Variant::COMPARED`], or where
    /// no held-out view has a truth to score them by [`Variant::UNSCORED`].
    pub rows: Option<Vec<Variant>>,
    /// Learning rate of the decoder.
    pub lr: f64,
    /// Both learning rates fall along a half cosine, to 1 % at the end (the paper keeps them constant).
    pub lr_decay: bool,
    /// Frozen features brought to mean 0 and spread 1 per channel before the decoder (not in the paper).
    pub standardise: bool,
    /// LayerNorm in the decoder's shared MLPs.
    pub layer_norm: bool,
    /// Learning rate of per-Gaussian identities.
    pub lr_per_gaussian: f64,
    /// What is blended, in training and in the stored identities.
    pub blend: Blend,
    /// What the decoder's scores are added to; `votes` needs `blend = "probabilities"`.
    pub prior: Prior,
    /// Loss of row `ours`.
    pub loss: LabelLoss,
    /// Exponent q of the GCE loss, in [`GCE_EXPONENTS`]: towards 0 it is cross-entropy, at 1 the absolute error. 0.7 is its authors'.
    pub gce_exponent: f64,
    /// Weight of the raw label in the JS and GJS losses, in (0, 1).
    pub pi_rl: f64,
    /// Share of the frozen channels that each of the two predictions of `loss = "gjs"` does without, in (0, 1).
    pub gjs_dropout: f64,
    /// Weight of the label loss.
    pub lambda_pix: f64,
    /// Weight of the 3D regularisation (Eq. 9).
    pub lambda_reg: f64,
    /// Share of the run trained with CE before any other loss.
    pub warmup: f64,
    /// Mean probability of its own labels below which GCE has a smaller exponent for a class, the nearer to CE the further it is
    /// below, so that no class is given up (not in the paper); 0 is never.
    pub least_recall: f64,
    /// Identities come from the mean of the decoder's parameters over the steps after the warm-up (not in the paper).
    pub average: bool,
    /// What label maps are rendered from.
    pub render: LabelSource,
    /// Pixels whose coverage 1 - T is below this are not trained on, and show no label.
    pub min_coverage: f64,
    /// Share of the labelled pixels of a view used in a step, in (0, 1].
    pub pixel_share: f64,
    /// Sampled Gaussians of the 3D regularisation, at most.
    pub reg_samples: usize,
    /// Neighbours of each in the 3D regularisation.
    pub reg_neighbours: usize,
    /// Megabytes (2^20 bytes) for blending weights of the training views, or on a GPU for the Gaussians that they show, kept
    /// for all rows. The decoder in training has half as much again for what it keeps of each view, so that both take one and
    /// a half times this at most. What is beyond is computed at each use, to the same bits.
    pub weight_cache_mb: usize,
    /// Gaussians decoded together in a training step, which bounds the memory of the decoder's layers; that of the scores of
    /// all Gaussians that a view shows, of their probabilities and gradients, still grows. Views that show more are decoded in
    /// parts, twice, for the same gradients. 0: all at once.
    pub decoder_chunk: usize,
    /// Iterations between held-out evaluations; 0 means ten in the run.
    pub eval_every: usize,
    /// Iterations between checkpoints; 0 means ten in the run.
    pub checkpoint_every: usize,
}

impl SegmentationConfig {
    /// `rows`, or what its absence stands for where there is a truth.
    pub fn rows(&self) -> &[Variant] {
        self.rows.as_deref().unwrap_or(&Variant::COMPARED)
    }
}

impl Default for SegmentationConfig {
    fn default() -> Self {
        Self {
            iterations: 2_000,
            rows: None,
            lr: 6e-3,
            lr_decay: true,
            standardise: true,
            layer_norm: false,
            lr_per_gaussian: 5e-2,
            blend: Blend::Probabilities,
            prior: Prior::Votes,
            loss: LabelLoss::Gce,
            gce_exponent: 0.7,
            pi_rl: 0.99,
            gjs_dropout: 0.2,
            lambda_pix: 0.8,
            lambda_reg: 0.2,
            warmup: 0.1,
            least_recall: 0.3,
            average: true,
            render: LabelSource::Labels,
            min_coverage: 0.5,
            pixel_share: 1.0,
            reg_samples: 1_000,
            reg_neighbours: 5,
            weight_cache_mb: 2_048,
            decoder_chunk: 65_536,
            eval_every: 0,
            checkpoint_every: 0,
        }
    }
}

//! Every setting of a run, as plain data. `config.toml` in a run folder is this structure as it ran.
//!
//! Sections follow the pipeline. Unknown keys are errors. `--set section.key=value` overrides one key.
//! [`Config::load`] reads files and overrides, [`Config::preset`] holds the named sets of defaults,
//! [`Config::validate`] the allowed ranges.

mod load;
mod presets;
pub use presets::BUILTIN_SCENE;
mod row;
mod validate;

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

/// Where the scene comes from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataConfig {
    /// Scene folder; absent means the built-in scene.
    pub dir: Option<std::path::PathBuf>,
    /// File within `dir` that lists frames.
    pub transforms: String,
    /// Folder of raw labels within `dir`; replaces the folder named in the frames. Empty: as the frames say.
    pub raw_labels: String,
}

impl Default for DataConfig {
    fn default() -> Self {
        Self { dir: None, transforms: "transforms.json".into(), raw_labels: String::new() }
    }
}

/// Stage one (3DGS): 0.8 L1 + 0.2 (1 - SSIM), Adam, adaptive density control.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BuildingConfig {
    /// Optimiser steps.
    pub iterations: usize,
    /// Highest SH degree, 0 to 3.
    pub sh_degree: usize,
    /// Weight of the SSIM term; L1 has the rest.
    pub ssim_weight: f32,
    /// Learning rate of the means at the start, times the scene extent.
    pub lr_means: f64,
    /// Learning rate of the means at the end, times the scene extent.
    pub lr_means_final: f64,
    /// Learning rate of the SH constant term.
    pub lr_sh_dc: f64,
    /// Learning rate of the higher SH terms.
    pub lr_sh_rest: f64,
    /// Learning rate of the opacity logits.
    pub lr_opacity: f64,
    /// Learning rate of the log-scales.
    pub lr_scales: f64,
    /// Learning rate of the rotations.
    pub lr_rotations: f64,
    /// Iterations between densifications.
    pub densify_every: usize,
    /// First densification: the smaller of this and 8 % of the run.
    pub densify_from: usize,
    /// Densification ends at this share of the run.
    pub densify_until: f32,
    /// Threshold on the mean screen-space gradient |(dL/du W/2, dL/dv H/2)|.
    pub densify_threshold: f32,
    /// Gaussians below this share of the extent are cloned, others split.
    pub clone_below: f32,
    /// Gaussians less opaque than this are pruned.
    pub prune_opacity: f32,
    /// Gaussians larger than this share of the extent are pruned.
    pub prune_scale: f32,
    /// Smallest number of iterations between opacity resets; at least 5 passes over the views are kept as well.
    pub reset_every: usize,
    /// No more Gaussians than this; 0 means no limit.
    pub max_gaussians: usize,
    /// Points when the scene has no initial cloud.
    pub random_points: usize,
    /// Iterations between held-out evaluations; 0 means ten in the run.
    pub eval_every: usize,
    /// Iterations between checkpoints; 0 means ten in the run.
    pub checkpoint_every: usize,
}

impl Default for BuildingConfig {
    fn default() -> Self {
        Self {
            iterations: 7_000,
            sh_degree: 3,
            ssim_weight: 0.2,
            lr_means: 1.6e-4,
            lr_means_final: 1.6e-6,
            lr_sh_dc: 2.5e-3,
            lr_sh_rest: 1.25e-4,
            lr_opacity: 5e-2,
            lr_scales: 5e-3,
            lr_rotations: 1e-3,
            densify_every: 100,
            densify_from: 500,
            densify_until: 0.5,
            densify_threshold: 2e-4,
            clone_below: 0.01,
            prune_opacity: 0.005,
            prune_scale: 0.1,
            reset_every: 1_000,
            max_gaussians: 0,
            random_points: 20_000,
            eval_every: 0,
            checkpoint_every: 0,
        }
    }
}

/// Blending constants (DESIGN: cap, cut-offs).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RasterConfig {
    /// Cap of alpha'; 0.99 matches gsplat and graphdeco.
    pub alpha_max: f64,
    /// Pairs below this alpha' are skipped.
    pub alpha_min: f64,
    /// A splat that would bring the transmittance to this or below is not added and the pixel ends.
    pub t_min: f64,
    /// Near plane, world units.
    pub near: f64,
    /// Added to the diagonal of the 2D covariance, pixels squared.
    pub low_pass: f64,
    /// Background, linear blend weight T, sRGB 0..1.
    pub background: [f32; 3],
}

impl Default for RasterConfig {
    fn default() -> Self {
        Self { alpha_max: 0.999, alpha_min: 1.0 / 255.0, t_min: 1e-4, near: 0.01, low_pass: 0.3, background: [0.0; 3] }
    }
}

/// Where 2D image features come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FeatureSource {
    /// MobileNetV2 when weights are given, else the descriptor.
    #[default]
    Auto,
    /// The built-in multi-scale descriptor; needs no weights.
    Descriptor,
    /// MobileNetV2, blocks 3, 6, 13, 17.
    Mobilenetv2,
    /// Maps read from files, one set a view.
    Import,
}

/// 2D image features.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FeatureConfig {
    /// The extractor.
    pub source: FeatureSource,
    /// Weights of the extractor.
    pub weights: Option<std::path::PathBuf>,
    /// Folder of imported maps: `STEM.N.npy` ([H, W, C] f32, N = 1..4) or `STEM.safetensors` (tensors `scale1`..`scale4`).
    pub import_dir: Option<std::path::PathBuf>,
    /// Dimensions kept by PCA, per scale.
    pub dimensions: usize,
    /// Folder of cached maps, keyed by content; absent means no cache.
    pub cache_dir: Option<std::path::PathBuf>,
}

impl Default for FeatureConfig {
    fn default() -> Self {
        Self { source: FeatureSource::Auto, weights: None, import_dir: None, dimensions: 64, cache_dir: None }
    }
}

/// What the weighted sum of Eq. 5 is divided by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Normalisation {
    /// Pixels inside the radius (the paper).
    Count,
    /// Sum of alpha' T: a weighted mean.
    #[default]
    Weight,
}

/// At which resolution the blending weights of the unprojection are taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Resolution {
    /// Cameras scaled to the feature map (the paper).
    Feature,
    /// Image resolution, the map read bilinearly.
    #[default]
    Image,
}

/// Lifting 2D features onto Gaussians (Eq. 5, Algorithm 1).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UnprojectionConfig {
    /// The divisor.
    pub normalisation: Normalisation,
    /// The resolution.
    pub resolution: Resolution,
    /// Gaussians counted on fewer than this share of all training pixels are pruned.
    pub attendance: f64,
}

impl Default for UnprojectionConfig {
    fn default() -> Self {
        Self { normalisation: Normalisation::Weight, resolution: Resolution::Image, attendance: 1e-5 }
    }
}

/// Where the point encoder's weights come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SpatialSource {
    /// The weights inside this crate, made by `coseg pretrain`.
    #[default]
    Builtin,
    /// A checkpoint, see [`SpatialConfig::weights`].
    Pretrained,
    /// Random weights: an ablation row.
    Random,
}

/// What is encoded at once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Encode {
    /// The whole scene, once.
    #[default]
    Scene,
    /// The Gaussians visible in each view (the paper).
    View,
}

/// The frozen RandLA encoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SpatialConfig {
    /// Which weights.
    pub source: SpatialSource,
    /// Checkpoint (`.safetensors`, `.pth`) when `source = "pretrained"`.
    pub weights: Option<std::path::PathBuf>,
    /// Metres per world unit, applied before encoding; 0 means from the camera extent.
    pub scale: f64,
    /// What is encoded at once.
    pub encode: Encode,
}

impl Default for SpatialConfig {
    fn default() -> Self {
        Self { source: SpatialSource::Builtin, weights: None, scale: 1.0, encode: Encode::Scene }
    }
}

/// Loss on rendered labels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LabelLoss {
    /// Jensen-Shannon with a one-hot label (Eq. 8).
    #[default]
    Js,
    /// Cross-entropy.
    Ce,
    /// Generalised cross-entropy, q = 0.7.
    Gce,
    /// Half the absolute error, 1 - p of the label.
    Mae,
}

/// A row of the results table that a run trains.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Row {
    /// Raw labels of the test views, as they are.
    Raw,
    /// Each Gaussian takes the class with the largest summed alpha' T.
    Vote,
    /// Identities learned per Gaussian with CE (ablation row 1 of the paper).
    PerGaussian,
    /// The decoder with CE.
    OursCe,
    /// The decoder with the CoSeg loss.
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

/// What the decoder starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Prior {
    /// Nothing (the paper): the features have to say everything.
    None,
    /// The votes of each Gaussian's raw labels, as log-shares: the decoder learns what to correct in them.
    Votes,
}

/// Stage two: segmentation identities.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SegmentationConfig {
    /// Optimiser steps of each trained row.
    pub iterations: usize,
    /// Which rows are trained and scored; the scene stores `ours` where present, else the last.
    pub rows: Vec<Row>,
    /// Learning rate of the decoder.
    pub lr: f64,
    /// Factors of the learning rates to try for each trained row; the best on held-out raw labels of training views is
    /// taken. One factor or none: no trial.
    pub lr_trials: Vec<f64>,
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
    /// Weight of the raw label in the JS loss, in (0, 1).
    pub pi_rl: f64,
    /// Weight of the label loss.
    pub lambda_pix: f64,
    /// Weight of the 3D regularisation (Eq. 9).
    pub lambda_reg: f64,
    /// Share of the run trained with CE before the JS loss.
    pub warmup: f64,
    /// Identities come from the mean of the decoder's parameters over the steps after the warm-up (not in the paper).
    pub average: bool,
    /// Pixels whose coverage 1 - T is below this are not trained on.
    pub min_coverage: f64,
    /// Share of the pixels used in a step.
    pub pixel_share: f64,
    /// Sampled Gaussians of the 3D regularisation, at most.
    pub reg_samples: usize,
    /// Neighbours of each in the 3D regularisation.
    pub reg_neighbours: usize,
    /// Megabytes for cached blending weights; views beyond it are recomputed.
    pub weight_cache_mb: usize,
    /// Iterations between held-out evaluations; 0 means ten in the run.
    pub eval_every: usize,
    /// Iterations between checkpoints; 0 means ten in the run.
    pub checkpoint_every: usize,
}

impl Default for SegmentationConfig {
    fn default() -> Self {
        Self {
            iterations: 2_000,
            rows: vec![Row::Raw, Row::Vote, Row::PerGaussian, Row::OursCe, Row::Ours],
            lr: 3e-3,
            lr_trials: Vec::new(),
            lr_decay: true,
            standardise: true,
            layer_norm: false,
            lr_per_gaussian: 5e-2,
            blend: Blend::Probabilities,
            prior: Prior::Votes,
            loss: LabelLoss::Js,
            pi_rl: 0.9,
            lambda_pix: 0.8,
            lambda_reg: 0.2,
            warmup: 0.1,
            average: true,
            min_coverage: 0.5,
            pixel_share: 1.0,
            reg_samples: 1_000,
            reg_neighbours: 5,
            weight_cache_mb: 2_048,
            eval_every: 0,
            checkpoint_every: 0,
        }
    }
}

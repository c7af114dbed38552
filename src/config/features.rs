//! Settings of what stage two is shown: image features, their lifting onto Gaussians, the point encoder.

use serde::{Deserialize, Serialize};

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
    /// A DINO ViT of any size, the ends of the quarters of its depth (the paper).
    Dino,
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
    /// Whether the four blocks of a DINO ViT take its final layer normalisation; other sources have none.
    pub final_norm: bool,
    /// Folder of imported maps: `STEM.N.npy` ([H, W, C] f32, N = 1..4) or `STEM.safetensors` (tensors `scale1`..`scale4`).
    pub import_dir: Option<std::path::PathBuf>,
    /// Dimensions kept by PCA, per scale.
    pub dimensions: usize,
    /// Folder of cached maps, keyed by content; absent means no cache.
    pub cache_dir: Option<std::path::PathBuf>,
}

impl Default for FeatureConfig {
    fn default() -> Self {
        Self {
            source: FeatureSource::Auto,
            weights: None,
            final_norm: true,
            import_dir: None,
            dimensions: 64,
            cache_dir: None,
        }
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
    /// Gaussians counted on fewer than this share of all training pixels are pruned, if they are on fewer than
    /// `attendance_pixels` too.
    pub attendance: f64,
    /// Gaussians counted on this many pixels of all training views together stay, however many pixels there are: of hundreds of
    /// large photos a share alone would prune what only a dozen of them show. 0 is no such limit, as in the paper.
    pub attendance_pixels: f64,
}

impl Default for UnprojectionConfig {
    fn default() -> Self {
        Self {
            normalisation: Normalisation::Weight,
            resolution: Resolution::Image,
            attendance: 1e-5,
            attendance_pixels: 40.0,
        }
    }
}

impl UnprojectionConfig {
    /// Pixels, of `all` that the training views have, on which a Gaussian has to be counted (T_a of Algorithm 1).
    pub fn fewest_pixels(&self, all: u64) -> f64 {
        let share = self.attendance * all as f64;
        if self.attendance_pixels > 0.0 {
            share.min(self.attendance_pixels)
        } else {
            share
        }
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
        Self {
            source: SpatialSource::Builtin,
            weights: None,
            scale: 1.0,
            encode: Encode::Scene,
        }
    }
}

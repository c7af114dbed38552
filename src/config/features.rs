//! Settings of the inputs of stage two: image features, their lifting onto Gaussians, the point encoder.

use super::display_as_serialized;
use super::range::{Range, checked};
use crate::error::{Result, ensure};
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use std::path::PathBuf;

/// Largest number of dimensions: more than any network here has channels.
const MAX_DIMENSIONS: f64 = 4_096.0;
/// Scales of a view's feature maps, at most; the point encoder has as many.
pub const SCALES: usize = 4;

/// Where 2D image features come from.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
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
    /// The tensor of this name within the ONNX segmenter of `features.weights`, as in `coseg label`.
    Segmenter(String),
    /// Maps read from the files of this folder: `STEM.N.npy` ([H, W, C] f32, N = 1..4) or `STEM.safetensors` (tensors
    /// `scale1`..`scale4`).
    Import(PathBuf),
}

/// 2D image features.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, SmartDefault)]
#[serde(default, deny_unknown_fields)]
pub struct FeatureConfig {
    /// The extractor.
    pub source: FeatureSource,
    /// Weights of the extractor.
    #[serde(deserialize_with = "super::optional_path")]
    pub weights: Option<PathBuf>,
    /// Contract of the segmenter in `weights`: a file, or the name of a shipped one. Absent: as `coseg label` finds it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contract: Option<String>,
    /// Dimensions kept by PCA, per scale, 1 to 4096.
    #[default(64)]
    pub dimensions: usize,
    /// Scales of maps that are lifted and that the decoder reads, from the finest on, 1 to [`SCALES`]; absent for
    /// [`FeatureConfig::scale_count`] to decide.
    pub scales: Option<usize>,
    /// Folder of cached maps, keyed by content; absent means no cache.
    #[serde(deserialize_with = "super::optional_path")]
    pub cache_dir: Option<PathBuf>,
}

impl FeatureConfig {
    /// The number of scales. Unless `scales` says it, one for the descriptor and for a tensor of a segmenter, whose coarser maps add
    /// next to nothing, and four for networks whose scales come from different depths, and for imported maps.
    pub fn scale_count(&self) -> usize {
        let of_source = match self.source {
            FeatureSource::Descriptor | FeatureSource::Segmenter(_) => 1,
            FeatureSource::Auto if self.weights.is_none() => 1,
            _ => SCALES,
        };
        self.scales.unwrap_or(of_source)
    }

    pub(super) fn check(&self) -> Result<()> {
        Range::Within(1.0, MAX_DIMENSIONS).check("features.dimensions", self.dimensions)?;
        Range::Within(1.0, SCALES as f64).check("features.scales", self.scale_count())?;
        let network = match self.source {
            FeatureSource::Mobilenetv2 => "MobileNetV2",
            FeatureSource::Dino => "DINO",
            FeatureSource::Segmenter(_) => "segmenter",
            _ => return Ok(()),
        };
        ensure!(self.weights.is_some(), setting "features.weights"; found "nothing";
            expected "a path to {network} weights, because features.source asks for {network}";
            help "give it, or name another features.source, such as \"descriptor\", which needs no weights");
        Ok(())
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

/// Lifting 2D features onto Gaussians (Eq. 5, Algorithm 1).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault)]
#[serde(default, deny_unknown_fields)]
pub struct UnprojectionConfig {
    /// The divisor.
    pub normalisation: Normalisation,
    /// Gaussians counted on fewer than this share of all training pixels are pruned, if they are on fewer than
    /// `attendance_pixels` too.
    #[default(1e-5)]
    pub attendance: f64,
    /// Gaussians counted on this many pixels of all training views together are never pruned. In hundreds of large photos, the
    /// share alone would prune what only a dozen photos show. 0 means no such limit, as in the paper.
    #[default(40.0)]
    pub attendance_pixels: f64,
}

impl UnprojectionConfig {
    pub(super) fn check(&self) -> Result<()> {
        checked!(self, "unprojection": { attendance: Unit, attendance_pixels: NotNegative });
        Ok(())
    }

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
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SpatialSource {
    /// The weights inside this crate, made by `examples/pretrain_encoder`.
    #[default]
    Builtin,
    /// A checkpoint of RandLA-Net (`.safetensors`, `.pth`).
    Pretrained(PathBuf),
    /// Random weights: an ablation.
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

/// The size of a world unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(
    rename_all = "lowercase",
    expecting = "expected \"auto\" or a number of metres from 0"
)]
pub enum SpatialScale {
    /// From the extent of the cameras for a COLMAP model, whose unit is arbitrary; else a metre.
    #[default]
    Auto,
    /// Metres; 0 means from the extent of the cameras.
    #[serde(untagged)]
    Metres(f64),
}

display_as_serialized!(SpatialScale);

/// The frozen RandLA encoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault)]
#[serde(default, deny_unknown_fields)]
pub struct SpatialConfig {
    /// Which weights.
    pub source: SpatialSource,
    /// Metres per world unit, applied before encoding.
    pub scale: SpatialScale,
    /// What is encoded at once.
    pub encode: Encode,
}

impl SpatialConfig {
    pub(super) fn check(&self) -> Result<()> {
        let SpatialScale::Metres(scale) = self.scale else {
            return Ok(());
        };
        ensure!(scale.is_finite() && scale >= 0.0, setting "spatial.scale"; found "{scale}";
            expected "\"auto\" or a finite number from 0"; help "give the metres of a world unit, or 0 to estimate them from the cameras");
        Ok(())
    }
}

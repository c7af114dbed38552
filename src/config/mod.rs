//! Every setting of a run, as plain data. `config.toml` in a run folder is this structure as it ran.
//!
//! Sections follow the pipeline. Unknown keys are errors. `--set section.key=value` overrides one key. [`Config::load`] and
//! [`Config::load_for`] read files and overrides. [`Config::preset`] holds the named sets of defaults. [`Config::validate`] checks
//! the ranges that each section states beside its fields.
//!
//! Choices with settings of their own are enums with a payload: `segmentation.loss = "gce"` takes the defaults of that choice,
//! `segmentation.loss.gce.exponent = 0.5` chooses it and sets one of them.

mod assignment;
mod association;
mod budget;
mod building;
mod data;
mod features;
mod load;
mod pooling;
mod presets;
mod range;
mod segmentation;
mod variant;

pub use self::association::Association;
pub use self::budget::Budget;
pub use self::building::{BuildingConfig, RasterConfig, SizeRule};
pub(crate) use self::data::same_folder;
pub use self::data::{DataConfig, LabelsBy, Layout, NO_MASKS, RawFormat, ScannetClasses};
pub use self::features::{
    Encode, FeatureConfig, FeatureSource, Normalisation, SCALES, SpatialConfig, SpatialScale,
    SpatialSource, UnprojectionConfig,
};
pub use self::pooling::PoolingConfig;
pub use self::segmentation::{
    Blend, GCE_EXPONENTS, LAMBDA_PIX, LabelLoss, LabelSource, Prior, Reduction, SegmentationConfig,
};
pub use self::variant::Variant;

use crate::error::{Result, ensure};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize};
use std::path::PathBuf;

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
    /// Votes of the raw labels, corrected.
    pub pooling: PoolingConfig,
    /// Stage two: segmentation identities.
    pub segmentation: SegmentationConfig,
}

/// Named sets of defaults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Our choices.
    #[default]
    Default,
    /// The paper's choices, where the defaults of this crate differ from them. The paper's networks need weights of their own.
    Paper,
}

/// Shows values of an enum by the names that serde gives them.
macro_rules! display_as_serialized {
    ($($type:ty),+) => {
        $(
            impl std::fmt::Display for $type {
                fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                    serde::Serialize::serialize(self, f)
                }
            }
        )+
    };
}
pub(crate) use display_as_serialized;

display_as_serialized!(Layout, Preset, Prior);

impl Config {
    /// Checks that every value is in its range and that values that need each other are present.
    ///
    /// # Errors
    /// [`crate::Error::Config`] for the first value that is not.
    pub fn validate(&self) -> Result<()> {
        ensure!(self.seed <= i64::MAX as u64, setting "seed"; found "{}", self.seed; expected "at most 2^63 - 1";
            help "choose a smaller seed");
        self.data.check()?;
        self.building.validate()?;
        self.raster.check()?;
        self.features.check()?;
        self.unprojection.check()?;
        self.spatial.check()?;
        self.pooling.check()?;
        self.segmentation.check()
    }

    /// All settings that are paths.
    pub(crate) fn paths(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        let imported = match &mut self.features.source {
            FeatureSource::Import(folder) => Some(folder),
            _ => None,
        };
        let pretrained = match &mut self.spatial.source {
            SpatialSource::Pretrained(file) => Some(file),
            _ => None,
        };
        [
            self.data.dir.as_mut(),
            self.data.dataparser_transforms.as_mut(),
            self.building.gaussians.as_mut(),
            self.features.weights.as_mut(),
            self.features.cache_dir.as_mut(),
            imported,
            pretrained,
        ]
        .into_iter()
        .flatten()
    }
}

/// Reads an enum with payloads; `"name"` alone stands for `{ name = {} }`, the variant with its defaults.
fn by_name<'de, D: Deserializer<'de>, T: DeserializeOwned>(from: D) -> Result<T, D::Error> {
    let value = serde_json::Value::deserialize(from)?;
    let read = |value| serde_json::from_value::<T>(value);
    let result = match &value {
        serde_json::Value::String(name) => read(value.clone())
            .or_else(|error| read(serde_json::json!({ name: {} })).map_err(|_| error)),
        _ => read(value),
    };
    result.map_err(serde::de::Error::custom)
}

/// Reads a path; an empty one is none.
fn optional_path<'de, D: Deserializer<'de>>(from: D) -> Result<Option<PathBuf>, D::Error> {
    let path = Option::<PathBuf>::deserialize(from)?;
    Ok(path.filter(|path| !path.as_os_str().is_empty()))
}

//! Settings of stage one and of the blending.

use super::Budget;
use super::range::{MAX_BATCH, Range, checked};
use crate::error::{Result, ensure};
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use std::path::PathBuf;

/// Largest number of initial points: that of a point cloud.
const MAX_POINTS: f64 = 268_435_456.0;

/// The size from which Gaussians are pruned, as a tenth of a length.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SizeRule {
    /// The distance from the mean camera, or the extent where that is longer.
    #[default]
    Distance,
    /// The extent alone, from the first reset of opacities on: 3DGS. The limit on screen has no effect in the program of 3DGS
    /// either.
    Extent,
}

/// Stage one (3DGS): 0.8 L1 + 0.2 (1 - SSIM), Adam, adaptive density control. The fields marked `serde(skip)` have the values
/// of 3DGS (Kerbl et al. 2023). No key sets them; tests with short runs change them. A learning rate of 0 freezes its parameter,
/// except for densification and resets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault)]
#[serde(default, deny_unknown_fields)]
pub struct BuildingConfig {
    /// Views that are rendered, one for each optimiser step unless `batch` says otherwise. 0 takes `gaussians` as they are, and
    /// needs them.
    #[default(7_000)]
    pub iterations: usize,
    /// Views of an optimiser step. Learning rates grow with its root (Grendel-GS, Zhao et al. 2024, arXiv 2406.18533). Absent: 1,
    /// and in a new run under `mpirun` one for each rank.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub batch: Option<usize>,
    /// Gaussians to begin with: a 3DGS PLY of this or another trainer, in the world units and axes of the cameras. Absent:
    /// the scene's points.
    #[serde(deserialize_with = "super::optional_path")]
    pub gaussians: Option<PathBuf>,
    /// Highest SH degree, 0 to 3.
    #[default(3)]
    pub sh_degree: usize,
    /// Learning rate of the means at the start, times the scene extent; 1 % of it at the end.
    #[default(1.6e-4)]
    pub lr_means: f64,
    /// The screen-space gradient sums absolute values over pixels, so that the two sides of an edge do not cancel (AbsGS,
    /// Ye et al. 2024, arXiv 2404.10484).
    #[default(true)]
    pub absgrad: bool,
    /// Gaussians with a larger mean screen-space gradient |(dL/du W/2, dL/dv H/2)| are cloned or split; absent: 8e-4, or 2e-4
    /// without `absgrad`.
    pub gradient_threshold: Option<f32>,
    /// The size above which Gaussians are pruned.
    pub size_limit: SizeRule,
    /// Each step until densification ends has another background colour instead of `raster.background`, so that surfaces of
    /// that colour become opaque. Photos with transparent pixels keep `raster.background`.
    #[default(true)]
    pub random_background: bool,
    /// Largest number of Gaussians.
    pub max_gaussians: Budget,
    /// Points when the scene has no initial cloud, 1 to 2^28.
    #[default(20_000)]
    pub random_points: usize,
    /// Iterations between held-out evaluations; 0 means ten in the run.
    pub eval_every: usize,
    /// Iterations between checkpoints; 0 means ten in the run.
    #[serde(skip)]
    pub checkpoint_every: usize,
    /// Learning rate of the opacity logits.
    #[serde(skip)]
    #[default(5e-2)]
    pub lr_opacity: f64,
    /// Iterations between densifications.
    #[serde(skip)]
    #[default(100)]
    pub densify_every: usize,
    /// First densification: the smaller of this and 8 % of the run.
    #[serde(skip)]
    #[default(500)]
    pub densify_from: usize,
    /// Densification ends at this share of the run.
    #[serde(skip)]
    #[default(0.5)]
    pub densify_until: f32,
    /// Gaussians less opaque than this are pruned.
    #[serde(skip)]
    #[default(0.005)]
    pub prune_opacity: f32,
    /// Smallest number of iterations between opacity resets. There are also at least 5 passes over the views between them.
    #[serde(skip)]
    #[default(1_000)]
    pub reset_every: usize,
}

impl BuildingConfig {
    /// The Gaussians of the file `gaussians` as they are.
    pub(crate) fn taking(gaussians: PathBuf) -> Self {
        Self {
            gaussians: Some(gaussians),
            iterations: 0,
            ..Self::default()
        }
    }

    /// `batch`, or what its absence stands for.
    pub fn batch(&self) -> usize {
        self.batch.unwrap_or(1)
    }

    /// `gradient_threshold`, or what its absence stands for.
    pub fn gradient_threshold(&self) -> f32 {
        let usual = if self.absgrad { 8e-4 } else { 2e-4 };
        self.gradient_threshold.unwrap_or(usual)
    }

    /// Checks that every value is in its range.
    ///
    /// # Errors
    /// [`crate::Error::Config`] for the first value that is not.
    pub fn validate(&self) -> Result<()> {
        if self.gaussians.is_none() {
            checked!(self, "building": { iterations: Positive });
        }
        ensure!(self.iterations <= u32::MAX as usize,
            setting "building.iterations"; found "{}", self.iterations; expected "fewer than 2^32"; help "give fewer");
        ensure!(self.sh_degree <= 3,
            setting "building.sh_degree"; found "{}", self.sh_degree; expected "0, 1, 2 or 3"; help "3 is the usual choice");
        checked!(self, "building": { lr_means: NotNegative });
        Range::Within(1.0, MAX_BATCH).check("building.batch", self.batch())?;
        Range::Within(1.0, MAX_POINTS).check("building.random_points", self.random_points)?;
        ensure!(self.max_gaussians != Budget::AtMost(0), setting "building.max_gaussians"; found "0";
            expected "\"auto\", \"unlimited\" or a number from 1"; help "\"unlimited\" sets no limit");
        Range::NotNegative.check("building.gradient_threshold", self.gradient_threshold())
    }
}

/// Blending: the cap of alpha' and what lies behind the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault)]
#[serde(default, deny_unknown_fields)]
pub struct RasterConfig {
    /// Cap of alpha'; 0.99 matches graphdeco, 0.999 gsplat 1.5.
    #[default(0.999)]
    pub alpha_max: f64,
    /// Background, linear blend weight T, sRGB 0..1.
    pub background: [f32; 3],
}

impl RasterConfig {
    pub(super) fn check(&self) -> Result<()> {
        checked!(self, "raster": { alpha_max: Share });
        let mut channels = self.background.into_iter();
        channels.try_for_each(|channel| Range::Unit.check("raster.background", channel))
    }
}

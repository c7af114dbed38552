//! Settings of stage one and of the blending.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// How the Gaussians spread while they are trained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Strategy {
    /// Adaptive density control (Kerbl et al. 2023): cloned and split where the screen-space gradient is large, pruned where
    /// transparent or huge, opacities reset now and then.
    #[default]
    Adc,
    /// 3DGS-MCMC (Kheradmand et al. 2024, arXiv 2404.09591): noise on the means, transparent ones moved to opaque ones, their
    /// number grown to `max_gaussians` by a fixed share at a time. Nothing is reset.
    Mcmc,
}

/// Constants of [`Strategy::Mcmc`], by default those of the paper; the other strategy reads none of them. After each step
/// the means get `lr noise sigmoid(-k (o - t)) Sigma eta`, with lr their learning rate, o the opacity, Sigma the covariance
/// and eta standard normal. Lengths are taken in units of the scene's extent (1.1 times the largest distance of a camera
/// from the mean one), so that the constants mean the same in every scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct McmcConfig {
    /// Noise on the means, per learning rate; 0 is none.
    pub noise: f64,
    /// How sharply the noise fades out above `noise_opacity`: k.
    pub noise_sharpness: f64,
    /// Opacity at which half the noise is left: t.
    pub noise_opacity: f64,
    /// A densification adds this share of the Gaussians there are; short runs need more to reach the cap early.
    pub growth: f64,
    /// Weight of the mean opacity in the loss.
    pub opacity_reg: f64,
    /// Weight of the mean standard deviation, in extents, in the loss.
    pub scale_reg: f64,
    /// Opacity of initial Gaussians.
    pub init_opacity: f32,
    /// Standard deviation of initial Gaussians, in rms distances to their three neighbours.
    pub init_scale: f32,
}

impl Default for McmcConfig {
    fn default() -> Self {
        Self {
            noise: 5e5,
            noise_sharpness: 100.0,
            noise_opacity: 0.005,
            growth: 0.05,
            opacity_reg: 0.01,
            scale_reg: 0.01,
            init_opacity: 0.5,
            init_scale: 0.1,
        }
    }
}

/// Stage one (3DGS): 0.8 L1 + 0.2 (1 - SSIM), Adam, a strategy of densification. A learning rate of 0 leaves what it is of as
/// it is, but for densification and resets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BuildingConfig {
    /// Optimiser steps; 0, which needs `gaussians`, takes those as they are.
    pub iterations: usize,
    /// Gaussians to begin with, a 3DGS PLY of this or another trainer in the world units and axes of the cameras, instead of
    /// points. Absent: the scene's points.
    pub gaussians: Option<PathBuf>,
    /// Highest SH degree, 0 to 3.
    pub sh_degree: usize,
    /// Weight of the SSIM term; L1 has the rest.
    pub ssim_weight: f32,
    /// Learning rate of the means at the start, times the scene extent.
    pub lr_means: f64,
    /// Learning rate of the means at the end, times the scene extent; above 0.
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
    /// How the Gaussians spread.
    pub strategy: Strategy,
    /// Iterations between densifications.
    pub densify_every: usize,
    /// First densification: the smaller of this and 8 % of the run.
    pub densify_from: usize,
    /// Densification ends at this share of the run; without a value at 0.5, or 0.8 with `strategy = "mcmc"`.
    pub densify_until: Option<f32>,
    /// Threshold on the mean screen-space gradient |(dL/du W/2, dL/dv H/2)|; without a value 8e-4, or 2e-4 without `absgrad`.
    pub densify_threshold: Option<f32>,
    /// That gradient has the absolute values of dL/du and dL/dv of each pixel summed, where otherwise those of the two sides
    /// of an edge cancel (AbsGS, Ye et al. 2024, arXiv 2404.10484). `strategy = "mcmc"` reads no gradients.
    pub absgrad: bool,
    /// Behind the scene each step until densification ends has another colour instead of `raster.background`, so that surfaces of
    /// that colour have to be opaque. Not where a photo has transparent pixels, behind which `raster.background` lies too.
    pub random_background: bool,
    /// Gaussians below this share of the extent are cloned, others split.
    pub clone_below: f32,
    /// Gaussians less opaque than this are pruned, or moved with `strategy = "mcmc"`.
    pub prune_opacity: f32,
    /// Gaussians larger than this share of their distance from the mean camera, or of the extent where that is longer, are
    /// pruned.
    pub prune_scale: f32,
    /// Smallest number of iterations between opacity resets; at least 5 passes over the views are kept as well.
    pub reset_every: usize,
    /// No more Gaussians than this; larger initial clouds are thinned to it. 0 means no limit, and is refused with
    /// `strategy = "mcmc"`, which grows until it meets one.
    pub max_gaussians: usize,
    /// Points when the scene has no initial cloud.
    pub random_points: usize,
    /// Iterations between held-out evaluations; 0 means ten in the run.
    pub eval_every: usize,
    /// Iterations between checkpoints; 0 means ten in the run.
    pub checkpoint_every: usize,
    /// Constants of `strategy = "mcmc"`.
    pub mcmc: McmcConfig,
}

impl BuildingConfig {
    /// `densify_until`, or what its absence stands for.
    pub fn densify_until(&self) -> f32 {
        let usual = match self.strategy {
            Strategy::Adc => 0.5,
            Strategy::Mcmc => 0.8,
        };
        self.densify_until.unwrap_or(usual)
    }

    /// `densify_threshold`, or what its absence stands for.
    pub fn densify_threshold(&self) -> f32 {
        self.densify_threshold
            .unwrap_or(if self.absgrad { 8e-4 } else { 2e-4 })
    }
}

impl Default for BuildingConfig {
    fn default() -> Self {
        Self {
            iterations: 7_000,
            gaussians: None,
            sh_degree: 3,
            ssim_weight: 0.2,
            lr_means: 1.6e-4,
            lr_means_final: 1.6e-6,
            lr_sh_dc: 2.5e-3,
            lr_sh_rest: 1.25e-4,
            lr_opacity: 5e-2,
            lr_scales: 5e-3,
            lr_rotations: 1e-3,
            strategy: Strategy::Adc,
            densify_every: 100,
            densify_from: 500,
            densify_until: None,
            densify_threshold: None,
            absgrad: true,
            random_background: true,
            clone_below: 0.01,
            prune_opacity: 0.005,
            prune_scale: 0.1,
            reset_every: 1_000,
            max_gaussians: 0,
            random_points: 20_000,
            eval_every: 0,
            checkpoint_every: 0,
            mcmc: McmcConfig::default(),
        }
    }
}

/// Blending constants: cap, cut-offs, and what lies behind the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RasterConfig {
    /// Cap of alpha'; 0.99 matches graphdeco, 0.999 gsplat 1.5.
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
        Self {
            alpha_max: 0.999,
            alpha_min: 1.0 / 255.0,
            t_min: 1e-4,
            near: 0.01,
            low_pass: 0.3,
            background: [0.0; 3],
        }
    }
}

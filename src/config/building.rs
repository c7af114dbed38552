//! Settings of stage one and of the blending.

use serde::{Deserialize, Serialize};

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

//! What the rasterizer is given.

use crate::backend::{Real, check_finite};
use crate::config::RasterConfig;
use crate::error::{Result, ensure, invalid};
use crate::splat::Gaussians;

/// Blending constants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Cap of alpha', in (0, 1]; its gradient is masked there.
    pub alpha_max: f64,
    /// Pairs with alpha' below this are skipped; above 0, so that every Gaussian ends somewhere.
    pub alpha_min: f64,
    /// A splat that would bring the transmittance to this or below is not added, and the pixel ends.
    pub t_min: f64,
    /// Near plane, world units: Gaussians with camera z at or below it are culled.
    pub near: f64,
    /// Added to the diagonal of the 2D covariance, pixels squared.
    pub low_pass: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            alpha_max: RasterConfig::default().alpha_max,
            alpha_min: 1.0 / 255.0,
            t_min: 1e-4,
            near: 0.01,
            low_pass: 0.3,
        }
    }
}

impl From<&RasterConfig> for Settings {
    fn from(c: &RasterConfig) -> Self {
        Self {
            alpha_max: c.alpha_max,
            ..Self::default()
        }
    }
}

impl Settings {
    /// [`Error::Config`] for a value outside its range.
    pub(super) fn check(&self) -> Result<()> {
        let not_negative = 0.0..f64::INFINITY;
        let cap = self.alpha_max > 0.0 && self.alpha_max <= 1.0;
        let near = self.near > 0.0 && self.near.is_finite();
        let rules = [
            ("alpha_max", self.alpha_max, cap, "a number in (0, 1]"),
            (
                "alpha_min",
                self.alpha_min,
                self.alpha_min > 0.0 && self.alpha_min < 1.0,
                "a number in (0, 1)",
            ),
            (
                "t_min",
                self.t_min,
                (0.0..1.0).contains(&self.t_min),
                "a number in [0, 1)",
            ),
            ("near", self.near, near, "a positive number"),
            (
                "low_pass",
                self.low_pass,
                not_negative.contains(&self.low_pass),
                "a number of 0 or more",
            ),
        ];
        match rules.into_iter().find(|(_, _, holds, _)| !holds) {
            None => Ok(()),
            Some((key, found, _, range)) => Err(invalid!(setting "raster.{key}"; found "{found}";
                expected "{range}"; help "choose a value in that range")),
        }
    }
}

/// The geometry of N Gaussians, unactivated, row-major.
#[derive(Clone, Copy, Debug)]
pub struct Splats<'a, E> {
    /// Centres, `[N, 3]`, world units.
    pub means: &'a [E],
    /// Natural logarithm of the standard deviations, `[N, 3]`.
    pub log_scales: &'a [E],
    /// Quaternions (w, x, y, z), not normalised, `[N, 4]`.
    pub rotations: &'a [E],
    /// Logits of the opacities, `[N]`.
    pub opacity_logits: &'a [E],
}

impl<E: Real> Splats<'_, E> {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.opacity_logits.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.opacity_logits.is_empty()
    }

    /// [`Error::Argument`] when the lengths disagree, [`Error::NonFinite`] for the first row with a NaN or an infinity.
    pub(super) fn check(&self) -> Result<()> {
        let n = self.len();
        for (name, values, width) in [
            ("means", self.means, 3),
            ("log_scales", self.log_scales, 3),
            ("rotations", self.rotations, 4),
            ("opacity_logits", self.opacity_logits, 1),
        ] {
            ensure!(values.len() == n * width, argument "splats.{name}"; found "{} values", values.len();
                expected "{} ({n} opacity logits, {width} values each)", n * width;
                help "pass arrays of one scene");
            check_finite(name, values, width)?;
        }
        Ok(())
    }
}

impl Gaussians {
    /// The geometry as the rasterizer takes it.
    pub fn splats(&self) -> Splats<'_, f32> {
        Splats {
            means: self.means.as_flattened(),
            log_scales: self.log_scales.as_flattened(),
            rotations: self.rotations.as_flattened(),
            opacity_logits: &self.opacity_logits,
        }
    }
}

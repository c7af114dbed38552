//! Densification: which Gaussians are cloned, split, pruned, decided on the host from the geometry alone.
//!
//! [`adc`] returns a [`Densification`]. It is applied to the parameters and to the
//! moments of the optimiser alike, so that row `i` of all of them stays the same Gaussian.

mod adc;
mod statistics;

pub use self::adc::{AdcRules, SizeLimit, adc, reset_opacity};
pub(crate) use self::statistics::GradientAccumulator;
pub use self::statistics::GradientStatistics;

use crate::splat::Gaussians;

/// What one densification did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Densified {
    /// Gaussians added as copies of others.
    pub cloned: usize,
    /// Gaussians replaced by two.
    pub split: usize,
    /// Gaussians removed.
    pub pruned: usize,
}

/// The densified set of `R` rows. A row has the means, log-scales and opacities given here, and all else of an old row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Densification {
    /// Old row that each new row comes from, `[R]`.
    pub rows: Vec<u32>,
    /// Whether the moments of the row start at zero, `[R]`.
    pub is_new: Vec<bool>,
    /// `[R, 3]`.
    pub means: Vec<[f32; 3]>,
    /// `[R, 3]`.
    pub log_scales: Vec<[f32; 3]>,
    /// `[R]`.
    pub opacity_logits: Vec<f32>,
    /// What was done.
    pub done: Densified,
}

impl Densification {
    /// The new Gaussians.
    pub fn gaussians(&self, old: &Gaussians) -> Gaussians {
        Gaussians {
            means: self.means.clone(),
            log_scales: self.log_scales.clone(),
            opacity_logits: self.opacity_logits.clone(),
            ..old.select(&self.rows)
        }
    }

    /// Moments of the new rows; `old` is `[N, width]` row-major.
    pub fn moments(&self, old: &[f32], width: usize) -> Vec<f32> {
        let row = |(&row, &is_new): (&u32, &bool)| {
            if is_new {
                vec![0.0; width]
            } else {
                old[row as usize * width..][..width].to_vec()
            }
        };
        self.rows.iter().zip(&self.is_new).flat_map(row).collect()
    }
}

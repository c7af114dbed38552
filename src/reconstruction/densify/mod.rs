//! Densification: which Gaussians are cloned, split, pruned, decided on the host from the geometry alone.
//!
//! [`adc`] returns a [`Densification`]. It is applied to the parameters and to the
//! moments of the optimiser alike, so that row `i` of all of them stays the same Gaussian.

mod adc;
mod statistics;

pub use self::adc::{AdcRules, SizeLimit, adc, reset_opacity};
pub(crate) use self::statistics::GradientAccumulator;
pub use self::statistics::GradientStatistics;

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

//! The state of a trainer, on the host and in checkpoints.

use super::densify::GradientStatistics;
use super::optimizer::{Moments, NAMES, from_values, into_values, widths, zero_moments};
use crate::checkpoint::Checkpoint;
use crate::error::Result;
use crate::progress::{CurvePoint, Review};
use crate::provenance::Provenance;
use crate::splat::Gaussians;
use std::path::Path;

/// Kind of checkpoint.
const KIND: &str = "building";

/// State of stage one after some iterations. With scene and settings it determines the rest of the run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrainerState {
    /// Settings and photos that it was trained with; empty for a state made in memory.
    pub provenance: Provenance,
    /// Seed of the run.
    pub seed: u64,
    /// Iterations done, each one view.
    pub iteration: usize,
    /// The parameters.
    pub gaussians: Gaussians,
    /// First moments.
    pub first: Moments,
    /// Second moments.
    pub second: Moments,
    /// Screen-space gradients since the last densification.
    pub stats: GradientStatistics,
    /// Reviews of the number of Gaussians so far.
    pub reviews: Vec<Review>,
    /// Sum and number of the training losses since the last point of the curve.
    pub losses: (f64, u64),
    /// Curves so far.
    pub curve: Vec<CurvePoint>,
    /// Seconds of training so far.
    pub seconds: f64,
}

impl TrainerState {
    /// The state before the first iteration.
    pub fn new(gaussians: Gaussians, seed: u64) -> Self {
        let first = zero_moments(&gaussians);
        let second = zero_moments(&gaussians);
        let stats = GradientStatistics::new(gaussians.len());
        Self {
            seed,
            gaussians,
            first,
            second,
            stats,
            ..Self::default()
        }
    }

    /// Writes a checkpoint. The file that was there stays whole until the new one is on disk.
    ///
    /// # Errors
    /// [`crate::Error::Io`] naming the file.
    pub fn save(&self, path: &Path) -> Result<()> {
        let mut c = Checkpoint::new(KIND);
        let n = self.gaussians.len();
        c.set("sh_degree", &self.gaussians.sh_degree)?;
        c.set("seed", &self.seed)?;
        c.set("iteration", &self.iteration)?;
        let values = into_values(self.gaussians.clone());
        for (k, width) in widths(self.gaussians.sh_degree).into_iter().enumerate() {
            let name = NAMES[k];
            let shape = [n, width];
            c.put(name, &shape, values[k].clone())?;
            c.put(format!("{name}.first"), &shape, self.first[k].clone())?;
            c.put(format!("{name}.second"), &shape, self.second[k].clone())?;
        }
        c.put("density.gradient", &[n], self.stats.gradient.clone())?;
        c.put("density.visible", &[n], self.stats.visible.clone())?;
        c.set("reviews", &self.reviews)?;
        c.set("losses", &self.losses)?;
        c.set("seconds", &self.seconds)?;
        c.set("provenance", &self.provenance)?;
        c.set("curve", &self.curve)?;
        c.save(path)
    }

    /// Reads a checkpoint.
    ///
    /// # Errors
    /// [`crate::Error::Io`] and [`crate::Error::Input`] naming file and field.
    pub fn load(path: &Path) -> Result<Self> {
        let mut c = Checkpoint::load(path, KIND)?;
        let sh_degree: usize = c.get("sh_degree")?;
        if sh_degree > 3 {
            return Err(c.wrong("metadata sh_degree", sh_degree.to_string(), "0 to 3"));
        }
        let n = match c.shape(NAMES[0])? {
            &[n, _] => n,
            other => {
                return Err(c.wrong("tensor means", format!("shape {other:?}"), "shape [N, 3]"));
            }
        };
        let mut state = Self {
            provenance: c.get("provenance")?,
            seed: c.get("seed")?,
            iteration: c.get("iteration")?,
            reviews: c.get("reviews")?,
            losses: c.get("losses")?,
            curve: c.get("curve")?,
            seconds: c.get("seconds")?,
            ..Self::default()
        };
        let mut values = Moments::default();
        for (k, width) in widths(sh_degree).into_iter().enumerate() {
            let name = NAMES[k];
            let shape = [n, width];
            values[k] = c.take(name, &shape)?;
            state.first[k] = c.take(&format!("{name}.first"), &shape)?;
            state.second[k] = c.take(&format!("{name}.second"), &shape)?;
        }
        state.gaussians = from_values(values, sh_degree);
        state.stats = GradientStatistics {
            gradient: c.take("density.gradient", &[n])?,
            visible: c.take("density.visible", &[n])?,
        };
        Ok(state)
    }
}

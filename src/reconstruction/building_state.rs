//! Everything a building stage remembers, on the host and in checkpoints.

use super::densify::DensityStats;
use super::parameters::{Moments, NAMES, widths, zero_moments};
use crate::checkpoint::Checkpoint;
use crate::error::Result;
use crate::progress::CurvePoint;
use crate::provenance::Provenance;
use crate::splat::Gaussians;
use std::path::Path;

/// Kind of checkpoint.
const KIND: &str = "building";

/// State of a building stage after some iterations; with scene and settings it determines the rest of the run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BuildingState {
    /// What it was made from; nothing for a state that no stage has had.
    pub provenance: Provenance,
    /// Seed of the run.
    pub seed: u64,
    /// Iterations done; also the number of Adam steps.
    pub iteration: usize,
    /// The parameters.
    pub gaussians: Gaussians,
    /// First moments.
    pub first: Moments,
    /// Second moments.
    pub second: Moments,
    /// Screen-space gradients since the last densification.
    pub stats: DensityStats,
    /// Sum and number of the training losses since the last point of the curve.
    pub losses: (f64, u64),
    /// Curves so far.
    pub curve: Vec<CurvePoint>,
    /// Seconds of training so far.
    pub seconds: f64,
}

impl BuildingState {
    /// The state before the first iteration.
    pub fn new(gaussians: Gaussians, seed: u64) -> Self {
        let (first, second) = (zero_moments(&gaussians), zero_moments(&gaussians));
        let stats = DensityStats::new(gaussians.len());
        Self {
            seed,
            gaussians,
            first,
            second,
            stats,
            ..Self::default()
        }
    }

    /// Writes a checkpoint; the file that was there stays whole until the new one is on disk.
    ///
    /// # Errors
    /// [`crate::Error::Io`] naming the file.
    pub fn save(&self, path: &Path) -> Result<()> {
        let mut c = Checkpoint::new(KIND);
        let n = self.gaussians.len();
        c.set("sh_degree", &self.gaussians.sh_degree)?;
        c.put("seed", &[], vec![self.seed])?;
        c.put("iteration", &[], vec![self.iteration as u64])?;
        let g = &self.gaussians;
        let values = [
            g.means.as_flattened(),
            g.log_scales.as_flattened(),
            g.rotations.as_flattened(),
            &g.opacity_logits,
            &g.sh,
        ];
        for (k, width) in widths(g).into_iter().enumerate() {
            c.put(NAMES[k], &[n, width], values[k].to_vec())?;
            c.put(
                format!("{}.first", NAMES[k]),
                &[n, width],
                self.first[k].clone(),
            )?;
            c.put(
                format!("{}.second", NAMES[k]),
                &[n, width],
                self.second[k].clone(),
            )?;
        }
        c.put("density.gradient", &[n], self.stats.gradient.clone())?;
        c.put("density.visible", &[n], self.stats.visible.clone())?;
        c.put("loss.sum", &[], vec![self.losses.0])?;
        c.put("loss.count", &[], vec![self.losses.1])?;
        c.put("seconds", &[], vec![self.seconds])?;
        c.set("provenance", &self.provenance)?;
        c.put_curve(&self.curve)?;
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
            seed: scalar(&mut c, "seed")?,
            ..Self::default()
        };
        state.iteration = scalar::<u64>(&mut c, "iteration")? as usize;
        state.gaussians.sh_degree = sh_degree;
        let mut values = Moments::default();
        for (k, width) in widths(&state.gaussians).into_iter().enumerate() {
            values[k] = c.take(NAMES[k], &[n, width])?;
            state.first[k] = c.take(&format!("{}.first", NAMES[k]), &[n, width])?;
            state.second[k] = c.take(&format!("{}.second", NAMES[k]), &[n, width])?;
        }
        let [means, log_scales, rotations, opacity_logits, sh] = values;
        state.gaussians = Gaussians {
            means: means.as_chunks().0.to_vec(),
            log_scales: log_scales.as_chunks().0.to_vec(),
            rotations: rotations.as_chunks().0.to_vec(),
            opacity_logits,
            sh,
            sh_degree,
        };
        state.stats = DensityStats {
            gradient: c.take("density.gradient", &[n])?,
            visible: c.take("density.visible", &[n])?,
        };
        state.losses = (scalar(&mut c, "loss.sum")?, scalar(&mut c, "loss.count")?);
        state.seconds = scalar(&mut c, "seconds")?;
        state.provenance = c.get("provenance")?;
        state.curve = c.take_curve()?;
        Ok(state)
    }
}

/// A tensor without dimensions.
fn scalar<T: crate::checkpoint::Scalar>(c: &mut Checkpoint, name: &str) -> Result<T> {
    let value = c.take::<T>(name, &[])?.pop();
    value.ok_or_else(|| c.wrong(format!("tensor {name}"), "no value", "one value"))
}

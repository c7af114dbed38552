//! What the strategies of densification add to an iteration, and where the first Gaussians come from.

use super::{BuildingStage, Densified, Tally};
use crate::config::{Config, Strategy};
use crate::data::{Points, Scene, View};
use crate::error::Result;
use crate::gaussians::densify::{DensityRules, DensityStats, RowPlan, reset_opacity};
use crate::gaussians::noise::PositionNoise;
use crate::gaussians::relocate::{RelocationPlan, RelocationRules};
use crate::gaussians::{Gaussians, frusta, init};
use crate::ops::sum_all;
use crate::random::{Purpose, stream};
use crate::train::parameters::{Leaves, OPACITY, Parameters, widths};
use crate::train::schedule::extent;
use burn::tensor::Tensor;
use burn::tensor::activation::sigmoid;
use std::borrow::Cow;

/// Gaussians at the scene's points, or in the camera frusta where it has none; no more than `max_gaussians`.
///
/// # Errors
/// [`crate::Error::NonFinite`] for points that are not finite; those of [`crate::data::Photo::pixels`].
pub(super) fn initial(scene: &Scene, train: &[&View], config: &Config) -> Result<Gaussians> {
    let building = &config.building;
    let points = if scene.points.positions.is_empty() {
        let mut rng = stream(config.seed, Purpose::InitialPoints, 0);
        Cow::Owned(frusta::points(train, building.random_points, &mut rng)?)
    } else {
        Cow::Borrowed(&scene.points)
    };
    let points = match building.max_gaussians {
        0 => points,
        most => thinned(points, most, config.seed),
    };
    let mut gaussians = init::from_points(&points, building.sh_degree, extent(train, &scene.points))?;
    if building.strategy == Strategy::Mcmc {
        let wider = building.mcmc.init_scale.ln();
        gaussians.opacity_logits.fill(init::logit(building.mcmc.init_opacity));
        gaussians.log_scales.as_flattened_mut().iter_mut().for_each(|s| *s += wider);
    }
    Ok(gaussians)
}

/// `most` of the points, drawn by chance, in their order.
fn thinned(points: Cow<'_, Points>, most: usize, seed: u64) -> Cow<'_, Points> {
    let count = points.positions.len();
    if count <= most {
        return points;
    }
    let mut rng = stream(seed, Purpose::InitialPoints, 1);
    let mut kept = rand::seq::index::sample(&mut rng, count, most).into_vec();
    kept.sort_unstable();
    let pick = |values: &[[f32; 3]]| kept.iter().filter_map(|&i| values.get(i).copied()).collect();
    Cow::Owned(Points { positions: pick(&points.positions), colors: pick(&points.colors) })
}

impl BuildingStage<'_> {
    /// What takes up the screen-space gradient, for strategies that ask for it.
    pub(super) fn screen(&self) -> Option<Tensor<2>> {
        let building = &self.config.building;
        let columns = if building.absgrad { 4 } else { 2 };
        let screen = || Tensor::zeros([self.parameters.len(), columns], &self.device).autodiff().require_grad();
        (building.strategy == Strategy::Adc).then(screen)
    }

    /// The loss with what 3DGS-MCMC adds to it: weights times the mean opacity and the mean standard deviation, the latter in
    /// extents.
    pub(super) fn regularised(&self, loss: Tensor<1>, leaves: &Leaves) -> Tensor<1> {
        let building = &self.config.building;
        if building.strategy != Strategy::Mcmc {
            return loss;
        }
        let n = self.parameters.len().max(1) as f64;
        let opacity = sum_all(sigmoid(leaves.opacity_logits.clone())) * (building.mcmc.opacity_reg / n);
        let scales = sum_all(leaves.log_scales.clone().exp()) * (building.mcmc.scale_reg / (3.0 * n * self.extent));
        loss + opacity + scales
    }

    /// The noise of 3DGS-MCMC after the step of `iteration`.
    pub(super) fn add_noise(&mut self, iteration: usize) -> Result<()> {
        let (building, mcmc) = (&self.config.building, &self.config.building.mcmc);
        if building.strategy != Strategy::Mcmc || mcmc.noise == 0.0 {
            return Ok(());
        }
        let noise = PositionNoise {
            scale: mcmc.noise * self.schedule.means_rate(iteration) / (self.extent * self.extent),
            sharpness: mcmc.noise_sharpness,
            opacity: mcmc.noise_opacity,
        };
        self.parameters.add_noise(&noise, &stream(self.config.seed, Purpose::PositionNoise, iteration as u64))
    }

    /// One densification.
    pub(super) fn densify(&mut self) -> Result<Densified> {
        let (gaussians, first, second) = self.parameters.clone().into_host()?;
        let mut rng = stream(self.config.seed, Purpose::Densification, self.iteration as u64);
        let b = &self.config.building;
        let widths = widths(&gaussians);
        let all =
            |of: &dyn Fn(&[f32], usize) -> Vec<f32>, m: [Vec<f32>; 5]| std::array::from_fn(|k| of(&m[k], widths[k]));
        let (gaussians, first, second, done) = match b.strategy {
            Strategy::Adc => {
                let rules = DensityRules {
                    threshold: b.densify_threshold(),
                    clone_below: b.clone_below * self.extent as f32,
                    prune_opacity: b.prune_opacity,
                    prune_scale: b.prune_scale * self.extent as f32,
                    max_gaussians: b.max_gaussians,
                };
                let plan = RowPlan::new(&gaussians, &self.tally.read()?, &rules)?;
                let moments = |old: &[f32], width: usize| plan.moments(old, width);
                let RowPlan { cloned, split, pruned, .. } = plan;
                let done = Densified { cloned, split, pruned, relocated: 0 };
                (plan.gaussians(&gaussians, &mut rng), all(&moments, first), all(&moments, second), done)
            }
            Strategy::Mcmc => {
                let rules =
                    RelocationRules { dead: b.prune_opacity, growth: b.mcmc.growth, max_gaussians: b.max_gaussians };
                let plan = RelocationPlan::new(&gaussians.opacity_logits, &rules, &mut rng);
                let moments = |old: &[f32], width: usize| plan.moments(old, width);
                let done = Densified { cloned: plan.added, relocated: plan.relocated, ..Densified::default() };
                (plan.gaussians(&gaussians), all(&moments, first), all(&moments, second), done)
            }
        };
        self.tally = Tally::new(DensityStats::new(gaussians.len()), &self.device);
        self.parameters = Parameters::new(gaussians, first, second, &self.device);
        Ok(done)
    }

    /// An opacity reset.
    pub(super) fn reset(&mut self) -> Result<()> {
        let (mut gaussians, mut first, mut second) = self.parameters.clone().into_host()?;
        reset_opacity(&mut gaussians.opacity_logits);
        first[OPACITY].fill(0.0);
        second[OPACITY].fill(0.0);
        self.parameters = Parameters::new(gaussians, first, second, &self.device);
        Ok(())
    }
}

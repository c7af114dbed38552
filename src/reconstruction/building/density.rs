//! What the strategies of densification add to an iteration, and where the first Gaussians come from.

use super::{BuildingStage, Densified, GradientAccumulator};
use crate::config::{AdcConfig, Config, McmcConfig, Strategy};
use crate::data::{Points, Scene, View};
use crate::error::{Error, Result};
use crate::ops::sum_all;
use crate::random::{Purpose, stream};
use crate::reconstruction::densify::{DensityRules, DensityStats, RowPlan, SizeLimit};
use crate::reconstruction::noise::PositionNoise;
use crate::reconstruction::parameters::{Leaves, NewValues, RowMap};
use crate::reconstruction::relocate::{RelocationPlan, RelocationRules};
use crate::reconstruction::schedule::extent;
use crate::reconstruction::{frusta, initialization};
use crate::splat::{Gaussians, Geometry};
use burn::tensor::Tensor;
use burn::tensor::activation::sigmoid;
use rand_chacha::ChaCha8Rng;
use std::borrow::Cow;

/// Gaussians at the scene's points, or in the camera frusta where it has none; no more than `max_gaussians`.
///
/// # Errors
/// [`crate::Error::NonFinite`] for points that are not finite; those of [`crate::data::Photo::pixels`].
pub(crate) fn initial(scene: &Scene, train: &[&View], config: &Config) -> Result<Gaussians> {
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
    let mut gaussians =
        initialization::from_points(&points, building.sh_degree, extent(train, &scene.points))?;
    if let Strategy::Mcmc(mcmc) = &building.strategy {
        let wider = mcmc.init_scale.ln();
        gaussians
            .opacity_logits
            .fill(initialization::logit(mcmc.init_opacity));
        gaussians
            .log_scales
            .as_flattened_mut()
            .iter_mut()
            .for_each(|s| *s += wider);
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
    let pick = |values: &[[f32; 3]]| {
        kept.iter()
            .filter_map(|&i| values.get(i).copied())
            .collect()
    };
    Cow::Owned(Points {
        positions: pick(&points.positions),
        colors: pick(&points.colors),
    })
}

impl BuildingStage<'_> {
    /// What takes up the screen-space gradient, for strategies that ask for it.
    pub(crate) fn screen(&self) -> Option<Tensor<2>> {
        let Strategy::Adc(adc) = &self.config.building.strategy else {
            return None;
        };
        let columns = if adc.absgrad { 4 } else { 2 };
        let screen = Tensor::zeros([self.parameters.len(), columns], &self.device);
        Some(screen.autodiff().require_grad())
    }

    /// The loss with what 3DGS-MCMC adds to it: weights times the mean opacity and the mean standard deviation, the latter in
    /// extents.
    pub(crate) fn regularised(&self, loss: Tensor<1>, leaves: &Leaves) -> Tensor<1> {
        let Strategy::Mcmc(mcmc) = &self.config.building.strategy else {
            return loss;
        };
        let n = self.parameters.len().max(1) as f64;
        let opacity = sum_all(sigmoid(leaves.opacity_logits.clone())) * (mcmc.opacity_reg / n);
        let scales =
            sum_all(leaves.log_scales.clone().exp()) * (mcmc.scale_reg / (3.0 * n * self.extent));
        loss + opacity + scales
    }

    /// The noise of 3DGS-MCMC after the step of `iteration`.
    pub(crate) fn add_noise(&mut self, iteration: usize) {
        let mcmc = match &self.config.building.strategy {
            Strategy::Mcmc(mcmc) if mcmc.noise > 0.0 => mcmc,
            _ => return,
        };
        let noise = PositionNoise {
            scale: mcmc.noise * self.schedule.means_rate(iteration) / (self.extent * self.extent),
            sharpness: mcmc.noise_sharpness,
            opacity: mcmc.noise_opacity,
        };
        let mut rng = stream(self.config.seed, Purpose::PositionNoise, iteration as u64);
        self.parameters.add_noise(&noise, &mut rng);
    }

    /// One densification: decided on the host from the geometry alone. All else is moved where it lies.
    pub(crate) fn densify(&mut self) -> Result<Densified> {
        let values = self.parameters.geometry()?;
        let old = Geometry::of_values(&values);
        if old.is_empty() {
            return Ok(Densified::default());
        }
        let mut rng = stream(
            self.config.seed,
            Purpose::Densification,
            self.iteration as u64,
        );
        let (map, values, done) = match &self.config.building.strategy {
            Strategy::Adc(adc) => self.controlled(old, adc, &mut rng)?,
            Strategy::Mcmc(mcmc) => self.relocated(old, mcmc, &mut rng),
        };
        if map.is_empty() && !old.is_empty() {
            let name = format!("densification after {} steps", self.iteration);
            let found = format!(
                "{} Gaussians, none of which is opaque and small enough to stay",
                old.len()
            );
            let help = "run `coseg data check` on the scene, whose poses are in doubt";
            return Err(Error::argument(
                &name,
                found,
                "some that the photos show",
                help,
            ));
        }
        let stats = DensityStats::new(map.len());
        self.statistics = GradientAccumulator::new(stats, &self.device);
        self.parameters.rearrange(&map, values);
        Ok(done)
    }

    /// What adaptive density control does.
    fn controlled(
        &self,
        old: Geometry<'_>,
        adc: &AdcConfig,
        rng: &mut ChaCha8Rng,
    ) -> Result<(RowMap, NewValues, Densified)> {
        let plan = RowPlan::new(old, &self.statistics.read()?, &self.density_rules(adc))?;
        let (means, log_scales) = plan.placed(old, rng);
        let values = NewValues {
            means: Some(means),
            log_scales: Some(log_scales),
            ..NewValues::default()
        };
        let RowPlan {
            cloned,
            split,
            pruned,
            ..
        } = plan;
        Ok((
            RowMap::new(plan.sources(), &self.device),
            values,
            Densified {
                cloned,
                split,
                pruned,
                relocated: 0,
            },
        ))
    }

    /// What 3DGS-MCMC does.
    fn relocated(
        &self,
        old: Geometry<'_>,
        mcmc: &McmcConfig,
        rng: &mut ChaCha8Rng,
    ) -> (RowMap, NewValues, Densified) {
        let plan = RelocationPlan::new(old.opacity_logits, &self.relocation_rules(mcmc), rng);
        let (opacity_logits, log_scales) = plan.corrected(old);
        let values = NewValues {
            means: None,
            log_scales: Some(log_scales),
            opacity_logits: Some(opacity_logits),
        };
        let done = Densified {
            cloned: plan.added,
            relocated: plan.relocated,
            ..Densified::default()
        };
        (RowMap::new(plan.sources(), &self.device), values, done)
    }

    fn density_rules(&self, adc: &AdcConfig) -> DensityRules {
        let b = &self.config.building;
        DensityRules {
            threshold: adc.threshold(),
            clone_below: b.clone_below * self.extent as f32,
            prune_opacity: b.prune_opacity,
            prune_scale: SizeLimit {
                share: b.prune_scale,
                extent: self.extent as f32,
                center: self.center.as_vec3().to_array(),
            },
            max_gaussians: b.max_gaussians,
        }
    }

    fn relocation_rules(&self, mcmc: &McmcConfig) -> RelocationRules {
        let b = &self.config.building;
        RelocationRules {
            dead: b.prune_opacity,
            growth: mcmc.growth,
            max_gaussians: b.max_gaussians,
        }
    }

    /// An opacity reset.
    pub(crate) fn reset(&mut self) -> Result<()> {
        self.parameters.reset_opacity()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::device::{BackendName, device_of_tests};
    use crate::backend::host_fallbacks;
    use crate::config::BuildingConfig;
    use crate::data::builtin::{BuiltinOptions, scene_with};
    use crate::reconstruction::BuildingState;
    use crate::reconstruction::densify::reset_opacity;
    use crate::reconstruction::parameters::{Moments, OPACITY, widths};

    fn waves(count: usize, step: f32) -> Vec<f32> {
        (0..count).map(|i| (i as f32 * step).sin()).collect()
    }

    /// `start` as if it had been trained: moments of every size, gradients and opacities on either side of all thresholds.
    fn trained(mut start: BuildingState, rules: &DensityRules) -> BuildingState {
        let g = &mut start.gaussians;
        let n = g.len();
        g.opacity_logits = waves(n, 1.3).iter().map(|v| 7.0 * v).collect();
        g.log_scales = waves(n, 0.7)
            .iter()
            .map(|v| [v - 3.0, 3.0 * v, v - 4.0].map(|s| s + rules.clone_below.ln()))
            .collect();
        g.sh = waves(g.sh.len(), 0.9);
        start.first = widths(g).map(|width| waves(n * width, 1.1));
        start.second = widths(g).map(|width| waves(n * width, 1.9).iter().map(|v| v * v).collect());
        start.stats.visible = (0..n as u32).map(|i| i % 5).collect();
        start.stats.gradient = waves(n, 2.3)
            .iter()
            .map(|v| 6.0 * rules.threshold * v.abs())
            .collect();
        start
    }

    /// Has `look` see a stage on each device there is, and the state that it began with.
    fn on_each_device(strategy: Strategy, look: impl Fn(BuildingStage<'_>, BuildingState)) {
        let options = BuiltinOptions {
            width: 64,
            height: 48,
            train_views: 2,
            points: 900,
            ..BuiltinOptions::default()
        };
        let scene = scene_with(&options).expect("a scene");
        let building = BuildingConfig {
            strategy,
            sh_degree: 2,
            max_gaussians: 1000,
            ..BuildingConfig::default()
        };
        let config = Config {
            building,
            ..Config::default()
        };
        for &name in BackendName::compiled() {
            let Some(device) = device_of_tests(name) else {
                continue;
            };
            let stage = BuildingStage::new(&scene, &config, &device).expect("a stage");
            let start = trained(
                stage.state().expect("readable"),
                &stage.density_rules(&AdcConfig::default()),
            );
            let stage = BuildingStage::from_state(&scene, &config, &device, start.clone())
                .expect("a stage");
            assert!(
                stage.state().expect("readable") == start,
                "what a stage begins with, on {name}"
            );
            look(stage, start);
        }
    }

    fn assert_same(
        stage: &BuildingStage<'_>,
        gaussians: &Gaussians,
        [first, second]: [&Moments; 2],
    ) {
        let got = stage.state().expect("readable");
        assert!(
            got.gaussians == *gaussians,
            "Gaussians on {:?}",
            stage.device
        );
        assert!(
            got.first == *first && got.second == *second,
            "moments on {:?}",
            stage.device
        );
    }

    #[test]
    fn a_densification_is_that_of_host_vectors_on_every_device() {
        on_each_device(Strategy::default(), |mut stage, start| {
            let mut rng = stream(start.seed, Purpose::Densification, 0);
            let plan = RowPlan::new(
                &start.gaussians,
                &start.stats,
                &stage.density_rules(&AdcConfig::default()),
            )
            .expect("matching");
            assert!(
                plan.cloned > 9 && plan.split > 9 && plan.pruned > 9,
                "{} {} {}",
                plan.cloned,
                plan.split,
                plan.pruned
            );
            let want = plan.gaussians(&start.gaussians, &mut rng);
            let moments = [&start.first, &start.second].map(|old| {
                std::array::from_fn(|k| plan.moments(&old[k], widths(&start.gaussians)[k]))
            });
            let before = host_fallbacks();
            let done = stage.densify().expect("readable");
            assert_eq!(
                host_fallbacks(),
                before,
                "tensors went to the host on {:?}",
                stage.device
            );
            assert_eq!(
                (done.cloned, done.split, done.pruned),
                (plan.cloned, plan.split, plan.pruned)
            );
            assert_same(&stage, &want, moments.each_ref());
            assert_eq!(
                stage.statistics.read().expect("readable"),
                DensityStats::new(want.len())
            );
        });
    }

    #[test]
    fn a_relocation_is_that_of_host_vectors_on_every_device() {
        on_each_device(Strategy::Mcmc(McmcConfig::default()), |mut stage, start| {
            let mut rng = stream(start.seed, Purpose::Densification, 0);
            let plan = RelocationPlan::new(
                &start.gaussians.opacity_logits,
                &stage.relocation_rules(&McmcConfig::default()),
                &mut rng,
            );
            assert!(
                plan.relocated > 9 && plan.added > 9,
                "{} and {}",
                plan.relocated,
                plan.added
            );
            let want = plan.gaussians(&start.gaussians);
            let moments = [&start.first, &start.second].map(|old| {
                std::array::from_fn(|k| plan.moments(&old[k], widths(&start.gaussians)[k]))
            });
            let before = host_fallbacks();
            let done = stage.densify().expect("readable");
            assert_eq!(
                host_fallbacks(),
                before,
                "tensors went to the host on {:?}",
                stage.device
            );
            assert_eq!((done.relocated, done.cloned), (plan.relocated, plan.added));
            assert_same(&stage, &want, moments.each_ref());
        });
    }

    #[test]
    fn a_reset_changes_opacities_and_their_moments_alone() {
        on_each_device(Strategy::default(), |mut stage, start| {
            let BuildingState {
                mut gaussians,
                mut first,
                mut second,
                ..
            } = start;
            reset_opacity(&mut gaussians.opacity_logits);
            first[OPACITY].fill(0.0);
            second[OPACITY].fill(0.0);
            stage.reset().expect("readable");
            assert_same(&stage, &gaussians, [&first, &second]);
        });
    }
}

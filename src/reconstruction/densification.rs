//! Adaptive density control (Kerbl et al. 2023) in the iterations of stage one: Gaussians with a large screen-space gradient are
//! cloned or split, transparent and huge ones are pruned.

use super::Trainer;
use super::densify::{
    AdcRules, Densified, GradientAccumulator, GradientStatistics, SizeLimit, adc,
};
use crate::config::SizeRule;
use crate::error::{Result, ensure};
use crate::random::{Purpose, stream};
use burn::tensor::Tensor;

/// Gaussians below this share of the extent are cloned, others split.
const CLONE_BELOW: f32 = 0.01;
/// Gaussians larger than this share of the length that [`SizeRule`] names are pruned.
const PRUNE_SCALE: f32 = 0.1;

impl Trainer<'_> {
    /// A tensor of zeros that receives the screen-space gradient.
    pub(crate) fn screen(&self) -> Tensor<2> {
        let columns = if self.config.building.absgrad { 4 } else { 2 };
        let zeros = Tensor::zeros([self.parameters.len(), columns], &self.device);
        zeros.autodiff().require_grad()
    }

    /// One densification. The host decides from the geometry alone; all else is moved on the device.
    pub(crate) fn densify(&mut self) -> Result<Densified> {
        let old = self.parameters.geometry()?;
        if old.is_empty() {
            return Ok(Densified::default());
        }
        let iteration = self.iteration as u64;
        let mut rng = stream(self.config.seed, Purpose::Densification, iteration);
        let statistics = self.statistics.clone().of_all_ranks()?.read()?;
        let densification = adc(&old, &statistics, &self.adc_rules(), &mut rng)?;
        ensure!(!densification.rows.is_empty(), argument "densification after {} steps", self.iteration;
            found  "{} Gaussians, none of which is opaque and small enough to stay", old.len();
            expected "some that the photos show";
            help "run `coseg data check` on the scene, whose poses are in doubt");
        let stats = GradientStatistics::new(densification.rows.len());
        self.statistics = GradientAccumulator::new(stats, &self.device);
        let done = densification.done;
        self.parameters.rearrange(densification);
        Ok(done)
    }

    fn adc_rules(&self) -> AdcRules {
        let building = &self.config.building;
        AdcRules {
            threshold: building.gradient_threshold(),
            clone_below: CLONE_BELOW * self.extent as f32,
            prune_opacity: building.prune_opacity,
            prune_scale: self.size_limit(),
            max_gaussians: self.capacity(),
        }
    }

    fn size_limit(&self) -> SizeLimit {
        let by_distance = self.config.building.size_limit == SizeRule::Distance;
        // By the extent alone, Gaussians of any size stay until the first reset of opacities.
        let prunes = by_distance || self.iteration > self.schedule.reset_every();
        SizeLimit {
            share: if prunes { PRUNE_SCALE } else { f32::INFINITY },
            extent: self.extent as f32,
            center: by_distance.then(|| self.center.as_vec3().to_array()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::device::{BackendName, device_of_tests};
    use crate::backend::host_fallbacks;
    use crate::config::{Budget, BuildingConfig, Config};
    use crate::data::builtin::{BuiltinOptions, scene_with};
    use crate::reconstruction::TrainerState;
    use crate::reconstruction::densify::{Densification, reset_opacity};
    use crate::reconstruction::optimizer::{Moments, OPACITY, widths};
    use crate::splat::Gaussians;

    fn waves(count: usize, step: f32) -> Vec<f32> {
        (0..count).map(|i| (i as f32 * step).sin()).collect()
    }

    /// `start` as if it had been trained: moments of every size, gradients and opacities on either side of all thresholds.
    fn trained(mut start: TrainerState, rules: &AdcRules) -> TrainerState {
        let g = &mut start.gaussians;
        let n = g.len();
        g.opacity_logits = waves(n, 1.3).iter().map(|v| 7.0 * v).collect();
        g.log_scales = waves(n, 0.7)
            .iter()
            .map(|v| [v - 3.0, 3.0 * v, v - 4.0].map(|s| s + rules.clone_below.ln()))
            .collect();
        g.sh = waves(g.sh.len(), 0.9);
        start.first = widths(g.sh_degree).map(|width| waves(n * width, 1.1));
        start.second =
            widths(g.sh_degree).map(|width| waves(n * width, 1.9).iter().map(|v| v * v).collect());
        start.stats.visible = (0..n as u32).map(|i| i % 5).collect();
        start.stats.gradient = waves(n, 2.3)
            .iter()
            .map(|v| 6.0 * rules.threshold * v.abs())
            .collect();
        start
    }

    /// Calls `look` with a new trainer on each device, and with its initial state.
    fn on_each_device(look: impl Fn(Trainer<'_>, TrainerState)) {
        let options = BuiltinOptions {
            width: 64,
            height: 48,
            train_views: 2,
            points: 900,
            ..BuiltinOptions::default()
        };
        let scene = scene_with(&options).expect("a scene");
        let building = BuildingConfig {
            sh_degree: 2,
            max_gaussians: Budget::AtMost(1000),
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
            let stage = Trainer::new(&scene, &config, &device).expect("a stage");
            let start = trained(stage.state().expect("readable"), &stage.adc_rules());
            let stage =
                Trainer::from_state(&scene, &config, &device, start.clone()).expect("a stage");
            assert!(
                stage.state().expect("readable") == start,
                "what a stage begins with, on {name}"
            );
            look(stage, start);
        }
    }

    fn assert_same(stage: &Trainer<'_>, gaussians: &Gaussians, [first, second]: [&Moments; 2]) {
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

    /// Moments of the rows of `plan`; `old` is `[N, width]` row-major.
    fn moments(plan: &Densification, old: &[f32], width: usize) -> Vec<f32> {
        let rows = plan.rows.iter().zip(&plan.is_new);
        let row = |(&row, &is_new): (&u32, &bool)| {
            if is_new {
                vec![0.0; width]
            } else {
                old[row as usize * width..][..width].to_vec()
            }
        };
        rows.flat_map(row).collect()
    }

    /// Densifies `stage` and compares it with `plan` applied to host vectors.
    fn assert_densifies(mut stage: Trainer<'_>, start: &TrainerState, plan: &Densification) {
        let want = Gaussians {
            means: plan.means.clone(),
            log_scales: plan.log_scales.clone(),
            opacity_logits: plan.opacity_logits.clone(),
            ..start.gaussians.select(&plan.rows)
        };
        let widths = widths(start.gaussians.sh_degree);
        let moments = [&start.first, &start.second]
            .map(|old| std::array::from_fn(|k| moments(plan, &old[k], widths[k])));
        let before = host_fallbacks();
        let done = stage.densify().expect("readable");
        assert_eq!(
            host_fallbacks(),
            before,
            "tensors went to the host on {:?}",
            stage.device
        );
        assert_eq!(done, plan.done);
        assert_same(&stage, &want, moments.each_ref());
        assert_eq!(
            stage.statistics.read().expect("readable"),
            GradientStatistics::new(want.len())
        );
    }

    #[test]
    fn a_densification_is_that_of_host_vectors_on_every_device() {
        on_each_device(|stage, start| {
            let mut rng = stream(start.seed, Purpose::Densification, 0);
            let rules = stage.adc_rules();
            let plan = adc(&start.gaussians, &start.stats, &rules, &mut rng).expect("matching");
            let Densified {
                cloned,
                split,
                pruned,
                ..
            } = plan.done;
            assert!(cloned > 9 && split > 9 && pruned > 9, "{:?}", plan.done);
            assert_densifies(stage, &start, &plan);
        });
    }

    #[test]
    fn a_reset_changes_opacities_and_their_moments_alone() {
        on_each_device(|mut stage, start| {
            let TrainerState {
                mut gaussians,
                mut first,
                mut second,
                ..
            } = start;
            reset_opacity(&mut gaussians.opacity_logits);
            first[OPACITY].fill(0.0);
            second[OPACITY].fill(0.0);
            stage.parameters.reset_opacity().expect("readable");
            assert_same(&stage, &gaussians, [&first, &second]);
        });
    }
}

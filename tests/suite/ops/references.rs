//! A whole step of a stage with all custom operations replaced by their plain-tensor references.

use crate::reconstruction::trainer::{config, scene};
use coseg::config::{BuildingConfig, Config, Strategy};
use coseg::ops::with_references;
use coseg::reconstruction::{Trainer, TrainerState};

/// Loss of a step, and the state after it, whose first moments are a tenth of the gradients.
fn step(config: &Config) -> (f64, TrainerState) {
    let scene = scene();
    let device = crate::support::device();
    let mut start = Trainer::new(&scene, config, &device)
        .and_then(|trainer| trainer.state())
        .expect("a state");
    // Round Gaussians have no gradient to their rotations.
    for (i, scales) in start.gaussians.log_scales.iter_mut().enumerate() {
        *scales = [0.3, 1.1, 2.7].map(|by| scales[0] + 0.5 * (i as f32 * by).sin());
    }
    for (i, rotation) in start.gaussians.rotations.iter_mut().enumerate() {
        *rotation = [0.3, 0.9, 1.7, 2.3].map(|by| (i as f32 * by + 1.0).sin());
    }
    let mut trainer = Trainer::from_state(&scene, config, &device, start).expect("a trainer");
    let loss = trainer.step().expect("a step").loss;
    (loss, trainer.state().expect("readable"))
}

fn assert_close(name: &str, got: &[f32], want: &[f32], tolerance: f32) {
    let largest = want.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
    assert!(largest > 0.0, "{name}: all zero");
    let off = got.iter().zip(want).map(|(a, b)| (a - b).abs());
    let worst = off.fold(0.0, |m: f32, d| if d.is_nan() { d } else { m.max(d) }) / largest;
    assert!(worst < tolerance, "{name}: {worst} of the largest value");
}

#[test]
fn a_step_of_stage_one_equals_that_of_the_references() {
    for strategy in [Strategy::default(), Strategy::Mcmc(Default::default())] {
        let building = BuildingConfig {
            strategy,
            max_gaussians: 1_000,
            ..config().building
        };
        let config = Config {
            building,
            ..config()
        };
        let (loss, got) = step(&config);
        let (want_loss, want) = with_references(|| step(&config));
        assert!(
            (loss - want_loss).abs() < 1e-5 * want_loss,
            "{loss} against {want_loss}"
        );
        let names = ["means", "log_scales", "rotations", "opacity_logits", "sh"];
        for (k, name) in names.iter().enumerate() {
            assert_close(name, &got.first[k], &want.first[k], 1e-3);
            assert_close(name, &got.second[k], &want.second[k], 1e-3);
        }
        let means = |state: &TrainerState| state.gaussians.means.as_flattened().to_vec();
        assert_close("means after the step", &means(&got), &means(&want), 1e-3);
    }
}

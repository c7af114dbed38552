//! A whole step of a stage with all custom operations replaced by their plain-tensor references.

use crate::reconstruction::trainer::{config, scene};
use coseg::config::{BuildingConfig, Config, Strategy};
use coseg::ops::with_references;
use coseg::reconstruction::{Trainer, TrainerState};

/// Loss of the first step, and the state after it, whose first moments are a tenth of the gradients.
fn step(config: &Config) -> (f64, TrainerState) {
    let scene = scene();
    let mut stage = Trainer::new(&scene, config, &crate::support::device()).expect("a stage");
    let loss = stage.step().expect("a step").loss;
    (loss, stage.state().expect("readable"))
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

//! Ranges of stage one's settings: the same wherever they are given.

use crate::support::assert_names;
use crate::support::device;
use coseg::config::{Budget, BuildingConfig, Config};
use coseg::data::builtin::{BuiltinOptions, scene_with};
use coseg::reconstruction::Trainer;

#[test]
fn a_run_and_a_stage_refuse_the_same_settings() {
    let options = BuiltinOptions {
        width: 32,
        height: 24,
        train_views: 2,
        test_views: 1,
        points: 50,
        ..Default::default()
    };
    let scene = scene_with(&options).unwrap();
    type Edit = fn(&mut BuildingConfig);
    let cases: [(&str, Edit); 7] = [
        ("building.iterations", |b| b.iterations = 0),
        ("building.iterations", |b| b.iterations = 1 << 32),
        ("building.sh_degree", |b| b.sh_degree = 4),
        ("building.lr_means", |b| b.lr_means = -1e-3),
        ("building.random_points", |b| b.random_points = 0),
        ("building.gradient_threshold", |b| {
            b.gradient_threshold = Some(f32::INFINITY)
        }),
        ("building.max_gaussians", |b| {
            b.max_gaussians = Budget::AtMost(0)
        }),
    ];
    for (key, edit) in cases {
        let mut config = Config::default();
        edit(&mut config.building);
        let stage = Trainer::new(&scene, &config, &device())
            .err()
            .expect("must be refused");
        for error in [
            config.validate().unwrap_err(),
            config.building.validate().unwrap_err(),
            stage,
        ] {
            assert_names(&error, &["setting", key, "expected"]);
        }
    }
}

#[test]
fn a_rate_of_zero_leaves_a_parameter_as_it_is() {
    let options = BuiltinOptions {
        width: 32,
        height: 24,
        train_views: 2,
        test_views: 1,
        points: 200,
        ..Default::default()
    };
    let scene = scene_with(&options).unwrap();
    let building = BuildingConfig {
        lr_means: 0.0,
        lr_opacity: 0.0,
        iterations: 4,
        max_gaussians: Budget::Unlimited,
        ..BuildingConfig::default()
    };
    let config = Config {
        building,
        ..Config::default()
    };
    config.validate().unwrap();
    let mut stage = Trainer::new(&scene, &config, &device()).unwrap();
    let before = stage.gaussians().unwrap();
    for _ in 0..3 {
        stage.step().unwrap();
    }
    let after = stage.gaussians().unwrap();
    assert_eq!(
        (&before.means, &before.opacity_logits),
        (&after.means, &after.opacity_logits)
    );
    assert!(before.log_scales != after.log_scales && before.sh != after.sh);
}

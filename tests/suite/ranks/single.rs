//! A process that is alone, and batches of views in one.

use crate::support::{assert_names, device};
use coseg::config::{BuildingConfig, Config};
use coseg::data::Scene;
use coseg::data::builtin::{BuiltinOptions, scene_with};
use coseg::ranks;
use coseg::reconstruction::Trainer;

#[test]
fn one_process_has_all_items_and_sums_nothing() {
    assert_eq!((ranks::index(), ranks::count()), (0, 1));
    assert!(ranks::share(0..5).eq(0..5));
    let mut values = [1.5_f32, -2.0];
    ranks::sum(&mut values);
    assert_eq!(values, [1.5, -2.0]);
    assert_eq!(
        ranks::divided(0..4, |i| Ok(10 * i)).unwrap(),
        [0, 10, 20, 30]
    );
    assert_eq!(ranks::gather("here".to_owned()).unwrap(), ["here"]);
    assert!(ranks::any(true).unwrap() && !ranks::any(false).unwrap());
    ranks::expect_same("a value", "x".to_owned()).unwrap();
    assert_eq!(ranks::sent(), 0);
}

fn scene() -> Scene {
    let options = BuiltinOptions {
        width: 48,
        height: 36,
        train_views: 3,
        test_views: 1,
        points: 300,
        ..BuiltinOptions::default()
    };
    scene_with(&options).unwrap()
}

fn config(iterations: usize, batch: Option<usize>) -> Config {
    let building = BuildingConfig {
        iterations,
        batch,
        random_background: false,
        ..BuildingConfig::default()
    };
    Config {
        building,
        ..Config::default()
    }
}

#[test]
fn a_step_takes_as_many_views_as_its_batch() {
    let scene = scene();
    let mut trainer = Trainer::new(&scene, &config(7, Some(3)), &device()).unwrap();
    let ends: Vec<usize> = (0..3).map(|_| trainer.step().unwrap().iteration).collect();
    assert_eq!(ends, [3, 6, 7]);
    let error = config(7, Some(0)).building.validate().unwrap_err();
    assert_names(&error, &["building.batch", "found 0", "1 to 65536"]);
}

/// Adam ignores the size of the gradient, so that the first step of a batch shows its learning rate: the root of its views.
#[test]
fn learning_rates_grow_with_the_root_of_the_batch() {
    let scene = scene();
    let moved = |batch| {
        let mut trainer = Trainer::new(&scene, &config(100, Some(batch)), &device()).unwrap();
        let before = trainer.gaussians().unwrap();
        trainer.step().unwrap();
        let after = trainer.gaussians().unwrap();
        let pairs = after.opacity_logits.iter().zip(&before.opacity_logits);
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    // A step of one view moves by the rate. In one of `batch`, the moments keep `0.9^batch` and `0.999^batch`.
    let rate = config(1, None).building.lr_opacity as f32;
    for batch in [1, 3] {
        let found = moved(batch) / rate;
        let expected = (batch as f32).sqrt();
        assert!((found - expected).abs() < 1e-3, "{found} of {batch} views");
    }
}

#[cfg(not(feature = "mpi"))]
#[test]
fn a_build_without_mpi_says_so_under_mpirun() {
    use crate::support::program::text;
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_coseg"));
    let output = command
        .args(["train"])
        .env("OMPI_COMM_WORLD_SIZE", "2")
        .output()
        .unwrap();
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("mpirun: found 2 processes"), "{message}");
    assert!(message.contains("--features mpi"), "{message}");
}

//! Stage one on a GPU: the same steps as on ndarray, what densification gathers, resuming.

use crate::support::gpu;
use burn::tensor::Device;
use coseg::config::{Budget, BuildingConfig, Config};
use coseg::data::{LoadOptions, Scene, load};
use coseg::reconstruction::{Trainer, TrainerState};

/// The plates, and the folder that they are read from.
fn scene() -> (Scene, tempfile::TempDir) {
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    (
        load(folder.path(), &LoadOptions::default()).expect("a scene"),
        folder,
    )
}

fn config(densify_from: usize, absgrad: bool) -> Config {
    let building = BuildingConfig {
        absgrad,
        max_gaussians: Budget::AtMost(600),
        iterations: 60,
        random_points: 500,
        densify_from,
        densify_every: 10,
        ..BuildingConfig::default()
    };
    Config {
        building,
        ..Config::default()
    }
}

fn steps(stage: &mut Trainer, count: usize) -> Vec<f64> {
    (0..count)
        .map(|_| stage.step().expect("a step").loss)
        .collect()
}

#[test]
fn steps_on_a_gpu_are_those_on_ndarray() {
    let Some(gpu) = gpu() else { return };
    let (scene, _folder) = scene();
    for absgrad in [false, true] {
        compare(&gpu, &scene, &config(1000, absgrad));
    }
}

fn compare(gpu: &Device, scene: &Scene, config: &Config) {
    let run = |device: &Device| {
        let mut stage = Trainer::new(scene, config, device).expect("a stage");
        let losses = steps(&mut stage, 12);
        (losses, stage.state().expect("readable"))
    };
    let ((losses, got), (want_losses, want)) = (run(gpu), run(&crate::support::device()));
    for (i, (got, want)) in losses.iter().zip(&want_losses).enumerate() {
        assert!(
            (got - want).abs() < 1e-3 * want,
            "loss of step {i}: {got} for {want}"
        );
    }
    assert!(losses[9] < 0.8 * losses[0], "{losses:?}"); // an opacity reset follows
    let n = want.stats.visible.len();
    let same = got
        .stats
        .visible
        .iter()
        .zip(&want.stats.visible)
        .filter(|(a, b)| a == b)
        .count();
    assert!(same * 100 >= n * 98, "{same} of {n} were seen as often");
    assert!(
        want.stats
            .visible
            .iter()
            .any(|&count| count > 0 && count < 12),
        "some are seen in some views"
    );
    let total = |state: &TrainerState| {
        state
            .stats
            .gradient
            .iter()
            .map(|&g| f64::from(g))
            .sum::<f64>()
    };
    let (a, b) = (total(&got), total(&want));
    assert!((a - b).abs() < 0.02 * b, "{a} for {b}");
    let largest = want.stats.gradient.iter().fold(0.0_f32, |m, v| m.max(*v));
    let pairs = got.stats.gradient.iter().zip(&want.stats.gradient);
    let off = pairs
        .filter(|(a, b)| (*a - *b).abs() > 0.05 * **b + 1e-3 * largest)
        .count();
    assert!(off * 50 <= n, "{off} of {n} gathered another gradient");
}

#[test]
fn a_resumed_stage_goes_on_to_the_same_bits() {
    let Some(gpu) = gpu() else { return };
    let (scene, _folder) = scene();
    assert_resumes(&gpu, &scene, &config(5, false));
}

fn assert_resumes(gpu: &Device, scene: &Scene, config: &Config) {
    let mut whole = Trainer::new(scene, config, gpu).expect("a stage");
    steps(&mut whole, 15);
    let state = whole.state().expect("readable");
    assert!(
        state.gaussians.len() != 500,
        "a densification has been: {}",
        state.gaussians.len()
    );
    let mut resumed = Trainer::from_state(scene, config, gpu, state).expect("a stage");
    assert_eq!(steps(&mut whole, 8), steps(&mut resumed, 8));
    let [a, b] = [whole, resumed].map(|stage| stage.state().expect("readable"));
    assert!(
        a.gaussians == b.gaussians
            && a.stats == b.stats
            && a.first == b.first
            && a.second == b.second
    );
}

//! The building stage on a tiny scene: it learns, resumes exactly, and refuses what it cannot train on.

use crate::support::painted_plane::{
    HEIGHT, WIDTH, advance, assert_bits_follow_the_seed, config, scene, untimed,
};
use coseg::config::{BuildingConfig, Config};
use coseg::data::{Scene, Split};
use coseg::progress::{Event, Progress, Silent};
use coseg::raster::{Settings, render};
use coseg::reconstruction::{Trainer, TrainerState, schedule};
use glam::DVec3;

fn device() -> burn::tensor::Device {
    crate::support::device()
}

#[derive(Default)]
struct Recorder(Vec<Event>);

impl Progress for Recorder {
    fn event(&mut self, event: &Event) {
        self.0.push(event.clone());
    }
}

#[test]
fn one_tripod_is_as_large_as_what_it_sees() {
    let mut scene = scene();
    let at = |scene: &mut Scene, step: f64| {
        for (i, view) in scene.views.iter_mut().enumerate() {
            view.camera.center = DVec3::new(0.3, -0.2, 2.5) + DVec3::X * step * i as f64;
        }
    };
    let extent = |scene: &Scene| {
        schedule::extent(
            &scene.split(Split::Train).collect::<Vec<_>>(),
            &scene.points,
        )
    };
    at(&mut scene, 0.0);
    let exact = extent(&scene);
    assert!(
        exact > 2.5 && exact < 4.0,
        "the rms distance of the points: {exact}"
    );
    // Poses as programs write them, rounded to sixteen digits.
    at(&mut scene, 1e-16);
    assert!(
        (extent(&scene) / exact - 1.0).abs() < 1e-6,
        "{}",
        extent(&scene)
    );
    at(&mut scene, 1e-3);
    assert!(extent(&scene) < 0.01, "cameras that do move say how far");
}

#[test]
fn a_densification_that_leaves_nothing_is_an_error() {
    let building = BuildingConfig {
        prune_opacity: 0.9,
        ..config().building
    };
    let scene = scene();
    let mut stage = Trainer::new(
        &scene,
        &Config {
            building,
            ..config()
        },
        &device(),
    )
    .expect("a stage");
    let error = stage
        .run(&mut Recorder::default())
        .expect_err("no Gaussian is that opaque");
    crate::support::assert_names(&error, &["400 Gaussians", "10 steps", "data check"]);
}

#[test]
fn training_learns_the_scene() {
    let scene = scene();
    let device = device();
    let building = BuildingConfig {
        iterations: 400,
        sh_degree: 2,
        ..BuildingConfig::default()
    };
    let mut stage = Trainer::new(
        &scene,
        &Config {
            building,
            ..config()
        },
        &device,
    )
    .expect("a stage");
    let before = stage
        .evaluate()
        .expect("scores")
        .held_out
        .psnr
        .expect("test views");
    let mut recorder = Recorder::default();
    stage.run(&mut recorder).expect("a run");
    let curve = stage.curve();
    let last = curve.last().expect("points");
    let (psnr, ssim) = (
        last.held_out.psnr.expect("test views"),
        last.held_out.ssim.expect("test views"),
    );
    assert!(
        psnr > before + 8.0 && psnr > 26.0,
        "held-out PSNR {before} before, {psnr} after"
    );
    assert!(ssim > 0.8, "held-out SSIM {ssim}");
    assert_eq!((curve.len(), last.iteration), (11, 400));
    let count = |kind: fn(&Event) -> bool| recorder.0.iter().filter(|e| kind(e)).count();
    assert_eq!(count(|e| matches!(e, Event::Step { .. })), 400);
    assert_eq!(count(|e| matches!(e, Event::Evaluated(_))), 10);
    assert_eq!(recorder.0.last(), Some(&Event::Finished));
}

#[test]
fn black_surfaces_become_opaque_before_a_changing_background() {
    let mut scene = scene();
    let black = image::RgbImage::new(WIDTH as u32, HEIGHT as u32);
    scene
        .views
        .iter_mut()
        .for_each(|view| view.image = black.clone().into());
    scene
        .points
        .colors
        .iter_mut()
        .for_each(|color| *color = [0.0; 3]);
    let coverage = |random_background| {
        let building = BuildingConfig {
            iterations: 150,
            // None, all along which the background changes.
            densify_every: 1_000,
            densify_until: 1.0,
            reset_every: 1,
            random_background,
            ..BuildingConfig::default()
        };
        let mut stage = Trainer::new(
            &scene,
            &Config {
                building,
                seed: 7,
                ..Config::default()
            },
            &device(),
        )
        .unwrap();
        stage.run(&mut Silent).expect("a run");
        let rendered = render(
            &stage.gaussians().unwrap(),
            &scene.views[2].camera,
            &Settings::default(),
            [0.0; 3],
        );
        let transmittance = rendered.unwrap().transmittance;
        1.0 - transmittance.iter().sum::<f32>() / transmittance.len() as f32
    };
    let (changing, black) = (coverage(true), coverage(false));
    assert!(
        changing > 0.9 && changing > black + 0.2,
        "covered {changing}, {black} before black"
    );
}

#[test]
fn resumed_run_equals_uninterrupted_run_bit_for_bit() {
    let scene = scene();
    let device = device();
    let config = config();
    let mut whole = Trainer::new(&scene, &config, &device).expect("a stage");
    let mut densified = 0;
    let mut resets = 0;
    while whole.iteration() < 60 {
        let report = whole.step().expect("a step");
        densified += report.densified.map_or(0, |plan| plan.cloned + plan.split);
        resets += usize::from(report.reset);
    }
    assert!(
        densified > 0 && resets == 1 && !whole.reviews().is_empty(),
        "the run must densify ({densified}), reset ({resets}) and review"
    );
    let whole = untimed(whole.state().expect("a state"));

    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("building.safetensors");
    // before and after densifications, and on both sides of the reset
    let mut stage = Trainer::new(&scene, &config, &device).expect("a stage");
    for stop in [1, 17, 20, 29, 30, 44, 60] {
        advance(&mut stage, stop);
        let state = stage.state().expect("a state");
        state.save(&path).expect("saved");
        let loaded = TrainerState::load(&path).expect("loaded");
        assert!(loaded == state, "a checkpoint gives back the state");
        stage = Trainer::from_state(&scene, &config, &device, loaded).expect("a stage");
    }
    assert!(
        untimed(stage.state().expect("a state")) == whole,
        "the resumed run differs"
    );
}

#[test]
fn run_resumed_from_its_own_checkpoint_keeps_the_curves() {
    struct StopAt(usize);
    impl Progress for StopAt {
        fn event(&mut self, event: &Event) {
            if let Event::Step { .. } = event {
                self.0 -= 1;
            }
        }
        fn stop(&mut self) -> bool {
            self.0 == 0
        }
    }
    let scene = scene();
    let device = device();
    let config = config();
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("building.safetensors");
    let mut whole = Trainer::new(&scene, &config, &device).expect("a stage");
    whole.run(&mut Silent).expect("a run");
    let mut part = Trainer::new(&scene, &config, &device)
        .expect("a stage")
        .checkpoint_at(&path);
    part.run(&mut StopAt(33)).expect("a run");
    assert_eq!(part.iteration(), 33);
    let state = TrainerState::load(&path).expect("loaded");
    let mut rest = Trainer::from_state(&scene, &config, &device, state)
        .expect("a stage")
        .checkpoint_at(&path);
    rest.run(&mut Silent).expect("a run");
    let whole = untimed(whole.state().expect("a state"));
    assert!(untimed(rest.state().expect("a state")) == whole);
    assert!(
        untimed(TrainerState::load(&path).expect("loaded")) == whole,
        "the last checkpoint is the end of the run"
    );
}

#[test]
fn same_seed_same_bits_at_one_and_two_threads() {
    assert_bits_follow_the_seed(&config());
}

#[test]
fn non_finite_values_stop_the_run_and_are_located() {
    let scene = scene();
    let device = device();
    let config = config();
    let mut stage = Trainer::new(&scene, &config, &device).expect("a stage");
    advance(&mut stage, 3);
    let good = stage.state().expect("a state");
    let failure = |spoil: fn(&mut TrainerState)| {
        let mut state = good.clone();
        spoil(&mut state);
        let mut stage = Trainer::from_state(&scene, &config, &device, state).expect("a stage");
        let message = stage.step().expect_err("must stop").to_string();
        assert_eq!(stage.iteration(), 3);
        assert!(
            message.contains("iteration 4") && message.contains("view view"),
            "{message}"
        );
        message
    };
    let message = failure(|s| s.gaussians.means[21][1] = f32::NAN);
    assert!(
        message.contains("means") && message.contains("row 21"),
        "{message}"
    );
    let message = failure(|s| s.gaussians.sh.iter_mut().for_each(|v| *v = 3e38));
    assert!(
        message.contains("loss") || message.contains("gradient") || message.contains("sh"),
        "{message}"
    );
}

#[test]
fn an_empty_scene_of_gaussians_trains_without_effect() {
    let scene = scene();
    let device = device();
    let empty = coseg::splat::Gaussians {
        sh_degree: 2,
        ..Default::default()
    };
    let state = TrainerState::new(empty, 7);
    let mut stage = Trainer::from_state(&scene, &config(), &device, state).expect("a stage");
    advance(&mut stage, 12);
    assert!(stage.gaussians().expect("on the host").is_empty());
    assert!(stage.evaluate().expect("scores").held_out.psnr.is_some());
}

#[test]
fn unusable_settings_and_scenes_are_refused() {
    let scene = scene();
    let device = device();
    let refusal = |scene: &Scene, edit: fn(&mut Config)| {
        let mut config = config();
        edit(&mut config);
        Trainer::new(scene, &config, &device)
            .err()
            .expect("must be refused")
            .to_string()
    };
    assert!(refusal(&scene, |c| c.building.sh_degree = 4).contains("building.sh_degree"));
    assert!(refusal(&scene, |c| c.building.lr_means = f64::NAN).contains("building.lr_means"));
    let mut untrained = scene.clone();
    untrained
        .views
        .iter_mut()
        .for_each(|v| v.split = Split::Test);
    assert!(refusal(&untrained, |_| ()).contains("training view"));
    let mut misfit = scene.clone();
    misfit.views[3].camera.width += 1;
    assert!(refusal(&misfit, |_| ()).contains("view3"));
    let state = Trainer::new(&scene, &config(), &device)
        .expect("a stage")
        .state()
        .expect("a state");
    let other = Config {
        seed: 8,
        ..config()
    };
    let message = Trainer::from_state(&scene, &other, &device, state)
        .err()
        .expect("another seed")
        .to_string();
    assert!(message.contains("seed"), "{message}");
}

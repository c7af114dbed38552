//! The building stage with 3DGS-MCMC, and with AbsGS: both learn, keep to the cap, and resume exactly.

use crate::support::painted_plane::{advance, assert_bits_follow_the_seed, config, scene, untimed};
use coseg::config::{AdcConfig, Budget, BuildingConfig, Config, McmcConfig, Strategy};
use coseg::data::Points;
use coseg::reconstruction::{Trainer, TrainerState, schedule};
use coseg::splat::Gaussians;

const CAP: usize = 470;

/// Relocates and grows every 10 iterations from 10 to 45; the 400 initial Gaussians are close to the threshold.
fn mcmc() -> Config {
    let mcmc = McmcConfig {
        init_opacity: 0.12,
        init_scale: 0.5,
        ..McmcConfig::default()
    };
    let building = BuildingConfig {
        strategy: Strategy::Mcmc(mcmc),
        max_gaussians: Budget::AtMost(CAP),
        prune_opacity: 0.1,
        ..config().building
    };
    Config {
        building,
        ..config()
    }
}

fn stage<'a>(scene: &'a coseg::data::Scene, config: &Config) -> Trainer<'a> {
    Trainer::new(scene, config, &crate::support::device()).expect("a stage")
}

#[test]
fn resumed_run_equals_uninterrupted_run_across_relocation_and_growth() {
    let (scene, config) = (scene(), mcmc());
    let mut whole = stage(&scene, &config);
    let (mut relocated, mut added, mut counts) = (Vec::new(), 0, Vec::new());
    while whole.iteration() < 60 {
        let report = whole.step().expect("a step");
        assert!(report.gaussians <= CAP && !report.reset);
        if let Some(done) = report.densified {
            relocated.push(done.relocated);
            added += done.cloned;
            counts.push(report.gaussians);
        }
    }
    assert_eq!((counts, added), (vec![420, 441, 464, CAP], 70));
    assert!(
        relocated[0] > 0 && relocated[1] > 0,
        "the run must relocate: {relocated:?}"
    );
    let whole = untimed(whole.state().expect("a state"));

    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("building.safetensors");
    let mut part = stage(&scene, &config);
    for stop in [1, 9, 10, 25, 40, 41, 60] {
        advance(&mut part, stop);
        part.state().expect("a state").save(&path).expect("saved");
        let loaded = TrainerState::load(&path).expect("loaded");
        part = Trainer::from_state(&scene, &config, &crate::support::device(), loaded)
            .expect("a stage");
    }
    assert!(
        untimed(part.state().expect("a state")) == whole,
        "the resumed run differs"
    );

    let mut other = config;
    other.building.strategy = Strategy::Mcmc(McmcConfig {
        growth: 0.1,
        ..McmcConfig::default()
    });
    let state = TrainerState::load(&path).expect("loaded");
    let refusal = Trainer::from_state(&scene, &other, &crate::support::device(), state)
        .err()
        .expect("refused");
    crate::support::assert_names(&refusal, &["building.strategy", "0.1", "0.05"]);
}

#[test]
fn same_seed_same_bits_at_one_and_two_threads() {
    assert_bits_follow_the_seed(&mcmc());
}

#[test]
fn mcmc_learns_the_scene() {
    let scene = scene();
    let building = BuildingConfig {
        iterations: 400,
        sh_degree: 2,
        max_gaussians: Budget::AtMost(600),
        densify_every: 20,
        // the usual small start is for longer runs: scales grow by 0.5 % a step
        strategy: Strategy::Mcmc(McmcConfig {
            init_opacity: 0.1,
            init_scale: 1.0,
            ..McmcConfig::default()
        }),
        ..BuildingConfig::default()
    };
    let mut stage = stage(
        &scene,
        &Config {
            building,
            ..config()
        },
    );
    let before = stage
        .evaluate()
        .expect("scores")
        .held_out
        .psnr
        .expect("test views");
    advance(&mut stage, 400);
    let last = stage.evaluate().expect("scores");
    let psnr = last.held_out.psnr.expect("test views");
    assert_eq!(last.gaussians, 600);
    assert!(
        psnr > before + 8.0 && psnr > 26.0,
        "held-out PSNR {before} before, {psnr} after"
    );
}

#[test]
fn the_loss_has_the_means_of_opacity_and_scale() {
    let scene = scene();
    let first = |opacity_reg, scale_reg| {
        let mut config = mcmc();
        if let Strategy::Mcmc(mcmc) = &mut config.building.strategy {
            (mcmc.opacity_reg, mcmc.scale_reg) = (opacity_reg, scale_reg);
        }
        let mut stage = stage(&scene, &config);
        let gaussians = stage.gaussians().expect("on the host");
        (stage.step().expect("a step").loss, gaussians)
    };
    let (plain, gaussians) = first(0.0, 0.0);
    let extent = schedule::extent(
        &scene.split(coseg::data::Split::Train).collect::<Vec<_>>(),
        &scene.points,
    );
    let scales = gaussians.log_scales.as_flattened();
    let scale =
        scales.iter().map(|s| f64::from(*s).exp()).sum::<f64>() / scales.len() as f64 / extent;
    assert!(
        (first(1.0, 0.0).0 - plain - 0.12).abs() < 1e-5,
        "every opacity is 0.12"
    );
    assert!((first(0.0, 2.0).0 - plain - 2.0 * scale).abs() < 1e-5);
}

#[test]
fn large_clouds_are_thinned_to_the_cap() {
    let scene = scene();
    for strategy in [Strategy::default(), mcmc().building.strategy] {
        let building = BuildingConfig {
            strategy: strategy.clone(),
            max_gaussians: Budget::AtMost(150),
            ..mcmc().building
        };
        let config = Config { building, ..mcmc() };
        let mut stage = stage(&scene, &config);
        let kept = stage.gaussians().expect("on the host").means;
        assert_eq!(kept.len(), 150);
        let mut rest = scene.points.positions.iter();
        assert!(
            kept.iter().all(|mean| rest.any(|point| point == mean)),
            "points of the cloud, in its order"
        );
        while stage.iteration() < 21 {
            assert!(
                stage.step().expect("a step").gaussians <= 150,
                "{strategy:?}"
            );
        }
    }
    let mut bare = scene;
    bare.points = Points::default();
    let building = BuildingConfig {
        random_points: 500,
        ..mcmc().building
    };
    let config = Config { building, ..mcmc() };
    assert_eq!(
        stage(&bare, &config)
            .gaussians()
            .expect("on the host")
            .len(),
        CAP
    );
}

#[test]
fn mcmc_without_gaussians_or_without_a_cap() {
    let (scene, config, device) = (scene(), mcmc(), crate::support::device());
    let state = TrainerState::new(
        Gaussians {
            sh_degree: 2,
            ..Gaussians::default()
        },
        7,
    );
    let mut empty = Trainer::from_state(&scene, &config, &device, state).expect("a stage");
    advance(&mut empty, 12);
    assert!(empty.gaussians().expect("on the host").is_empty());
    let mut endless = config;
    endless.building.max_gaussians = Budget::Unlimited;
    let refusal = Trainer::new(&scene, &endless, &device)
        .err()
        .expect("refused");
    crate::support::assert_names(&refusal, &["building.max_gaussians", "mcmc"]);
}

#[test]
fn absgrad_finds_more_to_densify_and_resumes() {
    let scene = scene();
    let grown = |absgrad| {
        let building = BuildingConfig {
            strategy: Strategy::Adc(AdcConfig {
                absgrad,
                threshold: Some(1e-4),
                ..AdcConfig::default()
            }),
            ..config().building
        };
        let config = Config {
            building,
            ..config()
        };
        let mut whole = stage(&scene, &config);
        advance(&mut whole, 21);
        let whole = untimed(whole.state().expect("a state"));
        let mut part = stage(&scene, &config);
        advance(&mut part, 14);
        let half = part.state().expect("a state");
        let mut part =
            Trainer::from_state(&scene, &config, &crate::support::device(), half).expect("a stage");
        advance(&mut part, 21);
        assert!(
            untimed(part.state().expect("a state")) == whole,
            "the resumed run differs"
        );
        whole.gaussians.len()
    };
    let (usual, absolute) = (grown(false), grown(true));
    assert!(absolute > usual, "{absolute} with, {usual} without");
}

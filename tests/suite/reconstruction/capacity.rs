//! How many Gaussians stage one has: the cap, and what AbsGS adds.

use crate::support::painted_plane::{advance, config, scene, untimed};
use coseg::config::{Budget, BuildingConfig, Config};
use coseg::data::{Points, Scene};
use coseg::reconstruction::Trainer;

fn trainer<'a>(scene: &'a Scene, building: BuildingConfig) -> Trainer<'a> {
    let config = Config {
        building,
        ..config()
    };
    Trainer::new(scene, &config, &crate::support::device()).expect("a stage")
}

#[test]
fn large_clouds_are_thinned_to_the_cap() {
    let mut scene = scene();
    let building = BuildingConfig {
        max_gaussians: Budget::AtMost(150),
        random_points: 500,
        ..config().building
    };
    let mut stage = trainer(&scene, building.clone());
    let kept = stage.gaussians().expect("on the host").means;
    assert_eq!(kept.len(), 150);
    let mut rest = scene.points.positions.iter();
    assert!(
        kept.iter().all(|mean| rest.any(|point| point == mean)),
        "points of the cloud, in its order"
    );
    while stage.iteration() < 21 {
        assert!(stage.step().expect("a step").gaussians <= 150);
    }
    scene.points = Points::default();
    let random = trainer(&scene, building).gaussians().expect("on the host");
    assert_eq!(random.len(), 150);
}

#[test]
fn absgrad_finds_more_to_densify_and_resumes() {
    let scene = scene();
    let grown = |absgrad| {
        let building = BuildingConfig {
            absgrad,
            gradient_threshold: Some(1e-4),
            ..config().building
        };
        let mut whole = trainer(&scene, building.clone());
        advance(&mut whole, 21);
        let whole = untimed(whole.state().expect("a state"));
        let mut part = trainer(&scene, building.clone());
        advance(&mut part, 14);
        let half = part.state().expect("a state");
        let config = Config {
            building,
            ..config()
        };
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

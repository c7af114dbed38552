//! Points that a scene without points starts from.

use crate::support::painted_plane::{HEIGHT, WIDTH, config, scene};
use coseg::config::{BuildingConfig, Config};
use coseg::data::mask::Mask;
use coseg::data::{Points, Split, View};
use coseg::reconstruction::Trainer;
use coseg::reconstruction::initialization::random_points;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[test]
fn scenes_without_points_start_in_the_frusta() {
    let mut scene = scene();
    scene.points = Points::default();
    let building = BuildingConfig {
        random_points: 500,
        ..config().building
    };
    let config = Config {
        building,
        ..config()
    };
    let stage = Trainer::new(&scene, &config, &crate::support::device()).expect("a stage");
    let gaussians = stage.gaussians().expect("on the host");
    assert_eq!(gaussians.len(), 500);
    let seen = |p: &[f32; 3]| {
        let p = glam::Vec3::from(*p).as_dvec3();
        let sees = |v: &&View| {
            let hit = v.camera.project(p);
            hit.is_some_and(|(x, y, _)| (0.0..44.0).contains(&x) && (0.0..36.0).contains(&y))
        };
        scene.split(Split::Train).filter(sees).count()
    };
    assert!(gaussians.means.iter().all(|p| seen(p) >= 1));
    // photos agree on the painted plane: most points lie near it, where blind ones would spread over metres
    let mut heights: Vec<f32> = gaussians.means.iter().map(|p| p[2].abs()).collect();
    heights.sort_by(f32::total_cmp);
    assert!(
        heights[250] < 0.3,
        "median distance from the plane {}",
        heights[250]
    );
}

/// The pixels that `count` initial points of `views` are drawn at: each photo shows at a pixel where that is.
fn drawn(views: &mut [View], count: usize) -> Vec<(usize, usize, usize)> {
    for (i, view) in views.iter_mut().enumerate() {
        view.image = image::RgbImage::from_fn(WIDTH as u32, HEIGHT as u32, |x, y| {
            image::Rgb([i as u8, x as u8, y as u8])
        })
        .into();
    }
    let views: Vec<&View> = views.iter().collect();
    let points = random_points(&views, count, &mut ChaCha8Rng::seed_from_u64(8)).expect("points");
    assert_eq!(points.positions.len(), points.colors.len());
    points
        .colors
        .iter()
        .map(|c| c.map(|v| (v * 255.0).round() as usize))
        .map(|[i, x, y]| (i, x, y))
        .collect()
}

#[test]
fn initial_points_lie_on_used_pixels_however_few() {
    let mut views = scene().views;
    // 5 % of each photo but one, which is left out, and one without a mask.
    let used = |x: usize, y: usize| (30..40).contains(&x) && (20..28).contains(&y);
    let masks = |i: usize| match i {
        3 => None,
        5 => Some(Mask::new(WIDTH, HEIGHT, |_| false)),
        _ => Some(Mask::new(WIDTH, HEIGHT, |pixel| {
            used(pixel % WIDTH, pixel / WIDTH)
        })),
    };
    views
        .iter_mut()
        .enumerate()
        .for_each(|(i, view)| view.mask = masks(i));
    let count = 7_000;
    let pixels = drawn(&mut views, count);
    assert_eq!(pixels.len(), count);
    assert!(
        pixels
            .iter()
            .all(|&(i, x, y)| i != 5 && (i == 3 || used(x, y))),
        "none on a pixel that is left out"
    );
    let each: Vec<usize> = (0..80)
        .map(|p| {
            pixels
                .iter()
                .filter(|at| at.0 != 3 && at.1 == 30 + p % 10 && at.2 == 20 + p / 10)
                .count()
        })
        .collect();
    assert!(
        each.iter().all(|times| (40..120).contains(times)),
        "75 of each: {each:?}"
    );
    views.iter_mut().for_each(|view| view.mask = masks(5));
    assert!(drawn(&mut views, 10).is_empty(), "no pixel is used");
}

#[test]
fn initial_points_without_masks_are_those_of_the_seed() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut draw = || {
        let pixel = (
            rng.random_range(0..8),
            rng.random_range(0..WIDTH),
            rng.random_range(0..HEIGHT),
        );
        let _offset: f64 = rng.random();
        pixel
    };
    let want: Vec<(usize, usize, usize)> = (0..300).map(|_| draw()).collect();
    assert_eq!(drawn(&mut scene().views, 300), want);
}

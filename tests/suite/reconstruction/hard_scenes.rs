//! Scenes far from the origin and photos of extreme sizes train.

use crate::support::capture::Capture;
use crate::support::device;
use crate::support::painted_plane::config;
use coseg::config::{BuildingConfig, Config};
use coseg::data::{LoadOptions, load};
use coseg::progress::Silent;
use coseg::reconstruction::Trainer;
use coseg::splat::camera::Camera;
use glam::DVec3;

#[test]
fn a_scene_a_million_units_from_the_origin_trains_as_well() {
    let folder = tempfile::tempdir().expect("a folder");
    let capture = Capture::room(folder.path(), 12);
    let device = device();
    let trained = |offset: f64, densify_until: f32| {
        capture.moved(folder.path(), DVec3::new(offset, -offset, offset));
        let scene = load(folder.path(), &LoadOptions::default()).expect("a scene");
        let building = BuildingConfig {
            iterations: 200,
            densify_until,
            ..BuildingConfig::default()
        };
        let config = Config {
            building,
            ..config()
        };
        let mut stage = Trainer::new(&scene, &config, &device).expect("a stage");
        stage.run(&mut Silent).expect("a run");
        let last = stage.evaluate().expect("scores");
        last.held_out.psnr.expect("test views")
    };
    let alike = |densify_until: f32, bound: f64| {
        let [near, far] = [0.0, 1e6].map(|offset| trained(offset, densify_until));
        println!("held-out PSNR {near:.3} dB, a million units away {far:.3} dB");
        assert!(near > 15.0 && (near - far).abs() < bound, "{near} {far}");
    };
    alike(0.0, 0.01);
    // Growth turns the last bits of numbers into other Gaussians, and those into hundredths of a decibel: with AVX-512 0.064.
    if !cfg!(feature = "avx512") {
        alike(BuildingConfig::default().densify_until, 0.05);
    }
}

#[test]
fn photos_of_one_pixel_and_thin_strips_train() {
    for (width, height) in [(1, 1), (3, 10_000)] {
        let folder = tempfile::tempdir().expect("a folder");
        let mut capture = Capture::room(folder.path(), 6);
        for (path, camera) in &mut capture.shots {
            let photo = image::open(&*path).expect("a photo");
            let filter = image::imageops::FilterType::Triangle;
            let photo = photo.resize_exact(width, height, filter);
            photo.save(&*path).expect("a folder to write to");
            let across = f64::from(width) / camera.width as f64;
            let down = f64::from(height) / camera.height as f64;
            *camera = Camera {
                fx: camera.fx * across,
                cx: camera.cx * across,
                fy: camera.fy * down,
                cy: camera.cy * down,
                width: width as usize,
                height: height as usize,
                ..camera.clone()
            };
        }
        capture.moved(folder.path(), DVec3::ZERO);
        let scene = load(folder.path(), &LoadOptions::default()).expect("a scene");
        let building = BuildingConfig {
            iterations: 12,
            densify_every: 4,
            ..BuildingConfig::default()
        };
        let config = Config {
            building,
            ..config()
        };
        let mut stage = Trainer::new(&scene, &config, &device()).expect("a stage");
        let before = stage.evaluate().expect("scores").held_out.psnr;
        stage.run(&mut Silent).expect("a run");
        let after = stage.evaluate().expect("scores").held_out;
        assert!(
            after.psnr > before,
            "{width}x{height}: {before:?} dB became {:?}",
            after.psnr
        );
        assert!(after.ssim.is_none_or(f64::is_finite));
    }
}

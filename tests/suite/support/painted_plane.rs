//! A painted plane in eight photos, and a short first stage on it.

use coseg::config::{BuildingConfig, Config};
use coseg::data::{Classes, Points, Scene, Split, View, WorldUnit};
use coseg::reconstruction::{Trainer, TrainerState};
use coseg::splat::camera::Camera;
use glam::{DMat3, DVec3};

pub const WIDTH: usize = 44;
pub const HEIGHT: usize = 36;

/// A camera at `center` that looks at the origin, world up +z.
fn camera(center: DVec3) -> Camera {
    let forward = -center.normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
    let (width, height) = (WIDTH, HEIGHT);
    Camera {
        rotation,
        center,
        fx: 40.0,
        fy: 40.0,
        cx: 22.0,
        cy: 18.0,
        width,
        height,
    }
}

/// Colour of the plane z = 0 at (x, y).
fn paint(x: f64, y: f64) -> [f64; 3] {
    let check = 0.2 * (4.0 * x).sin() * (4.0 * y).sin();
    [
        0.45 + 0.3 * x.sin() + check,
        0.45 + 0.3 * (1.3 * y).cos() - check,
        0.5 + 0.2 * (x + y).sin(),
    ]
}

/// The plane as `camera` sees it.
fn photo(camera: &Camera) -> image::RgbImage {
    image::RgbImage::from_fn(WIDTH as u32, HEIGHT as u32, |u, v| {
        let ray = camera.ray(f64::from(u) + 0.5, f64::from(v) + 0.5);
        let hit = camera.center - ray * (camera.center.z / ray.z);
        image::Rgb(paint(hit.x, hit.y).map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8))
    })
}

/// A painted plane seen from an arc; every fourth view is held out.
pub fn scene() -> Scene {
    let views = (0..8)
        .map(|i| {
            let angle = 0.5 + 0.25 * f64::from(i);
            let camera = camera(DVec3::new(2.0 * angle.cos(), 2.0 * angle.sin(), 2.5));
            let split = if i % 4 == 2 {
                Split::Test
            } else {
                Split::Train
            };
            View {
                name: format!("view{i}"),
                split,
                image: photo(&camera).into(),
                camera,
                mask: None,
                truth: None,
                raw: None,
                scores: None,
                segments: Vec::new(),
                corrected: None,
                instances: None,
            }
        })
        .collect();
    let positions: Vec<[f32; 3]> = (0..400)
        .map(|i| {
            [
                (i % 20) as f32 * 0.2 - 1.9,
                (i / 20) as f32 * 0.2 - 1.9,
                0.0,
            ]
        })
        .collect();
    let colors = positions
        .iter()
        .map(|p| paint(f64::from(p[0]), f64::from(p[1])).map(|c| c as f32))
        .collect();
    Scene {
        name: "plane".into(),
        views,
        classes: Classes::default(),
        points: Points { positions, colors },
        drawn: false,
        origin: DVec3::ZERO,
        up: DVec3::Z,
        unit: WorldUnit::Metre,
    }
}

/// Densifies every 10 iterations from 10 to 45 and resets at 30.
pub fn config() -> Config {
    let building = BuildingConfig {
        iterations: 60,
        sh_degree: 2,
        densify_every: 10,
        densify_until: 0.75,
        gradient_threshold: Some(2e-5),
        reset_every: 30,
        ..BuildingConfig::default()
    };
    Config {
        building,
        seed: 7,
        ..Config::default()
    }
}

/// Steps until `to` iterations are done.
pub fn advance(stage: &mut Trainer, to: usize) {
    while stage.iteration() < to {
        stage.step().expect("a step");
    }
}

/// Clocks differ between runs; everything else must not.
pub fn untimed(mut state: TrainerState) -> TrainerState {
    state.seconds = 0.0;
    state.curve.iter_mut().for_each(|p| p.seconds = 0.0);
    state
}

/// Runs of `config` with equal seeds agree in every bit at one and two threads, and others differ.
pub fn assert_bits_follow_the_seed(config: &Config) {
    let run = |threads, seed| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        pool.install(|| {
            let scene = scene();
            let device = crate::support::device();
            let config = Config {
                seed,
                ..config.clone()
            };
            let mut stage = Trainer::new(&scene, &config, &device).expect("a stage");
            advance(&mut stage, 35);
            untimed(stage.state().expect("a state"))
        })
    };
    let one = run(1, 7);
    assert!(one == run(2, 7));
    assert!(one.gaussians != run(1, 8).gaussians);
}

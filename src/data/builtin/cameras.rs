//! Where the photos of the built-in scene are taken.

use super::room::{Room, RoomStream, stream};
use crate::data::Split;
use crate::splat::camera::Camera;
use glam::{DMat3, DVec2, DVec3};
use rand::Rng;
use std::f64::consts::{PI, TAU};

/// Distance every test camera keeps from every training camera, metres.
pub const TEST_DISTANCE: f64 = 0.3;
/// Free space around every camera, metres.
const CLEARANCE: f64 = 0.32;
/// Depth that nine tenths of a picture should exceed, metres.
const MIN_DEPTH: f64 = 1.1;

/// A camera, its split, and its place along the walk (0..1), which defines neighbouring views.
pub(super) struct Shot {
    pub camera: Camera,
    pub split: Split,
    pub along: f64,
}

/// Training cameras on a walk of two rounds: the outer one looks across the room, the inner one at the walls. Test cameras
/// stand between and beside them. Training views come first.
pub(super) fn shots(
    room: &Room,
    (width, height): (usize, usize),
    train: usize,
    test: usize,
    seed: u64,
) -> Vec<Shot> {
    let rng = &mut stream(seed, RoomStream::Cameras);
    let start: f64 = rng.random_range(0.0..TAU);
    let shot = |eye, target, split, along| Shot {
        camera: look(eye, target, width, height),
        split,
        along,
    };
    let mut shots: Vec<Shot> = Vec::with_capacity(train + test);
    for i in 0..train {
        let along = i as f64 / train as f64;
        let (eye, target) = walk(room, start, along);
        let eye = good_place(room, eye, target);
        shots.push(shot(eye, target, Split::Train, along));
    }
    for i in 0..test {
        let along = (i as f64 + 0.5) / test as f64;
        let (eye, target) = walk(room, start, along);
        let mut within = |reach: f64| rng.random_range(-reach..reach);
        let shift = DVec3::new(within(0.6), within(0.6), within(0.25));
        let target = target + shift;
        // Off the walk: drawn towards the room's middle, to the side, higher or lower.
        let mut best: Option<(f64, DVec3)> = None;
        for _ in 0..200 {
            let scale = rng.random_range(0.45..1.05);
            let flat =
                DVec2::from_angle(rng.random_range(-0.35..0.35)).rotate(eye.truncate() * scale);
            let at = flat.extend(rng.random_range(1.2..1.75));
            let near = shots.iter().filter(|s| s.split == Split::Train);
            let distance = near
                .map(|s| s.camera.center.distance(at))
                .fold(f64::INFINITY, f64::min);
            // Distance counts most: below the promised one no view is good.
            let good = (distance / (1.2 * TEST_DISTANCE)).min(1.0) * 2.0
                + goodness(room, at, target).min(1.0);
            if best.is_none_or(|(g, _)| good > g) {
                best = Some((good, at));
            }
            if good >= 3.0 {
                break;
            }
        }
        let at = best.map_or(eye, |b| b.1);
        shots.push(shot(at, target, Split::Test, along));
    }
    shots
}

/// Place and target of the walk at `along` in 0..1.
fn walk(room: &Room, start: f64, along: f64) -> (DVec3, DVec3) {
    let reach = room.size.truncate() / 2.0;
    let outer = along < 0.58;
    let round = if outer {
        along / 0.58
    } else {
        (along - 0.58) / 0.42
    };
    let angle = start + TAU * round;
    let (ring, height) = if outer {
        (0.8, 1.55 + 0.25 * (2.0 * angle).sin())
    } else {
        (0.34, 1.35 + 0.15 * (3.0 * angle).sin())
    };
    let out = DVec2::from_angle(angle);
    let eye = (out * reach * ring).extend(height);
    // The outer round looks across, the inner one over its shoulder at the walls near by and far.
    let turn = if outer {
        PI + 0.5 * (3.0 * angle).sin()
    } else {
        2.0 * PI / 3.0
    };
    let far = DVec2::from_angle(angle + turn) * reach * if outer { 0.55 } else { 0.95 };
    let target = far.extend(if outer { 0.85 } else { 1.05 } + 0.3 * (5.0 * angle).sin());
    (eye, target)
}

/// Quality of a camera at `eye` that looks at `target`; 1 or more is good. A good camera has free space around it, and near
/// objects fill at most a tenth of its picture.
fn goodness(room: &Room, eye: DVec3, target: DVec3) -> f64 {
    let free = room.clearance(eye) / CLEARANCE;
    if free < 0.7 || (eye.abs().truncate() - room.size.truncate() / 2.0).max_element() > -CLEARANCE
    {
        return free.min(0.0);
    }
    let camera = look(eye, target, 8, 6);
    let depth = |i: usize| {
        let d = camera.ray((i % 8) as f64 + 0.5, (i / 8) as f64 + 0.5);
        room.cast(eye, d).map_or(0.0, |hit| hit.t)
    };
    let mut depths: Vec<f64> = (0..48).map(depth).collect();
    depths.sort_by(f64::total_cmp);
    free.min(depths[4] / MIN_DEPTH)
}

/// The good place nearest to `eye`, searched on a spiral around it.
fn good_place(room: &Room, eye: DVec3, target: DVec3) -> DVec3 {
    let mut best = (goodness(room, eye, target), eye);
    for step in 1..250 {
        if best.0 >= 1.0 {
            break;
        }
        let r = 0.06 * f64::from(step).sqrt();
        let a = f64::from(step) * 2.399_963;
        let at = eye + DVec3::new(r * a.cos(), r * a.sin(), 0.1 * f64::from(step % 3));
        let good = goodness(room, at, target);
        if good > best.0 {
            best = (good, at);
        }
    }
    best.1
}

/// A camera at `eye` that looks at `target`, upright; 71 degrees wide.
fn look(eye: DVec3, target: DVec3, width: usize, height: usize) -> Camera {
    let forward = (target - eye).normalize_or(DVec3::Y);
    let right = forward.cross(DVec3::Z).normalize_or(DVec3::X);
    let down = forward.cross(right);
    Camera {
        rotation: DMat3::from_cols(right, down, forward).transpose(),
        center: eye,
        ..Camera::centred([0.7 * width as f64; 2], [width, height])
    }
}

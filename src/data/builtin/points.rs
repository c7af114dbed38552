//! Point clouds: the initial cloud of a scene, and labelled clouds of other rooms for pretraining the point encoder.

use super::room::{Room, RoomStream, Truth, stream};
use crate::data::Points;
use crate::random::standard_normal;
use crate::splat::camera::Camera;
use glam::DVec3;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::collections::HashSet;

/// Seeds meant for [`labelled_points`].
pub const PRETRAINING_SEEDS: std::ops::Range<u64> = 0..1 << 32;

/// A labelled cloud.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LabelledPoints {
    /// `[N, 3]`, metres; z up, floor at 0, room centred in x and y.
    pub positions: Vec<[f32; 3]>,
    /// `[N, 3]`, sRGB in 0..1.
    pub colors: Vec<[f32; 3]>,
    /// `[N]` class ids of [`super::classes`].
    pub classes: Vec<u16>,
}

/// `count` points of a random room, distributed like the means of trained Gaussians. They lie 1-2 cm off the surfaces that are
/// visible from standing places, and denser near those places. 1 % are outliers, with the class of the first object along their
/// ray. Layout, furniture, colours and lights are drawn from `seed` and a random stream that no scene uses. So no seed gives a room
/// of [`super::scene`]. Takes time in proportion to `count`.
pub fn labelled_points(seed: u64, count: usize) -> LabelledPoints {
    let room = Room::for_pretraining(seed);
    let rng = &mut stream(seed, RoomStream::Points);
    let eyes = eyes(&room, rng);
    let area =
        2.0 * (room.size.x * room.size.y + room.size.x * room.size.z + room.size.y * room.size.z);
    // Visible surface is about 1.3 times the shell; cells a little finer than the mean spacing even the density out.
    let cell = (1.3 * area / count.max(1) as f64).sqrt() * 0.7;
    let noise = rng.random_range(0.008..0.018);
    let mut taken = HashSet::new();
    let mut rays = Vec::with_capacity(count);
    let mut tries = 0;
    while rays.len() < count {
        let eye = eyes[rng.random_range(0..eyes.len())];
        let d = unit(rng);
        tries += 1;
        let Some(hit) = room.cast(eye, d) else {
            continue;
        };
        let p = eye + d * hit.t;
        // One point for each cell, until too few cells are empty.
        if taken.insert((p / cell).floor().as_i64vec3()) || tries > 6 * count {
            let offset = gauss3(rng) * noise;
            rays.push((eye, d, hit, offset, rng.random::<f64>()));
        }
    }
    let made = rays.par_iter().map(|(eye, d, hit, offset, fate)| {
        // Outliers lie in front of their surface.
        let share = if *fate < 0.01 { 0.3 + 65.0 * fate } else { 1.0 };
        let p = *eye + *d * (hit.t * share) + *offset;
        let color = room.shade(hit, *eye, *d, (16, 2));
        let class = room.solids.all[hit.solid].class;
        ((p.as_vec3().to_array(), color), class)
    });
    let ((positions, colors), classes) = made.unzip();
    LabelledPoints {
        positions,
        colors,
        classes,
    }
}

/// Standing places with free space around them.
fn eyes(room: &Room, rng: &mut ChaCha8Rng) -> Vec<DVec3> {
    let mut eyes = Vec::new();
    let reach = room.size / 2.0 - 0.5;
    for _ in 0..400 {
        let x = rng.random_range(-reach.x..reach.x);
        let y = rng.random_range(-reach.y..reach.y);
        let at = DVec3::new(x, y, 1.5 + rng.random_range(-0.4..0.4));
        if room.clearance(at) > 0.25 {
            eyes.push(at);
        }
        if eyes.len() == 12 {
            break;
        }
    }
    if eyes.is_empty() {
        eyes.push(DVec3::new(0.0, 0.0, 1.5));
    }
    eyes
}

fn unit(rng: &mut ChaCha8Rng) -> DVec3 {
    let z = rng.random_range(-1.0..1.0_f64);
    let a = rng.random_range(0.0..std::f64::consts::TAU);
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * a.cos(), r * a.sin(), z)
}

fn gauss3(rng: &mut ChaCha8Rng) -> DVec3 {
    std::array::from_fn(|_| standard_normal(rng)).into()
}

/// About `count` points back-projected from the depth of training views, thinned to one in a cell of 8 cm. They have noise of 0.3 %
/// of depth plus 5 mm and slightly wrong colours; 2 % are outliers anywhere in the room.
pub(super) fn initial_points(
    room: &Room,
    views: &[(&Camera, &Truth)],
    count: usize,
    seed: u64,
) -> Points {
    let rng = &mut stream(seed, RoomStream::Points);
    let mut points = Points::default();
    let mut taken = HashSet::new();
    for _ in 0..count * 20 {
        if points.positions.len() >= count || views.is_empty() {
            break;
        }
        let (camera, truth) = views[rng.random_range(0..views.len())];
        let x = rng.random_range(0..camera.width);
        let y = rng.random_range(0..camera.height);
        let depth = f64::from(truth.depth[y * camera.width + x]);
        let mut p = camera.center + camera.ray(x as f64 + 0.5, y as f64 + 0.5) * depth;
        if !taken.insert((p / 0.08).floor().as_i64vec3()) {
            continue;
        }
        p += gauss3(rng) * (0.005 + 0.003 * depth);
        if rng.random_bool(0.02) {
            let inside = DVec3::new(rng.random(), rng.random(), rng.random());
            p = (inside - DVec3::new(0.5, 0.5, 0.0)) * room.size;
        }
        let rgb = truth.image.get_pixel(x as u32, y as u32).0;
        points.positions.push(p.as_vec3().to_array());
        points.colors.push(
            rgb.map(|c| {
                (f32::from(c) / 255.0 + 0.02 * standard_normal(rng) as f32).clamp(0.0, 1.0)
            }),
        );
    }
    points
}

//! Gaussians of the built-in room without training: flat discs on the surfaces that its training views see.

use crate::data::builtin::{EVALUATED_SEED, Room, Truth, render_truth};
use crate::data::{Points, Scene, Split};
use crate::error::Result;
use crate::random::{Purpose, stream};
use crate::reconstruction::initialization::from_points;
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use glam::{DQuat, DVec3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use std::collections::HashSet;

/// Surfaces are looked up in views of this width at most, pixels.
const WIDTH: usize = 160;
/// A surfel's thickness as a share of its radius.
const THICKNESS: f32 = 0.1;
/// Logits of the opacities are spread evenly between these: 0.1 to 0.993.
const OPACITY_LOGITS: [f32; 2] = [-2.2, 5.0];
/// Neighbouring depths that differ by more than this share are two surfaces.
const DEPTH_STEP: f64 = 0.05;
/// Draws a surfel, before places that are taken already are taken again.
const PATIENCE: usize = 6;

/// What the training views of the built-in room see, at low resolution.
#[derive(Clone, Debug)]
pub struct Surfaces {
    views: Vec<(Camera, Truth)>,
    extent: f64,
}

impl Surfaces {
    /// Ray-casts the training views of `scene`, which must be the built-in room.
    pub fn new(scene: &Scene) -> Self {
        let room = Room::of_scene(EVALUATED_SEED);
        let views = scene.split(Split::Train).map(|view| {
            let camera = &view.camera;
            let width = camera.width.min(WIDTH);
            let camera =
                camera.resized(width, (camera.height * width / camera.width.max(1)).max(1));
            let truth = render_truth(&room, &camera);
            (camera, truth)
        });
        Self {
            views: views.collect(),
            extent: room.size.length(),
        }
    }

    /// `count` surfels: places where training views look, spread as evenly as their number allows, each a disc along the
    /// surface as wide as the rms distance to its 3 nearest neighbours, a tenth of that thick; opacity 0.1 to 0.993, the
    /// colour of the surface, SH above degree 0 zero.
    ///
    /// # Errors
    /// Those of [`from_points`].
    pub fn gaussians(&self, count: usize, sh_degree: usize, seed: u64) -> Result<Gaussians> {
        let mut rng = stream(seed, Purpose::Benchmark, count as u64);
        let mut points = Points::default();
        let mut normals = Vec::with_capacity(count);
        let area: f64 = self.extent.powi(2) * 1.5; // the shell of a room and a third more, about
        let cell = 0.7 * (area / count.max(1) as f64).sqrt();
        let mut taken = HashSet::new();
        let mut tries = 0;
        while points.positions.len() < count && tries < 100 * count && !self.views.is_empty() {
            tries += 1;
            let Some((p, normal, color)) = self.draw(&mut rng) else {
                continue;
            };
            if taken.insert((p / cell).floor().as_i64vec3()) || tries > PATIENCE * count {
                points.positions.push(p.as_vec3().to_array());
                points.colors.push(color);
                normals.push(normal);
            }
        }
        let mut out = from_points(&points, sh_degree, self.extent)?;
        for (i, normal) in normals.iter().enumerate() {
            let q = DQuat::from_rotation_arc(DVec3::Z, *normal);
            out.rotations[i] = [q.w, q.x, q.y, q.z].map(|v| v as f32);
            out.log_scales[i][2] += THICKNESS.ln();
            out.opacity_logits[i] = rng.random_range(OPACITY_LOGITS[0]..OPACITY_LOGITS[1]);
        }
        Ok(out)
    }

    /// A random point of a random view: position, unit normal towards the camera, colour. `None` at the border of the
    /// view, of a thing, or of the room.
    fn draw(&self, rng: &mut ChaCha8Rng) -> Option<(DVec3, DVec3, [f32; 3])> {
        let (camera, truth) = &self.views[rng.random_range(0..self.views.len())];
        let (w, h) = (camera.width, camera.height);
        let (x, y) = (rng.random_range(0..w), rng.random_range(0..h));
        let (u, v): (f64, f64) = (rng.random(), rng.random());
        if x + 1 >= w || y + 1 >= h {
            return None;
        }
        let depth = |x: usize, y: usize| f64::from(truth.depth[y * w + x]);
        let at = |x: usize, y: usize| {
            camera.center + camera.ray(x as f64 + 0.5, y as f64 + 0.5) * depth(x, y)
        };
        let here = depth(x, y);
        let flat = |other: f64| other > 0.0 && (other - here).abs() < DEPTH_STEP * here;
        if !(here > 0.0 && flat(depth(x + 1, y)) && flat(depth(x, y + 1))) {
            return None;
        }
        let p = at(x, y);
        let (right, down) = (at(x + 1, y) - p, at(x, y + 1) - p);
        // OpenCV axes: right x down points away from the camera.
        let normal = down.cross(right).try_normalize()?;
        // Anywhere between the three pixel centres' parallelogram, on its plane.
        let color = truth
            .image
            .get_pixel(x as u32, y as u32)
            .0
            .map(|c| f32::from(c) / 255.0);
        Some((p + right * u + down * v, normal, color))
    }
}

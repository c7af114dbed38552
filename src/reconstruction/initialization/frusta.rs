//! Initial points of scenes without a point cloud: pixels at the depth at which other photos agree best.

use crate::data::{Points, View};
use crate::error::{Result, in_order};
use crate::splat::camera::{Camera, spread};
use crate::splat::median;
use glam::{DMat3, DVec3};
use image::RgbImage;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::sync::Arc;

/// Depths that are tried for a pixel.
const DEPTHS: usize = 24;
/// Depths span this factor either way of the focus distance.
const DEPTH_FACTOR: f64 = 4.0;
/// Largest number of other views that a depth is checked in.
const MAX_OTHER_VIEWS: usize = 12;
/// Photos that are in memory at a time.
const PHOTOS_IN_MEMORY: usize = 16;

/// `count` points in the frusta of `views`, coloured as the pixel they were drawn at.
///
/// Each point lies on the ray of a random pixel of a random view. 24 depths are tried, log-spaced with a random offset, from a
/// quarter of the focus distance to four times it. At the chosen depth, the better half of the other views that see the point show
/// the most similar colour (mean absolute difference). Masked pixels are neither drawn nor compared. The focus distance is the median
/// depth of the point nearest to all optical axes, or ten baselines where the axes are parallel.
///
/// Empty without a view that has unmasked pixels. Each photo is decoded twice at most.
///
/// # Errors
/// Those of [`crate::data::Photo::pixels`].
pub fn points(views: &[&View], count: usize, rng: &mut ChaCha8Rng) -> Result<Points> {
    let views: Vec<&View> = views
        .iter()
        .copied()
        .filter(|v| v.camera.width > 0 && v.camera.height > 0)
        .collect();
    // Views that are masked altogether still count for the focus distance.
    let used: Vec<usize> = (0..views.len())
        .filter(|&i| views[i].mask.as_ref().is_none_or(|mask| mask.kept() > 0))
        .collect();
    if used.is_empty() {
        return Ok(Points::default());
    }
    let focus = focus_distance(&views);
    let witnesses: Vec<Vec<usize>> = (0..views.len()).map(|i| witnesses(&views, i)).collect();
    // Pixels are drawn in order, and compared in parallel.
    let mut drawn: Vec<Drawn> = (0..count)
        .map(|_| {
            let view = used[rng.random_range(0..used.len())];
            Drawn::new(view, views[view], rng)
        })
        .collect();
    each_photo(&views, |first, photos| {
        drawn.par_iter_mut().for_each(|drawn| {
            if let Some(photo) = drawn.view.checked_sub(first).and_then(|i| photos.get(i)) {
                drawn.color = photo
                    .get_pixel_checked(drawn.x, drawn.y)
                    .map_or([0; 3], |p| p.0);
            }
        });
    })?;
    each_photo(&views, |first, photos| {
        drawn
            .par_iter_mut()
            .for_each(|drawn| drawn.compare(&views, focus, &witnesses[drawn.view], first, photos));
    })?;
    let placed: Vec<([f32; 3], [f32; 3])> = drawn
        .into_par_iter()
        .map(|mut drawn| {
            let depth = drawn.best_depth();
            let position = drawn.position(&views[drawn.view].camera, focus, depth);
            let color = drawn.color.map(|c| f32::from(c) / 255.0);
            (position.as_vec3().to_array(), color)
        })
        .collect();
    let (positions, colors) = placed.into_iter().unzip();
    Ok(Points { positions, colors })
}

/// A random pixel of a random view.
struct Drawn {
    view: usize,
    x: u32,
    y: u32,
    /// Shift of the depths, in steps, 0 to 1.
    offset: f64,
    /// Its colour.
    color: [u8; 3],
    /// Indices of depths, each with the colour difference in a view that sees the point there.
    differences: Vec<(u8, u16)>,
}

impl Drawn {
    /// A pixel of `source`, the view of index `view`. Each of its unmasked pixels is equally likely.
    fn new(view: usize, source: &View, rng: &mut ChaCha8Rng) -> Self {
        let View { camera, mask, .. } = source;
        // By rank among the unmasked ones.
        let ranked = mask.as_ref().and_then(|mask| {
            let pixel = mask.nth(rng.random_range(0..mask.kept()))?;
            Some((pixel % mask.width(), pixel / mask.width()))
        });
        let (x, y) = ranked.unwrap_or_else(|| {
            (
                rng.random_range(0..camera.width),
                rng.random_range(0..camera.height),
            )
        });
        let offset = rng.random();
        Self {
            view,
            x: x as u32,
            y: y as u32,
            offset,
            color: [0; 3],
            differences: Vec::new(),
        }
    }

    /// The point at depth `k` on the pixel's ray, of `camera`; `focus` is the focus distance.
    fn position(&self, camera: &Camera, focus: f64, k: usize) -> DVec3 {
        let ray = camera.ray(f64::from(self.x) + 0.5, f64::from(self.y) + 0.5);
        let share = 2.0 * (k as f64 + self.offset) / DEPTHS as f64 - 1.0;
        camera.center + ray * (focus * DEPTH_FACTOR.powf(share))
    }

    /// Adds the differences in those of the views `witnesses` that `photos` show, of the views from index `first` on.
    fn compare(
        &mut self,
        views: &[&View],
        focus: f64,
        witnesses: &[usize],
        first: usize,
        photos: &[Arc<RgbImage>],
    ) {
        let shown = first..first + photos.len();
        let shown: Vec<usize> = witnesses
            .iter()
            .copied()
            .filter(|w| shown.contains(w))
            .collect();
        for k in (0..DEPTHS).filter(|_| !shown.is_empty()) {
            let position = self.position(&views[self.view].camera, focus, k);
            let color = self.color;
            let seen = shown.iter().filter_map(|&w| {
                let difference = difference(views[w], &photos[w - first], position, color)?;
                Some((k as u8, difference))
            });
            self.differences.extend(seen);
        }
    }

    /// The depth at which the other views agree best; a random one where none sees the pixel.
    fn best_depth(&mut self) -> usize {
        self.differences.sort_unstable();
        let judged = self
            .differences
            .chunk_by(|a, b| a.0 == b.0)
            .map(|of_depth| (disagreement(of_depth), usize::from(of_depth[0].0)));
        judged
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map_or((self.offset * DEPTHS as f64) as usize, |(_, k)| k)
    }
}

/// Calls `look` with the photos of all views, a few at a time: index of the first one, and the photos.
fn each_photo(views: &[&View], mut look: impl FnMut(usize, &[Arc<RgbImage>])) -> Result<()> {
    for (batch, views) in views.chunks(PHOTOS_IN_MEMORY).enumerate() {
        let photos = in_order(views.par_iter().map(|view| view.image.pixels()))?;
        look(batch * PHOTOS_IN_MEMORY, &photos);
    }
    Ok(())
}

/// Up to [`MAX_OTHER_VIEWS`] other views, spread over the nearer half of them.
fn witnesses(views: &[&View], index: usize) -> Vec<usize> {
    let center = views[index].camera.center;
    let mut others: Vec<usize> = (0..views.len()).filter(|&i| i != index).collect();
    others.sort_by(|&a, &b| {
        let distance = |i: usize| views[i].camera.center.distance_squared(center);
        distance(a).total_cmp(&distance(b)).then(a.cmp(&b))
    });
    let near = others
        .len()
        .div_ceil(2)
        .max(MAX_OTHER_VIEWS.min(others.len()));
    let stride = near.div_ceil(MAX_OTHER_VIEWS).max(1);
    others[..near].iter().step_by(stride).copied().collect()
}

/// Difference between `color` and the colour of a view at `position`; `None` where it is out of view or masked.
fn difference(view: &View, photo: &RgbImage, position: DVec3, color: [u8; 3]) -> Option<u16> {
    let (u, v, _) = view.camera.project(position)?;
    if u < 0.0 || v < 0.0 {
        return None;
    }
    let place = v as usize * view.camera.width + u as usize;
    let is_used = view.mask.as_ref().is_none_or(|mask| mask.uses(place));
    let pixel = photo.get_pixel_checked(u as u32, v as u32)?;
    let channels = pixel.0.into_iter().zip(color);
    let difference = channels.map(|(a, b)| u16::from(a.abs_diff(b))).sum();
    is_used.then_some(difference)
}

/// Mean over the better half of the differences of a depth, which are sorted.
fn disagreement(differences: &[(u8, u16)]) -> f64 {
    let half = differences.len().div_ceil(2);
    let sum: u32 = differences[..half]
        .iter()
        .map(|(_, difference)| u32::from(*difference))
        .sum();
    f64::from(sum) / half as f64
}

/// Median depth of the point nearest to all optical axes, or ten baselines where that point is not in front.
fn focus_distance(views: &[&View]) -> f64 {
    let (mean, baseline) = spread(views.iter().map(|v| v.camera.center));
    let fallback = if baseline > 0.0 { 10.0 * baseline } else { 1.0 };
    // Normal equations of sum |(I - d d^T) (x - c)|^2
    let mut a = DMat3::ZERO;
    let mut b = DVec3::ZERO;
    for view in views {
        let d = view.camera.rotation.transpose().z_axis;
        let p = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        a += p;
        b += p * (view.camera.center - mean);
    }
    // Parallel axes leave the depth undetermined.
    if a.determinant() < 1e-4 * (views.len() as f64).powi(3) {
        return fallback;
    }
    let focus = a.inverse() * b + mean;
    let depth = median(views.iter().map(|v| v.camera.to_camera(focus).z));
    if depth.is_finite() && depth > 0.1 * baseline {
        depth
    } else {
        fallback
    }
}

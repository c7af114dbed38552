//! Initial Gaussians: from a point cloud, or from points placed in the camera frusta.

use super::Gaussians;
use crate::data::{Points, View};
use crate::error::{Error, Result};
use glam::{DMat3, DVec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use std::num::NonZero;

/// SH basis function of degree 0, 1 / (2 sqrt(pi)).
pub const SH_0: f32 = 0.282_094_8;
/// Opacity of a new Gaussian.
const OPACITY: f32 = 0.1;
/// Neighbours that set the scale, the point itself not counted.
const NEIGHBOURS: usize = 3;
/// Smallest initial scale and scale of a lone point, as shares of the extent.
const SCALE_FLOOR: f64 = 1e-7;
const LONE_SCALE: f64 = 0.01;

/// Logit of `p`, natural logarithm of the odds.
pub fn logit(p: f32) -> f32 {
    (p / (1.0 - p)).ln()
}

/// Gaussians at `points`: isotropic with the rms distance to the 3 nearest distinct points as scale, opacity 0.1, SH
/// constant term (rgb - 0.5) / 0.2820948, all other SH zero.
///
/// Points at the same position count once as neighbours and share their scale, so duplicates never give a scale of 0.
/// With fewer than 4 distinct points the distances that exist are used; a single one gets 1 % of `extent`.
/// `extent` is the scene's size in world units (see `train::schedule::extent`).
///
/// # Errors
/// [`Error::NonFinite`] for a position or colour that is not finite; [`Error::Limit`] beyond 2^32 points.
pub fn from_points(points: &Points, sh_degree: usize, extent: f64) -> Result<Gaussians> {
    let finite = |v: &[f32; 3]| v.iter().all(|x| x.is_finite());
    if let Some(row) = points.positions.iter().position(|p| !finite(p)) {
        return Err(Error::non_finite("points.positions", row));
    }
    if let Some(row) = points.colors.iter().position(|c| !finite(c)) {
        return Err(Error::non_finite("points.colors", row));
    }
    let n = points.positions.len();
    let coefficients = 3 * (sh_degree + 1).pow(2);
    let mut sh = vec![0.0; n * coefficients];
    for (row, color) in sh.chunks_exact_mut(coefficients).zip(&points.colors) {
        for (s, c) in row.iter_mut().zip(color) {
            *s = (c - 0.5) / SH_0;
        }
    }
    let log_scales = neighbour_distances(&points.positions)?
        .into_iter()
        .map(|d| [d.unwrap_or(LONE_SCALE * extent).max(SCALE_FLOOR * extent).ln() as f32; 3])
        .collect();
    Ok(Gaussians {
        means: points.positions.clone(),
        log_scales,
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacity_logits: vec![logit(OPACITY); n],
        sh,
        sh_degree,
    })
}

/// Root mean square distance of each point to its 3 nearest at other positions; `None` when there is no other position.
///
/// # Errors
/// [`Error::Limit`] beyond 2^32 points.
fn neighbour_distances(positions: &[[f32; 3]]) -> Result<Vec<Option<f64>>> {
    // -0 and 0 are one position
    let wide = |p: &[f32; 3]| p.map(|x| f64::from(x) + 0.0);
    let mut order: Vec<usize> = (0..positions.len()).collect();
    order.sort_unstable_by_key(|&i| (wide(&positions[i]).map(f64::to_bits), i));
    let mut distinct: Vec<[f64; 3]> = Vec::new();
    let mut slot = vec![0; positions.len()];
    for i in order {
        let p = wide(&positions[i]);
        if distinct.last() != Some(&p) {
            distinct.push(p);
        }
        slot[i] = distinct.len() - 1;
    }
    if distinct.len() < 2 {
        return Ok(vec![None; positions.len()]);
    }
    let tree = ImmutableKdTree::<f64, 3>::new_from_slice(&distinct).map_err(|_| Error::Limit {
        what: "initial points".into(),
        found: distinct.len().to_string(),
        limit: u32::MAX.to_string(),
        mend: "thin the point cloud".into(),
    })?;
    let wanted = NonZero::new(NEIGHBOURS + 1).unwrap_or(NonZero::<usize>::MIN);
    let found = tree.query_batch(&distinct).nearest_n::<SquaredEuclidean<f64>>(wanted).execute();
    let distances: Vec<Option<f64>> = found
        .iter()
        .map(|hits| {
            // the point itself is the one hit at distance 0
            let others = hits.len().saturating_sub(1);
            (others > 0).then(|| (hits.iter().map(|h| h.distance).sum::<f64>() / others as f64).sqrt())
        })
        .collect();
    Ok(slot.into_iter().map(|s| distances[s]).collect())
}

/// `count` points in the frusta of `views`, for scenes without a point cloud, coloured as the pixel they were drawn at.
///
/// Each point lies on the ray of a random pixel of a random view. Depths are log-uniform between a quarter and four
/// times the distance at which the views' optical axes meet best (least squares), or, for parallel axes, the reach of
/// ten baselines. Points that only one view sees are drawn again, a few times.
///
/// Empty when there is no view with pixels.
pub fn random_points(views: &[&View], count: usize, rng: &mut ChaCha8Rng) -> Points {
    let views: Vec<&View> = views.iter().copied().filter(|v| v.camera.width > 0 && v.camera.height > 0).collect();
    let mut points = Points::default();
    if views.is_empty() {
        return points;
    }
    let focus = focus_distance(&views);
    let wanted = views.len().min(2);
    for _ in 0..count {
        for attempt in 0..8 {
            let view = views[rng.random_range(0..views.len())];
            let camera = &view.camera;
            let (x, y) = (rng.random_range(0..camera.width), rng.random_range(0..camera.height));
            let depth = focus * 4.0_f64.powf(rng.random_range(-1.0..1.0));
            let position = camera.center + camera.ray(x as f64 + 0.5, y as f64 + 0.5) * depth;
            let seen = views.iter().filter(|v| sees(v, position)).take(wanted).count();
            if seen < wanted && attempt < 7 {
                continue;
            }
            points.positions.push(position.as_vec3().to_array());
            points.colors.push(view.image.get_pixel(x as u32, y as u32).0.map(|c| f32::from(c) / 255.0));
            break;
        }
    }
    points
}

fn sees(view: &View, position: DVec3) -> bool {
    let camera = &view.camera;
    camera
        .project(position)
        .is_some_and(|(u, v, _)| u >= 0.0 && v >= 0.0 && u < camera.width as f64 && v < camera.height as f64)
}

/// Median depth of the point nearest to all optical axes, or ten baselines where that point is not in front.
fn focus_distance(views: &[&View]) -> f64 {
    let mean = views.iter().map(|v| v.camera.center).sum::<DVec3>() / views.len() as f64;
    let baseline = views.iter().map(|v| v.camera.center.distance(mean)).fold(0.0, f64::max);
    let fallback = if baseline > 0.0 { 10.0 * baseline } else { 1.0 };
    // normal equations of sum |(I - d d^T) (x - c)|^2
    let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
    for view in views {
        let d = view.camera.rotation.transpose().z_axis;
        let p = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        a += p;
        b += p * (view.camera.center - mean);
    }
    // parallel axes leave the depth undetermined
    if a.determinant() < 1e-4 * (views.len() as f64).powi(3) {
        return fallback;
    }
    let focus = a.inverse() * b + mean;
    let mut depths: Vec<f64> = views.iter().map(|v| v.camera.to_camera(focus).z).collect();
    depths.sort_by(f64::total_cmp);
    let median = depths[depths.len() / 2];
    if median.is_finite() && median > 0.1 * baseline { median } else { fallback }
}

//! Initial Gaussians from a point cloud, or from random points in the camera frusta.

mod frusta;

pub use self::frusta::points as random_points;

use super::schedule::extent;
use crate::backend::check_finite;
use crate::config::Config;
use crate::data::{Points, Scene, View};
use crate::error::Result;
use crate::memory;
use crate::random::{Purpose, stream};
use crate::segmentation::neighbours::PointIndex;
use crate::splat::{Gaussians, SH_0};
use std::borrow::Cow;

/// Opacity of a new Gaussian.
const OPACITY: f32 = 0.1;
/// Neighbours that set the scale, the point itself not counted.
const NEIGHBOURS: usize = 3;
/// Smallest initial scale and scale of a lone point, as shares of the extent.
const SCALE_FLOOR: f64 = 1e-7;
const LONE_SCALE: f64 = 0.01;

/// Gaussians at the points of the scene, or in the camera frusta where it has none; no more than `max_gaussians`.
///
/// # Errors
/// Those of [`from_points`] and of [`crate::data::Photo::pixels`].
pub(crate) fn initial_gaussians(
    scene: &Scene,
    train: &[&View],
    config: &Config,
) -> Result<Gaussians> {
    let building = &config.building;
    let count = match scene.points.positions.len() {
        0 => building.random_points,
        points => points,
    };
    let most = building.max_gaussians.limit().unwrap_or(usize::MAX);
    memory::check_building(count.min(most), building.sh_degree)?;
    let points = if scene.points.positions.is_empty() {
        let mut rng = stream(config.seed, Purpose::InitialPoints, 0);
        Cow::Owned(random_points(train, building.random_points, &mut rng)?)
    } else {
        Cow::Borrowed(&scene.points)
    };
    let points = if points.positions.len() > most {
        Cow::Owned(thinned(&points, most, config.seed))
    } else {
        points
    };
    from_points(&points, building.sh_degree, extent(train, &scene.points))
}

/// `most` random points of `points`, in their order.
fn thinned(points: &Points, most: usize, seed: u64) -> Points {
    let mut rng = stream(seed, Purpose::InitialPoints, 1);
    let mut kept = rand::seq::index::sample(&mut rng, points.positions.len(), most).into_vec();
    kept.sort_unstable();
    let pick = |values: &[[f32; 3]]| {
        let kept = kept.iter().filter_map(|&i| values.get(i));
        kept.copied().collect()
    };
    Points {
        positions: pick(&points.positions),
        colors: pick(&points.colors),
    }
}

/// Logit of `p`, natural logarithm of the odds.
pub fn logit(p: f32) -> f32 {
    (p / (1.0 - p)).ln()
}

/// Gaussians at `points`: isotropic with the rms distance to the 3 nearest distinct points as scale, opacity 0.1, SH
/// constant term (rgb - 0.5) / 0.2820948, all other SH zero.
///
/// Points at the same position count once as neighbours and share their scale, so duplicates never give a scale of 0. With fewer
/// than 4 distinct points the distances that exist are used. A single point gets 1 % of `extent`. `extent` is the scene's size in
/// world units (see [`extent`]).
///
/// # Errors
/// [`crate::Error::NonFinite`] for a position or colour that is not finite; [`crate::Error::Limit`] beyond 2^32 points.
pub fn from_points(points: &Points, sh_degree: usize, extent: f64) -> Result<Gaussians> {
    check_finite("points.positions", points.positions.as_flattened(), 3)?;
    check_finite("points.colors", points.colors.as_flattened(), 3)?;
    let n = points.positions.len();
    let coefficients = 3 * (sh_degree + 1).pow(2);
    let mut sh = vec![0.0; n * coefficients];
    for (row, color) in sh.chunks_exact_mut(coefficients).zip(&points.colors) {
        for (s, c) in row.iter_mut().zip(color) {
            *s = (c - 0.5) / SH_0;
        }
    }
    let log_scale = |distance: Option<f64>| {
        let scale = distance.unwrap_or(LONE_SCALE * extent);
        [scale.max(SCALE_FLOOR * extent).ln() as f32; 3]
    };
    let distances = PointIndex::new(&points.positions)?.rms_distances(NEIGHBOURS);
    let log_scales = distances.into_iter().map(log_scale).collect();
    Ok(Gaussians {
        means: points.positions.clone(),
        log_scales,
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacity_logits: vec![logit(OPACITY); n],
        sh,
        sh_degree,
    })
}

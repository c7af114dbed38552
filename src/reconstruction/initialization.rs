//! Initial Gaussians from a point cloud.

use crate::data::Points;
use crate::error::{Error, Result};
use crate::splat::Gaussians;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
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
        .map(|d| {
            [d.unwrap_or(LONE_SCALE * extent)
                .max(SCALE_FLOOR * extent)
                .ln() as f32; 3]
        })
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
        help: "thin the point cloud".into(),
    })?;
    let wanted = NonZero::new(NEIGHBOURS + 1).unwrap_or(NonZero::<usize>::MIN);
    let found = tree
        .query_batch(&distinct)
        .nearest_n::<SquaredEuclidean<f64>>(wanted)
        .execute();
    let distances: Vec<Option<f64>> = found
        .iter()
        .map(|hits| {
            // the point itself is the one hit at distance 0
            let others = hits.len().saturating_sub(1);
            (others > 0)
                .then(|| (hits.iter().map(|h| h.distance).sum::<f64>() / others as f64).sqrt())
        })
        .collect();
    Ok(slot.into_iter().map(|s| distances[s]).collect())
}

//! A scene as files hold it, and the origin of one that names none.

use crate::error::{Error, Result, invalid};
use crate::splat::Gaussians;
use glam::DVec3;
use std::path::Path;

/// Positions are stored as double when float would move one by more than this share of the scene's size.
const POSITION_LOSS: f64 = 1e-5;

/// A scene as read from a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlyScene {
    /// The Gaussians, relative to [`PlyScene::origin`].
    pub gaussians: Gaussians,
    /// What was subtracted from every position (f64). Cameras in world units must be moved by it too.
    pub origin: DVec3,
    /// Class id per Gaussian, when the file has a `label` column, or labels are beside it.
    pub labels: Option<Vec<u16>>,
}

/// A scene whose means are world positions, floats in the file `path`. It must hold finite numbers alone.
pub(super) fn scene_of(path: &Path, mut gaussians: Gaussians) -> Result<PlyScene> {
    gaussians.check(None).map_err(|error| match error {
        Error::NonFinite { tensor, row, .. } => {
            invalid!(path, "row {row}"; found "a value of {tensor} that is not finite"; expected "finite numbers";
                help "remove this Gaussian (splat-transform --filter-nan)")
        }
        other => other,
    })?;
    let positions = gaussians.positions(DVec3::ZERO);
    let origin = origin_of(&positions);
    for (mean, position) in gaussians.means.iter_mut().zip(positions) {
        *mean = (position - origin).as_vec3().to_array();
    }
    Ok(PlyScene {
        gaussians,
        origin,
        labels: None,
    })
}

/// Mean position and mean distance from it.
fn centre_and_size(positions: &[DVec3]) -> (DVec3, f64) {
    let n = positions.len().max(1) as f64;
    let centre = positions.iter().sum::<DVec3>() / n;
    let distances = positions.iter().map(|p| p.distance(centre));
    (centre, distances.sum::<f64>() / n)
}

/// Whether rounding a position to float moves it by more than [`POSITION_LOSS`] of the scene's size.
pub(super) fn floats_lose(positions: &[DVec3]) -> bool {
    let most = POSITION_LOSS * centre_and_size(positions).1;
    let loss = |p: &DVec3| (p - p.as_vec3().as_dvec3()).abs().max_element();
    positions.iter().any(|p| loss(p) > most)
}

/// Zero for scenes near their coordinate origin, so that their float positions stay as they are.
pub(super) fn origin_of(positions: &[DVec3]) -> DVec3 {
    let (centre, size) = centre_and_size(positions);
    // Float positions show no rounding, but their spacing far out may be coarse for the scene.
    let coarse = size > 0.0 && centre.length() * f64::from(f32::EPSILON) > POSITION_LOSS * size;
    if coarse || floats_lose(positions) {
        centre
    } else {
        DVec3::ZERO
    }
}

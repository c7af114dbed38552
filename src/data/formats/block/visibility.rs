//! What photos show of a cloud of points.

use crate::data::Points;
use crate::data::options::evenly;
use crate::splat::camera::Camera;
use glam::DVec3;

/// Points of the initial cloud that photos are looked at with, at most.
const MAX_POINTS: usize = 200_000;

/// Cells across and down that a photo is divided into.
const CELLS: [usize; 2] = [16, 12];

/// Points of the initial cloud, evenly over its rows, to look at photos with.
pub(crate) struct PointSample {
    /// Their rows in the cloud.
    pub rows: Vec<usize>,
    /// Where they are in the world.
    pub positions: Vec<DVec3>,
}

impl PointSample {
    /// A sample of `points`, which are relative to `origin`.
    pub fn new(points: &Points, origin: DVec3) -> Self {
        let rows = evenly(points.len(), MAX_POINTS);
        let world = |&row: &usize| DVec3::from(points.positions[row].map(f64::from)) + origin;
        let positions = rows.iter().map(world).collect();
        Self { rows, positions }
    }
}

/// For each cell of a photo the number of the nearest of `points`, which are positions in the world: walls hide what is behind
/// them. Cells without points have none.
pub(crate) fn nearest(camera: &Camera, points: &[DVec3]) -> Vec<usize> {
    let [across, down] = CELLS;
    let mut nearest = vec![(f64::INFINITY, 0); across * down];
    for (number, point) in points.iter().enumerate() {
        let Some((u, v, depth)) = camera.project(*point) else {
            continue;
        };
        let x = u / camera.width as f64 * across as f64;
        let y = v / camera.height as f64 * down as f64;
        if (0.0..across as f64).contains(&x) && (0.0..down as f64).contains(&y) {
            let cell = &mut nearest[y as usize * across + x as usize];
            if depth < cell.0 {
                *cell = (depth, number);
            }
        }
    }
    nearest.retain(|(depth, _)| depth.is_finite());
    nearest.into_iter().map(|(_, number)| number).collect()
}

//! What photos show of a cloud of points, and how much of each photo shows each block.

use super::Grid;
use crate::splat::camera::Camera;
use glam::DVec3;

/// A photo is looked at in this many cells across and down.
const CELLS: [usize; 2] = [16, 12];

/// For each cell of a photo the number of the nearest of `points`, which are places in the world: walls hide what is behind them.
/// Cells without points have none.
pub(super) fn nearest(camera: &Camera, points: &[DVec3]) -> Vec<usize> {
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

/// The points of the initial cloud, each with the number of its block.
pub(super) struct Cloud {
    points: Vec<DVec3>,
    numbers: Vec<usize>,
    blocks: usize,
}

impl Cloud {
    /// Points in the world.
    pub fn new(points: Vec<DVec3>, grid: &Grid) -> Self {
        let number = |point: &DVec3| {
            let [column, row] = grid.cell(*point);
            column * grid.counts[1] + row
        };
        Self {
            numbers: points.iter().map(number).collect(),
            points,
            blocks: grid.len(),
        }
    }

    /// For each block the share of the photo in which the nearest point belongs to its core, 0 to 1. Cells without points do not
    /// count.
    pub fn shares(&self, camera: &Camera) -> Vec<f64> {
        let seen = nearest(camera, &self.points);
        let mut counts = vec![0_usize; self.blocks];
        seen.iter()
            .for_each(|&point| counts[self.numbers[point]] += 1);
        let all = seen.len().max(1);
        counts.iter().map(|&n| n as f64 / all as f64).collect()
    }
}

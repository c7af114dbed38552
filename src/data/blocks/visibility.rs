//! How much of each photo shows each block.

use super::Grid;
use crate::splat::camera::Camera;
use glam::DVec3;

/// A photo is looked at in this many cells across and down.
const CELLS: [usize; 2] = [16, 12];

/// The points of the initial cloud, each with the number of its block.
pub(super) struct Cloud {
    points: Vec<(DVec3, usize)>,
    blocks: usize,
}

impl Cloud {
    /// Points in the world.
    pub fn new(points: impl Iterator<Item = DVec3>, grid: &Grid) -> Self {
        let number = |[column, row]: [usize; 2]| column * grid.counts[1] + row;
        let with_block = |point| (point, number(grid.cell(point)));
        Self {
            points: points.map(with_block).collect(),
            blocks: grid.len(),
        }
    }

    /// For each block the share of the photo in which the nearest point belongs to its core, 0 to 1: walls hide what is behind them.
    /// Cells without points do not count.
    pub fn shares(&self, camera: &Camera) -> Vec<f64> {
        let [across, down] = CELLS;
        let mut nearest = vec![(f64::INFINITY, 0); across * down];
        for &(point, block) in &self.points {
            let Some((u, v, depth)) = camera.project(point) else {
                continue;
            };
            let x = u / camera.width as f64 * across as f64;
            let y = v / camera.height as f64 * down as f64;
            if (0.0..across as f64).contains(&x) && (0.0..down as f64).contains(&y) {
                let cell = &mut nearest[y as usize * across + x as usize];
                if depth < cell.0 {
                    *cell = (depth, block);
                }
            }
        }
        let mut counts = vec![0_usize; self.blocks];
        let seen = nearest.iter().filter(|(depth, _)| depth.is_finite());
        seen.for_each(|(_, block)| counts[*block] += 1);
        let all = counts.iter().sum::<usize>().max(1);
        counts.iter().map(|&n| n as f64 / all as f64).collect()
    }
}

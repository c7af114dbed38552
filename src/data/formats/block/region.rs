//! A rectangle of the floor, of any height.

use super::visibility::{PointSample, nearest};
use crate::data::Points;
use crate::data::formats::frame::Frame;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// A rectangle of the floor, of any height, half open: its low sides belong to it. Sides may be infinite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    /// The horizontal directions that the sides are measured along, unit vectors.
    pub axes: [DVec3; 2],
    /// The low sides, world units.
    pub low: DVec2,
    /// The high sides, world units.
    pub high: DVec2,
}

impl Region {
    /// Whether a world point lies in it.
    pub fn contains(&self, point: DVec3) -> bool {
        let at = DVec2::from(self.axes.map(|axis| axis.dot(point)));
        at.cmpge(self.low).all() && at.cmplt(self.high).all()
    }

    /// Whether both have points in common. The axes must be the same.
    pub fn meets(&self, other: &Self) -> bool {
        self.low.cmplt(other.high).all() && other.low.cmplt(self.high).all()
    }

    /// Keeps the points, relative to `origin`, that training on the frames of this region starts from: all points of the region,
    /// and outside it those that are the nearest in a cell of a photo. Without the latter, Gaussians of the region would have to
    /// imitate what the photos show behind it.
    pub(crate) fn thin(&self, points: &mut Points, frames: &[&Frame], origin: DVec3) {
        let world = |i: usize| DVec3::from(points.positions[i].map(f64::from)) + origin;
        let mut kept: Vec<bool> = (0..points.len()).map(|i| self.contains(world(i))).collect();
        let sample = PointSample::new(points, origin);
        let shown = |frame: &&Frame| nearest(&frame.camera, &sample.positions);
        let seen: Vec<_> = frames.par_iter().map(shown).collect();
        seen.iter()
            .flatten()
            .for_each(|&i| kept[sample.rows[i]] = true);
        points.retain(&kept);
    }
}

//! A rectangle of the floor, of any height.

use crate::data::Points;
use crate::data::formats::frame::Frame;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Of the points outside a region, every so many is a start for Gaussians that its photos show.
const THINNED: usize = 4;

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

    /// Leaves out points, relative to `origin`, that training on the frames of this region does not start from. All points of the
    /// region stay. Outside it every fourth one stays that some frame shows: without any, Gaussians of the region would take the
    /// place of what the photos show behind it.
    pub(crate) fn thin(&self, points: &mut Points, frames: &[&Frame], origin: DVec3) {
        let is_kept = |(i, position): (usize, &[f32; 3])| {
            let world = DVec3::from(position.map(f64::from)) + origin;
            self.contains(world)
                || i.is_multiple_of(THINNED) && frames.iter().any(|frame| shows(frame, world))
        };
        let mut kept = Vec::new();
        let positions = points.positions.par_iter().enumerate();
        positions.map(is_kept).collect_into_vec(&mut kept);
        points.retain(&kept);
    }
}

/// Whether a world point lies in the picture of a frame.
fn shows(frame: &Frame, world: DVec3) -> bool {
    let camera = &frame.camera;
    camera.project(world).is_some_and(|(u, v, _)| {
        (0.0..camera.width as f64).contains(&u) && (0.0..camera.height as f64).contains(&v)
    })
}

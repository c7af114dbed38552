//! Conventions of poses.

use crate::config::Layout;
use crate::splat::camera::Camera;
use glam::{DMat3, DVec3};

/// How a rotation and a translation are to be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Convention {
    /// They map world to camera coordinates, not back.
    to_camera: bool,
    /// Camera axes are x right, y down, z forward; else x right, y up, z backward.
    opencv: bool,
}

impl Convention {
    const fn new(to_camera: bool, opencv: bool) -> Self {
        Self { to_camera, opencv }
    }

    /// All conventions but this one.
    pub fn others(self) -> impl Iterator<Item = Self> {
        let all = [(false, false), (true, false), (false, true), (true, true)];
        all.into_iter()
            .map(|(to_camera, opencv)| Self::new(to_camera, opencv))
            .filter(move |other| *other != self)
    }

    /// The convention of a layout.
    pub fn of(layout: Layout) -> Self {
        match layout {
            Layout::Auto | Layout::Transforms => Self::new(false, false),
            Layout::Colmap => Self::new(true, true),
            Layout::Replica | Layout::Scannet => Self::new(false, true),
        }
    }

    pub fn name(self) -> String {
        let direction = if self.to_camera {
            "world-to-camera"
        } else {
            "camera-to-world"
        };
        let axes = if self.opencv { "OpenCV" } else { "OpenGL" };
        format!("{direction} in {axes} axes")
    }

    pub fn description(self) -> String {
        let axes = if self.opencv {
            "y down, looking along z"
        } else {
            "y up, looking along -z"
        };
        format!("{} (x right, {axes})", self.name())
    }

    /// From the axes of [`Camera`] to these, and back.
    fn axes(self) -> DMat3 {
        let sign = if self.opencv { 1.0 } else { -1.0 };
        DMat3::from_diagonal(DVec3::new(1.0, sign, sign))
    }

    /// `camera`, whose pose was read in the convention `as_read`, with the pose read in this convention instead.
    pub fn reread(self, as_read: Self, camera: &Camera) -> Camera {
        let rotation = as_read.axes() * camera.rotation;
        let (rotation, translation) = if as_read.to_camera {
            (rotation, -(rotation * camera.center))
        } else {
            (rotation.transpose(), camera.center)
        };
        let (rotation, center) = if self.to_camera {
            (rotation, -(rotation.transpose() * translation))
        } else {
            (rotation.transpose(), translation)
        };
        Camera {
            rotation: self.axes() * rotation,
            center,
            ..camera.clone()
        }
    }

    /// How to change poses of this convention into those of a layout with another one.
    pub fn help(self, layout: Layout) -> String {
        let wanted = Self::of(layout);
        let matrix = match layout {
            Layout::Auto | Layout::Transforms => "transform_matrix",
            Layout::Colmap => "pose",
            Layout::Replica | Layout::Scannet => "matrix",
        };
        // The camera's side of the matrix.
        let lines = if wanted.to_camera { "rows" } else { "columns" };
        let inverts = self.to_camera != wanted.to_camera;
        let negates = self.opencv != wanted.opencv;
        if !inverts {
            format!("negate the second and third {lines} of each {matrix}")
        } else if negates {
            format!("invert each {matrix}, then negate its second and third {lines}")
        } else {
            format!("invert each {matrix}")
        }
    }
}

//! Vectors of three numbers in kernels.

use burn_cubecl::cubecl::{self, prelude::*};

#[derive(CubeType, Clone, Copy)]
pub(super) struct Vec3 {
    pub x: f32,
    pub y: f32,
    pub z: f32,
}

#[cube]
pub(super) fn vec3(x: f32, y: f32, z: f32) -> Vec3 {
    Vec3 { x, y, z }
}

/// Entries `at..at + 3` of `from`.
#[cube]
pub(super) fn read3(from: &[f32], at: usize) -> Vec3 {
    Vec3 {
        x: from[at],
        y: from[at + 1],
        z: from[at + 2],
    }
}

#[cube]
pub(super) fn write3(to: &mut [f32], at: usize, v: &Vec3) {
    to[at] = v.x;
    to[at + 1] = v.y;
    to[at + 2] = v.z;
}

#[cube]
pub(super) fn dot(a: &Vec3, b: &Vec3) -> f32 {
    a.x * b.x + a.y * b.y + a.z * b.z
}

#[cube]
pub(super) fn cross(a: &Vec3, b: &Vec3) -> Vec3 {
    Vec3 {
        x: a.y * b.z - a.z * b.y,
        y: a.z * b.x - a.x * b.z,
        z: a.x * b.y - a.y * b.x,
    }
}

/// `a + s b`.
#[cube]
pub(super) fn add_scaled(a: &Vec3, s: f32, b: &Vec3) -> Vec3 {
    Vec3 {
        x: a.x + s * b.x,
        y: a.y + s * b.y,
        z: a.z + s * b.z,
    }
}

#[cube]
pub(super) fn scaled(s: f32, a: &Vec3) -> Vec3 {
    Vec3 {
        x: s * a.x,
        y: s * a.y,
        z: s * a.z,
    }
}

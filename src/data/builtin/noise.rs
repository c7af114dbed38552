//! Hashes, smooth value noise and small curves for procedural patterns.

use crate::data::labels::palette::linear;
use glam::DVec3;

/// A colour in linear light from an sRGB code such as `0xc08040`.
pub(super) fn rgb(code: u32) -> DVec3 {
    let channel = |shift: u32| linear(f64::from(code >> shift & 255) / 255.0);
    DVec3::new(channel(16), channel(8), channel(0))
}

/// A hash of three integers, uniform in 0..1.
pub(super) fn hash(x: i64, y: i64, seed: u64) -> f64 {
    let mut h = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
        ^ seed.wrapping_mul(0x1656_67b1_9e37_79f9);
    h = (h ^ h >> 32).wrapping_mul(0xd6e8_feb8_6659_fd93);
    h = (h ^ h >> 32).wrapping_mul(0xd6e8_feb8_6659_fd93);
    (h ^ h >> 32) as u32 as f64 / 4_294_967_296.0
}

/// Value noise in 0..1, smooth, with unit cell size.
pub(super) fn noise(x: f64, y: f64, seed: u64) -> f64 {
    let (fx, fy) = (x.floor(), y.floor());
    let (i, j) = (fx as i64, fy as i64);
    let (u, v) = (ease(x - fx), ease(y - fy));
    let row = |j: i64| hash(i, j, seed) * (1.0 - u) + hash(i + 1, j, seed) * u;
    row(j) * (1.0 - v) + row(j + 1) * v
}

/// Two octaves of [`noise`].
pub(super) fn cloud(x: f64, y: f64, seed: u64) -> f64 {
    0.67 * noise(x, y, seed) + 0.33 * noise(2.1 * x + 5.2, 2.1 * y + 1.3, seed ^ 0x55)
}

fn ease(t: f64) -> f64 {
    t * t * (3.0 - 2.0 * t)
}

/// 0 below `a`, 1 above `b`, smooth between.
pub(super) fn step(a: f64, b: f64, x: f64) -> f64 {
    ease(((x - a) / (b - a)).clamp(0.0, 1.0))
}

/// 1 within `half` of zero, falling to 0 over `soft`.
pub(super) fn band(x: f64, half: f64, soft: f64) -> f64 {
    1.0 - step(half, half + soft, x.abs())
}

/// Distance from `x` to the nearest multiple of `period`, signed.
pub(super) fn fold(x: f64, period: f64) -> f64 {
    x - (x / period).round() * period
}

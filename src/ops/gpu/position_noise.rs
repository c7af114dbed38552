//! The noise of 3DGS-MCMC in one kernel, a unit a Gaussian, which draws its own normal numbers.

use super::numeric::ln_1p;
use super::own;
use crate::backend::gpu::{Gpu, arg};
use crate::ops::position_noise::{NoiseBackend, NoiseStep};
use crate::random::philox::{FACTORS, ROUNDS, STEPS};
use burn::backend::tensor::FloatTensor;
use burn::tensor::DType;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::{cast, into_contiguous};

/// 2 pi / 2^24.
const TURN: f32 = (std::f64::consts::TAU / 16_777_216.0) as f32;
/// 1 / 2^23.
const STEP: f32 = 1.0 / 8_388_608.0;
/// Where e^x is neither 0 nor beyond f32.
const LARGEST: f32 = 80.0;

#[derive(CubeType, Clone, Copy)]
struct Words {
    a: u32,
    b: u32,
    c: u32,
    d: u32,
}

/// The upper 32 bits of `a b`, by halves.
#[cube]
fn product_high(a: u32, #[comptime] b: u32) -> u32 {
    let low = comptime![b & 0xffff];
    let high = comptime![b >> 16];
    let below = a & 0xffffu32;
    let above = a >> 16u32;
    let first = above * low + ((below * low) >> 16u32);
    let second = below * high + (first & 0xffffu32);
    above * high + (first >> 16u32) + (second >> 16u32)
}

/// [`crate::random::philox::philox`] of the counter `index`.
#[cube]
fn philox(index: u32, key0: u32, key1: u32) -> Words {
    let mut w = Words {
        a: index,
        b: 0u32,
        c: 0u32,
        d: 0u32,
    };
    #[unroll]
    for round in 0..ROUNDS {
        let k0 = key0 + comptime![(round as u32).wrapping_mul(STEPS[0])];
        let k1 = key1 + comptime![(round as u32).wrapping_mul(STEPS[1])];
        let p = product_high(w.a, comptime![FACTORS[0]]);
        let q = product_high(w.c, comptime![FACTORS[1]]);
        let a = q ^ w.b ^ k0;
        let b = w.c * comptime![FACTORS[1]];
        let c = p ^ w.d ^ k1;
        let d = w.a * comptime![FACTORS[0]];
        w.a = a;
        w.b = b;
        w.c = c;
        w.d = d;
    }
    w
}

/// The distance from 0 of two normal numbers.
#[cube]
fn radius(word: u32) -> f32 {
    let u = (f32::cast_from(word >> 9u32) + 0.5f32) * STEP;
    (f32::new(-2.0) * ln_1p(u - 1.0f32)).sqrt()
}

#[derive(CubeType, Clone, Copy)]
struct Direction {
    x: f32,
    y: f32,
}

/// Their direction. Devices may take `cos` with an error of 2^-11 (WGSL).
#[cube]
fn direction(word: u32) -> Direction {
    let turn = word >> 8u32;
    let quarter = (turn + (1u32 << 21u32)) >> 22u32;
    // at most an eighth of a turn to either side
    let angle = (f32::cast_from(turn) - f32::cast_from(quarter << 22u32)) * TURN;
    let q = angle * angle;
    let cos = 1.0f32
        - q * (0.5f32
            - q * (1.0f32 / 24.0f32 - q * (1.0f32 / 720.0f32 - q * (1.0f32 / 40320.0f32))));
    let more = 1.0f32 / 120.0f32 - q * (1.0f32 / 5040.0f32 - q * (1.0f32 / 362880.0f32));
    let sin = angle * (1.0f32 - q * (1.0f32 / 6.0f32 - q * more));
    let odd = quarter & 1u32 == 1u32;
    let sign = select(quarter & 2u32 == 2u32, f32::new(-1.0), 1.0f32);
    Direction {
        x: sign * select(odd, f32::new(-1.0) * sin, cos),
        y: sign * select(odd, cos, sin),
    }
}

#[cube]
fn sigmoid(x: f32) -> f32 {
    1.0f32 / (1.0f32 + (f32::new(-1.0) * x.clamp(f32::new(-LARGEST), LARGEST)).exp())
}

#[derive(CubeType, Clone, Copy)]
struct Vector {
    x: f32,
    y: f32,
    z: f32,
}

/// `v` turned by the unit quaternion (w, x, y, z).
#[cube]
fn turned(v: Vector, w: f32, x: f32, y: f32, z: f32) -> Vector {
    let a = y * v.z - z * v.y;
    let b = z * v.x - x * v.z;
    let c = x * v.y - y * v.x;
    Vector {
        x: v.x + 2.0f32 * (w * a + y * c - z * b),
        y: v.y + 2.0f32 * (w * b + z * a - x * c),
        z: v.z + 2.0f32 * (w * c + x * b - y * a),
    }
}

#[cube(launch)]
fn add_noise(
    means: &mut [f32],
    log_scales: &[f32],
    rotations: &[f32],
    opacity_logits: &[f32],
    count: u32,
    key0: u32,
    key1: u32,
    scale: f32,
    sharpness: f32,
    opacity: f32,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let gate = sigmoid(sharpness * (opacity - sigmoid(opacity_logits[i])));
    if gate > comptime![f32::EPSILON] {
        let words = philox(i as u32, key0, key1);
        let first = radius(words.a);
        let pair = direction(words.b);
        let third = radius(words.c) * direction(words.d).x;
        let normal = Vector {
            x: first * pair.x,
            y: first * pair.y,
            z: third,
        };
        let w = rotations[4 * i];
        let x = rotations[4 * i + 1];
        let y = rotations[4 * i + 2];
        let z = rotations[4 * i + 3];
        let square = w * w + x * x + y * y + z * z;
        // A quaternion of zeros turns nothing.
        let mut by = 0.0f32;
        if square >= 1e-12f32 {
            by = 1.0f32 / square.sqrt();
        }
        let (w, x, y, z) = (w * by, x * by, y * by, z * by);
        let back = f32::new(-1.0) * w;
        let mut local = turned(normal, back, x, y, z);
        local.x *= (2.0f32 * log_scales[3 * i]).exp();
        local.y *= (2.0f32 * log_scales[3 * i + 1]).exp();
        local.z *= (2.0f32 * log_scales[3 * i + 2]).exp();
        let moved = turned(local, w, x, y, z);
        means[3 * i] += scale * gate * moved.x;
        means[3 * i + 1] += scale * gate * moved.y;
        means[3 * i + 2] += scale * gate * moved.z;
    }
}

impl NoiseBackend for CubeBackend {
    fn add_position_noise(
        means: FloatTensor<Self>,
        log_scales: FloatTensor<Self>,
        rotations: FloatTensor<Self>,
        opacity_logits: FloatTensor<Self>,
        step: NoiseStep,
    ) -> FloatTensor<Self> {
        let count = opacity_logits.meta.num_elements();
        if count == 0 {
            return means;
        }
        let gpu = Gpu::of(&means);
        let means = own(cast(means, DType::F32));
        let [log_scales, rotations, opacity_logits] = [log_scales, rotations, opacity_logits]
            .map(|tensor| into_contiguous(cast(tensor, DType::F32)));
        add_noise::launch(
            &gpu.client,
            gpu.cubes_for(count),
            gpu.dim(),
            arg(&means),
            arg(&log_scales),
            arg(&rotations),
            arg(&opacity_logits),
            count as u32,
            step.key[0],
            step.key[1],
            step.scale,
            step.sharpness,
            step.opacity,
        );
        means
    }
}

//! The photometric loss on a GPU: one cube for each tile and channel, one unit for each pixel, the window in two passes.
//!
//! The first kernel computes SSIM and its derivatives by the windowed moments of the image. The second computes the gradient,
//! which needs those derivatives of the neighbouring tiles too. Each cube leaves its part of the loss.

use super::{C1, C2, CHANNELS, PhotometricTarget, RADIUS, TAPS, cpu, taps};
use crate::backend::gpu::{Gpu, UNITS, launch, sum_cube};
use crate::ops::gpu::covers;
use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::FloatTensor;
use burn::tensor::Shape;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;
use std::sync::Arc;

/// 1 / 255 in two parts. The first has 16 bits, so that a byte times it is exact. The sum of both products is the byte / 255 as
/// the CPU rounds it, unless a compiler adds the parts first.
const BYTE_HIGH: f32 = f32::from_bits(0x3b80_8000);
const BYTE_LOW: f32 = (1.0 / 255.0 - BYTE_HIGH as f64) as f32;

/// Value number `at` of a photo, whose bytes lie four to a word.
#[cube]
fn value_at(photo: &[u32], at: usize) -> f32 {
    let byte = f32::cast_from(photo[at / 4] >> (at as u32 % 4 * 8) & 255u32);
    byte * comptime![BYTE_HIGH] + byte * comptime![BYTE_LOW]
}

/// The bytes of a photo, four to a word.
pub(super) type PhotoWords = CubeTensor;

/// Pixels on a side of a tile; a unit has one.
const TILE: usize = 16;
/// The tile with the pixels around it that the window reaches.
const SIDE: usize = TILE + 2 * RADIUS;
/// Values of a plane: a tile with its rim.
const PLANE: usize = SIDE * SIDE;
/// Values of a plane whose rows have been convolved.
const ROWS: usize = SIDE * TILE;

/// Cubes for all tiles and channels.
fn cubes(height: usize, width: usize) -> usize {
    width.div_ceil(TILE) * height.div_ceil(TILE) * CHANNELS
}

/// A pixel of a tile or of its rim.
#[derive(CubeType, Clone, Copy)]
struct RimPixel {
    /// Whether it lies in the image.
    inside: bool,
    /// Its number, row-major; 0 where it lies outside of the image.
    pixel: usize,
}

#[cube]
fn rim_pixel(tile: usize, column: usize, row: usize, width: u32, height: u32) -> RimPixel {
    let across = (width + (TILE - 1) as u32) / TILE as u32;
    // Counted from the rim's corner of the first tile, so that nothing is negative.
    let x = (tile as u32 % across) * TILE as u32 + column as u32;
    let y = (tile as u32 / across) * TILE as u32 + row as u32;
    let rim = RADIUS as u32;
    let inside = x >= rim && x < width + rim && y >= rim && y < height + rim;
    RimPixel {
        inside,
        pixel: select(inside, (y - rim) * width + x - rim, 0u32) as usize,
    }
}

/// The pixel of this unit.
#[cube]
fn own_pixel(tile: usize, width: u32, height: u32) -> RimPixel {
    let unit = UNIT_POS as usize;
    rim_pixel(
        tile,
        RADIUS + unit % TILE,
        RADIUS + unit / TILE,
        width,
        height,
    )
}

/// The first `count` of `planes`, convolved, at the unit's pixel. All units of the cube call it; `planes` is complete before.
#[cube]
fn windowed(
    planes: &Shared<[f32]>,
    rows: &mut Shared<[f32]>,
    #[comptime] count: usize,
) -> Array<f32> {
    let unit = UNIT_POS as usize;
    let mut k = unit;
    while k < ROWS {
        let at = k / TILE * SIDE + k % TILE;
        #[unroll]
        for plane in 0..count {
            let mut sum = 0.0f32;
            #[unroll]
            for t in 0..TAPS {
                let tap = comptime![taps::<f32>()[t]];
                sum += tap * planes[at + t + plane * PLANE];
            }
            rows[k + plane * ROWS] = sum;
        }
        k += UNITS as usize;
    }
    sync_cube();
    let mut out = Array::<f32>::new(count);
    #[unroll]
    for plane in 0..count {
        let mut sum = 0.0f32;
        #[unroll]
        for t in 0..TAPS {
            let tap = comptime![taps::<f32>()[t]];
            sum += tap * rows[unit + t * TILE + plane * ROWS];
        }
        out[plane] = sum;
    }
    out
}

/// Windowed moments of image x and photo y: of x, x^2, x y, y and y^2. The loss has derivatives by the first three.
const MOMENTS: usize = 5;
const PARTIALS: usize = 3;

/// `scale` times the derivatives of SSIM by the moments (`[CHANNELS, PARTIALS, H, W]`), and each cube's sum of 1 - SSIM.
#[cube(launch)]
fn dissimilarity(
    image: &[f32],
    photo: &[u32],
    partials: &mut [f32],
    sums: &mut [f32],
    width: u32,
    height: u32,
    cubes: u32,
    scale: f32,
) {
    if CUBE_POS >= cubes as usize {
        terminate!();
    }
    let tile = CUBE_POS / CHANNELS;
    let channel = CUBE_POS % CHANNELS;
    let mut planes = Shared::<[f32]>::new_slice(MOMENTS * PLANE);
    let mut rows = Shared::<[f32]>::new_slice(MOMENTS * ROWS);
    let mut k = UNIT_POS as usize;
    while k < PLANE {
        let at = rim_pixel(tile, k % SIDE, k / SIDE, width, height);
        let mut x = 0.0f32;
        let mut y = 0.0f32;
        if at.inside {
            x = image[at.pixel * CHANNELS + channel];
            y = value_at(photo, at.pixel * CHANNELS + channel);
        }
        planes[k] = x;
        planes[k + PLANE] = x * x;
        planes[k + 2 * PLANE] = x * y;
        planes[k + 3 * PLANE] = y;
        planes[k + 4 * PLANE] = y * y;
        k += UNITS as usize;
    }
    sync_cube();
    let moments = windowed(&planes, &mut rows, MOMENTS);
    let own = own_pixel(tile, width, height);
    let mut short = 0.0f32;
    if own.inside {
        let (mx, my) = (moments[0], moments[3]);
        let sxx = moments[1] - mx * mx;
        let sxy = moments[2] - mx * my;
        let syy = moments[4] - my * my;
        let a1 = 2.0f32 * mx * my + comptime![C1 as f32];
        let a2 = 2.0f32 * sxy + comptime![C2 as f32];
        let r1 = 1.0f32 / (mx * mx + my * my + comptime![C1 as f32]);
        let r2 = 1.0f32 / (sxx + syy + comptime![C2 as f32]);
        let ssim = a1 * a2 * r1 * r2;
        let d_square = f32::new(-1.0) * ssim * r2;
        let d_product = 2.0f32 * a1 * r1 * r2;
        let d_mean =
            2.0f32 * (my * a2 * r1 * r2 - mx * ssim * r1) - 2.0f32 * mx * d_square - my * d_product;
        let pixels = (width * height) as usize;
        let to = channel * PARTIALS * pixels + own.pixel;
        partials[to] = scale * d_mean;
        partials[to + pixels] = scale * d_square;
        partials[to + 2 * pixels] = scale * d_product;
        short = 1.0f32 - ssim;
    }
    let sum = sum_cube(short);
    if UNIT_POS == 0 {
        sums[CUBE_POS] = sum;
    }
}

/// The gradient `[H, W, CHANNELS]`, and in place of each cube's sum of 1 - SSIM its part of the loss.
#[cube(launch)]
fn gradient_of(
    image: &[f32],
    photo: &[u32],
    partials: &[f32],
    gradient: &mut [f32],
    sums: &mut [f32],
    width: u32,
    height: u32,
    cubes: u32,
    ssim_scale: f32,
    l1_scale: f32,
) {
    if CUBE_POS >= cubes as usize {
        terminate!();
    }
    let tile = CUBE_POS / CHANNELS;
    let channel = CUBE_POS % CHANNELS;
    let mut planes = Shared::<[f32]>::new_slice(PARTIALS * PLANE);
    let mut rows = Shared::<[f32]>::new_slice(PARTIALS * ROWS);
    let pixels = (width * height) as usize;
    let mut k = UNIT_POS as usize;
    while k < PLANE {
        let at = rim_pixel(tile, k % SIDE, k / SIDE, width, height);
        let from = channel * PARTIALS * pixels + at.pixel;
        #[unroll]
        for partial in 0..PARTIALS {
            let mut value = 0.0f32;
            if at.inside {
                value = partials[from + partial * pixels];
            }
            planes[k + partial * PLANE] = value;
        }
        k += UNITS as usize;
    }
    sync_cube();
    let by = windowed(&planes, &mut rows, PARTIALS);
    let own = own_pixel(tile, width, height);
    let mut distance = 0.0f32;
    if own.inside {
        let at = own.pixel * CHANNELS + channel;
        let x = image[at];
        let y = value_at(photo, at);
        let difference = x - y;
        let mut l1 = 0.0f32;
        if difference > 0.0f32 {
            l1 = l1_scale;
        }
        if difference < 0.0f32 {
            l1 = f32::new(-1.0) * l1_scale;
        }
        gradient[at] = by[2] * y + (by[1] * (x + x) + (by[0] + l1));
        distance = difference.abs();
    }
    let sum = sum_cube(distance);
    if UNIT_POS == 0 {
        sums[CUBE_POS] = ssim_scale * sums[CUBE_POS] + l1_scale * sum;
    }
}

/// The photo's bytes, four to a word, the first one lowest. Zeros fill up the last word.
fn words(target: &PhotometricTarget) -> Vec<u32> {
    let words = target.pixels.as_raw().chunks(4).map(|bytes| {
        let mut word = [0; 4];
        word[..bytes.len()].copy_from_slice(bytes);
        u32::from_le_bytes(word)
    });
    words.collect()
}

/// Loss `[1]` and gradient `[H, W, CHANNELS]`.
fn compare(
    gpu: &Gpu,
    image: &CubeTensor,
    target: &PhotometricTarget,
    ssim_weight: f64,
) -> (CubeTensor, CubeTensor) {
    let (height, width) = target.size();
    let cubes = cubes(height, width);
    let is_here = |words: &PhotoWords| words.device == gpu.device;
    let photo = target.words.get(is_here, || gpu.upload(&words(target)));
    let gradient = gpu.floats([height, width, CHANNELS]);
    let values = height * width * CHANNELS;
    let ssim_scale = ssim_weight / values as f64;
    let l1_scale = (1.0 - ssim_weight) / values as f64;
    let partials = gpu.floats([PARTIALS * values]);
    let sums = gpu.floats([cubes]);
    launch!(gpu, dissimilarity, gpu.cubes(cubes);
        image, &photo, &partials, &sums; width as u32, height as u32, cubes as u32, -ssim_scale as f32);
    launch!(gpu, gradient_of, gpu.cubes(cubes);
        image, &photo, &partials, &gradient, &sums;
        width as u32, height as u32, cubes as u32, ssim_scale as f32, l1_scale as f32);
    let sums = CubeBackend::float_reshape(sums, Shape::new([1, cubes]));
    let loss = CubeBackend::float_sum_dim(sums, 1);
    (CubeBackend::float_reshape(loss, Shape::new([1])), gradient)
}

/// Whether one allocation holds the derivatives of an image of `values` values, and 32 bits count them.
fn fits(gpu: &Gpu, values: usize) -> bool {
    values.saturating_mul(PARTIALS) <= (gpu.largest() / size_of::<f32>()).min(i32::MAX as usize)
}

/// Loss and gradient on a GPU. Tensors that are not f32 and images that are too large take the kernels for CPUs.
pub fn loss_and_gradient(
    image: FloatTensor<CubeBackend>,
    target: Arc<PhotometricTarget>,
    ssim_weight: f64,
) -> (FloatTensor<CubeBackend>, FloatTensor<CubeBackend>) {
    let gpu = Gpu::of(&image);
    let values = image.meta.num_elements();
    if !covers(&image) || values == 0 || !fits(&gpu, values) {
        return cpu::loss_and_gradient::<CubeBackend>(image, target, ssim_weight);
    }
    compare(&gpu, &into_contiguous(image), &target, ssim_weight)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_become_the_values_that_the_host_has() {
        assert_eq!(BYTE_HIGH.to_bits() & 0xff, 0, "16 bits of mantissa");
        for byte in 0..=255 {
            let byte = byte as f32;
            let want = byte / 255.0;
            assert_eq!(byte * BYTE_HIGH + byte * BYTE_LOW, want);
            assert_eq!(
                byte.mul_add(BYTE_LOW, byte * BYTE_HIGH),
                want,
                "of devices that fuse"
            );
        }
    }
}

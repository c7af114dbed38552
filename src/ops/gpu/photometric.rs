//! The photometric loss on a device: a cube a tile and channel, a unit a pixel, the window in two passes.
//!
//! A first kernel makes SSIM and its derivatives by the windowed moments, a second one the gradient, which needs the first
//! kernel's results from the neighbouring tiles. Each leaves a sum a cube, and one last cube adds these up.

use super::covers;
use super::photo::{DevicePhoto, used, value_at};
use super::sum::{sum, sum_cube};
use super::tile_window::{PLANE, ROWS, SIDE, cubes, own_place, place, windowed};
use crate::backend::gpu::{Gpu, UNITS, arg};
use crate::ops::Compared;
use crate::ops::photo::{C1, C2, CHANNELS};
use crate::ops::photometric::{PhotometricBackend, on_host};
use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::FloatTensor;
use burn::tensor::Shape;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;

/// Windowed moments of the image: of x, x^2 and x y.
const MOMENTS: usize = 3;

/// `scale` times the derivatives of SSIM by the moments (`[CHANNELS, MOMENTS, H, W]`), and each cube's sum of 1 - SSIM.
#[cube(launch)]
fn dissimilarity(
    image: &[f32],
    photo: &[u32],
    photo_mean: &[f32],
    photo_variance: &[f32],
    partials: &mut [f32],
    sums: &mut [f32],
    width: u32,
    height: u32,
    cubes: u32,
    scale: f32,
    #[comptime] packed: bool,
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
        let at = place(tile, k % SIDE, k / SIDE, width, height);
        let mut x = 0.0f32;
        let mut y = 0.0f32;
        if at.inside {
            x = image[at.pixel * CHANNELS + channel];
            y = value_at(photo, at.pixel * CHANNELS + channel, packed);
        }
        planes[k] = x;
        planes[k + PLANE] = x * x;
        planes[k + 2 * PLANE] = x * y;
        k += UNITS as usize;
    }
    sync_cube();
    let moments = windowed(&planes, &mut rows, true);
    let own = own_place(tile, width, height);
    let mut short = 0.0f32;
    if own.inside {
        let at = own.pixel * CHANNELS + channel;
        let mx = moments.first;
        let my = photo_mean[at];
        let sxx = moments.second - mx * mx;
        let sxy = moments.third - mx * my;
        let a1 = 2.0f32 * mx * my + comptime![C1 as f32];
        let a2 = 2.0f32 * sxy + comptime![C2 as f32];
        let r1 = 1.0f32 / (mx * mx + my * my + comptime![C1 as f32]);
        let r2 = 1.0f32 / (sxx + photo_variance[at] + comptime![C2 as f32]);
        let ssim = a1 * a2 * r1 * r2;
        let d_square = f32::new(-1.0) * ssim * r2;
        let d_product = 2.0f32 * a1 * r1 * r2;
        let d_mean =
            2.0f32 * (my * a2 * r1 * r2 - mx * ssim * r1) - 2.0f32 * mx * d_square - my * d_product;
        let pixels = (width * height) as usize;
        let to = channel * MOMENTS * pixels + own.pixel;
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
    #[comptime] packed: bool,
) {
    if CUBE_POS >= cubes as usize {
        terminate!();
    }
    let tile = CUBE_POS / CHANNELS;
    let channel = CUBE_POS % CHANNELS;
    let mut planes = Shared::<[f32]>::new_slice(MOMENTS * PLANE);
    let mut rows = Shared::<[f32]>::new_slice(MOMENTS * ROWS);
    let pixels = (width * height) as usize;
    let mut k = UNIT_POS as usize;
    while k < PLANE {
        let at = place(tile, k % SIDE, k / SIDE, width, height);
        let from = channel * MOMENTS * pixels + at.pixel;
        #[unroll]
        for moment in 0..MOMENTS {
            let mut value = 0.0f32;
            if at.inside {
                value = partials[from + moment * pixels];
            }
            planes[k + moment * PLANE] = value;
        }
        k += UNITS as usize;
    }
    sync_cube();
    let by = windowed(&planes, &mut rows, true);
    let own = own_place(tile, width, height);
    let mut distance = 0.0f32;
    if own.inside {
        let at = own.pixel * CHANNELS + channel;
        let x = image[at];
        let y = value_at(photo, at, packed);
        let difference = x - y;
        let mut l1 = 0.0f32;
        if difference > 0.0f32 {
            l1 = l1_scale;
        }
        if difference < 0.0f32 {
            l1 = f32::new(-1.0) * l1_scale;
        }
        gradient[at] = by.third * y + (by.second * (x + x) + (by.first + l1));
        distance = difference.abs();
    }
    let sum = sum_cube(distance);
    if UNIT_POS == 0 {
        sums[CUBE_POS] = ssim_scale * sums[CUBE_POS] + l1_scale * sum;
    }
}

impl DevicePhoto {
    /// Loss `[1]` and gradient `[H, W, CHANNELS]`.
    fn compare(
        &self,
        gpu: &Gpu,
        image: &CubeTensor,
        (height, width): (usize, usize),
        ssim_weight: f64,
    ) -> (CubeTensor, CubeTensor) {
        let cubes = cubes(height, width);
        let values = height * width * CHANNELS;
        let (ssim_scale, l1_scale) = (
            ssim_weight / values as f64,
            (1.0 - ssim_weight) / values as f64,
        );
        let (partials, sums) = (gpu.floats([MOMENTS * values]), gpu.floats([cubes]));
        dissimilarity::launch(
            &gpu.client,
            gpu.cubes(cubes),
            gpu.dim(),
            arg(image),
            arg(&self.rgb),
            arg(&self.mean),
            arg(&self.variance),
            arg(&partials),
            arg(&sums),
            width as u32,
            height as u32,
            cubes as u32,
            -ssim_scale as f32,
            self.packed,
        );
        let gradient = gpu.floats([height, width, CHANNELS]);
        gradient_of::launch(
            &gpu.client,
            gpu.cubes(cubes),
            gpu.dim(),
            arg(image),
            arg(&self.rgb),
            arg(&partials),
            arg(&gradient),
            arg(&sums),
            width as u32,
            height as u32,
            cubes as u32,
            ssim_scale as f32,
            l1_scale as f32,
            self.packed,
        );
        (sum(gpu, &sums, cubes), gradient)
    }
}

/// Whether one allocation holds the derivatives of an image of `values` values, and 32 bits count them.
fn fits(gpu: &Gpu, values: usize) -> bool {
    values.saturating_mul(MOMENTS) <= (gpu.largest() / size_of::<f32>()).min(i32::MAX as usize)
}

impl PhotometricBackend for CubeBackend {
    fn photometric(
        image: FloatTensor<Self>,
        photo: Compared,
        ssim_weight: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let (gpu, (height, width)) = (Gpu::of(&image), photo.size());
        let values = height * width * CHANNELS;
        if !covers(&image) || values == 0 || !fits(&gpu, values) {
            return on_host::loss::<Self>(image, &photo, ssim_weight);
        }
        assert_eq!(
            image.meta.num_elements(),
            values,
            "photometric loss: image against photo"
        );
        let (image, size, photo) = (
            into_contiguous(image),
            photo.size(),
            DevicePhoto::of(&gpu, &photo),
        );
        let Some(bits) = &photo.mask else {
            return photo.compare(&gpu, &image, size, ssim_weight);
        };
        let (loss, gradient) = photo.compare(&gpu, &used(&gpu, &image, bits), size, ssim_weight);
        (loss, used(&gpu, &gradient, bits))
    }

    fn photometric_scale(
        gradient: FloatTensor<Self>,
        factor: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        let one = Shape::new([1; 3]);
        Self::float_mul(gradient, Self::float_reshape(factor, one))
    }
}

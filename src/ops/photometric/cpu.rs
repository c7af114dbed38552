//! The photometric loss on slices: bands of rows in parallel, the window in two passes.

use super::{C1, C2, CHANNELS, PhotometricTarget, RADIUS, TAPS, taps};
use crate::backend::simd::{multiply_add, wide_kernel};
use crate::backend::{HostBackend, Real, device_of};
use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn::tensor::DType;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// Rows of a task.
const BAND: usize = 32;

/// Loss and gradient by the kernels for CPUs, wherever the tensor lives.
pub fn loss_and_gradient<B: HostBackend>(
    image: FloatTensor<B>,
    target: Arc<PhotometricTarget>,
    ssim_weight: f64,
) -> (FloatTensor<B>, FloatTensor<B>) {
    let device = device_of::<B>(&image);
    let (height, width) = target.size();
    let shape = [height, width, CHANNELS];
    if image.dtype() == DType::F64 {
        let moments = Moments::new(target.values(), height, width);
        let (loss, gradient) = moments.compare(&B::values::<f64>(image), ssim_weight);
        return (
            B::tensor(vec![loss], &[1], &device),
            B::tensor(gradient, &shape, &device),
        );
    }
    let moments = target
        .moments
        .get_or_init(|| Moments::new(target.values(), height, width));
    let (loss, gradient) = moments.compare(&B::values::<f32>(image), ssim_weight);
    (
        B::tensor(vec![loss as f32], &[1], &device),
        B::tensor(gradient, &shape, &device),
    )
}

/// The values of a photo with their windowed moments, all `[H, W, 3]` row-major.
#[derive(Clone, Debug)]
pub(super) struct Moments<E> {
    height: usize,
    width: usize,
    rgb: Vec<E>,
    mean: Vec<E>,
    variance: Vec<E>,
}

impl<E: Real> Moments<E> {
    /// From `[H, W, 3]` values in 0..1.
    fn new(rgb: Vec<E>, height: usize, width: usize) -> Self {
        let row = width * CHANNELS;
        let mut mean = vec![E::zero(); rgb.len()];
        let mut variance = vec![E::zero(); rgb.len()];
        let band = (row * BAND).max(1);
        mean.par_chunks_mut(band)
            .zip(variance.par_chunks_mut(band))
            .enumerate()
            .for_each(|(b, (mean, variance))| {
                let rows = b * BAND..b * BAND + mean.len() / row;
                let source = |r: usize| &rgb[r * row..][..row];
                let sums = Band::new(&rows, height, row, |r, out| out.copy_from_slice(source(r)));
                let squares = Band::new(&rows, height, row, |r, out| {
                    multiply(source(r), source(r), out);
                });
                let rows = mean.chunks_exact_mut(row);
                for (k, (mean, variance)) in rows.zip(variance.chunks_exact_mut(row)).enumerate() {
                    sums.convolved(k, mean);
                    squares.convolved(k, variance);
                    let both = variance.iter_mut().zip(&*mean);
                    both.for_each(|(v, &m)| *v -= m * m);
                }
            });
        Self {
            height,
            width,
            rgb,
            mean,
            variance,
        }
    }

    /// Loss of `image` (`[H, W, 3]`) and its gradient to `image`.
    ///
    /// Sums are taken in row order, so the bits do not depend on the number of threads.
    fn compare(&self, image: &[E], ssim_weight: f64) -> (f64, Vec<E>) {
        let n = image.len();
        let row = self.width * CHANNELS;
        if n == 0 {
            return (0.0, Vec::new());
        }
        let (ssim, partials) = self.similarity(image, -ssim_weight / n as f64);
        let l1_scale = E::of((1.0 - ssim_weight) / n as f64);
        let mut gradient = vec![E::zero(); n];
        let bands = gradient.par_chunks_mut(row * BAND).enumerate();
        let l1: Vec<f64> = bands
            .map(|(b, gradient)| {
                let rows = b * BAND..b * BAND + gradient.len() / row;
                let bands = partials.each_ref().map(|partial| {
                    Band::new(&rows, self.height, row, |r, out| {
                        out.copy_from_slice(&partial[r * row..][..row])
                    })
                });
                let mut sums: [Vec<E>; 3] = std::array::from_fn(|_| vec![E::zero(); row]);
                let mut distance = vec![E::zero(); row];
                let mut total = 0.0;
                for (k, (r, out)) in rows.zip(gradient.chunks_exact_mut(row)).enumerate() {
                    let both = bands.iter().zip(&mut sums);
                    both.for_each(|(band, sum)| band.convolved(k, sum));
                    let span = r * row..(r + 1) * row;
                    let pixels = [&image[span.clone()], &self.rgb[span]];
                    let sums = sums.each_ref().map(|s| &**s);
                    gradient_row(pixels, sums, l1_scale, out, &mut distance);
                    total += sum_wide(&distance);
                }
                total
            })
            .collect();
        let l1 = l1.iter().sum::<f64>() / n as f64;
        let ssim = ssim / n as f64;
        let loss = (1.0 - ssim_weight) * l1 + ssim_weight * (1.0 - ssim);
        (loss, gradient)
    }

    /// Sum of SSIM over all scalars, and `scale` times its derivatives by the windowed x, x^2 and x y.
    fn similarity(&self, image: &[E], scale: f64) -> (f64, [Vec<E>; 3]) {
        let row = self.width * CHANNELS;
        let mut partials: [Vec<E>; 3] = std::array::from_fn(|_| vec![E::zero(); image.len()]);
        let [p, q, s] = &mut partials;
        let bands = p
            .par_chunks_mut(row * BAND)
            .zip(q.par_chunks_mut(row * BAND))
            .zip(s.par_chunks_mut(row * BAND));
        let sums: Vec<f64> = bands
            .enumerate()
            .map(|(b, ((p, q), s))| {
                let rows = b * BAND..b * BAND + p.len() / row;
                let x = |r: usize| &image[r * row..][..row];
                let y = |r: usize| &self.rgb[r * row..][..row];
                let bands = [
                    Band::new(&rows, self.height, row, |r, out| out.copy_from_slice(x(r))),
                    Band::new(&rows, self.height, row, |r, out| multiply(x(r), x(r), out)),
                    Band::new(&rows, self.height, row, |r, out| multiply(x(r), y(r), out)),
                ];
                let mut sums: [Vec<E>; 3] = std::array::from_fn(|_| vec![E::zero(); row]);
                let mut map = vec![E::zero(); row];
                let mut total = 0.0;
                let rows = rows
                    .zip(p.chunks_exact_mut(row))
                    .zip(q.chunks_exact_mut(row))
                    .zip(s.chunks_exact_mut(row));
                for (k, (((r, p), q), s)) in rows.enumerate() {
                    let both = bands.iter().zip(&mut sums);
                    both.for_each(|(band, sum)| band.convolved(k, sum));
                    let span = r * row..(r + 1) * row;
                    let photo = [&self.mean[span.clone()], &self.variance[span]];
                    let sums = sums.each_ref().map(|s| &**s);
                    ssim_row(sums, photo, E::of(scale), [p, q, s], &mut map);
                    total += sum_wide(&map);
                }
                total
            })
            .collect();
        (sums.iter().sum(), partials)
    }
}

/// Rows of an image, convolved horizontally, with the rows above and below that the vertical taps need.
struct Band<E> {
    /// Scalars of a row.
    row: usize,
    /// Rows `first - RADIUS .. last + RADIUS`; zero outside the image.
    values: Vec<E>,
    taps: [E; TAPS],
}

impl<E: Real> Band<E> {
    /// The band for output rows `rows` of an image of `height` rows of `row` scalars. `fill(r, out)` writes source row `r`.
    fn new(rows: &Range<usize>, height: usize, row: usize, fill: impl Fn(usize, &mut [E])) -> Self {
        let taps = taps();
        let pad = RADIUS * CHANNELS;
        let mut values = vec![E::zero(); (rows.len() + 2 * RADIUS) * row];
        let mut source = vec![E::zero(); row + 2 * pad];
        for (k, out) in values.chunks_exact_mut(row).enumerate() {
            let Some(r) = (rows.start + k).checked_sub(RADIUS).filter(|&r| r < height) else {
                continue;
            };
            fill(r, &mut source[pad..][..row]);
            let shifted = std::array::from_fn(|t| &source[t * CHANNELS..][..row]);
            weigh(shifted, &taps, out);
        }
        Self { row, values, taps }
    }

    /// Row `k` of the band, convolved in both directions.
    fn convolved(&self, k: usize, out: &mut [E]) {
        let rows = std::array::from_fn(|t| &self.values[(k + t) * self.row..][..self.row]);
        weigh(rows, &self.taps, out);
    }
}

wide_kernel! {
    /// `out = sum_t taps[t] rows[t]`; all slices have one length.
    fn weigh(rows: [&[E]; TAPS], taps: &[E; TAPS], out: &mut [E]) => weigh_body
}

#[inline(always)]
fn weigh_body<E: Real, const FMA: bool>(rows: [&[E]; TAPS], taps: &[E; TAPS], out: &mut [E]) {
    let n = out.len();
    let rows = rows.map(|r| &r[..n]);
    for i in 0..n {
        let mut sum = taps[0] * rows[0][i];
        for t in 1..TAPS {
            sum = multiply_add::<E, FMA>(taps[t], rows[t][i], sum);
        }
        out[i] = sum;
    }
}

fn multiply<E: Real>(a: &[E], b: &[E], out: &mut [E]) {
    let factors = a.iter().zip(b);
    out.iter_mut()
        .zip(factors)
        .for_each(|(o, (&a, &b))| *o = a * b);
}

wide_kernel! {
    /// Sum in f64 over eight fixed lanes.
    fn sum_wide(values: &[E]) -> f64 => sum_wide_body
}

#[inline(always)]
fn sum_wide_body<E: Real, const FMA: bool>(values: &[E]) -> f64 {
    let mut lanes = [0.0; 8];
    let (chunks, rest) = values.as_chunks::<8>();
    for chunk in chunks {
        for (lane, v) in lanes.iter_mut().zip(chunk) {
            *lane += v.wide();
        }
    }
    let mut sum = 0.0;
    for v in rest {
        sum += v.wide();
    }
    lanes.iter().sum::<f64>() + sum
}

wide_kernel! {
    /// SSIM of a row and its scaled derivatives. `sums` are the windowed x, x^2 and x y; `photo` has the windowed mean and
    /// variance.
    fn ssim_row(sums: [&[E]; 3], photo: [&[E]; 2], scale: E, out: [&mut [E]; 3], map: &mut [E]) => ssim_row_body
}

#[inline(always)]
fn ssim_row_body<E: Real, const FMA: bool>(
    sums: [&[E]; 3],
    photo: [&[E]; 2],
    scale: E,
    out: [&mut [E]; 3],
    map: &mut [E],
) {
    let n = map.len();
    let ([mean, square, product], [photo_mean, photo_variance]) =
        (sums.map(|s| &s[..n]), photo.map(|p| &p[..n]));
    let [by_mean, by_square, by_product] = out.map(|o| &mut o[..n]);
    let c1 = E::of(C1);
    let c2 = E::of(C2);
    let two = E::of(2.0);
    for i in 0..n {
        let (mx, my) = (mean[i], photo_mean[i]);
        let (sxx, sxy) = (square[i] - mx * mx, product[i] - mx * my);
        let a1 = two * mx * my + c1;
        let a2 = two * sxy + c2;
        let b1 = mx * mx + my * my + c1;
        let b2 = sxx + photo_variance[i] + c2;
        let r1 = E::one() / b1;
        let r2 = E::one() / b2;
        let ssim = a1 * a2 * r1 * r2;
        let d_square = -ssim * r2;
        let d_product = two * a1 * r1 * r2;
        let d_mean =
            two * (my * a2 * r1 * r2 - mx * ssim * r1) - two * mx * d_square - my * d_product;
        map[i] = ssim;
        by_mean[i] = scale * d_mean;
        by_square[i] = scale * d_square;
        by_product[i] = scale * d_product;
    }
}

wide_kernel! {
    /// Gradient of a row and |x - y|; `pixels` are x and y, `sums` the windowed derivatives of the SSIM term.
    fn gradient_row(pixels: [&[E]; 2], sums: [&[E]; 3], l1_scale: E, out: &mut [E], distance: &mut [E]) => gradient_row_body
}

#[inline(always)]
fn gradient_row_body<E: Real, const FMA: bool>(
    pixels: [&[E]; 2],
    sums: [&[E]; 3],
    l1_scale: E,
    out: &mut [E],
    distance: &mut [E],
) {
    let n = out.len();
    let [x, y] = pixels.map(|v| &v[..n]);
    let [p, q, s] = sums.map(|v| &v[..n]);
    let distance = &mut distance[..n];
    for i in 0..n {
        let difference = x[i] - y[i];
        let l1 = if difference > E::zero() {
            l1_scale
        } else if difference < E::zero() {
            -l1_scale
        } else {
            E::zero()
        };
        distance[i] = difference.abs();
        out[i] = multiply_add::<E, FMA>(
            y[i],
            s[i],
            multiply_add::<E, FMA>(x[i] + x[i], q[i], p[i] + l1),
        );
    }
}

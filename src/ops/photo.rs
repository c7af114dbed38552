//! Photos prepared for the photometric loss, and the CPU's kernels of it.

#[cfg(feature = "cube")]
use super::gpu::DevicePhoto;
use super::window::Band;
use crate::backend::Real;
#[cfg(feature = "cube")]
use crate::backend::gpu::Resident;
use crate::backend::simd::{multiply_add, wide_kernel};
use crate::data::mask::Mask;
use rayon::prelude::*;

/// Colour channels, interleaved.
pub(super) const CHANNELS: usize = 3;
/// Rows of a task.
const BAND: usize = 32;
pub(super) const C1: f64 = 0.01 * 0.01;
pub(super) const C2: f64 = 0.03 * 0.03;

/// A photo with its windowed moments: computed once, compared with many renders.
#[derive(Clone, Debug, PartialEq)]
pub struct Photo<E = f32> {
    height: usize,
    width: usize,
    /// `[H, W, 3]`.
    pub(super) rgb: Vec<E>,
    /// Windowed mean, `[H, W, 3]`.
    pub(super) mean: Vec<E>,
    /// Windowed variance, `[H, W, 3]`.
    pub(super) variance: Vec<E>,
    /// Pixels that are left out are black in all of these.
    pub(super) mask: Option<Mask>,
    #[cfg(feature = "cube")]
    pub(super) resident: Resident<DevicePhoto>,
}

impl<E: Real> Photo<E> {
    /// From `[H, W, 3]` values in 0..1, row-major.
    ///
    /// # Panics
    /// If `rgb` is not `height * width * 3` long.
    pub fn new(rgb: Vec<E>, height: usize, width: usize) -> Self {
        assert_eq!(
            rgb.len(),
            height * width * CHANNELS,
            "photo: values against {height} x {width} x {CHANNELS}"
        );
        let row = width * CHANNELS;
        let (mut mean, mut variance) = (vec![E::zero(); rgb.len()], vec![E::zero(); rgb.len()]);
        let band = (row * BAND).max(1);
        mean.par_chunks_mut(band)
            .zip(variance.par_chunks_mut(band))
            .enumerate()
            .for_each(|(b, (mean, variance))| {
                let rows = b * BAND..b * BAND + mean.len() / row;
                let source = |r: usize| &rgb[r * row..][..row];
                let sums = Band::new(&rows, height, row, CHANNELS, |r, out| {
                    out.copy_from_slice(source(r))
                });
                let squares = Band::new(&rows, height, row, CHANNELS, |r, out| {
                    multiply(source(r), source(r), out)
                });
                for (k, (mean, variance)) in mean
                    .chunks_exact_mut(row)
                    .zip(variance.chunks_exact_mut(row))
                    .enumerate()
                {
                    sums.convolved(k, mean);
                    squares.convolved(k, variance);
                    variance
                        .iter_mut()
                        .zip(&*mean)
                        .for_each(|(v, &m)| *v -= m * m);
                }
            });
        Self {
            height,
            width,
            rgb,
            mean,
            variance,
            mask: None,
            #[cfg(feature = "cube")]
            resident: Resident::default(),
        }
    }

    /// As [`Photo::new`], and what `mask` leaves out counts for nothing: it is black here and in each render that is compared,
    /// as if the image ended there, and the gradient is exactly zero.
    ///
    /// # Panics
    /// If `rgb` is not `height * width * 3` long, or the mask has another size.
    pub fn masked(mut rgb: Vec<E>, height: usize, width: usize, mask: Mask) -> Self {
        assert_eq!(
            (mask.height(), mask.width()),
            (height, width),
            "photo: mask against height and width"
        );
        mask.fill(&mut rgb, CHANNELS, E::zero());
        Self {
            mask: Some(mask),
            ..Self::new(rgb, height, width)
        }
    }

    /// The same photo in `f64`.
    pub(super) fn widened(&self) -> Photo<f64> {
        let rgb = self.rgb.iter().map(|v| v.wide()).collect();
        Photo {
            mask: self.mask.clone(),
            ..Photo::new(rgb, self.height, self.width)
        }
    }

    /// `[H, W, 3]` values; black where a mask leaves pixels out.
    pub fn rgb(&self) -> &[E] {
        &self.rgb
    }

    /// (height, width) in pixels.
    pub fn size(&self) -> (usize, usize) {
        (self.height, self.width)
    }

    /// Bytes held by a photo of this size in host memory; a GPU that it is compared on holds as many.
    pub fn bytes(height: usize, width: usize) -> usize {
        3 * height * width * CHANNELS * size_of::<E>()
    }

    /// Loss of `image` (`[H, W, 3]`) and its gradient to `image`.
    ///
    /// Bands of rows run in parallel; sums are taken in row order, so the bits do not depend on the threads.
    ///
    /// # Panics
    /// If `image` has another size.
    pub fn compare(&self, image: &[E], ssim_weight: f64) -> (f64, Vec<E>) {
        assert_eq!(
            image.len(),
            self.rgb.len(),
            "photometric loss: image against photo"
        );
        let Some(mask) = &self.mask else {
            return self.compare_all(image, ssim_weight);
        };
        let mut shown = image.to_vec();
        mask.fill(&mut shown, CHANNELS, E::zero());
        let (loss, mut gradient) = self.compare_all(&shown, ssim_weight);
        mask.fill(&mut gradient, CHANNELS, E::zero());
        (loss, gradient)
    }

    /// [`Photo::compare`] of all pixels.
    fn compare_all(&self, image: &[E], ssim_weight: f64) -> (f64, Vec<E>) {
        let (n, row) = (image.len(), self.width * CHANNELS);
        if n == 0 {
            return (0.0, Vec::new());
        }
        let (ssim, partials) = self.similarity(image, -ssim_weight / n as f64);
        let l1_scale = E::of((1.0 - ssim_weight) / n as f64);
        let mut gradient = vec![E::zero(); n];
        let l1: Vec<f64> = gradient
            .par_chunks_mut(row * BAND)
            .enumerate()
            .map(|(b, gradient)| {
                let rows = b * BAND..b * BAND + gradient.len() / row;
                let bands = partials.each_ref().map(|partial| {
                    Band::new(&rows, self.height, row, CHANNELS, |r, out| {
                        out.copy_from_slice(&partial[r * row..][..row])
                    })
                });
                let mut sums: [Vec<E>; 3] = std::array::from_fn(|_| vec![E::zero(); row]);
                let (mut distance, mut total) = (vec![E::zero(); row], 0.0);
                for (k, (r, out)) in rows.zip(gradient.chunks_exact_mut(row)).enumerate() {
                    bands
                        .iter()
                        .zip(&mut sums)
                        .for_each(|(band, sum)| band.convolved(k, sum));
                    let span = r * row..(r + 1) * row;
                    let pixels = [&image[span.clone()], &self.rgb[span]];
                    gradient_row(
                        pixels,
                        sums.each_ref().map(|s| &**s),
                        l1_scale,
                        out,
                        &mut distance,
                    );
                    total += sum_wide(&distance);
                }
                total
            })
            .collect();
        let (l1, ssim) = (l1.iter().sum::<f64>() / n as f64, ssim / n as f64);
        (
            (1.0 - ssim_weight) * l1 + ssim_weight * (1.0 - ssim),
            gradient,
        )
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
                let (x, y) = (
                    |r: usize| &image[r * row..][..row],
                    |r: usize| &self.rgb[r * row..][..row],
                );
                let bands = [
                    Band::new(&rows, self.height, row, CHANNELS, |r, out| {
                        out.copy_from_slice(x(r))
                    }),
                    Band::new(&rows, self.height, row, CHANNELS, |r, out| {
                        multiply(x(r), x(r), out)
                    }),
                    Band::new(&rows, self.height, row, CHANNELS, |r, out| {
                        multiply(x(r), y(r), out)
                    }),
                ];
                let mut sums: [Vec<E>; 3] = std::array::from_fn(|_| vec![E::zero(); row]);
                let (mut map, mut total) = (vec![E::zero(); row], 0.0);
                let rows = rows
                    .zip(p.chunks_exact_mut(row))
                    .zip(q.chunks_exact_mut(row))
                    .zip(s.chunks_exact_mut(row));
                for (k, (((r, p), q), s)) in rows.enumerate() {
                    bands
                        .iter()
                        .zip(&mut sums)
                        .for_each(|(band, sum)| band.convolved(k, sum));
                    let span = r * row..(r + 1) * row;
                    let photo = [&self.mean[span.clone()], &self.variance[span]];
                    ssim_row(
                        sums.each_ref().map(|s| &**s),
                        photo,
                        E::of(scale),
                        [p, q, s],
                        &mut map,
                    );
                    total += sum_wide(&map);
                }
                total
            })
            .collect();
        (sums.iter().sum(), partials)
    }
}

fn multiply<E: Real>(a: &[E], b: &[E], out: &mut [E]) {
    out.iter_mut()
        .zip(a.iter().zip(b))
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
    /// SSIM of a row and its scaled derivatives; `sums` are windowed x, x^2, x y, `photo` windowed mean and variance.
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
    let (c1, c2, two) = (E::of(C1), E::of(C2), E::of(2.0));
    for i in 0..n {
        let (mx, my) = (mean[i], photo_mean[i]);
        let (sxx, sxy) = (square[i] - mx * mx, product[i] - mx * my);
        let (a1, a2) = (two * mx * my + c1, two * sxy + c2);
        let (b1, b2) = (mx * mx + my * my + c1, sxx + photo_variance[i] + c2);
        let (r1, r2) = (E::one() / b1, E::one() / b2);
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
    let ([x, y], [p, q, s]) = (pixels.map(|v| &v[..n]), sums.map(|v| &v[..n]));
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

//! Gradients of the parameters from the sums over pixels of the backward pass.

use super::footprint::{Splat2, UNIT};
use super::geometry::{Moments, Splat3, project_backward};
use super::pixel_gradients::geometry_sums;
use super::projected::Projected;
use crate::backend::Real;
use crate::raster::settings::Splats;
use rayon::prelude::*;

/// Gaussians that one task handles.
const CHUNK: usize = 512;
/// Gaussians whose sums are read together.
const READ_TOGETHER: usize = 16;

/// Gradients of all that [`Projected::blend`] depends on; rows of culled Gaussians are zero.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SplatGradients<E> {
    /// `[N, 3]`.
    pub means: Vec<E>,
    /// `[N, 3]`.
    pub log_scales: Vec<E>,
    /// `[N, 4]`.
    pub rotations: Vec<E>,
    /// `[N]`.
    pub opacity_logits: Vec<E>,
    /// Gradients of the blended values, `[N, C]`.
    pub values: Vec<E>,
    /// Gradients of the projected centres in units of half the image: `(dL/du W/2, dL/dv H/2)`, `[N, 2]`.
    pub screen: Vec<E>,
    /// Each pixel's contribution to `screen` in absolute value, summed over the pixels, `[N, 2]`; empty unless requested.
    pub screen_absolute: Vec<E>,
}

/// The first six of a row of sums as [`Moments`]: the kernels' u and v are [`UNIT`] times those of [`Splat2`].
fn moments<E: Real>(m: &[E]) -> Moments {
    let first = UNIT.recip();
    let second = (UNIT * UNIT).recip();
    Moments {
        one: m[0].wide(),
        u: first * m[1].wide(),
        v: first * m[2].wide(),
        uu: second * m[3].wide(),
        uv: second * m[4].wide(),
        vv: second * m[5].wide(),
    }
}

impl<E: Real> SplatGradients<E> {
    fn zeros(n: usize, channels: usize) -> Self {
        let zeros = |width: usize| vec![E::zero(); n * width];
        Self {
            means: zeros(3),
            log_scales: zeros(3),
            rotations: zeros(4),
            opacity_logits: zeros(1),
            values: zeros(channels),
            screen: zeros(2),
            screen_absolute: Vec::new(),
        }
    }
}

/// Gradients of [`CHUNK`] Gaussians, rows as those of [`SplatGradients`].
struct Chunk<'a, E> {
    /// Index of the first.
    first: usize,
    means: &'a mut [E],
    log_scales: &'a mut [E],
    rotations: &'a mut [E],
    logits: &'a mut [E],
    screen: &'a mut [E],
    values: &'a mut [E],
}

impl<E: Real> Projected<E> {
    /// Gradients of the parameters from `sums`: rows of a visible Gaussian, moments, values, and sums of absolute values
    /// when `absolute`.
    pub(super) fn parameter_gradients(
        &self,
        splats: &Splats<'_, E>,
        sums: &[E],
        channels: usize,
        absolute: bool,
    ) -> SplatGradients<E> {
        let stride = geometry_sums(absolute) + channels;
        let ranks = self.ranks();
        let mut out = SplatGradients::zeros(self.len(), channels);
        (
            out.means.par_chunks_mut(3 * CHUNK),
            out.log_scales.par_chunks_mut(3 * CHUNK),
            out.rotations.par_chunks_mut(4 * CHUNK),
            out.opacity_logits.par_chunks_mut(CHUNK),
            out.screen.par_chunks_mut(2 * CHUNK),
            out.values.par_chunks_mut(channels * CHUNK),
            ranks.par_chunks(CHUNK),
        )
            .into_par_iter()
            .enumerate()
            .for_each(
                |(i, (means, log_scales, rotations, logits, screen, values, ranks))| {
                    let chunk = Chunk {
                        first: i * CHUNK,
                        means,
                        log_scales,
                        rotations,
                        logits,
                        screen,
                        values,
                    };
                    self.chunk_gradients(splats, sums, stride, ranks, chunk);
                },
            );
        if absolute {
            out.screen_absolute = self.screen_absolute(sums, stride);
        }
        out
    }

    /// Fills `chunk`, whose Gaussians have `ranks`.
    fn chunk_gradients(
        &self,
        splats: &Splats<'_, E>,
        sums: &[E],
        stride: usize,
        ranks: &[u32],
        chunk: Chunk<'_, E>,
    ) {
        let half = self.size().map(|s| s as f64 / 2.0);
        let channels = chunk.values.len() / ranks.len();
        let visible: Vec<(usize, usize)> = (ranks.iter().enumerate())
            .filter(|(_, rank)| **rank != u32::MAX)
            .map(|(row, &rank)| (row, rank as usize))
            .collect();
        for visible in visible.chunks(READ_TOGETHER) {
            // All reads of far memory come first, so that they wait for each other as little as possible.
            let mut near = [(Splat2::default(), Moments::default()); READ_TOGETHER];
            for (near, &(row, rank)) in near.iter_mut().zip(visible) {
                let sums = &sums[rank * stride..][..stride];
                *near = (self.splats[rank], moments(sums));
                chunk.values[channels * row..][..channels].copy_from_slice(&sums[6..6 + channels]);
            }
            for ((projected, moments), &(row, _)) in near.iter().zip(visible) {
                let g = project_backward(
                    &Splat3::read(splats, chunk.first + row),
                    &self.viewpoint,
                    projected,
                    moments,
                    self.settings.low_pass,
                );
                write(&mut chunk.means[3 * row..], g.mean);
                write(&mut chunk.log_scales[3 * row..], g.log_scale);
                write(&mut chunk.rotations[4 * row..], g.rotation);
                write(&mut chunk.logits[row..], [g.logit]);
                let screen = [g.center[0] * half[0], g.center[1] * half[1]];
                write(&mut chunk.screen[2 * row..], screen);
            }
        }
    }

    /// [`SplatGradients::screen_absolute`] from the last two of each row of `stride` sums.
    fn screen_absolute(&self, sums: &[E], stride: usize) -> Vec<E> {
        // The derivative of u^2 is 2 u, and the kernels' u and v are both longer by the unit than those of alpha'.
        let scale = self.size().map(|s| E::of(s as f64 / (UNIT * UNIT)));
        let rows = sums.chunks_exact(stride).flat_map(|row| {
            let [x, y] = [row[stride - 2], row[stride - 1]];
            [x * scale[0], y * scale[1]]
        });
        self.in_scene_order(&rows.collect::<Vec<E>>(), 2)
    }
}

/// `values` at the start of `to`.
#[inline(always)]
fn write<E: Real, const K: usize>(to: &mut [E], values: [f64; K]) {
    to[..K].copy_from_slice(&values.map(E::of));
}

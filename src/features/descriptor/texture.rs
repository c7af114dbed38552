//! Texture responses on a pyramid of octaves: gradient orientations, blobs, local binary patterns.

use super::FeatureMap;
use rayon::prelude::*;

/// Octaves of the pyramid: the image at 1, 1/2, 1/4 and 1/8 of its size.
const OCTAVES: usize = 4;
/// Bins of the unsigned gradient orientation over 180 degrees, weighted by magnitude.
const ORIENTATIONS: usize = 8;
/// Bright and dark blobs: the two signs of the Laplacian.
const BLOBS: usize = 2;
/// Rotation-invariant uniform patterns of 8 neighbours: 0..8 brighter ones in one run, or more than one run.
const PATTERNS: usize = 10;
/// Channels of an octave.
const OCTAVE: usize = ORIENTATIONS + BLOBS + PATTERNS;
/// All texture channels.
pub const TEXTURE: usize = OCTAVES * OCTAVE;

/// A neighbour counts as brighter when it is so by more than this (luma 0..1): flat noisy areas form a pattern of their own.
const BRIGHTER: f32 = 0.012;

/// Responses averaged onto an `h` x `w` grid, `[h, w, TEXTURE]`.
pub fn responses(luma: &FeatureMap, h: usize, w: usize) -> FeatureMap {
    let mut out = FeatureMap::zeros(h, w, TEXTURE);
    let mut level = luma.clone();
    for octave in 0..OCTAVES {
        if octave > 0 {
            level = level.resized(level.height.div_ceil(2), level.width.div_ceil(2));
        }
        let cells = of_level(&level).resized(h, w);
        for (out, cell) in out
            .data
            .chunks_exact_mut(TEXTURE)
            .zip(cells.data.chunks_exact(OCTAVE))
        {
            out[octave * OCTAVE..][..OCTAVE].copy_from_slice(cell);
        }
    }
    out
}

/// Responses of every pixel of one octave.
fn of_level(luma: &FeatureMap) -> FeatureMap {
    let (h, w) = (luma.height, luma.width);
    let mut out = FeatureMap::zeros(h, w, OCTAVE);
    out.data
        .par_chunks_exact_mut(w * OCTAVE)
        .enumerate()
        .for_each(|(y, out)| {
            let row = |y: usize| &luma.data[y * w..][..w];
            let (above, here, below) = (row(y.saturating_sub(1)), row(y), row((y + 1).min(h - 1)));
            for (x, out) in out.chunks_exact_mut(OCTAVE).enumerate() {
                let (l, r) = (x.saturating_sub(1), (x + 1).min(w - 1));
                let centre = here[x];
                // Clockwise from the left upper corner.
                let ring = [
                    above[l], above[x], above[r], here[r], below[r], below[x], below[l], here[l],
                ];
                let gx =
                    (ring[2] + 2.0 * ring[3] + ring[4] - ring[0] - 2.0 * ring[7] - ring[6]) / 4.0;
                let gy =
                    (ring[6] + 2.0 * ring[5] + ring[4] - ring[0] - 2.0 * ring[1] - ring[2]) / 4.0;
                let magnitude = (gx * gx + gy * gy).sqrt();
                if magnitude > 0.0 {
                    let turn = gy.atan2(gx) / std::f32::consts::PI; // -1..1; unsigned: period 1
                    let at = turn.rem_euclid(1.0) * ORIENTATIONS as f32;
                    let bin = at as usize % ORIENTATIONS;
                    let share = at.fract();
                    out[bin] += magnitude * (1.0 - share);
                    out[(bin + 1) % ORIENTATIONS] += magnitude * share;
                }
                let blob = centre - ring.iter().sum::<f32>() / 8.0;
                out[ORIENTATIONS] = blob.max(0.0);
                out[ORIENTATIONS + 1] = (-blob).max(0.0);
                out[ORIENTATIONS + BLOBS + pattern(&ring, centre)] = 1.0;
            }
        });
    out
}

/// Index of the rotation-invariant uniform local binary pattern (Ojala et al. 2002).
fn pattern(ring: &[f32; 8], centre: f32) -> usize {
    let bits = ring.iter().enumerate().fold(0_u8, |bits, (k, &x)| {
        bits | (u8::from(x > centre + BRIGHTER) << k)
    });
    let changes = (bits ^ bits.rotate_left(1)).count_ones();
    if changes <= 2 {
        bits.count_ones() as usize
    } else {
        PATTERNS - 1
    }
}

/// Pooled responses to descriptor values: logarithms of energies, square roots of frequencies.
pub fn finish(pooled: &[f32], out: &mut [f32]) {
    for (out, pooled) in out
        .chunks_exact_mut(OCTAVE)
        .zip(pooled.chunks_exact(OCTAVE))
    {
        let (energies, patterns) = pooled.split_at(ORIENTATIONS + BLOBS);
        for (o, &x) in out.iter_mut().zip(energies) {
            *o = 0.3 * (1.0 + 300.0 * x.max(0.0)).ln();
        }
        for (o, &x) in out[ORIENTATIONS + BLOBS..].iter_mut().zip(patterns) {
            *o = (x.max(0.0) + 1e-4).sqrt();
        }
    }
}

//! Label maps of scenes with one label for each Gaussian: each pixel sums the weights of every label that it sees. The number of
//! labels in the scene does not matter.

use super::blend::{Beside, blend_beside};
use super::footprint::{Buffer, PIXELS};
use super::projected::{Blended, Projected};
use super::tile_loop::LOOK;
use crate::backend::Real;
use crate::backend::simd::Lanes;

/// Sums of the weights of each label of a tile.
struct LabelSums<'a, E> {
    /// `[visible]`.
    labels: &'a [u16],
    /// Labels of the tile in the order in which they appear, and the sums of their weights.
    seen: Vec<u16>,
    weights: Vec<Buffer<E>>,
    /// Labels of the next Gaussians, and the place in `seen` of the current one's.
    near: [u16; LOOK],
    slot: usize,
}

impl<E: Real> Beside<E> for LabelSums<'_, E> {
    const CHANNELS: usize = 1;

    #[inline(always)]
    fn gather(&mut self, ranks: &[u32]) {
        for (label, &rank) in self.near.iter_mut().zip(ranks) {
            *label = self.labels[rank as usize];
        }
    }

    #[inline(always)]
    fn begin(&mut self, next: usize) {
        let label = self.near[next];
        if self.seen.get(self.slot) != Some(&label) {
            self.slot = self
                .seen
                .iter()
                .position(|&other| other == label)
                .unwrap_or_else(|| {
                    self.seen.push(label);
                    self.weights.push(Buffer::zeros());
                    self.seen.len() - 1
                });
        }
    }

    #[inline(always)]
    fn add<S: Lanes<E>>(&mut self, s: S, strip: usize, weight: S::V) {
        let own = &mut self.weights[self.slot];
        own.set::<S>(strip, s.add(weight, own.get::<S>(strip)));
    }

    /// The label with the largest sum, ties to the lower one, and 0 where nothing was taken.
    fn channel(&self) -> [E; PIXELS] {
        let mut ascending: Vec<(u16, &Buffer<E>)> =
            self.seen.iter().copied().zip(&self.weights).collect();
        ascending.sort_unstable_by_key(|&(label, _)| label);
        let (mut weights, mut labels) = ([E::zero(); PIXELS], [E::zero(); PIXELS]);
        for (label, own) in ascending {
            let label = E::of(f64::from(label));
            for ((weight, best), &own) in weights.iter_mut().zip(&mut labels).zip(&own.0) {
                *best = if own > *weight { label } else { *best };
                *weight = if own > *weight { own } else { *weight };
            }
        }
        labels
    }
}

/// Blends `values`, `[visible, C]` front to back, and `labels`, `[visible]`; the label with the largest weight at each pixel.
pub(super) fn blend<E: Real, const C: usize>(
    p: &Projected<E>,
    values: &[E],
    labels: &[u16],
) -> (Blended<E>, Vec<u16>) {
    let sums = || LabelSums {
        labels,
        seen: Vec::new(),
        weights: Vec::new(),
        near: [0; LOOK],
        slot: 0,
    };
    let mut blended = blend_beside::<E, _, C>(p, values, C, sums);
    // Whole numbers below 2^16.
    let ids = blended
        .image
        .iter()
        .skip(C)
        .step_by(C + 1)
        .map(|id| id.wide() as u16)
        .collect();
    let pixels = blended.image.len() / (C + 1);
    for i in 0..pixels {
        blended
            .image
            .copy_within(i * (C + 1)..i * (C + 1) + C, i * C);
    }
    blended.image.truncate(pixels * C);
    (blended, ids)
}

//! Blending of a few channels and of one label a Gaussian: each pixel sums the weights of every label that it sees, of however
//! many the scene has.

use super::footprint::{Buffer, Footprint, PIXELS, Rule, STRIPS, fresh_transmittance};
use super::projected::{Blended, Projected};
use super::tile_loop::{LOOK, Pass, Tile, for_each_tile_row, gather_rows, walk};
use crate::ops::Real;
use crate::ops::simd::{Kernel, dispatch};
use crate::ops::vector::{LANES, Vector};

struct LabelTile<'a, E, const C: usize> {
    p: &'a Projected<E>,
    tile: Tile<'a>,
    /// `[visible, C]`.
    values: &'a [E],
    /// `[visible]`.
    labels: &'a [u16],
    /// `[rows of the tile, W, C + 1]`: channels, and the label.
    image: &'a mut [E],
    transmittance: &'a mut [E],
}

struct LabelPass<'a, E, V, const C: usize> {
    rule: Rule<V>,
    values: &'a [E],
    labels: &'a [u16],
    t: Buffer<E>,
    sums: [Buffer<E>; C],
    /// Labels of the tile in the order in which they appear, and the sums of their weights.
    seen: Vec<u16>,
    weights: Vec<Buffer<E>>,
    /// Values and labels of the next Gaussians.
    near: [[E; C]; LOOK],
    near_labels: [u16; LOOK],
}

impl<E: Real, V: Vector<E>, const C: usize> Pass<E, V> for LabelPass<'_, E, V, C> {
    #[inline(always)]
    fn transmittance(&self) -> &Buffer<E> {
        &self.t
    }

    #[inline(always)]
    fn gather(&mut self, ranks: &[u32]) {
        gather_rows(self.values, ranks, &mut self.near);
        for (label, &rank) in self.near_labels.iter_mut().zip(ranks) {
            *label = self.labels[rank as usize];
        }
    }

    #[inline(always)]
    fn take(&mut self, next: usize, _entry: usize, footprint: &Footprint<E>) {
        if footprint.strips == 0 {
            return;
        }
        let value = self.near[next].map(V::splat);
        let slot = slot_of(self.near_labels[next], &mut self.seen, &mut self.weights);
        let own = &mut self.weights[slot];
        footprint.for_each(|strip| {
            let (mut alpha, mut t) = (footprint.alpha(strip, &self.rule), V::load(&self.t[strip]));
            let weight = self.rule.absorb(&mut alpha, &mut t);
            t.store(&mut self.t[strip]);
            weight.add(V::load(&own[strip])).store(&mut own[strip]);
            for (sums, &value) in self.sums.iter_mut().zip(&value) {
                weight.fma(value, V::load(&sums[strip])).store(&mut sums[strip]);
            }
        });
    }
}

/// Where `label` is in `seen`, of whose labels `weights` has the sums; added where it is new.
fn slot_of<E: Real>(label: u16, seen: &mut Vec<u16>, weights: &mut Vec<Buffer<E>>) -> usize {
    if let Some(last) = seen.len().checked_sub(1).filter(|&last| seen[last] == label) {
        return last;
    }
    seen.iter().position(|&other| other == label).unwrap_or_else(|| {
        seen.push(label);
        weights.push([[E::zero(); LANES]; STRIPS]);
        seen.len() - 1
    })
}

impl<E: Real, const C: usize> Kernel<E> for LabelTile<'_, E, C> {
    type Output = ();
    #[inline(always)]
    fn run<V: Vector<E>>(self) {
        let Self { p, tile, values, labels, image, transmittance } = self;
        let mut pass = LabelPass::<E, V, C> {
            rule: Rule::new::<E>(&p.settings),
            values,
            labels,
            t: fresh_transmittance(tile, p.size()),
            sums: [[[E::zero(); LANES]; STRIPS]; C],
            seen: Vec::new(),
            weights: Vec::new(),
            near: [[E::zero(); C]; LOOK],
            near_labels: [0; LOOK],
        };
        walk(p, tile, &mut pass);
        let largest = pass.largest();
        let first = tile.origin[1] * p.size()[0];
        for (from, to, len) in tile.rows(p.size()) {
            let to = to - first;
            for x in 0..len {
                transmittance[to + x] = pass.t.as_flattened()[from + x].abs();
                for c in 0..C {
                    image[(to + x) * (C + 1) + c] = pass.sums[c].as_flattened()[from + x];
                }
                image[(to + x) * (C + 1) + C] = largest[from + x];
            }
        }
    }
}

impl<E: Real, V, const C: usize> LabelPass<'_, E, V, C> {
    /// The label with the largest sum at each pixel, ties to the lower one, and 0 where nothing was taken.
    fn largest(&self) -> [E; PIXELS] {
        let mut ascending: Vec<(u16, &Buffer<E>)> = self.seen.iter().copied().zip(&self.weights).collect();
        ascending.sort_unstable_by_key(|&(label, _)| label);
        let (mut weights, mut labels) = ([E::zero(); PIXELS], [E::zero(); PIXELS]);
        for (label, own) in ascending {
            let label = E::of(f64::from(label));
            for ((weight, best), &own) in weights.iter_mut().zip(&mut labels).zip(own.as_flattened()) {
                *best = if own > *weight { label } else { *best };
                *weight = if own > *weight { own } else { *weight };
            }
        }
        labels
    }
}

/// Blends `values`, `[visible, C]` front to back, and `labels`, `[visible]`; the label with the largest weight at each pixel.
pub(super) fn blend<E: Real, const C: usize>(p: &Projected<E>, values: &[E], labels: &[u16]) -> (Blended<E>, Vec<u16>) {
    let mut blended = for_each_tile_row(p, C + 1, |tile, image, transmittance| {
        dispatch(LabelTile::<E, C> { p, tile, values, labels, image, transmittance });
    });
    // Whole numbers below 2^16.
    let ids = blended.image.iter().skip(C).step_by(C + 1).map(|id| id.wide() as u16).collect();
    let pixels = blended.image.len() / (C + 1);
    for i in 0..pixels {
        blended.image.copy_within(i * (C + 1)..i * (C + 1) + C, i * C);
    }
    blended.image.truncate(pixels * C);
    (blended, ids)
}

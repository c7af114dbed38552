//! Colours and label maps of scenes with one label for each Gaussian: each pixel sums the weights of every label that it sees. The
//! number of labels in the scene does not matter.

use super::blend::write_tile;
use super::footprint::{Buffer, Footprint, PIXELS, Rule, Tile, fresh_transmittance};
use super::projected::{Blended, Projected};
use super::tile_loop::{LIVE_CHECK_INTERVAL, Pass, for_each_tile_row, gather_rows, walk};
use crate::backend::Real;
use crate::backend::simd::{Kernel, Lanes};
use std::collections::BTreeMap;

impl<E: Real> Projected<E> {
    /// [`Projected::blend`] of `colours`, `[N, K - 1]`, and in the same pass the label of each pixel, `[H, W]`: its Gaussians have
    /// the largest summed alpha' T. Ties go to the lower label; pixels without Gaussians are 0. `labels` has one for each Gaussian.
    ///
    /// # Panics
    /// If `labels` does not have N entries, or `colours` not K - 1 for each.
    pub fn blend_labels<const K: usize>(
        &self,
        colours: &[E],
        labels: &[u16],
    ) -> (Blended<E>, Vec<u16>) {
        let n = self.len();
        assert_eq!(labels.len(), n, "one label for each Gaussian");
        assert_eq!(colours.len(), n * (K - 1), "colours of each Gaussian");
        let labels_in_depth_order: Vec<u16> =
            self.ids.iter().map(|&id| labels[id as usize]).collect();
        let colours = self.in_depth_order(colours, K - 1, K);
        // The label of a pixel is its last channel until both are parted.
        let Blended {
            image,
            transmittance,
        } = for_each_tile_row(self, K, |tile, image, transmittance| {
            E::dispatch(LabelTile::<E, K> {
                p: self,
                tile,
                colours: &colours,
                labels: &labels_in_depth_order,
                image,
                transmittance,
            });
        });
        let mut colours = Vec::with_capacity(transmittance.len() * (K - 1));
        let mut found = Vec::with_capacity(transmittance.len());
        for pixel in image.as_chunks::<K>().0 {
            colours.extend_from_slice(&pixel[..K - 1]);
            found.push(pixel[K - 1].wide() as u16);
        }
        let blended = Blended {
            image: colours,
            transmittance,
        };
        (blended, found)
    }
}

struct LabelTile<'a, E, const K: usize> {
    p: &'a Projected<E>,
    tile: Tile<'a>,
    /// `[visible, K]`, the last column unused.
    colours: &'a [E],
    /// `[visible]`.
    labels: &'a [u16],
    /// `[rows of the tile, W, K]`: colours, and the label.
    image: &'a mut [E],
    transmittance: &'a mut [E],
}

impl<E: Real, const K: usize> Kernel<E> for LabelTile<'_, E, K> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes<E>>(self, s: S) {
        let size = self.p.size();
        let mut pass = LabelPass::<E, S, K> {
            rule: Rule::new(s, &self.p.settings),
            colours: self.colours,
            labels: self.labels,
            t: fresh_transmittance(self.tile, size),
            sums: [Buffer::zeros(); K],
            weights: BTreeMap::new(),
            near: [[E::zero(); K]; LIVE_CHECK_INTERVAL],
            near_labels: [0; LIVE_CHECK_INTERVAL],
        };
        walk(s, self.p, self.tile, &mut pass);
        pass.sums[K - 1] = heaviest(&pass.weights);
        let LabelPass { t, sums, .. } = &pass;
        write_tile(self.tile, size, t, sums, self.image, self.transmittance);
    }
}

/// The label of the largest of the summed `weights` at each pixel.
fn heaviest<E: Real>(weights: &BTreeMap<u16, Buffer<E>>) -> Buffer<E> {
    let mut largest = [E::zero(); PIXELS];
    let mut found = Buffer::zeros();
    for (&label, weights) in weights {
        let label = E::of(label.into());
        for ((largest, found), &weight) in largest.iter_mut().zip(&mut found.0).zip(&weights.0) {
            if weight > *largest {
                *largest = weight;
                *found = label;
            }
        }
    }
    found
}

struct LabelPass<'a, E, S: Lanes<E>, const K: usize> {
    rule: Rule<E, S>,
    colours: &'a [E],
    labels: &'a [u16],
    t: Buffer<E>,
    /// Of colours; the last is unused.
    sums: [Buffer<E>; K],
    /// Summed alpha' T of each label in the tile.
    weights: BTreeMap<u16, Buffer<E>>,
    /// Colours and labels of the next Gaussians.
    near: [[E; K]; LIVE_CHECK_INTERVAL],
    near_labels: [u16; LIVE_CHECK_INTERVAL],
}

impl<E: Real, S: Lanes<E>, const K: usize> Pass<E> for LabelPass<'_, E, S, K> {
    #[inline(always)]
    fn transmittance(&self) -> &Buffer<E> {
        &self.t
    }

    #[inline(always)]
    fn gather(&mut self, ranks: &[u32]) {
        gather_rows(self.colours, ranks, &mut self.near);
        for (label, &rank) in self.near_labels.iter_mut().zip(ranks) {
            *label = self.labels[rank as usize];
        }
    }

    #[inline(always)]
    fn take(&mut self, next: usize, _entry: usize, footprint: &Footprint<E>) {
        if footprint.strips == 0 {
            return;
        }
        let s = self.rule.s;
        let colour = self.near[next].map(|value| s.splat(value));
        let label = self.near_labels[next];
        let weights = self.weights.entry(label).or_insert_with(Buffer::zeros);
        footprint.for_each(|strip| {
            let (_, weight) = self.rule.absorb(footprint, &mut self.t, strip);
            weights.set::<S>(strip, s.add(weights.get::<S>(strip), weight));
            for (sums, &colour) in self.sums[..K - 1].iter_mut().zip(&colour) {
                let sum = s.mul_add(weight, colour, sums.get::<S>(strip));
                sums.set::<S>(strip, sum);
            }
        });
    }
}

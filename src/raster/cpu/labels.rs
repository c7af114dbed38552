//! Label maps of scenes with one label for each Gaussian: each pixel sums the weights of every label that it sees. The number of
//! labels in the scene does not matter.

use super::footprint::{PIXELS, Tile, fresh_transmittance};
use super::pairs::Pairs;
use super::projected::Projected;
use crate::backend::Real;
use rayon::prelude::*;
use std::collections::BTreeMap;

impl<E: Real> Projected<E> {
    /// The label of each pixel, `[H, W]`: its Gaussians have the largest summed alpha' T. Ties go to the lower label; pixels
    /// without Gaussians are 0. `labels` has one for each Gaussian.
    ///
    /// # Panics
    /// If `labels` does not have N entries.
    pub fn label_map(&self, labels: &[u16]) -> Vec<u16> {
        let n = self.len();
        assert_eq!(labels.len(), n, "label_map: one label for each Gaussian");
        let [width, height] = self.size();
        let tiles: Vec<Tile<'_>> = self.all_tiles().collect();
        let found: Vec<[u16; PIXELS]> = tiles
            .par_iter()
            .map(|tile| label_tile(self, *tile, labels))
            .collect();
        let mut map = vec![0; width * height];
        for (tile, found) in tiles.iter().zip(&found) {
            for (from, to, len) in tile.rows(self.size()) {
                map[to..to + len].copy_from_slice(&found[from..from + len]);
            }
        }
        map
    }
}

fn label_tile<E: Real>(p: &Projected<E>, tile: Tile<'_>, labels: &[u16]) -> [u16; PIXELS] {
    let pairs = Pairs::<E, false>::gather(p, tile, fresh_transmittance(tile, p.size()));
    let mut sums: BTreeMap<u16, [E; PIXELS]> = BTreeMap::new();
    for (i, &rank) in tile.ranks.iter().enumerate().take(pairs.ends.len()) {
        let label = labels[p.ids[rank as usize] as usize];
        let sums = sums.entry(label).or_insert([E::zero(); PIXELS]);
        let range = pairs.range(i);
        for (&pixel, &weight) in pairs.pixels[range.clone()]
            .iter()
            .zip(&pairs.weights[range])
        {
            sums[pixel as usize] += weight;
        }
    }
    let mut largest = [E::zero(); PIXELS];
    let mut found = [0; PIXELS];
    for (label, sums) in sums {
        for ((largest, found), sum) in largest.iter_mut().zip(&mut found).zip(sums) {
            if sum > *largest {
                (*largest, *found) = (sum, label);
            }
        }
    }
    found
}

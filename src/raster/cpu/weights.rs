//! The matrix `W` of a view.

use super::footprint::{TILE, Tile};
use super::pairs::Pairs;
use super::projected::Projected;
use crate::backend::Real;
use crate::ops::SparseMatrix;
use rayon::prelude::*;

impl<E: Real> Projected<E> {
    /// `W` itself: rows are `pixels` (row-major indices), columns the N Gaussians, entries front to back.
    ///
    /// Values are exactly the weights that [`Projected::blend`] applies, rounded to `f32`.
    ///
    /// # Panics
    /// If a pixel index is outside the image.
    pub fn weights(&self, pixels: &[u32]) -> SparseMatrix {
        let [w, h] = self.size();
        let mut wanted = vec![false; w * h];
        for &pixel in pixels {
            wanted[pixel as usize] = true;
        }
        let tiles: Vec<Tile<'_>> = self.tiles_of_rows(0..self.tiles.rows).collect();
        let tiles: Vec<(Tile<'_>, Pairs<E, false>)> = tiles
            .into_par_iter()
            .map(|tile| (tile, Pairs::gather(self, tile, |pixel| wanted[pixel])))
            .collect();
        let in_image = |tile: &Tile<'_>, pixel: u16| {
            let pixel = pixel as usize;
            (tile.origin[1] + pixel / TILE) * w + tile.origin[0] + pixel % TILE
        };
        // A row for every pixel; those of pixels that are not wanted are empty.
        let mut offsets = vec![0_u32; w * h + 1];
        let total: usize = tiles.iter().map(|(_, pairs)| pairs.pixels.len()).sum();
        assert!(
            u32::try_from(total).is_ok(),
            "weights: {total} entries exceed 2^32 - 1; ask for fewer pixels"
        );
        for (tile, pairs) in &tiles {
            for &pixel in &pairs.pixels {
                offsets[in_image(tile, pixel) + 1] += 1;
            }
        }
        for pixel in 0..w * h {
            offsets[pixel + 1] += offsets[pixel];
        }
        let mut next = offsets.clone();
        let mut indices = vec![0; total];
        let mut values = vec![0.0; total];
        for (tile, pairs) in &tiles {
            for (i, &rank) in tile.ranks.iter().enumerate().take(pairs.ends.len()) {
                for pair in pairs.range(i) {
                    let at = &mut next[in_image(tile, pairs.pixels[pair])];
                    indices[*at as usize] = self.ids[rank as usize];
                    values[*at as usize] = pairs.weights[pair].wide() as f32;
                    *at += 1;
                }
            }
        }
        SparseMatrix::unchecked(self.len(), offsets, indices, values).select_rows(pixels)
    }
}

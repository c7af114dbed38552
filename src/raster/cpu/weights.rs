//! The matrix `W` of a view.

use super::footprint::{TILE, fresh_transmittance};
use super::pairs::Pairs;
use super::projected::Projected;
use super::tile_loop::Tile;
use crate::backend::Real;
use crate::ops::SparseMatrix;
use rayon::prelude::*;

/// `W` with rows `pixels`; see [`Projected::weights`].
pub(super) fn weights<E: Real>(p: &Projected<E>, pixels: Option<&[u32]>) -> SparseMatrix {
    let [w, h] = p.size();
    let wanted = pixels.map(|pixels| {
        let mut wanted = vec![false; w * h];
        for &pixel in pixels {
            wanted[pixel as usize] = true;
        }
        wanted
    });
    let all = every_row(p, wanted.as_deref());
    let Some(pixels) = pixels else { return all };
    let ascending = pixels.windows(2).all(|w| w[0] < w[1]);
    let mut offsets = Vec::with_capacity(pixels.len() + 1);
    offsets.push(0);
    let mut sum = 0;
    for &pixel in pixels {
        sum += all.row(pixel as usize).0.len();
        offsets.push(offset(sum));
    }
    if ascending {
        return SparseMatrix::unchecked(all.columns, offsets, all.indices, all.values);
    }
    let mut indices = Vec::with_capacity(sum);
    let mut values = Vec::with_capacity(sum);
    for &pixel in pixels {
        let (columns, weights) = all.row(pixel as usize);
        indices.extend_from_slice(columns);
        values.extend_from_slice(weights);
    }
    SparseMatrix::unchecked(all.columns, offsets, indices, values)
}

/// An entry count as the matrix stores it.
fn offset(count: usize) -> u32 {
    assert!(
        count <= u32::MAX as usize,
        "weights: {count} entries exceed 2^32 - 1; ask for fewer pixels"
    );
    count as u32
}

/// `W` with a row for every pixel; rows of pixels not in `wanted` are empty.
fn every_row<E: Real>(p: &Projected<E>, wanted: Option<&[bool]>) -> SparseMatrix {
    let [w, h] = p.size();
    struct Strip {
        /// Entries per pixel.
        counts: Vec<u32>,
        indices: Vec<u32>,
        values: Vec<f32>,
    }
    let strips: Vec<Strip> = (0..p.tiles.rows)
        .into_par_iter()
        .with_max_len(1)
        .map(|row| {
            let height = (h - row * TILE).min(TILE);
            let tiles: Vec<(Tile<'_>, Pairs<E, false>)> = (0..p.tiles.columns)
                .map(|column| {
                    let ranks = &p.tiles.ranks[p.tiles.tile(column, row)];
                    let tile = Tile {
                        origin: [column * TILE, row * TILE],
                        ranks,
                    };
                    let mut t = fresh_transmittance(tile, p.size());
                    if let Some(wanted) = wanted {
                        for (to, from, len) in tile.rows(p.size()) {
                            for x in 0..len {
                                if !wanted[from + x] {
                                    t.as_flattened_mut()[to + x] = -E::one();
                                }
                            }
                        }
                    }
                    (tile, Pairs::gather(p, tile, t))
                })
                .collect();
            let mut counts = vec![0; w * height];
            for (tile, pairs) in &tiles {
                for &pixel in &pairs.pixels {
                    counts[pixel as usize / TILE * w + tile.origin[0] + pixel as usize % TILE] += 1;
                }
            }
            let mut next = Vec::with_capacity(counts.len());
            let mut sum = 0_u32;
            for count in &counts {
                next.push(sum);
                sum += count;
            }
            let (mut indices, mut values) = (vec![0; sum as usize], vec![0.0; sum as usize]);
            for (tile, pairs) in &tiles {
                for (i, &rank) in tile.ranks.iter().enumerate().take(pairs.ends.len()) {
                    let id = p.ids[rank as usize];
                    let range = pairs.range(i);
                    for (&pixel, weight) in pairs.pixels[range.clone()]
                        .iter()
                        .zip(&pairs.weights[range])
                    {
                        let next = &mut next
                            [pixel as usize / TILE * w + tile.origin[0] + pixel as usize % TILE];
                        indices[*next as usize] = id;
                        values[*next as usize] = weight.wide() as f32;
                        *next += 1;
                    }
                }
            }
            Strip {
                counts,
                indices,
                values,
            }
        })
        .collect();
    let total: usize = strips.iter().map(|s| s.indices.len()).sum();
    let mut offsets = Vec::with_capacity(w * h + 1);
    offsets.push(0);
    let (mut indices, mut values) = (Vec::with_capacity(total), Vec::with_capacity(total));
    let mut sum = 0;
    for strip in strips {
        for count in strip.counts {
            sum += count as usize;
            offsets.push(offset(sum));
        }
        indices.extend_from_slice(&strip.indices);
        values.extend_from_slice(&strip.values);
    }
    SparseMatrix::unchecked(p.len(), offsets, indices, values)
}

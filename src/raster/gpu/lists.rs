//! Tile lists. The kernels count the tiles that each Gaussian reaches, write one entry for each in depth order, and sort the
//! entries by tile.

use super::outline::{outline, pixel_rows, tile_columns, tile_rows};
use super::project::ProjectedScene;
use super::radix_sort::sort_positions;
use super::scan::exclusive_sums;
use crate::backend::gpu::{Gpu, launch};
use crate::raster::cpu::footprint::TILE;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

/// Tiles of every Gaussian in depth order; a 0 follows the last, so that the exclusive sums end with the total.
#[cube(launch)]
fn count_tiles(
    splats: &[f32],
    radii: &[u32],
    ids: &[u32],
    counts: &mut [u32],
    gaussians: u32,
    width: u32,
    height: u32,
) {
    let rank = ABSOLUTE_POS;
    if rank > gaussians as usize {
        terminate!();
    }
    let mut sum = 0u32;
    if rank < gaussians as usize {
        let id = ids[rank] as usize;
        if radii[id] > 0u32 {
            let o = outline(splats, id);
            let pixels = pixel_rows(&o, height);
            let rows = tile_rows(&pixels);
            for row in rows.first..rows.end {
                let columns = tile_columns(&o, &pixels, row, width);
                sum += columns.end - columns.first;
            }
        }
    }
    counts[rank] = sum;
}

/// Reports the total number of entries to the host.
#[cube(launch)]
fn report_total(offsets: &[u32], report: &[Atomic<u32>], gaussians: u32) {
    if ABSOLUTE_POS == 0 {
        report[1].store(offsets[gaussians as usize]);
    }
}

/// Tile and Gaussian of every entry, and where the entries of each rank end.
#[cube(launch)]
fn emit_entries(
    splats: &[f32],
    ids: &[u32],
    offsets: &[u32],
    tiles: &mut [u32],
    gaussian_of: &mut [u32],
    ends: &mut [u32],
    gaussians: u32,
    width: u32,
    height: u32,
) {
    let rank = ABSOLUTE_POS;
    if rank >= gaussians as usize {
        terminate!();
    }
    let mut at = offsets[rank];
    let end = offsets[rank + 1];
    let tiles_across = (width + (TILE - 1) as u32) / TILE as u32;
    let tiles_down = (height + (TILE - 1) as u32) / TILE as u32;
    let id = ids[rank];
    if at < end {
        let o = outline(splats, id as usize);
        let pixels = pixel_rows(&o, height);
        let rows = tile_rows(&pixels);
        for row in rows.first..rows.end {
            let columns = tile_columns(&o, &pixels, row, width);
            for column in columns.first..columns.end {
                // Two kernels may round differently. Never write more entries than were counted,
                if at < end {
                    tiles[at as usize] = row * tiles_across + column;
                    gaussian_of[at as usize] = id;
                    at += 1u32;
                }
            }
        }
    }
    ends[rank] = at;
    // and give missing entries to a tile that does not exist.
    while at < end {
        tiles[at as usize] = tiles_across * tiles_down;
        gaussian_of[at as usize] = id;
        at += 1u32;
    }
}

/// Start and end of every tile's entries, and their Gaussians.
#[cube(launch)]
fn find_ranges(
    tiles: &[u32],
    entries: &[u32],
    gaussian_of: &[u32],
    ranges: &mut [u32],
    gaussians: &mut [u32],
    count: u32,
    tile_count: u32,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    gaussians[i] = gaussian_of[entries[i] as usize];
    let tile = tiles[i];
    if tile < tile_count {
        let mut before = tile_count;
        if i > 0 {
            before = tiles[i - 1];
        }
        if before != tile {
            ranges[2 * tile as usize] = i as u32;
        }
        let mut after = tile_count;
        if i + 1 < count as usize {
            after = tiles[i + 1];
        }
        if after != tile {
            ranges[2 * tile as usize + 1] = i as u32 + 1u32;
        }
    }
}

/// Gaussians in depth order.
pub(super) struct Order {
    /// Index in the scene of every rank; culled ones come last.
    pub ids: CubeTensor,
    /// First entry of every rank, and the end of the last.
    pub offsets: CubeTensor,
    pub len: usize,
}

/// Sorts by depth and counts tiles. Writes the number of entries, capped at [`super::scan::CEILING`], to `report[1]`.
pub(super) fn depth_order(
    gpu: &Gpu,
    scene: &ProjectedScene,
    len: usize,
    size: [usize; 2],
    report: &CubeTensor,
) -> Order {
    let (_, ids) = sort_positions(gpu, scene.depths.clone(), len, 32);
    let counts = gpu.words(len + 1);
    launch!(gpu, count_tiles, gpu.cubes_for(len + 1);
        &scene.splats, &scene.radii, &ids, &counts; len as u32, size[0] as u32, size[1] as u32);
    let offsets = exclusive_sums(gpu, &counts, len + 1);
    launch!(gpu, report_total, gpu.cubes_for(1);
        &offsets, report; len as u32);
    Order { ids, offsets, len }
}

/// Entries sorted by tile, front to back within each.
pub(super) struct TileEntries {
    /// Number of entries.
    pub len: usize,
    /// Start and end of each tile's list, row-major.
    pub ranges: CubeTensor,
    /// The Gaussian of each entry of the lists.
    pub gaussians: CubeTensor,
    /// Position of each entry of the lists among the entries in depth order, where the entries of a Gaussian are neighbours.
    pub entries: CubeTensor,
    /// Where the entries of each rank end: those that a tile has.
    pub ends: CubeTensor,
}

/// Tiles across and down.
pub(super) fn tile_counts(size: [usize; 2]) -> [usize; 2] {
    size.map(|s| s.div_ceil(TILE))
}

/// The `len` entries of `order`.
pub(super) fn tile_entries(
    gpu: &Gpu,
    scene: &ProjectedScene,
    order: &Order,
    len: usize,
    size: [usize; 2],
) -> TileEntries {
    let tile_count: usize = tile_counts(size).iter().product();
    let ranges = gpu.filled(2 * tile_count, 0);
    if len == 0 {
        return TileEntries {
            len,
            ranges,
            gaussians: gpu.words(0),
            entries: gpu.words(0),
            ends: gpu.filled(order.len, 0),
        };
    }
    let gaussian_of = gpu.words(len);
    let gaussians = gpu.words(len);
    let ends = gpu.words(order.len);
    let tiles = gpu.words(len);
    launch!(gpu, emit_entries, gpu.cubes_for(order.len);
        &scene.splats, &order.ids, &order.offsets, &tiles, &gaussian_of, &ends;
        order.len as u32, size[0] as u32, size[1] as u32);
    // One number more than there are tiles, for entries without a tile.
    let bits = usize::BITS - tile_count.leading_zeros();
    let (tiles, entries) = sort_positions(gpu, tiles, len, bits);
    launch!(gpu, find_ranges, gpu.cubes_for(len);
        &tiles, &entries, &gaussian_of, &ranges, &gaussians; len as u32, tile_count as u32);
    TileEntries {
        len,
        ranges,
        gaussians,
        entries,
        ends,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Settings;
    use crate::raster::gpu::fixture::{View, words};

    #[test]
    fn tile_lists_agree() {
        for settings in [
            Settings::default(),
            Settings {
                alpha_min: 1e-14,
                ..Settings::default()
            },
        ] {
            for (n, scale, size) in [
                (2000, 0.03, [130, 90]),
                (300, 0.5, [65, 40]),
                (100, 3.0, [33, 47]),
            ] {
                let Some(view) = View::new(n, scale, size, &settings) else {
                    return;
                };
                let [across, down] = tile_counts(size);
                let ranges = words(&view.gpu, &view.prepared.entries.ranges);
                let gaussians = words(&view.gpu, &view.prepared.entries.gaussians);
                let mut entries = 0;
                let mut differing = 0;
                for tile in 0..across * down {
                    let got = &gaussians[ranges[2 * tile] as usize..ranges[2 * tile + 1] as usize];
                    let ranks =
                        &view.host.tiles.ranks[view.host.tiles.tile(tile % across, tile / across)];
                    let want: Vec<u32> = ranks
                        .iter()
                        .map(|&rank| view.host.ids[rank as usize])
                        .collect();
                    entries += want.len();
                    // Lists differ where an ellipse grazes a tile; what both have is in one order.
                    let both: Vec<u32> =
                        got.iter().copied().filter(|id| want.contains(id)).collect();
                    let shared: Vec<u32> =
                        want.iter().copied().filter(|id| got.contains(id)).collect();
                    let flips = both.iter().zip(&shared).filter(|(a, b)| a != b).count();
                    differing += got.len() + want.len() - both.len() - shared.len() + flips;
                }
                assert!(entries > 0);
                assert!(
                    differing * 500 <= entries,
                    "{differing} of {entries} entries differ, {n} Gaussians"
                );
            }
        }
    }
}

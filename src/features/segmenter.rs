//! Features from within a semantic segmenter in an ONNX file: one tensor of the network, and the same over larger areas.

use super::{FeatureMap, SCALES};
use crate::error::Result;
use crate::segmenter::Tap;
use image::RgbImage;

/// Changes with the arithmetic: cached maps of another version are computed again.
pub(super) const VERSION: &str = "segmenter 1";

/// The maps of a photo, fine to coarse: the tensor, and its means over areas of 2, 4 and 8 cells a side.
///
/// # Errors
/// As [`Tap::map`].
pub(super) fn maps(tap: &Tap, photo: &RgbImage) -> Result<[FeatureMap; SCALES]> {
    let found = tap.map(photo)?;
    let mut map = FeatureMap {
        height: found.height,
        width: found.width,
        channels: found.channels,
        data: found.values,
        steps: None,
    };
    let mut maps: [FeatureMap; SCALES] = Default::default();
    for scale in &mut maps {
        let coarser = halved(&map);
        *scale = std::mem::replace(&mut map, coarser);
    }
    Ok(maps)
}

/// The means over twice as large cells. Both maps divide the image evenly, so that a cell of an odd map is shared by two.
fn halved(map: &FeatureMap) -> FeatureMap {
    let rows = shares(map.height);
    let columns = shares(map.width);
    let mut data = vec![0.0; rows.len() * columns.len() * map.channels];
    for (y, row) in rows.iter().enumerate() {
        for (x, column) in columns.iter().enumerate() {
            let sums = &mut data[(y * columns.len() + x) * map.channels..][..map.channels];
            for (down, height) in row {
                for (across, width) in column {
                    let cell = map.cell(*across, *down);
                    sums.iter_mut()
                        .zip(cell)
                        .for_each(|(sum, value)| *sum += height * width * value);
                }
            }
        }
    }
    FeatureMap {
        height: rows.len(),
        width: columns.len(),
        channels: map.channels,
        data,
        steps: None,
    }
}

/// For each of half as many cells on an axis: the cells that it covers, and their shares of it.
fn shares(cells: usize) -> Vec<Vec<(usize, f32)>> {
    let count = cells.div_ceil(2);
    let length = cells as f64 / count as f64;
    let of = |i: usize| {
        let (start, end) = (i as f64 * length, (i + 1) as f64 * length);
        let covered = start as usize..(end.ceil() as usize).min(cells);
        let share = |cell: usize| (end.min(cell as f64 + 1.0) - start.max(cell as f64)) / length;
        covered.map(|cell| (cell, share(cell) as f32)).collect()
    };
    (0..count).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::shares;

    #[test]
    fn larger_cells_cover_the_axis_evenly() {
        for cells in [1, 2, 5, 8, 97] {
            let shares = shares(cells);
            let mut sums = vec![0.0; cells];
            for of in &shares {
                let all: f32 = of.iter().map(|(_, share)| share).sum();
                assert!((all - 1.0).abs() < 1e-5, "{cells}: {of:?}");
                of.iter().for_each(|(cell, share)| sums[*cell] += share);
            }
            let expected = shares.len() as f32 / cells as f32;
            assert!(
                sums.iter().all(|sum| (sum - expected).abs() < 1e-5),
                "{cells}: {sums:?}"
            );
        }
    }
}

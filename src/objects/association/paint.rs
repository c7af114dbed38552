//! From the groups of a view's segments to its map.

use super::groups::Placed;
use super::masks::{BAND, Mask, NOTHING};
use crate::data::{LabelMap, LabelRuns, View};
use crate::error::Result;
use crate::raster::{Projected, Settings};
use crate::splat::Gaussians;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};

/// Id of each Gaussian of a divided segment, and that of its largest piece.
struct Divided {
    ids: HashMap<u32, u16>,
    largest: u16,
}

/// The raw labels of a view in ids of the groups, `ids` of a group's number; `None` where it has none.
///
/// A pixel of a segment that was divided takes the group whose piece has most weight `alpha' T` at it.
///
/// # Errors
/// [`crate::Error::NonFinite`] when a Gaussian's parameters are not finite.
pub(super) fn paint(
    gaussians: &Gaussians,
    view: &View,
    placed: &Placed<'_>,
    ids: &dyn Fn(u32) -> u16,
    settings: &Settings,
) -> Result<Option<LabelMap>> {
    let Some(raw) = view.raw.as_ref().map(LabelRuns::map) else {
        return Ok(None);
    };
    let mut pieces: BTreeMap<u16, Vec<(&Mask, u16)>> = BTreeMap::new();
    for (mask, group) in placed.masks.iter().zip(&placed.groups) {
        let id = group.map_or(NOTHING, ids);
        pieces.entry(mask.segment.id).or_default().push((mask, id));
    }
    let mut table = vec![NOTHING; 1 << 16];
    let mut divided: HashMap<u16, Divided> = HashMap::new();
    for (segment, pieces) in pieces {
        let largest = pieces
            .iter()
            .fold(pieces[0], |best, piece| {
                if piece.0.total > best.0.total {
                    *piece
                } else {
                    best
                }
            })
            .1;
        table[usize::from(segment)] = largest;
        if pieces.iter().any(|(_, id)| *id != largest) {
            let gaussians = pieces
                .iter()
                .flat_map(|(mask, id)| mask.weights.iter().map(|(gaussian, _)| (*gaussian, *id)));
            divided.insert(
                segment,
                Divided {
                    ids: gaussians.collect(),
                    largest,
                },
            );
        }
    }
    let ids = raw.ids.iter().map(|&id| table[usize::from(id)]).collect();
    let mut map = LabelMap {
        width: raw.width,
        height: raw.height,
        ids,
    };
    let pixels: Vec<u32> = (0..raw.ids.len() as u32)
        .filter(|&p| divided.contains_key(&raw.ids[p as usize]))
        .collect();
    if pixels.is_empty() {
        return Ok(Some(map));
    }
    let projected = Projected::new(&gaussians.splats(), &view.camera, settings)?;
    for band in pixels.chunks(BAND) {
        let weights = projected.weights(Some(band));
        let found: Vec<u16> = band
            .par_iter()
            .enumerate()
            .map(|(row, &pixel)| {
                let divided = &divided[&raw.ids[pixel as usize]];
                let (columns, values) = weights.row(row);
                let mut sums: Vec<(u16, f64)> = vec![(divided.largest, 0.0)];
                for (gaussian, weight) in columns.iter().zip(values) {
                    let Some(&id) = divided.ids.get(gaussian) else {
                        continue;
                    };
                    match sums.iter_mut().find(|(other, _)| *other == id) {
                        Some((_, sum)) => *sum += f64::from(*weight),
                        None => sums.push((id, f64::from(*weight))),
                    }
                }
                sums.iter()
                    .fold(
                        sums[0],
                        |best, sum| if sum.1 > best.1 { *sum } else { best },
                    )
                    .0
            })
            .collect();
        band.iter()
            .zip(found)
            .for_each(|(&pixel, id)| map.ids[pixel as usize] = id);
    }
    Ok(Some(map))
}

//! From the groups of a view's segments to its label map.

use super::groups::Assigned;
use super::segments::{BAND_PIXELS, NO_SEGMENT};
use crate::data::first_largest;
use crate::data::{LabelMap, LabelRuns, View};
use crate::error::Result;
use crate::raster::{Projected, Settings};
use crate::splat::{Gaussians, rows_where};
use rayon::prelude::*;
use std::collections::HashMap;

/// A segment that was divided among groups.
struct Divided {
    /// Id of each Gaussian.
    ids: HashMap<u32, u16>,
    /// Id of the largest piece.
    largest: u16,
}

/// The raw labels of a view in ids of the groups. `ids` gives the id of a group. `None` where the view has no raw labels.
///
/// A pixel of a divided segment takes the group whose piece has most weight `alpha' T` at it.
///
/// # Errors
/// [`crate::Error::NonFinite`] when a Gaussian's parameters are not finite.
pub(super) fn relabelled(
    gaussians: &Gaussians,
    view: &View,
    assigned: &Assigned<'_>,
    ids: &dyn Fn(u32) -> u16,
    settings: &Settings,
) -> Result<Option<LabelMap>> {
    let Some(raw) = view.raw.as_ref().map(LabelRuns::map) else {
        return Ok(None);
    };
    let mut table = vec![NO_SEGMENT; 1 << 16];
    let mut divided: HashMap<u16, Divided> = HashMap::new();
    for (pieces, groups) in assigned.by_segment() {
        let id = |n: usize| groups[n].map_or(NO_SEGMENT, ids);
        let largest = first_largest(pieces.iter().map(|piece| piece.total)).unwrap_or(0);
        let segment = pieces[0].segment.id;
        let largest = id(largest);
        table[usize::from(segment)] = largest;
        if (0..pieces.len()).any(|n| id(n) != largest) {
            let weights = pieces.iter().enumerate();
            let ids = weights.flat_map(|(n, piece)| {
                let id = id(n);
                piece
                    .weights
                    .iter()
                    .map(move |(gaussian, _)| (*gaussian, id))
            });
            let ids = ids.collect();
            divided.insert(segment, Divided { ids, largest });
        }
    }
    let ids = raw.ids.iter().map(|&id| table[usize::from(id)]).collect();
    let mut map = LabelMap {
        width: raw.width,
        height: raw.height,
        ids,
    };
    let pixels = rows_where(&raw.ids, |id| divided.contains_key(id));
    if pixels.is_empty() {
        return Ok(Some(map));
    }
    let projected = Projected::new(&gaussians.splats(), &view.camera, settings)?;
    for band in pixels.chunks(BAND_PIXELS) {
        let weights = projected.weights(band);
        let id = |(row, &pixel): (usize, &u32)| {
            let (columns, values) = weights.row(row);
            divided[&raw.ids[pixel as usize]].id_at(columns, values)
        };
        let ids: Vec<u16> = band.par_iter().enumerate().map(id).collect();
        for (&pixel, id) in band.iter().zip(ids) {
            map.ids[pixel as usize] = id;
        }
    }
    Ok(Some(map))
}

impl Divided {
    /// The id with most weight at a pixel, the first among equals. Without weight, the id of the largest piece.
    fn id_at(&self, gaussians: &[u32], weights: &[f32]) -> u16 {
        let mut sums: Vec<(u16, f64)> = vec![(self.largest, 0.0)];
        for (gaussian, weight) in gaussians.iter().zip(weights) {
            let Some(&id) = self.ids.get(gaussian) else {
                continue;
            };
            match sums.iter_mut().find(|(other, _)| *other == id) {
                Some((_, sum)) => *sum += f64::from(*weight),
                None => sums.push((id, f64::from(*weight))),
            }
        }
        let most = sums.into_iter();
        most.reduce(|best, sum| if sum.1 > best.1 { sum } else { best })
            .map_or(self.largest, |(id, _)| id)
    }
}

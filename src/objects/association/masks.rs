//! What each segment of a view covers: the weight `alpha' T` of its pixels on every Gaussian.

use crate::data::{LabelMap, Segment, View};
use crate::error::Result;
use crate::gaussians::Gaussians;
use crate::raster::{Projected, Settings};
use rayon::prelude::*;

/// The id of pixels that belong to no segment.
pub(super) const NOTHING: u16 = 0;
/// Pixels whose blending weights are held at once.
pub(super) const BAND: usize = 1 << 18;
/// Weights below a hundredth of a pixel are left out.
const LEAST: f64 = 0.01;

/// A segment of a view.
#[derive(Clone, Debug)]
pub(super) struct Mask {
    /// Its id, class and kind in the view.
    pub segment: Segment,
    /// Gaussian and the sum of `alpha' T` over the segment's pixels, ascending by Gaussian.
    pub weights: Vec<(u32, f32)>,
    /// Sum of the weights, pixels.
    pub total: f64,
}

/// All that a view's labels cover.
#[derive(Clone, Debug, Default)]
pub(super) struct Masks {
    /// The segments, ascending by id.
    pub segments: Vec<Mask>,
    /// The same weights of the pixels without a segment.
    pub rest: Vec<(u32, f32)>,
}

/// The segments of `raw`, a map of `view`.
pub(super) fn masks(gaussians: &Gaussians, view: &View, raw: &LabelMap, settings: &Settings) -> Result<Masks> {
    let mut place = vec![u32::MAX; 1 << 16];
    raw.ids.iter().for_each(|&id| place[usize::from(id)] = 0);
    let mut masks = Vec::new();
    for id in 0..=u16::MAX {
        if place[usize::from(id)] == 0 {
            place[usize::from(id)] = masks.len() as u32;
            let told = view.segments.iter().find(|segment| segment.id == id);
            let segment = told.copied().unwrap_or(Segment { id, class: None, thing: true });
            masks.push(Mask { segment, weights: Vec::new(), total: 0.0 });
        }
    }
    let pixels: Vec<u32> = (0..raw.ids.len() as u32).collect();
    let projected = Projected::new(&gaussians.splats(), &view.camera, settings)?;
    for band in pixels.chunks(BAND) {
        let weights = projected.weights(Some(band));
        let mut rows = vec![Vec::new(); masks.len()];
        for (row, &pixel) in band.iter().enumerate() {
            rows[place[usize::from(raw.ids[pixel as usize])] as usize].push(row);
        }
        // Each segment's sums run over its pixels in order: the same bits at any number of threads.
        masks.par_iter_mut().zip(rows).for_each_init(
            || vec![0.0_f64; gaussians.len()],
            |sums, (mask, rows)| {
                let mut touched = Vec::new();
                for (&gaussian, &weight) in rows.into_iter().flat_map(|row| {
                    let (columns, values) = weights.row(row);
                    columns.iter().zip(values)
                }) {
                    let sum = &mut sums[gaussian as usize];
                    if *sum == 0.0 {
                        touched.push(gaussian);
                    }
                    *sum += f64::from(weight);
                }
                let taken = touched.into_iter().map(|g| (g, std::mem::take(&mut sums[g as usize]) as f32));
                mask.weights.extend(taken);
            },
        );
    }
    masks.par_iter_mut().for_each(|mask| {
        // Bands add up; the sort keeps their order.
        mask.weights.sort_by_key(|(gaussian, _)| *gaussian);
        mask.weights.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            if same {
                kept.1 += next.1;
            }
            same
        });
        mask.weights.retain(|(_, weight)| f64::from(*weight) >= LEAST);
        mask.total = mask.weights.iter().map(|(_, weight)| f64::from(*weight)).sum();
    });
    let rest = masks.first().is_some_and(|mask| mask.segment.id == NOTHING).then(|| masks.remove(0).weights);
    Ok(Masks { segments: masks, rest: rest.unwrap_or_default() })
}

//! What each segment of a view covers: the weight `alpha' T` of its pixels on every Gaussian.

use super::sums::SparseSums;
use crate::data::{LabelMap, Segment, View};
use crate::error::Result;
use crate::raster::{Projected, Settings};
use crate::splat::Gaussians;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// The id of pixels that belong to no segment.
pub(super) const NO_SEGMENT: u16 = 0;
/// Pixels whose blending weights are held at once.
pub(super) const BAND_PIXELS: usize = 1 << 18;
/// Weights below a hundredth of a pixel are left out.
const MIN_WEIGHT: f64 = 0.01;

/// A segment of a view, or a piece of one, and the Gaussians that it covers.
#[derive(Clone, Debug)]
pub(super) struct SegmentWeights {
    /// Its id and category in the view.
    pub segment: Segment,
    /// Gaussian and the sum of `alpha' T` over the segment's pixels, ascending by Gaussian.
    pub weights: Vec<(u32, f32)>,
    /// Sum of the weights, pixels.
    pub total: f64,
}

/// What the labels of a view cover.
#[derive(Clone, Debug, Default)]
pub(super) struct ViewSegments {
    /// The segments, ascending by id.
    pub segments: Vec<SegmentWeights>,
    /// The weights of the pixels without a segment. Pixels that the view's mask leaves out do not count: what they show is
    /// unknown, not unlabelled.
    pub unlabelled: Vec<(u32, f32)>,
}

/// The segments of `raw`, a map of `view`.
pub(super) fn view_segments(
    gaussians: &Gaussians,
    view: &View,
    raw: &LabelMap,
    settings: &Settings,
) -> Result<ViewSegments> {
    let mut segments = empty_segments(view, raw);
    let mut index_of_id = vec![0; 1 << 16];
    for (n, segment) in segments.iter().enumerate() {
        index_of_id[usize::from(segment.segment.id)] = n;
    }
    let pixels: Vec<u32> = (0..raw.ids.len() as u32).collect();
    let projected = Projected::new(&gaussians.splats(), &view.camera, settings)?;
    let used = |pixel: u32| {
        let mask = view.mask.as_ref();
        mask.is_none_or(|mask| mask.uses(pixel as usize))
    };
    for band in pixels.chunks(BAND_PIXELS) {
        let weights = projected.weights(band);
        let mut rows = vec![Vec::new(); segments.len()];
        for (row, &pixel) in band.iter().enumerate().filter(|(_, pixel)| used(**pixel)) {
            rows[index_of_id[usize::from(raw.ids[pixel as usize])]].push(row);
        }
        // Each segment's sums run over its pixels in order: the same bits at any number of threads.
        segments.par_iter_mut().zip(rows).for_each_init(
            || SparseSums::new(gaussians.len()),
            |sums, (segment, rows)| {
                for row in rows {
                    let (columns, values) = weights.row(row);
                    for (&gaussian, &weight) in columns.iter().zip(values) {
                        sums.add(gaussian, f64::from(weight));
                    }
                }
                let sums = sums.take().into_iter();
                segment
                    .weights
                    .extend(sums.map(|(gaussian, sum)| (gaussian, sum as f32)));
            },
        );
    }
    segments.par_iter_mut().for_each(SegmentWeights::finish);
    let unlabelled = segments
        .first()
        .is_some_and(|segment| segment.segment.id == NO_SEGMENT)
        .then(|| segments.remove(0).weights);
    Ok(ViewSegments {
        segments,
        unlabelled: unlabelled.unwrap_or_default(),
    })
}

/// The segments of a map without weights, ascending by id; [`NO_SEGMENT`] is one of them where it occurs.
fn empty_segments(view: &View, raw: &LabelMap) -> Vec<SegmentWeights> {
    let ids: BTreeSet<u16> = raw.ids.iter().copied().collect();
    let segment = |id: u16| {
        let described = view.segments.iter().find(|segment| segment.id == id);
        let segment = described.copied().unwrap_or(Segment {
            id,
            class: None,
            thing: true,
        });
        SegmentWeights {
            segment,
            weights: Vec::new(),
            total: 0.0,
        }
    };
    ids.into_iter().map(segment).collect()
}

impl SegmentWeights {
    /// Adds up the weights of the bands and leaves out the smallest.
    fn finish(&mut self) {
        // The sort is stable: bands add up in order.
        self.weights.sort_by_key(|(gaussian, _)| *gaussian);
        self.weights.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            if same {
                kept.1 += next.1;
            }
            same
        });
        self.weights
            .retain(|(_, weight)| f64::from(*weight) >= MIN_WEIGHT);
        let weights = self.weights.iter();
        self.total = weights.map(|(_, weight)| f64::from(*weight)).sum();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Split;
    use crate::splat::camera::Camera;

    #[test]
    fn what_a_mask_leaves_out_is_not_without_a_segment() {
        let (width, height) = (40, 20);
        let at = |i: usize| [0.2 * (i % 8) as f32 - 0.7, 0.2 * (i / 8) as f32 - 0.3, 2.0];
        let gaussians = Gaussians {
            means: (0..32).map(at).collect(),
            log_scales: vec![[-2.5; 3]; 32],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; 32],
            opacity_logits: vec![2.0; 32],
            sh: vec![0.0; 96],
            sh_degree: 0,
        };
        let rotation = glam::DMat3::IDENTITY;
        let center = glam::DVec3::ZERO;
        let camera = Camera {
            rotation,
            center,
            fx: 40.0,
            fy: 40.0,
            cx: 20.0,
            cy: 10.0,
            width,
            height,
        };
        // The upper part is a segment. The lower part has none, and its left half is masked.
        let ids = (0..width * height)
            .map(|pixel| u16::from(pixel / width < 7))
            .collect();
        let raw = LabelMap { width, height, ids };
        let used = |pixel: usize| pixel / width < 7 || pixel % width >= 20;
        let mut view = View {
            name: "a".into(),
            split: Split::Train,
            camera,
            image: image::RgbImage::new(width as u32, height as u32).into(),
            mask: None,
            truth: None,
            raw: None,
            scores: None,
            segments: Vec::new(),
            corrected: None,
            instances: None,
        };
        let of = |view: &View| {
            view_segments(&gaussians, view, &raw, &Settings::default()).expect("segments")
        };
        let whole = of(&view);
        view.mask = Some(crate::data::mask::Mask::new(width, height, used));
        let part = of(&view);
        assert_eq!(part.segments[0].weights, whole.segments[0].weights);
        let projected =
            Projected::new(&gaussians.splats(), &view.camera, &Settings::default()).expect("view");
        let rest: Vec<f32> = (0..width * height)
            .map(|p| f32::from(u8::from(p / width >= 7 && used(p))))
            .collect();
        let want = projected.blend_adjoint(&rest, 1);
        let mut found = vec![0.0; 32];
        part.unlabelled
            .iter()
            .for_each(|&(gaussian, weight)| found[gaussian as usize] = weight);
        assert!(
            found.iter().zip(&want).all(|(a, b)| (a - b).abs() < 0.011),
            "{found:?} {want:?}"
        );
        let sum = |view: &ViewSegments| {
            view.unlabelled
                .iter()
                .map(|(_, weight)| weight)
                .sum::<f32>()
        };
        assert!(sum(&part) < 0.6 * sum(&whole) && sum(&part) > 0.0);
    }
}

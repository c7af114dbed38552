//! What each segment of a view covers: the weight `alpha' T` of its pixels on every Gaussian.

use super::scratch::Zeros;
use crate::data::{LabelMap, Segment, View};
use crate::error::Result;
use crate::raster::{Projected, Settings};
use crate::splat::Gaussians;
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
    /// The same weights of the pixels without a segment, those that the view's mask leaves out not counted: what they show is
    /// unknown, not without a segment.
    pub rest: Vec<(u32, f32)>,
}

/// The segments of `raw`, a map of `view`. `zeros` are as long as there are Gaussians.
pub(super) fn masks(
    gaussians: &Gaussians,
    view: &View,
    raw: &LabelMap,
    settings: &Settings,
    zeros: &Zeros<f64>,
) -> Result<Masks> {
    let mut place = vec![u32::MAX; 1 << 16];
    raw.ids.iter().for_each(|&id| place[usize::from(id)] = 0);
    let mut masks = Vec::new();
    for id in 0..=u16::MAX {
        if place[usize::from(id)] == 0 {
            place[usize::from(id)] = masks.len() as u32;
            let told = view.segments.iter().find(|segment| segment.id == id);
            let segment = told.copied().unwrap_or(Segment {
                id,
                class: None,
                thing: true,
            });
            masks.push(Mask {
                segment,
                weights: Vec::new(),
                total: 0.0,
            });
        }
    }
    let pixels: Vec<u32> = (0..raw.ids.len() as u32).collect();
    let projected = Projected::new(&gaussians.splats(), &view.camera, settings)?;
    for band in pixels.chunks(BAND) {
        let weights = projected.weights(Some(band));
        let mut rows = vec![Vec::new(); masks.len()];
        let used = |pixel: u32| {
            view.mask
                .as_ref()
                .is_none_or(|mask| mask.uses(pixel as usize))
        };
        for (row, &pixel) in band.iter().enumerate().filter(|(_, pixel)| used(**pixel)) {
            rows[place[usize::from(raw.ids[pixel as usize])] as usize].push(row);
        }
        // Each segment's sums run over its pixels in order: the same bits at any number of threads.
        masks.par_iter_mut().zip(rows).for_each_init(
            || zeros.lend(),
            |sums, (mask, rows)| {
                let sums: &mut [f64] = sums;
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
                let taken = touched
                    .into_iter()
                    .map(|g| (g, std::mem::take(&mut sums[g as usize]) as f32));
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
        mask.weights
            .retain(|(_, weight)| f64::from(*weight) >= LEAST);
        mask.total = mask
            .weights
            .iter()
            .map(|(_, weight)| f64::from(*weight))
            .sum();
    });
    let rest = masks
        .first()
        .is_some_and(|mask| mask.segment.id == NOTHING)
        .then(|| masks.remove(0).weights);
    Ok(Masks {
        segments: masks,
        rest: rest.unwrap_or_default(),
    })
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
        let (rotation, center) = (glam::DMat3::IDENTITY, glam::DVec3::ZERO);
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
        // A segment above, nothing below, of which the left half is left out.
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
            segments: Vec::new(),
            instances: None,
        };
        let zeros = Zeros::new(gaussians.len());
        let of = |view: &View| {
            masks(&gaussians, view, &raw, &Settings::default(), &zeros).expect("masks")
        };
        let whole = of(&view);
        view.mask = Some(crate::data::mask::Mask::new(width, height, used));
        let part = of(&view);
        assert!(zeros.lend().iter().all(|sum| *sum == 0.0), "as it was lent");
        assert_eq!(part.segments[0].weights, whole.segments[0].weights);
        let projected =
            Projected::new(&gaussians.splats(), &view.camera, &Settings::default()).expect("view");
        let rest: Vec<f32> = (0..width * height)
            .map(|p| f32::from(u8::from(p / width >= 7 && used(p))))
            .collect();
        let want = projected.blend_adjoint(&rest, 1);
        let mut found = vec![0.0; 32];
        part.rest
            .iter()
            .for_each(|&(gaussian, weight)| found[gaussian as usize] = weight);
        assert!(
            found.iter().zip(&want).all(|(a, b)| (a - b).abs() < 0.011),
            "{found:?} {want:?}"
        );
        let sum = |masks: &Masks| masks.rest.iter().map(|(_, weight)| weight).sum::<f32>();
        assert!(sum(&part) < 0.6 * sum(&whole) && sum(&part) > 0.0);
    }
}

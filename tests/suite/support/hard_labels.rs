//! Label maps of scenes that have one label a Gaussian.

use coseg::data::LabelMap;
use coseg::raster::Projected;

/// Renders one label per Gaussian: at each pixel the label whose Gaussians have the largest summed alpha' T, ties to the
/// lower id, and 0 where 1 - T is below `min_coverage`.
///
/// Every id that occurs competes, also one that a class table calls unlabelled.
///
/// # Panics
/// If `labels` does not have one id for each Gaussian of `projected`.
pub fn hard_label_map(projected: &Projected<f32>, labels: &[u16], min_coverage: f32) -> LabelMap {
    let (blended, mut ids) = projected.blend_labels::<1>(&[], labels);
    for (id, &t) in ids.iter_mut().zip(&blended.transmittance) {
        let covered = 1.0 - t >= min_coverage;
        *id = if covered { *id } else { 0 };
    }
    let [width, height] = projected.size();
    LabelMap { width, height, ids }
}

//! Label maps rendered from one label per Gaussian, as a PLY file carries them.

use crate::data::LabelMap;
use crate::raster::Projected;

/// Labels blended at once; bounds the memory of scenes with many classes.
const CHUNK: usize = 16;

/// Renders one label per Gaussian: at each pixel the label whose Gaussians have the largest summed alpha' T, ties to the
/// lower id, and 0 where 1 - T is below `min_coverage`.
///
/// Every id that occurs competes, also one that a class table calls unlabelled.
///
/// # Panics
/// If `labels` does not have one id for each Gaussian of `projected`.
pub fn hard_label_map(projected: &Projected<f32>, labels: &[u16], min_coverage: f32) -> LabelMap {
    assert_eq!(labels.len(), projected.len(), "one label a Gaussian");
    let mut present = labels.to_vec();
    present.sort_unstable();
    present.dedup();
    let [width, height] = projected.size();
    let mut best = vec![(0.0_f32, 0_u16); width * height];
    let transmittance = projected.blend(&[], 0).transmittance;
    for chunk in present.chunks(CHUNK) {
        let c = chunk.len();
        let mut one_hot = vec![0.0; labels.len() * c];
        for (row, label) in one_hot.chunks_exact_mut(c).zip(labels) {
            if let Ok(channel) = chunk.binary_search(label) {
                row[channel] = 1.0;
            }
        }
        let blended = projected.blend(&one_hot, c);
        for (best, weights) in best.iter_mut().zip(blended.image.chunks_exact(c)) {
            for (&weight, &label) in weights.iter().zip(chunk) {
                if weight > best.0 {
                    *best = (weight, label);
                }
            }
        }
    }
    let covered = |t: &f32| 1.0 - t >= min_coverage;
    let ids = best.iter().zip(&transmittance).map(|((_, id), t)| if covered(t) { *id } else { 0 }).collect();
    LabelMap { width, height, ids }
}

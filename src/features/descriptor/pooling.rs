//! Pooling of response maps over Gaussian windows.

use super::FeatureMap;
use crate::features::map::Taps;

/// Two maps of one grid, channels side by side.
pub fn join(a: &FeatureMap, b: &FeatureMap) -> FeatureMap {
    let channels = a.channels + b.channels;
    let mut out = FeatureMap::zeros(a.height, a.width, channels);
    let pairs = a
        .data
        .chunks_exact(a.channels)
        .zip(b.data.chunks_exact(b.channels));
    for (out, (a, b)) in out.data.chunks_exact_mut(channels).zip(pairs) {
        let (left, right) = out.split_at_mut(a.len());
        left.copy_from_slice(a);
        right.copy_from_slice(b);
    }
    out
}

/// The first `channels` channels of a map.
pub fn first_channels(map: &FeatureMap, channels: usize) -> FeatureMap {
    let data = map
        .data
        .chunks_exact(map.channels)
        .flat_map(|cell| cell[..channels].iter().copied())
        .collect();
    FeatureMap {
        channels,
        data,
        ..*map
    }
}

/// Gaussian mean with standard deviation `sigma` cells, cut at 3 sigma; weights outside the map are left out.
pub fn gaussian(map: &FeatureMap, sigma: f64) -> FeatureMap {
    let rows = map.mixed_rows(&blur_axis(map.height, sigma));
    rows.mixed_columns(&blur_axis(map.width, sigma))
}

/// For each position of an axis the cells read and their normalised weights.
fn blur_axis(size: usize, sigma: f64) -> Vec<Taps> {
    let radius = (3.0 * sigma).ceil() as usize;
    (0..size)
        .map(|i| {
            let first = i.saturating_sub(radius);
            let last = (i + radius).min(size - 1);
            let taps: Vec<f64> = (first..=last)
                .map(|k| {
                    let d = (k as f64 - i as f64) / sigma;
                    (-0.5 * d * d).exp()
                })
                .collect();
            let sum: f64 = taps.iter().sum();
            let weights = taps.iter().map(|t| (t / sum) as f32);
            (first..).zip(weights).collect()
        })
        .collect()
}

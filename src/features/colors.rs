//! Colours of Gaussians by their image features.

use super::{Moments, Pca};
use crate::error::{Result, ensure};
use crate::weights::{HostTensor, WeightFile};
use std::path::Path;

/// Gaussians that the components are fitted on, at most.
const FITTED_GAUSSIANS: usize = 20_000;
/// Gaussians that are projected at once.
const BLOCK: usize = 4_096;
/// Shares of the Gaussians that are darker than black and brighter than full brightness.
const CLIPPED: [f64; 2] = [0.02, 0.98];
/// Name of the tensor in the file.
const COLORS: &str = "colors";

/// A colour for each Gaussian: the three main components of its lifted features.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FeatureColors {
    /// sRGB in 0..1.
    pub rgb: Vec<[f32; 3]>,
}

impl FeatureColors {
    /// Colours of the features of all scales, each `[N, dimensions]`. A component is 0 at its 2nd percentile and 1 at its 98th. A
    /// component without variance is 0.5.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] for features that are not finite.
    pub fn of(scales: &[Vec<f32>], dimensions: usize) -> Result<Self> {
        let channels = scales.len() * dimensions;
        let values = scales.first().map_or(0, Vec::len);
        let count = values / dimensions.max(1);
        let mut moments = Moments::new(channels);
        let fitted = (0..count).step_by(count.div_ceil(FITTED_GAUSSIANS).max(1));
        let fitted = joined(scales, dimensions, fitted);
        moments.add(&fitted, "lifted features", channels)?;
        let pca = Pca::fit(&moments, 3);
        let mut components = [(); 3].map(|()| Vec::with_capacity(count));
        for first in (0..count).step_by(BLOCK) {
            let rows = joined(scales, dimensions, first..(first + BLOCK).min(count));
            for projected in pca.project(&rows, "lifted features")?.chunks_exact(3) {
                for (component, value) in components.iter_mut().zip(projected) {
                    component.push(*value);
                }
            }
        }
        components.iter_mut().for_each(stretch);
        let [r, g, b] = components;
        let rgb = r.iter().zip(&g).zip(&b);
        Ok(Self {
            rgb: rgb.map(|((r, g), b)| [*r, *g, *b]).collect(),
        })
    }

    /// Writes tensor `colors` `[N, 3]` f32 as a safetensors file, atomically.
    ///
    /// # Errors
    /// [`crate::Error::Io`] when the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let colors = HostTensor {
            shape: vec![self.rgb.len(), 3],
            values: self.rgb.as_flattened().to_vec(),
        };
        WeightFile::write_one(path, COLORS, colors)
    }

    /// Reads what [`FeatureColors::write`] wrote for a scene of `gaussians`.
    ///
    /// # Errors
    /// [`crate::Error::Io`]; [`crate::Error::Input`] for another file, another number of Gaussians, or values that are not
    /// colours.
    pub fn read(path: &Path, gaussians: usize) -> Result<Self> {
        const HELP: &str = "give the run folder that `coseg train` wrote, with its own scene.ply";
        let mut file = WeightFile::open_sealed(path)?;
        let tensor = file.tensors.remove(COLORS).unwrap_or_default();
        let HostTensor { shape, values } = tensor;
        ensure!(shape == [gaussians, 3], path, "{COLORS}"; found "shape {shape:?}";
            expected "[{gaussians}, 3], a colour for each Gaussian of the scene"; help "{HELP}");
        let wrong = values.iter().find(|value| !(0.0..=1.0).contains(*value));
        ensure!(wrong.is_none(), path, "{COLORS}"; found "{}", wrong.copied().unwrap_or_default();
            expected "values from 0 to 1"; help "{HELP}");
        let (rgb, _) = values.as_chunks::<3>();
        Ok(Self { rgb: rgb.to_vec() })
    }
}

/// The features of all scales of `rows` side by side.
fn joined(scales: &[Vec<f32>], dimensions: usize, rows: impl Iterator<Item = usize>) -> Vec<f32> {
    let mut all = Vec::new();
    for row in rows {
        for scale in scales {
            all.extend_from_slice(&scale[row * dimensions..][..dimensions]);
        }
    }
    all
}

/// Brings `values` to 0..1 by their percentiles.
fn stretch(values: &mut Vec<f32>) {
    let mut sorted = values.clone();
    sorted.sort_unstable_by(f32::total_cmp);
    let last = sorted.len().saturating_sub(1) as f64;
    let at = |share: f64| sorted.get((share * last).round() as usize).copied();
    let [low, high] = CLIPPED.map(|share| at(share).unwrap_or_default());
    for value in values {
        let place = (*value - low) / (high - low);
        *value = if high > low {
            place.clamp(0.0, 1.0)
        } else {
            0.5
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_main_component_is_red_and_outliers_are_clipped() {
        // The second channel of the third scale varies most, and one Gaussian is far off.
        let count = 101;
        let mut scales = vec![vec![0.25; 2 * count]; 4];
        for i in 0..count {
            scales[2][2 * i + 1] = i as f32;
            scales[0][2 * i] = 0.1 * (i as f32 * 2.4).sin();
        }
        scales[2][2 * 100 + 1] = 1e4;
        let colors = FeatureColors::of(&scales, 2).expect("finite").rgb;
        assert_eq!(colors.len(), count);
        let red: Vec<f32> = colors.iter().map(|color| color[0]).collect();
        assert!(red.is_sorted(), "{red:?}");
        assert_eq!((red[2], red[98], red[100]), (0.0, 1.0, 1.0));
        assert!((red[50] - 0.5).abs() < 1e-3, "{}", red[50]);
        let (low, high) = (colors[0][1], colors[1][1]);
        assert!(low != high, "the second component varies as well");
        assert!(colors.iter().all(|color| color[2] == 0.5), "no third one");
        assert!(
            colors
                .as_flattened()
                .iter()
                .all(|v| (0.0..=1.0).contains(v))
        );
    }

    #[test]
    fn unusable_features_are_refused_and_none_make_no_colours() {
        let none = FeatureColors::of(&[], 2).expect("nothing");
        assert!(none.rgb.is_empty());
        let mut scales = vec![vec![1.0; 8]; 4];
        let plain = FeatureColors::of(&scales, 2).expect("finite");
        assert_eq!(plain.rgb, [[0.5; 3]; 4]);
        scales[3][5] = f32::NAN;
        assert!(FeatureColors::of(&scales, 2).is_err());
    }
}

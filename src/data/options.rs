//! How a scene folder is read, and which of its frames.

use super::Split;
use crate::config::{Association, Config, DataConfig, Layout, RawFormat, ScannetClasses};
use std::path::PathBuf;

/// How [`super::load`] reads a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LoadOptions {
    /// How the folder is laid out.
    pub layout: Layout,
    /// File within the folder that lists the frames, of layout `transforms`.
    pub transforms: String,
    /// nerfstudio's `dataparser_transforms.json`, whose world the poses are moved to.
    pub dataparser_transforms: Option<PathBuf>,
    /// Folder of photos within the folder, of layout `colmap`.
    pub images: String,
    /// Folder of raw labels within the scene folder, instead of the one that the frames or the layout name.
    pub raw_labels: Option<String>,
    /// Folder of masks within the scene folder. It replaces the masks that the frames or the layout name.
    /// [`NO_MASKS`](crate::config::NO_MASKS) for none.
    pub masks: Option<String>,
    /// How raw labels are stored.
    pub raw_format: RawFormat,
    /// Whether ids of raw labels are classes, or segments of their view that are to be put together.
    pub association: Association,
    /// Every `stride`-th frame of each split is read; at least 1.
    pub stride: usize,
    /// No more frames than this, evenly chosen; 0 means no limit.
    pub max_frames: usize,
    /// Longer side of a photo at most, in pixels; larger ones are reduced. 0 means no limit.
    pub max_side: usize,
    /// Class table for ScanNet.
    pub scannet_classes: ScannetClasses,
    /// sRGB colour that transparent pixels of photos are blended onto: what the scene is rendered over.
    pub background: [u8; 3],
    /// Megabytes (2^20 bytes) of decoded photos that a scene keeps; the others are decoded again at each use.
    pub decoded_mb: usize,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self::from(&DataConfig::default())
    }
}

impl From<&DataConfig> for LoadOptions {
    fn from(config: &DataConfig) -> Self {
        Self {
            layout: config.layout,
            transforms: config.transforms.clone(),
            dataparser_transforms: config.dataparser_transforms.clone(),
            images: config.images.clone(),
            raw_labels: (!config.raw_labels.is_empty()).then(|| config.raw_labels.clone()),
            masks: (!config.masks.is_empty()).then(|| config.masks.clone()),
            raw_format: config.raw_format,
            association: config.association,
            stride: config.stride,
            max_frames: config.max_frames,
            max_side: config.max_side,
            scannet_classes: config.scannet_classes,
            background: [0; 3],
            decoded_mb: config.decoded_mb,
        }
    }
}

impl From<&Config> for LoadOptions {
    fn from(config: &Config) -> Self {
        let background = config.raster.background.map(|c| (c * 255.0).round() as u8);
        Self {
            background,
            ..Self::from(&config.data)
        }
    }
}

impl LoadOptions {
    /// Which frames are read, as (index, split), ascending. `splits` are those that the folder defines. Without any, every 8th
    /// frame that is read is a test frame, from the first on.
    pub(crate) fn pick(&self, splits: &[Option<Split>]) -> Vec<(usize, Split)> {
        let wanted = if self.max_frames == 0 {
            splits.len()
        } else {
            self.max_frames
        };
        let mut stride = self.stride.max(splits.len().div_ceil(wanted.max(1))).max(1);
        loop {
            let picked = every(splits, stride);
            // Each split is rounded up by itself.
            if picked.len() <= wanted || stride >= splits.len() {
                return picked;
            }
            stride += 1;
        }
    }
}

/// At most `most` of the indices below `n`, evenly chosen.
pub(crate) fn evenly(n: usize, most: usize) -> Vec<usize> {
    let taken = n.min(most);
    (0..taken).map(|i| i * n / taken).collect()
}

fn every(splits: &[Option<Split>], stride: usize) -> Vec<(usize, Split)> {
    if splits.iter().all(Option::is_none) {
        let split = |i: usize| {
            if i.is_multiple_of(8) {
                Split::Test
            } else {
                Split::Train
            }
        };
        return (0..splits.len())
            .step_by(stride)
            .enumerate()
            .map(|(place, i)| (i, split(place)))
            .collect();
    }
    let mut seen = [0_usize; 2];
    let mut picked = Vec::new();
    for (i, split) in splits.iter().enumerate() {
        let split = split.unwrap_or(Split::Train);
        let count = &mut seen[usize::from(split == Split::Test)];
        if count.is_multiple_of(stride) {
            picked.push((i, split));
        }
        *count += 1;
    }
    picked
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(stride: usize, max_frames: usize) -> LoadOptions {
        LoadOptions {
            stride,
            max_frames,
            ..LoadOptions::default()
        }
    }

    #[test]
    fn thinning_keeps_both_splits() {
        let none = [None; 40];
        assert_eq!(
            options(1, 0)
                .pick(&none)
                .iter()
                .filter(|p| p.1 == Split::Test)
                .count(),
            5
        );
        let picked = options(3, 0).pick(&none);
        assert_eq!(
            (picked.len(), picked[1].0, picked[8]),
            (14, 3, (24, Split::Test))
        );
        // A stride of 8 does not leave the held-out frames only.
        assert_eq!(
            options(8, 0)
                .pick(&none)
                .iter()
                .filter(|p| p.1 == Split::Test)
                .count(),
            1
        );
        assert_eq!(options(1, 7).pick(&none).len(), 7);
        let splits: Vec<_> = (0..40)
            .map(|i| {
                Some(if i % 4 == 3 {
                    Split::Test
                } else {
                    Split::Train
                })
            })
            .collect();
        let picked = options(5, 0).pick(&splits);
        assert_eq!(picked.iter().filter(|p| p.1 == Split::Test).count(), 2);
        assert_eq!(picked.len(), 8);
        assert!(options(1, 9).pick(&splits).len() <= 9);
        assert!(options(1, 0).pick(&[]).is_empty());
        assert_eq!(options(0, 0).pick(&none).len(), 40);
    }
}

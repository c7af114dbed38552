//! One label a Gaussian: at each pixel the label whose Gaussians weigh most.
//!
//! The CPU's kernel sums the weights of the labels that a tile shows. A GPU blends one channel for each label, in blocks.

use super::tensors::ProjectedView;
use super::view::SplatView;
use crate::backend::device::{read, upload};
use crate::error::Result;
use crate::ops::CustomOp;
use burn::tensor::{Device, Tensor};
use std::ops::Range;
use std::sync::OnceLock;

/// Bytes of one channel a label for all Gaussians, and labels that are blended together all the same.
const BLOCK_BYTES: usize = 1 << 30;
const MIN_CHANNELS: usize = 8;

/// The labels of a scene's Gaussians.
#[derive(Clone, Debug)]
pub(crate) struct GaussianLabels {
    /// `[N]`.
    labels: Vec<u16>,
    /// Those that occur, ascending.
    ids: Vec<u16>,
    /// Index among `ids` of each Gaussian's, `[N, 1]`, made at first use.
    indices: OnceLock<Tensor<2>>,
}

/// What [`SplatView::blend_labels`] returns.
pub(crate) struct LabelledImage {
    /// `[H, W, 3]` without background; empty without colours.
    pub rgb: Vec<f32>,
    /// `[H, W]`: the label whose Gaussians have the largest summed alpha' T. Ties go to the lower label; pixels without Gaussians
    /// are 0.
    pub labels: Vec<u16>,
    /// What shows of the background, `[H, W]`.
    pub transmittance: Vec<f32>,
}

impl GaussianLabels {
    pub fn new(labels: Vec<u16>) -> Self {
        let mut ids = labels.clone();
        ids.sort_unstable();
        ids.dedup();
        Self {
            labels,
            ids,
            indices: OnceLock::new(),
        }
    }

    /// Ranges of labels: those that `view` blends beside `others` channels, and further ones in passes of their own. An
    /// image of a range and its channels of all Gaussians each fit a block.
    fn blocks(&self, view: &SplatView, others: usize) -> Vec<Range<usize>> {
        let labels = self.ids.len();
        let of_image = view
            .channel_blocks(others + labels)
            .next()
            .map_or(labels, |block| block.len() - others);
        let of_gaussians = view.splats().channels_within(BLOCK_BYTES).max(MIN_CHANNELS);
        let together = of_image.min(of_gaussians).max(1);
        (0..labels)
            .step_by(together)
            .map(|first| first..(first + together).min(labels))
            .collect()
    }

    /// 1 where a Gaussian has a label of `block`, `[N, len]`.
    fn one_hot(&self, block: Range<usize>, device: &Device) -> Tensor<2> {
        let indices = self.indices.get_or_init(|| {
            let index = |label| self.ids.partition_point(|id| id < label) as f32;
            let indices: Vec<f32> = self.labels.iter().map(index).collect();
            upload(indices, [self.labels.len(), 1], device)
        });
        let shape = [self.labels.len(), block.len()];
        let columns = block.map(|index| index as f32).collect();
        let columns = upload(columns, [1, shape[1]], device).expand(shape);
        indices.clone().expand(shape).equal(columns).float()
    }
}

impl SplatView {
    /// At each pixel the label that weighs most, and the colour if there are `colours` `[N, 3]`.
    ///
    /// # Errors
    /// As [`SplatView::blend`].
    ///
    /// # Panics
    /// If there is not one label for each Gaussian.
    pub(crate) fn blend_labels(
        &self,
        colours: Option<Tensor<2>>,
        labels: &GaussianLabels,
    ) -> Result<LabelledImage> {
        let n = self.splats().len();
        assert_eq!(labels.labels.len(), n, "one label for each Gaussian");
        if !CustomOp::Raster.is_replaced()
            && let ProjectedView::F32(projected) = self.projected()?
        {
            let (blended, labels) = match colours {
                Some(colours) => {
                    projected.blend_labels::<4>(&read("colours", colours)?, &labels.labels)
                }
                None => projected.blend_labels::<1>(&[], &labels.labels),
            };
            return Ok(LabelledImage {
                rgb: blended.image,
                labels,
                transmittance: blended.transmittance,
            });
        }
        self.blend_one_hot(colours, labels)
    }

    /// [`SplatView::blend_labels`] with a channel for each label.
    fn blend_one_hot(
        &self,
        colours: Option<Tensor<2>>,
        labels: &GaussianLabels,
    ) -> Result<LabelledImage> {
        let others = colours.as_ref().map_or(0, |_| 3);
        let pixels = self.camera().width * self.camera().height;
        let mut beside = colours;
        let mut parts: Vec<Tensor<1>> = Vec::new();
        let mut largest: Option<Largest> = None;
        for block in labels.blocks(self, others) {
            let first = block.start as f64;
            let one_hot = labels.one_hot(block, &self.device());
            let found = match beside.take() {
                // The first block is blended together with the colours.
                Some(colours) => {
                    let (image, transmittance) =
                        self.blend(Tensor::cat(vec![colours, one_hot], 1))?;
                    parts.push(image.clone().narrow(2, 0, 3).reshape([3 * pixels]));
                    parts.push(transmittance.reshape([pixels]));
                    // Colours below any weight never win; slicing them off would copy all other channels.
                    let [height, width, _] = image.dims();
                    Largest::of(image.slice_fill([0..height, 0..width, 0..3], -1.0), -3.0)
                }
                None => {
                    let (image, transmittance) = self.blend(one_hot)?;
                    if parts.is_empty() {
                        parts.push(transmittance.reshape([pixels]));
                    }
                    Largest::of(image, first)
                }
            };
            largest = Some(match largest {
                Some(before) => before.or(found),
                None => found,
            });
        }
        let Some(largest) = largest else {
            return Ok(LabelledImage {
                rgb: vec![0.0; others * pixels],
                labels: vec![0; pixels],
                transmittance: vec![1.0; pixels],
            });
        };
        parts.push(largest.indices());
        let mut rgb = read("a label map", Tensor::cat(parts, 0))?;
        let mut transmittance = rgb.split_off(others * pixels);
        let indices = transmittance.split_off(pixels);
        // A pixel with nothing at it has a negative index.
        let label = |index: f32| match index {
            0.0.. => labels.ids.get(index as usize).copied().unwrap_or(0),
            _ => 0,
        };
        Ok(LabelledImage {
            rgb,
            labels: indices.into_iter().map(label).collect(),
            transmittance,
        })
    }
}

/// The largest channel at each pixel.
#[derive(Clone)]
pub(crate) struct Largest {
    /// Its value, `[H, W, 1]`.
    pub value: Tensor<3>,
    /// Its number, `[H, W, 1]`.
    pub index: Tensor<3>,
}

impl Largest {
    /// The largest channels of `image`, `[H, W, C]`. Its first channel has the number `first`. Ties go to the lower number.
    pub fn of(image: Tensor<3>, first: f64) -> Self {
        let (value, index) = image.max_dim_with_indices(2);
        Self {
            value,
            index: index.float() + first,
        }
    }

    /// The larger of both at each pixel, `self` where they are equal.
    pub fn or(self, other: Self) -> Self {
        let better = other.value.clone().greater(self.value.clone());
        Self {
            value: self.value.mask_where(better.clone(), other.value),
            index: self.index.mask_where(better, other.index),
        }
    }

    /// The numbers, `[H W]`, -1 where no channel is above 0.
    pub fn indices(self) -> Tensor<1> {
        let [height, width, _] = self.value.dims();
        self.index
            .mask_fill(self.value.lower_equal_elem(0.0), -1.0)
            .reshape([height * width])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::device::{BackendName, device_of_tests};

    #[test]
    fn equal_labels_go_to_the_lower_one_within_and_between_blocks() {
        for device in BackendName::compiled()
            .iter()
            .filter_map(|&name| device_of_tests(name))
        {
            let block = |values: [f32; 4], first| {
                Largest::of(Tensor::from_data([[values]], &device), first)
            };
            let index =
                |largest: Largest| largest.index.into_data().into_vec::<f32>().expect("floats")[0];
            assert_eq!(index(block([0.1, 0.4, 0.4, 0.3], 8.0)), 9.0, "{device:?}");
            let between = |a, b| index(block(a, 0.0).or(block(b, 4.0)));
            assert_eq!(
                between([0.0, 0.0, 0.5, 0.0], [0.5, 0.5, 0.0, 0.0]),
                2.0,
                "{device:?}"
            );
            assert_eq!(
                between([0.0, 0.0, 0.5, 0.0], [0.0, 0.6, 0.6, 0.0]),
                5.0,
                "{device:?}"
            );
        }
    }
}

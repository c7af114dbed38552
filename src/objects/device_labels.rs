//! One label a Gaussian on a GPU: the label that weighs most at each pixel, by blending a channel for each.

use crate::backend::device::largest_allocation;
use crate::raster::SplatView;
use burn::tensor::{Device, Tensor, TensorData};
use std::ops::Range;

/// Bytes of one channel a label for all Gaussians, and labels that are blended together all the same.
const BLOCK_BYTES: usize = 1 << 30;
const FEWEST: usize = 8;

/// The largest weight of a label at each pixel and the index of that label, both `[H, W, 1]`.
pub(super) type Largest = (Tensor<3>, Tensor<3>);

/// The labels of a scene's Gaussians.
#[derive(Debug)]
pub(super) struct DeviceLabels {
    /// Those that occur, ascending.
    ids: Vec<u16>,
    /// Index among them of each Gaussian's, `[N, 1]`.
    of_gaussians: Tensor<2>,
    /// Labels that were blended first in the last view, and 1 where a Gaussian has one, `[N, len]`.
    first: (Range<usize>, Tensor<2>),
}

impl DeviceLabels {
    pub fn new(labels: &[u16], device: &Device) -> Self {
        let mut ids = labels.to_vec();
        ids.sort_unstable();
        ids.dedup();
        let index = |label| ids.partition_point(|id| id < label) as f32;
        let of_gaussians: Vec<f32> = labels.iter().map(index).collect();
        let of_gaussians =
            Tensor::from_data(TensorData::new(of_gaussians, [labels.len(), 1]), device);
        let first = (0..0, Tensor::zeros([1, 1], device));
        Self {
            ids,
            of_gaussians,
            first,
        }
    }

    /// The labels that occur, ascending: what an index stands for.
    pub fn ids(&self) -> &[u16] {
        &self.ids
    }

    /// Ranges of labels: those that `view` blends beside `others` channels, and further ones in passes of their own. Neither an
    /// image of them nor a channel a Gaussian is more than a block may have.
    pub fn blocks(&self, view: &SplatView, others: usize) -> Vec<Range<usize>> {
        let labels = self.ids.len();
        let of_image = view
            .channel_blocks(others + labels)
            .next()
            .map_or(labels, |block| block.len() - others);
        let [n, _] = self.of_gaussians.dims();
        let most = largest_allocation(&self.of_gaussians.device())
            .map_or(BLOCK_BYTES, |most| (most / 4).min(BLOCK_BYTES));
        let of_gaussians = (most / (n * size_of::<f32>()).max(1)).max(FEWEST);
        let together = of_image.min(of_gaussians);
        (0..labels)
            .step_by(together)
            .map(|first| first..(first + together).min(labels))
            .collect()
    }

    /// [`DeviceLabels::one_hot`], kept for the next view.
    pub fn first(&mut self, block: Range<usize>) -> Tensor<2> {
        if self.first.0 != block {
            self.first = (block.clone(), self.one_hot(block));
        }
        self.first.1.clone()
    }

    /// 1 where a Gaussian has a label of `block`, `[N, len]`.
    pub fn one_hot(&self, block: Range<usize>) -> Tensor<2> {
        one_hot(
            &self.of_gaussians,
            block.map(|index| index as f32).collect(),
        )
    }
}

/// 1 where the one value of a row of `[rows, 1]` is the value of the column, `[rows, values]`.
pub(super) fn one_hot(of_rows: &Tensor<2>, values: Vec<f32>) -> Tensor<2> {
    let (rows, columns) = (of_rows.dims()[0], values.len());
    let values = Tensor::<2>::from_data(TensorData::new(values, [1, columns]), &of_rows.device());
    of_rows
        .clone()
        .expand([rows, columns])
        .equal(values.expand([rows, columns]))
        .float()
}

/// The largest channel of `weights`, `[H, W, C]`, the first of which is label `first`; ties to the lower one.
pub(super) fn largest_of(weights: Tensor<3>, first: f64) -> Largest {
    let (weight, index) = weights.max_dim_with_indices(2);
    (weight, index.float() + first)
}

/// The larger of both at each pixel, the former where they are equal.
pub(super) fn larger_of(a: Largest, b: Largest) -> Largest {
    let better = b.0.clone().greater(a.0.clone());
    (
        a.0.mask_where(better.clone(), b.0),
        a.1.mask_where(better, b.1),
    )
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
            let block =
                |values: [f32; 4], first| largest_of(Tensor::from_data([[values]], &device), first);
            let index =
                |largest: Largest| largest.1.into_data().into_vec::<f32>().expect("floats")[0];
            assert_eq!(index(block([0.1, 0.4, 0.4, 0.3], 8.0)), 9.0, "{device:?}");
            let between = |a, b| index(larger_of(block(a, 0.0), block(b, 4.0)));
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

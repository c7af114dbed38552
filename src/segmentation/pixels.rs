//! Labelled pixels of a training view, and the frozen blending weights that connect them to the Gaussians.

use crate::error::Result;
use crate::ops::{SparseMatrix, sparse_apply};
use burn::tensor::{Device, Int, Tensor, TensorData};
use std::sync::Arc;

/// The label of pixels that do not count.
pub const UNLABELLED: u16 = u16::MAX;

/// Blends the V Gaussians that a view sees into its pixels, with frozen weights. The weights of a pixel sum to 1.
pub trait Blending: std::fmt::Debug + Send + Sync {
    /// Blends `values` `[V, C]` at the pixels `pixels` (row-major numbers): `[P, C]`, with gradient to `values`.
    ///
    /// # Errors
    /// When the device fails.
    fn blend(&self, values: Tensor<2>, pixels: &[u32]) -> Result<Tensor<2>>;
}

/// The weights of [`LabelledPixels`].
#[derive(Clone, Debug)]
pub enum PixelWeights {
    /// Stored as a matrix `[R, V]` whose rows sum to 1.
    Stored(Arc<SparseMatrix>),
    /// Computed anew at each use; rows are the pixels of a view.
    Rendered(Arc<dyn Blending>),
}

/// Labelled pixels of a view over the Gaussians it sees.
#[derive(Clone, Debug)]
pub struct LabelledPixels {
    /// Frozen blending weights.
    pub weights: PixelWeights,
    /// Rows of `weights`, one for each pixel.
    pub rows: Arc<Vec<u32>>,
    /// Class index of each pixel, or [`UNLABELLED`].
    pub labels: Arc<Vec<u16>>,
}

impl LabelledPixels {
    /// The rows `rows` of `weights`, with one class index each.
    pub fn new(weights: PixelWeights, rows: Vec<u32>, labels: Vec<u16>) -> Self {
        Self {
            weights,
            rows: Arc::new(rows),
            labels: Arc::new(labels),
        }
    }

    /// The pixels that have a label.
    #[must_use]
    pub fn labelled(&self) -> Self {
        if !self.labels.contains(&UNLABELLED) {
            return self.clone();
        }
        let pixels = self.rows.iter().zip(self.labels.iter());
        let (rows, labels) = pixels.filter(|(_, label)| **label != UNLABELLED).unzip();
        Self::new(self.weights.clone(), rows, labels)
    }

    /// The pixels at `places`.
    #[must_use]
    pub fn at(&self, places: &[usize]) -> Self {
        let rows = places.iter().map(|&place| self.rows[place]).collect();
        let labels = places.iter().map(|&place| self.labels[place]).collect();
        Self::new(self.weights.clone(), rows, labels)
    }

    /// Blends `values` `[V, C]` at the pixels: `[P, C]`, with gradient to `values`.
    ///
    /// # Errors
    /// Those of [`Blending::blend`].
    pub fn blend(&self, values: Tensor<2>) -> Result<Tensor<2>> {
        match &self.weights {
            PixelWeights::Stored(weights) => {
                let rows = weights.select_rows(&self.rows);
                Ok(sparse_apply(values, Arc::new(rows)))
            }
            PixelWeights::Rendered(view) => view.blend(values, &self.rows),
        }
    }

    /// Blends only the channel of each pixel's label: `[P, 1]` from `values` `[V, C]`. All pixels must be labelled.
    ///
    /// With stored weights this costs one multiplication for each weight, for any number of classes.
    ///
    /// # Errors
    /// Those of [`Blending::blend`].
    pub fn blend_own_class(&self, values: Tensor<2>) -> Result<Tensor<2>> {
        let [gaussians, classes] = values.dims();
        let PixelWeights::Stored(weights) = &self.weights else {
            let blended = self.blend(values)?;
            let own = one_hot(&self.labels, &blended);
            return Ok((blended * own).sum_dim(1));
        };
        let labels = self.labels.iter().map(|&label| u32::from(label));
        let own = weights.select_channels(&self.rows, labels, classes as u32);
        let flat = values.reshape([gaussians * classes, 1]);
        Ok(sparse_apply(flat, Arc::new(own)))
    }
}

/// 1 at each pixel's label, else 0: a constant of the shape of `values` `[P, C]`.
pub(crate) fn one_hot(labels: &[u16], values: &Tensor<2>) -> Tensor<2> {
    let shape = values.dims();
    let device = values.device();
    let plain = device.clone().inner();
    let labels: Vec<i32> = labels.iter().map(|&label| i32::from(label)).collect();
    let labels = Tensor::<2, Int>::from_data(TensorData::new(labels, [shape[0], 1]), &plain);
    let numbers = Tensor::<1, Int>::arange(0..shape[1] as i64, &plain).reshape([1, shape[1]]);
    let same = labels.expand(shape).equal(numbers.expand(shape));
    constant(same.float().cast(values.dtype()), &device)
}

/// A tensor without autodiff, beside tensors of `device`.
pub(crate) fn constant<const D: usize>(tensor: Tensor<D>, device: &Device) -> Tensor<D> {
    if device.is_autodiff() && !tensor.device().is_autodiff() {
        Tensor::from_inner(tensor)
    } else {
        tensor
    }
}

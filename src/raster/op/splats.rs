//! The geometry of Gaussians as tensors.

use super::tensors::RasterTensors;
use crate::backend::device::{in_host_memory, indices, largest_allocation, upload};
use crate::error::{Result, ensure};
use crate::splat::Gaussians;
use burn::backend::Dispatch;
use burn::tensor::{DType, Device, Tensor};

/// Geometry of N Gaussians on a device, frozen: no gradient goes there.
#[derive(Clone, Debug)]
pub struct SplatTensors {
    /// `[N, 3]`, world units.
    pub means: Tensor<2>,
    /// `[N, 3]`, natural logarithms.
    pub log_scales: Tensor<2>,
    /// `[N, 4]` (w, x, y, z), not normalised.
    pub rotations: Tensor<2>,
    /// `[N]`.
    pub opacity_logits: Tensor<1>,
}

impl SplatTensors {
    /// The geometry of `gaussians` on `device`, in f32 and without autodiff.
    pub fn new(gaussians: &Gaussians, device: &Device) -> Self {
        let device = device.clone().inner();
        let n = gaussians.len();
        let rows = |values: &[f32], width| upload(values.to_vec(), [n, width], &device);
        Self {
            means: rows(gaussians.means.as_flattened(), 3),
            log_scales: rows(gaussians.log_scales.as_flattened(), 3),
            rotations: rows(gaussians.rotations.as_flattened(), 4),
            opacity_logits: upload(gaussians.opacity_logits.clone(), [n], &device),
        }
    }

    /// The same tensors without autodiff.
    #[must_use]
    pub(super) fn inner(self) -> Self {
        Self {
            means: self.means.inner(),
            log_scales: self.log_scales.inner(),
            rotations: self.rotations.inner(),
            opacity_logits: self.opacity_logits.inner(),
        }
    }

    /// The tensors of a call with this geometry; absent ones are empty.
    pub(super) fn with_values(
        self,
        sh: Option<Tensor<3>>,
        features: Option<Tensor<2>>,
        screen: Option<Tensor<2>>,
    ) -> RasterTensors<Dispatch> {
        let place = (&self.device(), self.means.dtype());
        let absent = || Tensor::<2>::zeros([self.len(), 0], place).into_dispatch();
        RasterTensors {
            sh: sh.map_or_else(absent, Tensor::into_dispatch),
            features: features.map_or_else(absent, Tensor::into_dispatch),
            screen: screen.map_or_else(absent, Tensor::into_dispatch),
            means: self.means.into_dispatch(),
            log_scales: self.log_scales.into_dispatch(),
            rotations: self.rotations.into_dispatch(),
            opacity_logits: self.opacity_logits.into_dispatch(),
        }
    }

    /// Where they live, without autodiff.
    pub fn device(&self) -> Device {
        self.means.device()
    }

    /// Whether [`SplatView::weights`](super::SplatView::weights) exist. A GPU blends anew at each use.
    pub(crate) fn have_stored_weights(&self) -> bool {
        in_host_memory(&self.device())
    }

    /// How many channels of all Gaussians a quarter of one allocation holds, `most` bytes at most.
    pub(crate) fn channels_within(&self, most: usize) -> usize {
        let bytes = largest_allocation(&self.device()).map_or(most, |all| (all / 4).min(most));
        bytes / (self.len() * size_of::<f32>()).max(1)
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.opacity_logits.dims()[0]
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The Gaussians `rows` alone, in that order.
    ///
    /// # Panics
    /// If a row is not below N.
    #[must_use]
    pub fn select(&self, rows: &[u32]) -> Self {
        let index = indices(rows, &self.means.device());
        Self {
            means: self.means.clone().select(0, index.clone()),
            log_scales: self.log_scales.clone().select(0, index.clone()),
            rotations: self.rotations.clone().select(0, index.clone()),
            opacity_logits: self.opacity_logits.clone().select(0, index),
        }
    }

    /// Whether shapes and float types agree, the latter with `dtype`.
    pub(super) fn check(&self, dtype: DType) -> Result<()> {
        let n = self.len();
        let matrices = [&self.means, &self.log_scales, &self.rotations];
        let shapes = matrices.map(Tensor::dims);
        let expected = [[n, 3], [n, 3], [n, 4]];
        let [means, log_scales, rotations] = matrices.map(Tensor::dtype);
        let types = [means, log_scales, rotations, self.opacity_logits.dtype()];
        ensure!(shapes == expected && types == [dtype; 4],
            argument "frozen Gaussians"; found "{shapes:?}, {types:?}"; expected "{expected:?}, all {dtype:?}";
            help "pass tensors of one scene and one float type");
        Ok(())
    }
}

//! The inputs of a call.

use super::sh::Harmonics;
use burn::backend::ops::FloatTensorOps;
use burn_cubecl::CubeBackend;
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;

/// The inputs of one call, contiguous `f32` tensors on one device.
pub(crate) struct Inputs {
    /// `[N, 3]`.
    pub means: CubeTensor,
    /// `[N, 3]`.
    pub log_scales: CubeTensor,
    /// `[N, 4]`.
    pub rotations: CubeTensor,
    /// `[N]`.
    pub logits: CubeTensor,
    /// Coefficients `[N, K, 3]`.
    pub sh: Option<Harmonics>,
    /// `[N, C]`, C above 0.
    pub features: Option<CubeTensor>,
}

impl Inputs {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.logits.meta.num_elements()
    }

    /// The coefficients of SH and the features, where they are given.
    pub(super) fn coefficients_and_features(&self) -> impl Iterator<Item = &CubeTensor> {
        let coefficients = self.sh.iter().map(|harmonics| &harmonics.sh);
        coefficients.chain(&self.features)
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        let colours = self.sh.as_ref().map_or(0, |_| 3);
        let width = |t: &CubeTensor| t.meta.num_elements() / self.len().max(1);
        colours + self.features.as_ref().map_or(0, width)
    }

    /// `colours` `[N, 3]` and the features side by side, `[N, C]`.
    pub fn values(&self, colours: Option<CubeTensor>) -> CubeTensor {
        let parts: Vec<CubeTensor> = colours.into_iter().chain(self.features.clone()).collect();
        match &parts[..] {
            [only] => only.clone(),
            _ => into_contiguous(CubeBackend::float_cat(parts, 1)),
        }
    }
}

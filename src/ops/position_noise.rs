//! The noise of 3DGS-MCMC on a GPU.

use burn::backend::{Backend, Dispatch, backend_extension, tensor::FloatTensor};
use burn::tensor::Tensor;

/// Noise of one iteration: what a kernel needs besides the tensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseStep {
    /// Of the normal numbers.
    pub key: [u32; 2],
    /// One over world units.
    pub scale: f32,
    /// Of the gate.
    pub sharpness: f32,
    /// Where the gate is half open.
    pub opacity: f32,
}

/// Adds noise on a GPU, to tensors that lie there.
#[backend_extension(Cube: cfg(feature = "cube"))]
pub trait NoiseBackend: Backend {
    /// `means` with noise, `[N, 3]`.
    fn add_position_noise(
        means: FloatTensor<Self>,
        log_scales: FloatTensor<Self>,
        rotations: FloatTensor<Self>,
        opacity_logits: FloatTensor<Self>,
        step: NoiseStep,
    ) -> FloatTensor<Self>;
}

/// The means (`[N, 3]`) with the noise of [`crate::reconstruction::noise::PositionNoise`]; `log_scales` are `[N, 3]`, `rotations`
/// `[N, 4]`, `opacity_logits` `[N]`, all on a GPU and without autodiff.
pub(crate) fn add_position_noise(
    [means, log_scales, rotations]: [Tensor<2>; 3],
    opacity_logits: Tensor<1>,
    step: NoiseStep,
) -> Tensor<2> {
    Tensor::from_dispatch(Dispatch::add_position_noise(
        means.into_dispatch(),
        log_scales.into_dispatch(),
        rotations.into_dispatch(),
        opacity_logits.into_dispatch(),
        step,
    ))
}

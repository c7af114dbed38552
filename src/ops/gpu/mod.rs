//! Operations of this crate by CubeCL kernels: the CPU's formulas in `f32`, sums in a fixed order, no float atomics.

mod label_loss;
mod numeric;
mod photometric;
mod sparse;
mod sum;

pub(super) use photometric::DevicePhoto;
pub(super) use sparse::DeviceMatrix;

use burn::tensor::DType;
use burn_cubecl::tensor::CubeTensor;

/// Whether kernels take `tensor`; what is not `f32` goes to the host's.
fn covers(tensor: &CubeTensor) -> bool {
    tensor.dtype == DType::F32
}

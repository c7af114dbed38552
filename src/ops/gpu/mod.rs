//! Operations of this crate by CubeCL kernels: the CPU's formulas in `f32`, sums in a fixed order, no float atomics.

mod adam;
mod dense;
mod finite;
mod fusion_layer;
mod gather;
mod label_loss;
mod neighbour_divergence;
mod numeric;
mod photo;
mod photometric;
mod position_noise;
mod rows;
mod screen_gradient;
mod sparse;
mod sum;
mod tile_window;

pub(super) use self::photo::{DeviceBytes, DevicePhoto};
pub(super) use self::sparse::DeviceMatrix;

use burn::tensor::DType;
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;

/// `tensor` where a kernel may write: itself if nobody else holds it, or a copy.
fn own(tensor: CubeTensor) -> CubeTensor {
    let tensor = into_contiguous(tensor);
    // A copy may have its rows padded.
    if tensor.can_mut() {
        tensor
    } else {
        into_contiguous(tensor.copy())
    }
}

/// Whether kernels take `tensor`; what is not `f32` goes to the host's.
fn covers(tensor: &CubeTensor) -> bool {
    tensor.dtype == DType::F32
}

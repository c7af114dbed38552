//! Operations of this crate by CubeCL kernels: the CPU's formulas in `f32`, sums in a fixed order, no float atomics.

use burn::tensor::DType;
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;

/// `tensor` where a kernel may write: itself if nobody else holds it, or a copy.
pub(super) fn own(tensor: CubeTensor) -> CubeTensor {
    let tensor = into_contiguous(tensor);
    // A copy may have its rows padded.
    if tensor.can_mut() {
        tensor
    } else {
        into_contiguous(tensor.copy())
    }
}

/// Whether the GPU's kernels take `tensor`. Other types go to the CPU's kernels.
pub(super) fn covers(tensor: &CubeTensor) -> bool {
    tensor.dtype == DType::F32
}

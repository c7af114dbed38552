//! Tensor contents as slices, on every backend.

use super::Real;
use burn::backend::{Backend, TensorMetadata, tensor::FloatTensor};
use std::cell::Cell;
use std::ops::Deref;

/// The row-major contents of a tensor in host memory.
pub enum HostValues<E> {
    /// A copy, or the tensor's own buffer.
    Owned(Vec<E>),
    /// A shared ndarray buffer in standard layout.
    #[cfg(feature = "ndarray")]
    Shared(ndarray::ArcArray<E, ndarray::IxDyn>),
    /// A flex buffer, perhaps shared, whose values lie in order.
    #[cfg(feature = "flex")]
    Flex(burn::backend::flex::FlexTensor),
}

impl<E: Real> Deref for HostValues<E> {
    type Target = [E];
    fn deref(&self) -> &[E] {
        match self {
            Self::Owned(values) => values,
            #[cfg(feature = "ndarray")]
            Self::Shared(array) => array.as_slice().unwrap_or(&[]), // standard layout by construction: always Some
            #[cfg(feature = "flex")]
            Self::Flex(tensor) => E::of_flex(tensor).unwrap_or(&[]), // in order by construction: always Some
        }
    }
}

impl<E: Real> HostValues<E> {
    /// The values as a vector; no copy when the buffer is not shared.
    pub fn into_vec(self) -> Vec<E> {
        match self {
            Self::Owned(values) => values,
            #[cfg(feature = "ndarray")]
            Self::Shared(array) => {
                let len = array.len();
                let (mut values, offset) = array.into_owned().into_raw_vec_and_offset();
                // A view of a part of the buffer.
                values.drain(..offset.unwrap_or(0));
                values.truncate(len);
                values
            }
            #[cfg(feature = "flex")]
            Self::Flex(tensor) => copy_out::<burn::backend::Flex, E>(tensor), // takes the buffer over unless it is shared
        }
    }
}

/// A backend whose tensors can be read and made as slices in host memory.
///
/// On CPU backends this costs nothing where the layout is contiguous; on a GPU it copies both ways.
pub trait HostBackend: Backend {
    /// Row-major contents of `tensor`, whose dtype must be `E`'s.
    fn values<E: Real>(tensor: FloatTensor<Self>) -> HostValues<E>;
    /// A tensor of `values` in row-major order on `device`.
    fn tensor<E: Real>(values: Vec<E>, shape: &[usize], device: &Self::Device)
    -> FloatTensor<Self>;
}

/// Runs `$body` with the type `$e` bound to the element type of `$tensor` (f32 or f64).
macro_rules! real_kernel {
    ($tensor:expr, $e:ident => $body:expr) => {
        match burn::backend::TensorMetadata::dtype(&$tensor) {
            burn::tensor::DType::F64 => {
                type $e = f64;
                $body
            }
            _ => {
                type $e = f32;
                $body
            }
        }
    };
}
pub(crate) use real_kernel;

thread_local! {
    static FALLBACKS: Cell<usize> = const { Cell::new(0) };
}

/// Number of GPU tensors that calls on this thread passed to kernels for the CPU.
pub fn host_fallbacks() -> usize {
    FALLBACKS.get()
}

#[cfg(feature = "ndarray")]
mod on_ndarray {
    use super::*;
    use burn::backend::NdArray;
    use ndarray::{ArcArray, IxDyn};

    impl HostBackend for NdArray {
        fn values<E: Real>(tensor: FloatTensor<Self>) -> HostValues<E> {
            let dtype = tensor.dtype();
            match E::of_ndarray(tensor) {
                Some(array) if array.is_standard_layout() => HostValues::Shared(array),
                Some(array) => HostValues::Owned(array.iter().copied().collect()),
                None => panic!(
                    "kernel called with {dtype:?} where {:?} was expected",
                    E::dtype()
                ),
            }
        }
        fn tensor<E: Real>(
            values: Vec<E>,
            shape: &[usize],
            _device: &Self::Device,
        ) -> FloatTensor<Self> {
            match ArcArray::from_shape_vec(IxDyn(shape), values) {
                Ok(array) => E::into_ndarray(array),
                Err(error) => panic!("kernel output does not fill shape {shape:?}: {error}"),
            }
        }
    }
}

#[cfg(feature = "flex")]
mod on_flex {
    use super::*;
    use burn::backend::Flex;
    use burn::backend::flex::{FlexTensor, Layout};
    use burn::tensor::{Bytes, Shape};

    impl HostBackend for Flex {
        fn values<E: Real>(tensor: FloatTensor<Self>) -> HostValues<E> {
            match E::of_flex(&tensor) {
                Some(_) => HostValues::Flex(tensor),
                None => HostValues::Owned(copy_out::<Self, E>(tensor)),
            }
        }
        fn tensor<E: Real>(
            values: Vec<E>,
            shape: &[usize],
            _device: &Self::Device,
        ) -> FloatTensor<Self> {
            FlexTensor::new(
                Bytes::from_elems(values),
                Layout::contiguous(Shape::from(shape.to_vec())),
                E::dtype(),
            )
        }
    }
}

#[cfg(feature = "cube")]
mod on_cube {
    use super::*;
    use burn::backend::ops::FloatTensorOps;
    use burn::tensor::TensorData;
    use burn_cubecl::CubeBackend;

    /// Counts, and warns once, that a kernel runs on the CPU although its tensors live on a GPU.
    fn note_host_fallback() {
        FALLBACKS.set(FALLBACKS.get() + 1);
        static ONCE: std::sync::Once = std::sync::Once::new();
        ONCE.call_once(|| {
            tracing::warn!(
                "part of this run has no kernel for this GPU: it runs on the CPU and copies from and to the GPU (tensors of f64, \
                 images beyond one allocation, absolute screen-space gradients of more than 8 channels, and all rasterizing where the \
                 device binds too few buffers or shares too little memory)"
            );
        });
    }

    impl HostBackend for CubeBackend {
        fn values<E: Real>(tensor: FloatTensor<Self>) -> HostValues<E> {
            note_host_fallback();
            HostValues::Owned(copy_out::<Self, E>(tensor))
        }
        fn tensor<E: Real>(
            values: Vec<E>,
            shape: &[usize],
            device: &Self::Device,
        ) -> FloatTensor<Self> {
            Self::float_from_data(TensorData::new(values, shape.to_vec()), device)
        }
    }
}

#[cfg(any(feature = "flex", feature = "cube"))]
fn copy_out<B: Backend, E: Real>(tensor: FloatTensor<B>) -> Vec<E> {
    let dtype = tensor.dtype();
    let data = burn::tensor::read_sync(B::float_into_data(tensor));
    match data.map(|d| d.into_vec::<E>()) {
        Ok(Ok(values)) => values,
        Ok(Err(error)) => panic!(
            "kernel called with {dtype:?} where {:?} was expected: {error:?}",
            E::dtype()
        ),
        Err(error) => panic!("reading a tensor back from the device failed: {error:?}"),
    }
}

/// The device of a tensor; a shorter name for the adapters.
pub(crate) fn device_of<B: Backend>(tensor: &FloatTensor<B>) -> B::Device {
    TensorMetadata::device(tensor)
}

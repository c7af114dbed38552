//! Device buffers, and how many cubes a kernel is launched with.

use burn::tensor::{DType, Element, Shape};
use burn_cubecl::cubecl::{calculate_cube_count_elemwise, prelude::*};
use burn_cubecl::ops::numeric::{empty_device_contiguous_dtype, full_client};
use burn_cubecl::{CubeDevice, tensor::CubeTensor};

/// Units of a cube, in all kernels: the pixels of a tile.
pub const UNITS: u32 = 256;

/// Where a call's buffers live.
#[derive(Clone)]
pub struct Gpu {
    pub client: Client,
    pub device: CubeDevice,
}

impl Gpu {
    /// The device of `tensor`.
    pub fn of(tensor: &CubeTensor) -> Self {
        Self {
            client: tensor.client.clone(),
            device: tensor.device.clone(),
        }
    }

    /// A device without a tensor.
    #[cfg(test)]
    pub fn on(device: CubeDevice) -> Self {
        Self {
            client: device.client(),
            device,
        }
    }

    /// Uninitialised floats; at least one, because a binding cannot be empty.
    pub fn floats(&self, shape: impl Into<Shape>) -> CubeTensor {
        self.empty(shape.into(), DType::F32)
    }

    /// Uninitialised `u32`s; at least one.
    pub fn words(&self, len: usize) -> CubeTensor {
        self.empty(Shape::new([len]), DType::U32)
    }

    /// `len` times `value`; at least once.
    pub fn filled(&self, len: usize, value: u32) -> CubeTensor {
        let client = self.client.clone();
        let device = self.device.clone();
        full_client(client, Shape::new([len.max(1)]), device, value)
    }

    fn empty(&self, shape: Shape, dtype: DType) -> CubeTensor {
        let shape = if shape.num_elements() == 0 {
            Shape::new([1])
        } else {
            shape
        };
        empty_device_contiguous_dtype(self.client.clone(), self.device.clone(), shape, dtype)
    }

    /// `values` on the device; without any, one that is uninitialised.
    pub fn upload<E: CubeElement + Element>(&self, values: &[E]) -> CubeTensor {
        if values.is_empty() {
            return self.empty(Shape::new([0]), E::dtype());
        }
        let handle = self.client.create_from_slice(E::as_bytes(values));
        let shape = Shape::new([values.len()]);
        CubeTensor::new_contiguous(
            self.client.clone(),
            self.device.clone(),
            shape,
            handle,
            E::dtype(),
        )
    }

    /// Cubes for `units` units.
    pub fn cubes_for(&self, units: usize) -> CubeCount {
        calculate_cube_count_elemwise(&self.client, units, self.dim())
    }

    /// `cubes` cubes, perhaps a few more, which a kernel has to skip.
    pub fn cubes(&self, cubes: usize) -> CubeCount {
        self.cubes_for(cubes * UNITS as usize)
    }

    /// Bytes of the largest buffer.
    pub fn largest(&self) -> usize {
        largest_buffer(&self.client)
    }

    /// Size of all cubes.
    pub fn dim(&self) -> CubeDim {
        CubeDim::new_1d(UNITS)
    }
}

/// Bytes of the largest buffer of a device.
pub fn largest_buffer(client: &Client) -> usize {
    usize::try_from(client.properties().memory.max_page_size).unwrap_or(usize::MAX)
}

/// Launches a kernel on `cubes` cubes. Buffers come first, then numbers and constants: `launch!(gpu, kernel, gpu.cubes_for(n); a,
/// &b; n as u32)`.
macro_rules! launch {
    ($gpu:expr, $kernel:ident, $cubes:expr; $($buffer:expr),+; $($value:expr),+) => {
        $kernel::launch(
            &$gpu.client, $cubes, $gpu.dim(),
            $(burn_cubecl::tensor::CubeTensor::clone($buffer).into_buffer_arg(),)+ $($value),+
        )
    };
}
pub(crate) use launch;

//! What the GPU kernels of this crate stand on: buffers and launch sizes, and host values that stay on a device.

mod buffers;
mod resident;

pub use buffers::{Gpu, UNITS, arg};
pub use resident::Resident;

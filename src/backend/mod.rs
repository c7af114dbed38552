//! Devices, access to tensors from the host, GPU buffers, SIMD.

mod custom_op;
pub mod device;
pub(crate) mod elementary;
#[cfg(feature = "cube")]
pub(crate) mod gpu;
pub(crate) mod host;
pub(crate) mod real;
mod resident;
pub(crate) mod simd;

pub(crate) use self::custom_op::{AutodiffTensor, custom_op, track};
pub use self::host::HostBackend;
pub use self::host::HostValues;
pub(crate) use self::host::device_of;
pub use self::host::host_fallbacks;
pub(crate) use self::host::real_kernel;
pub use self::real::Real;
pub(crate) use self::real::check_finite;
pub(crate) use self::resident::Resident;

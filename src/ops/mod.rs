//! What every custom burn operation of this crate stands on: kernels are plain slices-in, slices-out Rust, and
//! [`HostBackend`] lends them the contents of a tensor on any backend.

mod host;
mod real;
pub(crate) mod simd;
mod sparse;

pub(crate) use host::device_of;
pub(crate) use host::real_kernel;
pub use host::{HostBackend, HostValues, warn_host_fallback};
pub use real::Real;
pub use sparse::{SparseBackend, SparseMatrix, sparse_apply};

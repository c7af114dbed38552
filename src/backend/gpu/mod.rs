//! Basics of the GPU kernels: buffers and launch sizes, counts of non-finite values, sums.

mod buffers;
mod finite;
mod requirements;
mod sum;

pub(crate) use self::buffers::launch;
pub use self::buffers::{Gpu, UNITS, largest_buffer};
pub use self::finite::{add_non_finite, is_finite};
pub use self::requirements::missing_capability;
pub use self::sum::sum_cube;

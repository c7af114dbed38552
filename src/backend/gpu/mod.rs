//! Basics of the GPU kernels: buffers and launch sizes, counts of non-finite values, and host values that stay on a device.

mod buffers;
mod finite;
mod needs;
mod resident;
mod sum;

pub use self::buffers::{Gpu, UNITS, arg, largest_buffer};
pub use self::finite::{add_non_finite, is_finite};
pub use self::needs::shortfall;
pub use self::resident::Resident;
pub use self::sum::{sum, sum_cube};

//! The custom burn operations beside the rasterizer, and sums in a fixed order.

mod adam;
#[cfg(feature = "cube")]
mod gpu;
mod photometric;
mod sparse;
mod sum;

pub use self::adam::{AdamStep, AdamTensors, adam_step, adam_step_plain};
pub use self::photometric::{PhotometricTarget, photometric_loss, photometric_loss_plain};
pub use self::sparse::{SparseBackend, SparseMatrix, sparse_apply, sparse_apply_plain};
pub(crate) use self::sparse::{select, selected};
pub use self::sum::sum_all;

use std::cell::Cell;

/// Custom operations that tests and benchmarks replace by their references.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CustomOp {
    /// The rasterizer, blending with frozen geometry, its adjoint, lifting.
    Raster,
    /// [`sparse_apply`].
    Sparse,
    /// [`photometric_loss`].
    Photometric,
    /// [`adam_step`].
    Adam,
}

impl CustomOp {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Raster, Self::Sparse, Self::Photometric, Self::Adam];

    /// Whether this thread runs the reference, see [`with_references`].
    pub(crate) fn is_replaced(self) -> bool {
        REPLACED.get().contains(&self)
    }
}

thread_local! {
    static REPLACED: Cell<&'static [CustomOp]> = const { Cell::new(&[]) };
}

/// Runs `f` with the operations `replaced` that this thread calls replaced by their plain-tensor references.
#[doc(hidden)]
pub fn with_references<T>(replaced: &'static [CustomOp], f: impl FnOnce() -> T) -> T {
    let before = REPLACED.replace(replaced);
    let out = f();
    REPLACED.set(before);
    out
}

//! What every custom burn operation of this crate stands on: kernels are plain slices-in, slices-out Rust, and
//! `HostBackend` lends them the contents of a tensor on any backend.

mod adam;
mod finite;
#[cfg(feature = "cube")]
mod gpu;
mod photometric;
mod sparse;
mod sum;

pub use self::adam::{AdamStep, AdamTensors, adam_step, adam_step_plain};
pub use self::finite::FiniteCheck;
pub use self::photometric::{PhotometricTarget, photometric_loss, photometric_loss_plain};
pub use self::sparse::{SparseBackend, SparseMatrix, sparse_apply, sparse_apply_plain};
pub use self::sum::sum_all;

use std::cell::Cell;

thread_local! {
    static REFERENCES: Cell<bool> = const { Cell::new(false) };
}

/// Runs `f` with every custom operation that this thread calls replaced by its plain-tensor reference. For tests.
#[doc(hidden)]
pub fn with_references<T>(f: impl FnOnce() -> T) -> T {
    let before = REFERENCES.replace(true);
    let out = f();
    REFERENCES.set(before);
    out
}

/// Whether custom operations run as their references, see [`with_references`].
pub(crate) fn references() -> bool {
    REFERENCES.get()
}

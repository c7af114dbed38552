//! What every custom burn operation of this crate stands on: kernels are plain slices-in, slices-out Rust, and
//! [`HostBackend`] lends them the contents of a tensor on any backend.

mod adam;
mod assignment;
mod attentive_pool;
mod blended_labels;
mod dense;
mod finite;
mod fusion_layer;
mod gather;
#[cfg(feature = "cube")]
mod gpu;
mod gradient_in_hand;
mod label_loss;
mod neighbour_divergence;
mod photometric;
mod pixel_labels;
mod sparse;
mod sum;

pub use self::adam::{AdamStep, AdamTensors, adam_step, adam_step_plain};
pub use self::assignment::assignment;
pub use self::attentive_pool::{PoolBackend, attentive_pool, attentive_pool_plain};
pub use self::blended_labels::{
    BlendedLabelBackend, Blending, LabelledPixels, PixelWeights, blended_label_loss,
    blended_label_loss_plain,
};
#[cfg(feature = "cube")]
pub use self::dense::DenseBackend;
pub use self::dense::dense;
pub use self::finite::FiniteCheck;
pub use self::fusion_layer::{
    FusionBackend, LayerGradients, LayerMap, LayerTensors, fusion_layer, fusion_layer_plain,
};
#[cfg(feature = "cube")]
pub use self::gather::GatherBackend;
pub use self::gather::{RowList, gather_rows};
pub use self::label_loss::{
    ClassLosses, Kind, LabelLossBackend, UNLABELLED, label_loss, label_losses,
};
pub use self::neighbour_divergence::{
    DivergenceBackend, NeighbourPairs, neighbour_divergence, neighbour_divergence_plain,
};
pub use self::photometric::{PhotometricTarget, photometric_loss, photometric_loss_plain};
pub use self::pixel_labels::PixelLabels;
pub use self::sparse::{Compact, SparseBackend, SparseMatrix, sparse_apply};
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

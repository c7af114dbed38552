//! What every custom burn operation of this crate stands on: kernels are plain slices-in, slices-out Rust, and
//! [`HostBackend`] lends them the contents of a tensor on any backend.

mod adam;
mod assignment;
mod attentive_pool;
mod blended_labels;
mod compared;
mod dense;
mod finite;
mod fusion_layer;
mod gather;
#[cfg(feature = "cube")]
mod gpu;
mod gradient_in_hand;
mod label_loss;
mod neighbour_divergence;
mod photo;
mod photometric;
mod pixel_labels;
#[cfg(feature = "cube")]
pub(crate) mod position_noise;
mod rows;
mod screen_gradient;
mod sparse;
mod sum;
mod window;

pub use self::adam::{
    AdamBackend, AdamStep, AdamTensors, adam_step, adam_step_plain, move_towards,
};
pub use self::assignment::assignment;
pub use self::attentive_pool::{PoolBackend, attentive_pool, attentive_pool_plain};
pub use self::blended_labels::{
    BlendedLabelBackend, Blending, LabelledPixels, PixelWeights, blended_label_loss,
    blended_label_loss_plain,
};
pub use self::compared::{Compared, PackedPhoto};
#[cfg(feature = "cube")]
pub use self::dense::DenseBackend;
pub use self::dense::dense;
#[cfg(feature = "cube")]
pub use self::finite::FiniteBackend;
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
pub use self::photo::Photo;
pub use self::photometric::{PhotometricBackend, photometric_loss, photometric_loss_plain};
pub use self::pixel_labels::PixelLabels;
pub use self::rows::{RowBackend, RowMap, StartOfNew, take_rows};
pub use self::screen_gradient::{ScreenGradientBackend, add_screen_gradients};
pub use self::sparse::{Compact, SparseBackend, SparseMatrix, sparse_apply};
#[cfg(feature = "cube")]
pub use self::sum::SumBackend;
pub use self::sum::sum_all;

//! What every custom burn operation of this crate stands on: kernels are plain slices-in, slices-out Rust, and
//! [`HostBackend`] lends them the contents of a tensor on any backend.

mod adam;
mod assignment;
mod attentive_pool;
#[cfg(target_arch = "x86_64")]
mod avx;
mod blended_labels;
mod compared;
mod dense;
pub(crate) mod elementary;
mod finite;
mod fusion_layer;
mod gather;
#[cfg(feature = "cube")]
mod gpu;
mod gradient_in_hand;
mod host;
mod label_loss;
pub(crate) mod matmul;
mod neighbour_divergence;
mod photo;
mod photometric;
mod pixel_labels;
#[cfg(feature = "cube")]
pub(crate) mod position_noise;
mod real;
mod rows;
mod screen_gradient;
pub(crate) mod simd;
mod sparse;
mod sum;
pub(crate) mod vector;
mod window;

pub use adam::{AdamBackend, AdamStep, AdamTensors, adam_step, adam_step_plain, move_towards};
pub use assignment::assignment;
pub use attentive_pool::{PoolBackend, attentive_pool, attentive_pool_plain};
pub use blended_labels::{
    BlendedLabelBackend, Blending, LabelledPixels, PixelWeights, blended_label_loss,
    blended_label_loss_plain,
};
pub use compared::{Compared, PackedPhoto};
#[cfg(feature = "cube")]
pub use dense::DenseBackend;
pub use dense::dense;
#[cfg(feature = "cube")]
pub use finite::FiniteBackend;
pub use finite::FiniteCheck;
pub use fusion_layer::{
    FusionBackend, LayerGradients, LayerMap, LayerTensors, fusion_layer, fusion_layer_plain,
};
#[cfg(feature = "cube")]
pub use gather::GatherBackend;
pub use gather::{RowList, gather_rows};
pub(crate) use host::device_of;
pub(crate) use host::real_kernel;
pub use host::{HostBackend, HostKernels, HostValues, host_fallbacks};
pub use label_loss::{ClassLosses, Kind, LabelLossBackend, UNLABELLED, label_loss, label_losses};
pub use neighbour_divergence::{
    DivergenceBackend, NeighbourPairs, neighbour_divergence, neighbour_divergence_plain,
};
pub use photo::Photo;
pub use photometric::{PhotometricBackend, photometric_loss, photometric_loss_plain};
pub use pixel_labels::PixelLabels;
pub use real::Real;
pub use rows::{RowBackend, RowMap, StartOfNew, take_rows};
pub use screen_gradient::{ScreenGradientBackend, add_screen_gradients};
pub use sparse::{Compact, SparseBackend, SparseMatrix, sparse_apply};
#[cfg(feature = "cube")]
pub use sum::SumBackend;
pub use sum::sum_all;

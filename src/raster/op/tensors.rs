//! The typed values that pass through the rasterizer's backend trait.

use crate::error::Error;
use crate::raster::Projected;
use crate::raster::settings::Settings;
use crate::splat::camera::Camera;
use burn::backend::{Backend, ExtensionType, tensor::FloatTensor};
use std::fmt::{Debug, Formatter};
use std::sync::Arc;

/// The tensors of one call; absent ones are empty.
#[derive(Clone, Debug, ExtensionType)]
pub(crate) struct RasterTensors<B: Backend> {
    pub(super) means: FloatTensor<B>,
    pub(super) log_scales: FloatTensor<B>,
    pub(super) rotations: FloatTensor<B>,
    pub(super) opacity_logits: FloatTensor<B>,
    pub(super) sh: FloatTensor<B>,
    pub(super) features: FloatTensor<B>,
    pub(super) screen: FloatTensor<B>,
}

/// Number of [`RasterTensors`].
pub(super) const INPUTS: usize = 7;

impl<B: Backend> RasterTensors<B> {
    pub(super) fn from_array(tensors: [FloatTensor<B>; INPUTS]) -> Self {
        let [
            means,
            log_scales,
            rotations,
            opacity_logits,
            sh,
            features,
            screen,
        ] = tensors;
        Self {
            means,
            log_scales,
            rotations,
            opacity_logits,
            sh,
            features,
            screen,
        }
    }

    pub(super) fn into_array(self) -> [FloatTensor<B>; INPUTS] {
        [
            self.means,
            self.log_scales,
            self.rotations,
            self.opacity_logits,
            self.sh,
            self.features,
            self.screen,
        ]
    }
}

/// Image and transmittance of the forward pass, and their gradients.
#[derive(Clone, Debug, ExtensionType)]
pub(crate) struct PixelTensors<B: Backend> {
    /// `[H, W, C]`.
    pub(super) image: FloatTensor<B>,
    /// `[H, W, C]`.
    pub(super) d_image: FloatTensor<B>,
    /// `[H, W]`.
    pub(super) d_transmittance: FloatTensor<B>,
}

/// What a call renders besides its tensors.
#[derive(Clone, Debug)]
pub(crate) struct RasterCall {
    pub(super) camera: Camera,
    pub(super) settings: Settings,
    pub(super) background: [f64; 3],
    /// The degree of the SH, if there are SH.
    pub(super) sh_degree: Option<usize>,
    pub(super) active_sh_degree: usize,
    /// Whether the gradient of the screen has the columns of AbsGS.
    pub(super) absolute_screen: bool,
}

impl RasterCall {
    /// The SH degree in use, if there are SH.
    #[cfg(feature = "cube")]
    pub(super) fn shown_degree(&self) -> Option<usize> {
        self.sh_degree.map(|_| self.active_sh_degree)
    }

    /// Number of colour channels.
    pub(super) fn colours(&self) -> usize {
        self.sh_degree.map_or(0, |_| 3)
    }
}

/// What a view renders besides its Gaussians.
#[derive(Clone, Debug)]
pub(crate) struct ViewCall {
    pub(super) camera: Camera,
    pub(super) settings: Settings,
}

/// Result of a forward pass.
#[derive(Debug, ExtensionType)]
pub(crate) enum RasterPass<B: Backend> {
    /// The outputs.
    Done {
        /// `[H, W, C]`.
        image: FloatTensor<B>,
        /// `[H, W]`.
        transmittance: FloatTensor<B>,
        /// `[N]`.
        radii: FloatTensor<B>,
        /// What the backward pass reads.
        saved: SavedForward,
    },
    /// The inputs are not valid, or the device failed.
    Failed(Error),
}

/// A row for each Gaussian, or why there are none.
#[derive(Debug, ExtensionType)]
pub(crate) enum Rows<B: Backend> {
    /// `[N, C]`.
    Done(FloatTensor<B>),
    /// An input is not finite, the device failed, or it cannot hold the output.
    Failed(Error),
}

/// Image `[H, W, C]` and transmittance `[H, W]` of a view, or why there are none.
#[derive(Debug, ExtensionType)]
pub(crate) enum BlendedView<B: Backend> {
    /// The outputs.
    Done(FloatTensor<B>, FloatTensor<B>),
    /// The device failed, or cannot hold the output.
    Failed(Error),
}

/// Declares an enum of a value of the CPU's kernels in either precision, and one of the GPU's kernels.
macro_rules! by_kernels {
    ($(#[$meta:meta])* $name:ident, $host:ident, $device:ident) => {
        $(#[$meta])*
        #[derive(Clone)]
        pub(crate) enum $name {
            /// The CPU's kernels in f32 made it.
            F32(Arc<$host<f32>>),
            /// The CPU's kernels in f64 made it.
            F64(Arc<$host<f64>>),
            /// The GPU's kernels made it.
            #[cfg(feature = "cube")]
            Gpu(Arc<crate::raster::gpu::$device>),
        }

        impl From<$host<f32>> for $name {
            fn from(value: $host<f32>) -> Self {
                Self::F32(Arc::new(value))
            }
        }

        impl From<$host<f64>> for $name {
            fn from(value: $host<f64>) -> Self {
                Self::F64(Arc::new(value))
            }
        }

        impl OfHost<$host<f32>> for $name {
            fn of_host(&self) -> Option<&$host<f32>> {
                if let Self::F32(value) = self { Some(value) } else { None }
            }
        }

        impl OfHost<$host<f64>> for $name {
            fn of_host(&self) -> Option<&$host<f64>> {
                if let Self::F64(value) = self { Some(value) } else { None }
            }
        }

        impl Debug for $name {
            fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
                f.write_str(stringify!($name))
            }
        }
    };
}

/// Access to the value of the CPU's kernels in the precision of `T`.
pub(super) trait OfHost<T> {
    /// `None` where another precision or a GPU made the value.
    fn of_host(&self) -> Option<&T>;
}

by_kernels! {
    /// What a forward pass leaves for its backward pass.
    SavedForward, Forward, Forward
}

by_kernels! {
    /// Projection and tile lists of a view.
    ProjectedView, Projected, Prepared
}

/// What the CPU's forward pass computes.
pub(crate) struct Forward<E> {
    pub(super) projected: Projected<E>,
    /// Blended values, `[N, C]`; `None` where they are the features tensor itself.
    pub(super) values: Option<Vec<E>>,
    /// `[H, W]`.
    pub(super) transmittance: Vec<E>,
}

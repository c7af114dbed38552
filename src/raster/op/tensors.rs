//! The typed values that pass through the rasterizer's backend trait.

use crate::error::Error;
use crate::raster::Projected;
use crate::raster::settings::Settings;
use crate::splat::camera::Camera;
use burn::backend::{Backend, ExtensionType, tensor::FloatTensor};
use std::any::Any;
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
    pub(super) has_sh: bool,
    pub(super) sh_degree: usize,
    pub(super) active_sh_degree: usize,
    /// Whether the gradient of the screen has the columns of AbsGS.
    pub(super) absolute_screen: bool,
}

impl RasterCall {
    /// Width and height in pixels.
    pub(super) fn size(&self) -> [usize; 2] {
        [self.camera.width, self.camera.height]
    }

    /// The SH degree in use, where there are SH.
    #[cfg(feature = "cube")]
    pub(super) fn shown_degree(&self) -> Option<usize> {
        self.has_sh.then_some(self.active_sh_degree)
    }

    /// Number of colour channels.
    pub(super) fn colours(&self) -> usize {
        if self.has_sh { 3 } else { 0 }
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

/// What kernels left for kernels of the same device and precision, which know its type.
#[derive(Clone, Debug)]
pub(crate) struct OfKernels(Arc<dyn Any + Send + Sync>);

impl OfKernels {
    pub(super) fn new<T: Any + Send + Sync>(value: T) -> Self {
        Self(Arc::new(value))
    }

    /// `None` where another precision or device made the value.
    pub(super) fn get<T: Any>(&self) -> Option<&T> {
        self.0.downcast_ref()
    }
}

/// What a forward pass leaves for its backward pass: [`Forward`] of the CPU or of the GPU.
pub(crate) type SavedForward = OfKernels;

/// Projection and tile lists of a view: [`Projected`](crate::raster::Projected) of the CPU, `Lists` of the GPU.
pub(crate) type ProjectedView = OfKernels;

/// What the CPU's forward pass computes.
pub(crate) struct Forward<E> {
    pub(super) projected: Projected<E>,
    /// Blended values, `[N, C]`; `None` where they are the features tensor itself.
    pub(super) values: Option<Vec<E>>,
    /// `[H, W]`.
    pub(super) transmittance: Vec<E>,
}

//! The backend trait of the rasterizer, its kernels for each backend, and its nodes in the autodiff graph.

use super::cpu;
#[cfg(feature = "cube")]
use super::gpu;
use super::tensors::{
    BlendedView, PixelTensors, ProjectedView, RasterCall, RasterPass, RasterTensors, Rows,
    SavedForward, ViewCall,
};
use crate::backend::custom_op;
use crate::error::Result;
use burn::backend::tensor::FloatTensor;
use std::sync::Arc;

custom_op! {
    /// Backend side of [`crate::raster::rasterize`] and of [`SplatView`](super::SplatView).
    pub(crate) trait RasterBackend {
        /// Image, transmittance and radii.
        fn raster_forward(#[extension_type] tensors: RasterTensors<Self>, call: Arc<RasterCall>) -> RasterPass<Self>;
        /// Projection and tile lists of frozen geometry.
        fn project_view(#[extension_type] tensors: RasterTensors<Self>, call: Arc<ViewCall>) -> Result<ProjectedView>;
        /// Colours `[N, 3]` of the means `[N, 3]` and coefficients `[N, K, 3]`.
        fn view_colours(
            means: FloatTensor<Self>,
            sh: FloatTensor<Self>,
            degree: usize,
            view: ProjectedView,
            call: Arc<ViewCall>,
        ) -> Rows<Self>;
        /// `W s` of `values` `[N, C]`: the image `[H, W, C]` and the transmittance `[H, W]`.
        fn blend_view(values: FloatTensor<Self>, view: ProjectedView) -> BlendedView<Self>;
    }
    backward {
        /// Gradients of all inputs.
        fn raster_backward(
            #[extension_type] tensors: RasterTensors<Self>,
            #[extension_type] pixels: PixelTensors<Self>,
            saved: SavedForward,
            call: Arc<RasterCall>,
        ) -> RasterTensors<Self>;
        /// `W^T y` of an image `[H, W, C]`: sums `[N, C]`.
        fn blend_view_adjoint(image: FloatTensor<Self>, view: ProjectedView) -> Rows<Self>;
    }
}

/// The operations in the autodiff graph.
mod autodiff {
    use super::*;
    use crate::backend::{AutodiffTensor, track};
    use crate::raster::op::tensors::INPUTS;
    use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
    use burn::backend::{Autodiff, AutodiffBackend, TensorMetadata};
    use burn::tensor::Shape;

    /// Image and transmittance are two nodes, each with a whole backward pass of its own, so that neither waits for the other.
    pub(super) fn raster_forward<B: RasterBackend, C: CheckpointStrategy>(
        tensors: RasterTensors<Autodiff<B, C>>,
        call: Arc<RasterCall>,
    ) -> RasterPass<Autodiff<B, C>> {
        let tracked = tensors.into_array();
        let tensors = RasterTensors::<B>::from_array(tracked.clone().map(|t| t.into_parts().0));
        let (image, transmittance, radii, saved) =
            match B::raster_forward(tensors.clone(), call.clone()) {
                RasterPass::Done {
                    image,
                    transmittance,
                    radii,
                    saved,
                } => (image, transmittance, radii, saved),
                RasterPass::Failed(error) => return RasterPass::Failed(error),
            };
        let [no_image, no_transmittance] = [&image, &transmittance].map(zeros::<B>);
        let backward = {
            let (image, saved) = (image.clone(), saved.clone());
            move |d_image, d_transmittance| {
                let pixels = PixelTensors {
                    image,
                    d_image,
                    d_transmittance,
                };
                B::raster_backward(tensors, pixels, saved, call)
                    .into_array()
                    .map(Some)
            }
        };
        let of_image = backward.clone();
        let image = track::<B, C, INPUTS, _>(tracked.clone(), |_| {
            let backward =
                move |gradient, _: [bool; INPUTS]| of_image(gradient, no_transmittance());
            (image, backward)
        });
        let transmittance = track::<B, C, INPUTS, _>(tracked, |_| {
            let backward = move |gradient, _: [bool; INPUTS]| backward(no_image(), gradient);
            (transmittance, backward)
        });
        RasterPass::Done {
            image,
            transmittance,
            radii: Autodiff::<B, C>::from_inner(radii),
            saved,
        }
    }

    /// Makes zeros of the shape of a tensor when called, so that a node that never runs backward has none.
    fn zeros<B: RasterBackend>(
        of: &FloatTensor<B>,
    ) -> impl Fn() -> FloatTensor<B> + Clone + Send + use<B> {
        let shape = of.shape();
        let device = of.device();
        let dtype = of.dtype().into();
        move || B::float_zeros(shape.clone(), &device, dtype)
    }

    pub(super) fn project_view<B: RasterBackend, C: CheckpointStrategy>(
        tensors: RasterTensors<Autodiff<B, C>>,
        call: Arc<ViewCall>,
    ) -> Result<ProjectedView> {
        let plain = tensors.into_array().map(Autodiff::<B, C>::inner);
        B::project_view(RasterTensors::from_array(plain), call)
    }

    pub(super) fn view_colours<B: RasterBackend, C: CheckpointStrategy>(
        means: AutodiffTensor<B, C>,
        sh: AutodiffTensor<B, C>,
        degree: usize,
        view: ProjectedView,
        call: Arc<ViewCall>,
    ) -> Rows<Autodiff<B, C>> {
        let [means, sh] = [means, sh].map(Autodiff::<B, C>::inner);
        match B::view_colours(means, sh, degree, view, call) {
            Rows::Done(colours) => Rows::Done(Autodiff::<B, C>::from_inner(colours)),
            Rows::Failed(error) => Rows::Failed(error),
        }
    }

    pub(super) fn blend_view<B: RasterBackend, C: CheckpointStrategy>(
        values: AutodiffTensor<B, C>,
        view: ProjectedView,
    ) -> BlendedView<Autodiff<B, C>> {
        let plain = Autodiff::<B, C>::inner(values.clone());
        match B::blend_view(plain, view.clone()) {
            BlendedView::Failed(error) => BlendedView::Failed(error),
            BlendedView::Done(image, transmittance) => {
                let shape = values.shape();
                let image = track::<B, C, 1, _>([values], |_| {
                    let backward = move |gradient, _: [bool; 1]| {
                        [Some(gradient_of_values::<B>(gradient, view, shape))]
                    };
                    (image, backward)
                });
                BlendedView::Done(image, Autodiff::<B, C>::from_inner(transmittance))
            }
        }
    }

    /// NaN where the device fails: a backward pass returns no error, and without a gradient training would continue with zeros.
    fn gradient_of_values<B: RasterBackend>(
        gradient: FloatTensor<B>,
        view: ProjectedView,
        shape: Shape,
    ) -> FloatTensor<B> {
        let device = gradient.device();
        let dtype = gradient.dtype().into();
        match B::blend_view_adjoint(gradient, view) {
            Rows::Done(sums) => sums,
            Rows::Failed(error) => {
                tracing::error!("no gradient of blended values: {error}");
                B::float_full(shape, f32::NAN.into(), &device, dtype)
            }
        }
    }
}

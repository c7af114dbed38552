//! The operations in the autodiff graph.

use super::backend::{
    Colours, INPUTS, PixelTensors, ProjectedView, RasterBackend, RasterCall, RasterPass,
    RasterTensors, TensorPair,
};
use super::view::ViewCall;
use crate::backend::{AutodiffTensor, track};
use crate::error::Result;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::{Autodiff, AutodiffBackend, Backend, TensorMetadata, tensor::FloatTensor};
use burn::tensor::{Shape, Slice};
use std::ops::Range;
use std::sync::Arc;

/// Image and transmittance are parts of one node's output, so that one backward pass gets the gradients of both.
pub(super) fn raster_forward<B: RasterBackend, C: CheckpointStrategy>(
    tensors: RasterTensors<Autodiff<B, C>>,
    call: Arc<RasterCall>,
) -> RasterPass<Autodiff<B, C>> {
    let tracked = tensors.into_array();
    let tensors = RasterTensors::<B>::from_array(tracked.clone().map(|t| t.into_parts().0));
    let (image, transmittance, radii, tile_lists, saved) =
        match B::raster_forward(tensors.clone(), call.clone()) {
            RasterPass::Done {
                image,
                transmittance,
                radii,
                tile_lists,
                saved,
            } => (image, transmittance, radii, tile_lists, saved),
            RasterPass::Failed(error) => return RasterPass::Failed(error),
        };
    let (image_shape, pixel_shape) = (image.shape(), transmittance.shape());
    let (values, pixels) = (image_shape.num_elements(), pixel_shape.num_elements());
    let kept = saved.clone();
    let (image_dims, pixel_dims) = (image_shape.clone(), pixel_shape.clone());
    let both = track::<B, C, INPUTS, _>(tracked, |_| {
        let flat = |tensor, len| B::float_reshape(tensor, Shape::new([len]));
        let parts = vec![flat(image.clone(), values), flat(transmittance, pixels)];
        let backward = move |gradient: FloatTensor<B>, _: [bool; INPUTS]| {
            let pixels = PixelTensors {
                image,
                d_image: part::<B>(gradient.clone(), 0..values, image_dims),
                d_transmittance: part::<B>(gradient, values..values + pixels, pixel_dims),
            };
            B::raster_backward(tensors, pixels, kept, call)
                .into_array()
                .map(Some)
        };
        (B::float_cat(parts, 0), backward)
    });
    RasterPass::Done {
        image: part::<Autodiff<B, C>>(both.clone(), 0..values, image_shape),
        transmittance: part::<Autodiff<B, C>>(both, values..values + pixels, pixel_shape),
        radii: Autodiff::<B, C>::from_inner(radii),
        tile_lists: Autodiff::<B, C>::from_inner(tile_lists),
        saved,
    }
}

/// The values `range` of a vector in another shape.
fn part<B: Backend>(vector: FloatTensor<B>, range: Range<usize>, shape: Shape) -> FloatTensor<B> {
    B::float_reshape(B::float_slice(vector, &[Slice::from(range)]), shape)
}

pub(super) fn project_view<B: RasterBackend, C: CheckpointStrategy>(
    means: AutodiffTensor<B, C>,
    log_scales: AutodiffTensor<B, C>,
    rotations: AutodiffTensor<B, C>,
    opacity_logits: AutodiffTensor<B, C>,
    call: Arc<ViewCall>,
) -> Result<ProjectedView> {
    let [means, log_scales, rotations, opacity_logits] =
        [means, log_scales, rotations, opacity_logits].map(Autodiff::<B, C>::inner);
    B::project_view(means, log_scales, rotations, opacity_logits, call)
}

pub(super) fn view_colours<B: RasterBackend, C: CheckpointStrategy>(
    means: AutodiffTensor<B, C>,
    sh: AutodiffTensor<B, C>,
    degree: usize,
    view: ProjectedView,
    call: Arc<ViewCall>,
) -> Colours<Autodiff<B, C>> {
    let [means, sh] = [means, sh].map(Autodiff::<B, C>::inner);
    match B::view_colours(means, sh, degree, view, call) {
        Colours::Done(colours) => Colours::Done(Autodiff::<B, C>::from_inner(colours)),
        Colours::Failed(error) => Colours::Failed(error),
    }
}

pub(super) fn blend_view<B: RasterBackend, C: CheckpointStrategy>(
    values: AutodiffTensor<B, C>,
    view: ProjectedView,
) -> TensorPair<Autodiff<B, C>> {
    let plain = Autodiff::<B, C>::inner(values.clone());
    match B::blend_view(plain, view.clone()) {
        TensorPair::Failed(error) => TensorPair::Failed(error),
        TensorPair::Done(image, transmittance) => {
            let image = track::<B, C, 1, _>([values], |_| {
                let backward =
                    move |gradient, _: [bool; 1]| [gradient_of_values::<B>(gradient, view)];
                (image, backward)
            });
            TensorPair::Done(image, Autodiff::<B, C>::from_inner(transmittance))
        }
    }
}

fn gradient_of_values<B: RasterBackend>(
    gradient: FloatTensor<B>,
    view: ProjectedView,
) -> Option<FloatTensor<B>> {
    match B::blend_view_adjoint(gradient, view) {
        TensorPair::Done(sums, _) => Some(sums),
        // The gradient is as large as the values, which the device holds.
        TensorPair::Failed(error) => {
            tracing::error!("no gradient of blended values: {error}");
            None
        }
    }
}

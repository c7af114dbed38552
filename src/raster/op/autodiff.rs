//! The operation in the autodiff graph.

use super::backend::{INPUTS, RasterBackend, RasterTensors};
use super::call::RasterCall;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::{Autodiff, AutodiffBackend, tensor::FloatTensor};
use std::sync::Arc;

#[derive(Debug)]
struct ImageBackward;

impl<B: RasterBackend> Backward<B, INPUTS> for ImageBackward {
    type State = (RasterTensors<B>, FloatTensor<B>, Arc<RasterCall>);

    fn backward(
        self,
        ops: Ops<Self::State, INPUTS>,
        grads: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let d_image = grads.consume::<B>(&ops.node);
        let (tensors, image, call) = ops.state;
        let gradients = B::raster_backward(tensors, image, d_image, call);
        for (parent, gradient) in ops.parents.into_iter().zip(gradients.into_array()) {
            if let Some(node) = parent {
                grads.register::<B>(node.id, gradient);
            }
        }
    }
}

/// The transmittance hangs below the image in the graph, so that its backward step runs first.
#[derive(Debug)]
struct TransmittanceBackward;

impl<B: RasterBackend> Backward<B, 1> for TransmittanceBackward {
    type State = (FloatTensor<B>, Arc<RasterCall>);

    fn backward(
        self,
        ops: Ops<Self::State, 1>,
        grads: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let d_transmittance = grads.consume::<B>(&ops.node);
        let (image, call) = ops.state;
        let [parent] = ops.parents;
        if let Some(node) = parent {
            grads.register::<B>(
                node.id,
                B::raster_transmittance_backward(image, d_transmittance, call),
            );
        }
    }
}

impl<B: RasterBackend, C: CheckpointStrategy> RasterBackend for Autodiff<B, C> {
    fn raster_image(tensors: RasterTensors<Self>, call: Arc<RasterCall>) -> FloatTensor<Self> {
        let parts = tensors.into_array().map(|t| t.into_parts());
        let tensors = RasterTensors::from_array(parts.each_ref().map(|(t, _)| t.clone()));
        let nodes = parts.map(|(_, node)| node);
        match ImageBackward.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let image = B::raster_image(tensors.clone(), call.clone());
                prep.finish((tensors, image.clone(), call), image)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::raster_image(tensors, call)),
        }
    }

    fn raster_radii(image: FloatTensor<Self>, call: Arc<RasterCall>) -> FloatTensor<Self> {
        let (image, _) = image.into_parts();
        <Self as AutodiffBackend>::from_inner(B::raster_radii(image, call))
    }

    fn raster_summary(image: FloatTensor<Self>, call: Arc<RasterCall>) -> FloatTensor<Self> {
        let (image, _) = image.into_parts();
        <Self as AutodiffBackend>::from_inner(B::raster_summary(image, call))
    }

    fn raster_transmittance(image: FloatTensor<Self>, call: Arc<RasterCall>) -> FloatTensor<Self> {
        let (image, node) = image.into_parts();
        match TransmittanceBackward
            .prepare::<C>([node])
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => {
                let out = B::raster_transmittance(image.clone(), call.clone());
                prep.finish((image, call), out)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::raster_transmittance(image, call)),
        }
    }

    fn raster_transmittance_backward(
        _image: FloatTensor<Self>,
        _d_transmittance: FloatTensor<Self>,
        _call: Arc<RasterCall>,
    ) -> FloatTensor<Self> {
        unimplemented!("second-order gradients")
    }

    fn raster_backward(
        _tensors: RasterTensors<Self>,
        _image: FloatTensor<Self>,
        _d_image: FloatTensor<Self>,
        _call: Arc<RasterCall>,
    ) -> RasterTensors<Self> {
        unimplemented!("second-order gradients")
    }
}

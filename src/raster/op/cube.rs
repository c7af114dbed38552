//! The operation on CubeCL backends: the GPU kernels, or the host's where those do not reach.

use super::backend::{RasterBackend, RasterTensors};
use super::call::{HostInputs, RasterCall};
use super::frozen::{self, FrozenBackend, FrozenCall, FrozenTensors};
use super::on_host;
use crate::error::{Error, Result};
use crate::raster::gpu::{self, Forward, Gradients, Inputs, Lists, Scenery};
use burn::backend::tensor::FloatTensor;
use burn::tensor::DType;
use burn_cubecl::CubeBackend;
use burn_cubecl::kernel::{cast, into_contiguous};
use burn_cubecl::ops::numeric::zeros_client;
use burn_cubecl::tensor::CubeTensor;
use std::sync::Arc;

/// Whether the GPU kernels take this call: sums of absolute screen-space gradients they have for few channels. Without a
/// Gaussian or a channel there is next to nothing to compute, and no buffer to bind.
fn on_device(tensors: &RasterTensors<CubeBackend>, call: &RasterCall) -> bool {
    let channels = channels(tensors, call);
    let something = tensors.opacity_logits.meta.num_elements() > 0 && channels > 0;
    let absolute = !call.absolute_screen || channels <= gpu::ABSOLUTE_CHANNELS;
    something && absolute && !call.way.host_kernels && gpu::covers(&tensors.means)
}

fn channels(tensors: &RasterTensors<CubeBackend>, call: &RasterCall) -> usize {
    call.colours() + tensors.features.meta.shape()[1]
}

fn inputs(tensors: &RasterTensors<CubeBackend>, call: &RasterCall) -> Inputs {
    let whole = |t: &CubeTensor| into_contiguous(t.clone());
    Inputs {
        means: whole(&tensors.means),
        log_scales: whole(&tensors.log_scales),
        rotations: whole(&tensors.rotations),
        logits: whole(&tensors.opacity_logits),
        sh: call
            .has_sh
            .then(|| (whole(&tensors.sh), call.active_sh_degree)),
        features: (tensors.features.meta.num_elements() > 0).then(|| whole(&tensors.features)),
    }
}

fn zeros(like: &CubeTensor, shape: &[usize]) -> CubeTensor {
    zeros_client(
        like.client.clone(),
        like.device.clone(),
        shape.to_vec().into(),
        like.dtype,
    )
}

fn forward(tensors: RasterTensors<CubeBackend>, call: &RasterCall) -> Result<CubeTensor> {
    let scenery = Scenery {
        camera: &call.camera,
        settings: &call.settings,
        background: call.background,
    };
    match gpu::forward(&inputs(&tensors, call), scenery, call.way.room)? {
        Some((image, forward)) => {
            call.state().forward = Some(Box::new(forward));
            Ok(image)
        }
        // The host's own check names tensor and row.
        None => match HostInputs::<f32>::read::<CubeBackend>(tensors).forward(call) {
            Err(error) => Err(error),
            Ok(_) => Err(Error::non_finite("raster input", 0)),
        },
    }
}

impl RasterBackend for CubeBackend {
    fn raster_image(tensors: RasterTensors<Self>, call: Arc<RasterCall>) -> FloatTensor<Self> {
        if !on_device(&tensors, &call) {
            return on_host::image::<Self>(tensors, call);
        }
        let like = tensors.means.clone();
        let channels = channels(&tensors, &call);
        forward(tensors, &call).unwrap_or_else(|error| {
            call.state().error = Some(error);
            // The caller of `rasterize` gets the error; the graph needs a tensor all the same.
            zeros_client(
                like.client,
                like.device,
                [1, 1, channels].into(),
                like.dtype,
            )
        })
    }

    fn raster_radii(image: FloatTensor<Self>, call: Arc<RasterCall>) -> FloatTensor<Self> {
        match call
            .state()
            .forward
            .as_ref()
            .and_then(|f| f.downcast_ref::<Forward>())
        {
            Some(forward) => cast(forward.radii(), DType::F32),
            None => on_host::nothing::<Self>(image),
        }
    }

    fn raster_summary(image: FloatTensor<Self>, call: Arc<RasterCall>) -> FloatTensor<Self> {
        match call
            .state()
            .forward
            .as_ref()
            .and_then(|f| f.downcast_ref::<Forward>())
        {
            Some(forward) => forward.summary(),
            None => on_host::nothing::<Self>(image),
        }
    }

    fn raster_transmittance(image: FloatTensor<Self>, call: Arc<RasterCall>) -> FloatTensor<Self> {
        let state = call.state();
        match state
            .forward
            .as_ref()
            .and_then(|f| f.downcast_ref::<Forward>())
        {
            Some(forward) => forward.transmittance.clone(),
            None => {
                drop(state);
                on_host::transmittance::<Self>(image, call)
            }
        }
    }

    fn raster_transmittance_backward(
        image: FloatTensor<Self>,
        d_transmittance: FloatTensor<Self>,
        call: Arc<RasterCall>,
    ) -> FloatTensor<Self> {
        if call
            .state()
            .forward
            .as_ref()
            .is_none_or(|f| !f.is::<Forward>())
        {
            return on_host::transmittance_backward::<Self>(image, d_transmittance, call);
        }
        call.state().d_transmittance = Some(Box::new(into_contiguous(d_transmittance)));
        zeros(&image, &image.meta.shape().dims::<3>())
    }

    fn raster_backward(
        tensors: RasterTensors<Self>,
        image: FloatTensor<Self>,
        d_image: FloatTensor<Self>,
        call: Arc<RasterCall>,
    ) -> RasterTensors<Self> {
        let forward: Box<Forward> = {
            let mut state = call.state();
            match state.forward.take().map(|f| f.downcast()) {
                Some(Ok(forward)) => forward,
                other => {
                    state.forward = other.and_then(Result::err);
                    drop(state);
                    return on_host::backward::<Self>(tensors, image, d_image, call);
                }
            }
        };
        let d_transmittance: Option<CubeTensor> =
            RasterCall::take(&mut call.state().d_transmittance);
        let Gradients {
            means,
            log_scales,
            rotations,
            logits,
            sh,
            features,
            screen,
        } = forward.backward(
            &inputs(&tensors, &call),
            &into_contiguous(image),
            &into_contiguous(d_image),
            d_transmittance.as_ref(),
            call.absolute_screen,
        );
        RasterTensors {
            means,
            log_scales,
            rotations,
            opacity_logits: logits,
            // An absent input is empty, and so is its gradient.
            sh: sh.unwrap_or(tensors.sh),
            features: features.unwrap_or(tensors.features),
            screen: if tensors.screen.meta.num_elements() > 0 {
                screen
            } else {
                tensors.screen
            },
        }
    }
}

/// What came of a view's lists.
enum Found<R> {
    Here(R),
    /// The host's kernels are to do it.
    OnHost,
    /// After an error, which the call keeps.
    Nothing,
}

/// What `then` makes of the lists of a view.
fn with_lists<R>(
    tensors: &FrozenTensors<CubeBackend>,
    call: &FrozenCall,
    then: impl FnOnce(&Lists) -> Result<R>,
) -> Found<R> {
    let FrozenTensors {
        means,
        log_scales,
        rotations,
        opacity_logits,
        operand,
    } = tensors;
    if opacity_logits.meta.num_elements() * operand.meta.num_elements() == 0
        || !gpu::covers(operand)
    {
        return Found::OnHost;
    }
    let whole = |t: &CubeTensor| into_contiguous(t.clone());
    let make = || {
        let inputs = Inputs {
            means: whole(means),
            log_scales: whole(log_scales),
            rotations: whole(rotations),
            logits: whole(opacity_logits),
            sh: None,
            features: None,
        };
        let scenery = Scenery {
            camera: &call.camera,
            settings: &call.settings,
            background: [0.0; 3],
        };
        let lists = Lists::new(&inputs, scenery, call.entries.get().copied())?;
        if let Some(lists) = &lists {
            call.entries.get_or_init(|| lists.entries());
        }
        Ok(lists)
    };
    match call.prepared(make, then) {
        Ok(Some(found)) => Found::Here(found),
        // The host's own check names tensor and row.
        Ok(None) => Found::OnHost,
        Err(error) => {
            call.fail(error);
            Found::Nothing
        }
    }
}

impl FrozenBackend for CubeBackend {
    fn frozen_blend(
        tensors: FrozenTensors<Self>,
        call: Arc<FrozenCall>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let channels = tensors.operand.meta.shape()[1];
        let values = into_contiguous(tensors.operand.clone());
        match with_lists(&tensors, &call, |lists| lists.blend(values, channels)) {
            Found::Here(found) => found,
            Found::OnHost => frozen::on_host::blend::<Self>(tensors, &call),
            Found::Nothing => {
                let [h, w] = [call.camera.height, call.camera.width];
                (
                    zeros(&tensors.means, &[h, w, channels]),
                    zeros(&tensors.means, &[h, w]),
                )
            }
        }
    }

    fn frozen_adjoint(
        tensors: FrozenTensors<Self>,
        call: Arc<FrozenCall>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let (n, channels) = (
            tensors.opacity_logits.meta.num_elements(),
            tensors.operand.meta.shape()[2],
        );
        let image = into_contiguous(tensors.operand.clone());
        match with_lists(&tensors, &call, |lists| lists.lift(&image, channels)) {
            Found::Here(found) => found,
            Found::OnHost => frozen::on_host::adjoint::<Self>(tensors, &call),
            Found::Nothing => (
                zeros(&tensors.means, &[n, channels]),
                zeros(&tensors.means, &[n]),
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::backend::device::gpu_of_tests;
    use crate::raster::{Settings, SplatTensors};
    use crate::splat::camera::Camera;
    use burn::tensor::{Device, Distribution, Tensor};
    use glam::{DMat3, DVec3};
    use std::sync::{Arc, OnceLock};

    fn splats(n: usize, device: &Device) -> SplatTensors {
        let random = |columns, low, high| {
            Tensor::<2>::random([n, columns], Distribution::Uniform(low, high), device)
        };
        SplatTensors {
            means: random(3, -1.0, 1.0) + Tensor::<2>::from_floats([[0.0, 0.0, 2.5]], device),
            log_scales: random(3, -4.0, -1.5),
            rotations: random(4, -1.0, 1.0),
            opacity_logits: random(1, -2.0, 3.0).reshape([n]),
        }
    }

    #[test]
    fn lists_of_a_known_length_are_the_same() {
        let Some(device) = gpu_of_tests() else { return };
        let camera = Camera {
            width: 100,
            height: 70,
            fx: 80.0,
            fy: 80.0,
            cx: 50.0,
            cy: 35.0,
            rotation: DMat3::IDENTITY,
            center: DVec3::ZERO,
        };
        let (splats, settings) = (splats(300, &device), Settings::default());
        let values = Tensor::<2>::random([300, 5], Distribution::Default, &device);
        let entries = Arc::new(OnceLock::new());
        let looks = || {
            let view = splats.seen_again_by(&camera, &settings, &entries);
            let (image, transmittance) = view.blend(values.clone()).expect("an image");
            let lifted = view.adjoint(image.clone()).expect("sums");
            let parts = [
                image.reshape([-1]),
                transmittance.reshape([-1]),
                lifted.sums.reshape([-1]),
                lifted.counts,
            ];
            parts.map(|part: Tensor<1>| part.into_data().into_vec::<f32>().expect("floats"))
        };
        let first = looks();
        assert!(*entries.get().expect("counted") > 300 && first[0].iter().any(|v| *v > 0.1));
        assert!(first[3].iter().any(|count| *count > 10.0));
        assert_eq!(looks(), first);
    }
}

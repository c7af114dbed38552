//! The operations by the GPU's kernels, or by the CPU's where the GPU's do not reach.

use super::cpu;
use super::tensors::ViewCall;
use super::tensors::{
    Colours, PixelTensors, ProjectedView, RasterCall, RasterPass, RasterTensors, SavedForward,
    TensorPair,
};
use crate::backend::HostBackend;
use crate::error::{Error, Result};
use crate::raster::gpu::{self, Gradients, Inputs, Lists, Scenery};
use burn::tensor::DType;
use burn_cubecl::CubeBackend;
use burn_cubecl::kernel::{cast, into_contiguous};
use burn_cubecl::tensor::CubeTensor;
use std::sync::Arc;

/// Whether the GPU's kernels take this call. They have sums of absolute screen-space gradients for few channels. Without a
/// Gaussian or a channel there is no buffer to bind.
fn on_device(tensors: &RasterTensors<CubeBackend>, call: &RasterCall) -> bool {
    let channels = call.colours() + tensors.features.meta.shape()[1];
    let something = tensors.opacity_logits.meta.num_elements() > 0 && channels > 0;
    let absolute = !call.absolute_screen || channels <= gpu::ABSOLUTE_CHANNELS;
    something && absolute && gpu::covers(&tensors.means)
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

pub(super) fn raster_forward(
    tensors: RasterTensors<CubeBackend>,
    call: Arc<RasterCall>,
) -> RasterPass<CubeBackend> {
    if !on_device(&tensors, &call) {
        return cpu::raster_forward(tensors, call);
    }
    let scenery = Scenery {
        camera: &call.camera,
        settings: &call.settings,
        background: call.background,
    };
    match gpu::forward(&inputs(&tensors, &call), scenery) {
        Ok(Some((image, forward))) => RasterPass::Done {
            image,
            transmittance: forward.transmittance.clone(),
            radii: cast(forward.radii(), DType::F32),
            saved: SavedForward::Gpu(Arc::new(forward)),
        },
        // The CPU's own check names tensor and row.
        Ok(None) => match cpu::Inputs::<f32>::read::<CubeBackend>(tensors).forward(&call) {
            Err(error) => RasterPass::Failed(error),
            Ok(_) => RasterPass::Failed(Error::non_finite("raster input", 0)),
        },
        Err(error) => RasterPass::Failed(error),
    }
}

pub(super) fn raster_backward(
    tensors: RasterTensors<CubeBackend>,
    pixels: PixelTensors<CubeBackend>,
    saved: SavedForward,
    call: Arc<RasterCall>,
) -> RasterTensors<CubeBackend> {
    let SavedForward::Gpu(forward) = &saved else {
        return cpu::raster_backward(tensors, pixels, saved, call);
    };
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
        &into_contiguous(pixels.image),
        &into_contiguous(pixels.d_image),
        Some(&into_contiguous(pixels.d_transmittance)),
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

pub(super) fn project_view(
    means: CubeTensor,
    log_scales: CubeTensor,
    rotations: CubeTensor,
    opacity_logits: CubeTensor,
    call: Arc<ViewCall>,
) -> Result<ProjectedView> {
    if opacity_logits.meta.num_elements() == 0 || !gpu::covers(&means) {
        return cpu::project_view::<CubeBackend>(
            means,
            log_scales,
            rotations,
            opacity_logits,
            call,
        );
    }
    let inputs = Inputs {
        means: into_contiguous(means.clone()),
        log_scales: into_contiguous(log_scales.clone()),
        rotations: into_contiguous(rotations.clone()),
        logits: into_contiguous(opacity_logits.clone()),
        sh: None,
        features: None,
    };
    let scenery = Scenery {
        camera: &call.camera,
        settings: &call.settings,
        background: [0.0; 3],
    };
    match Lists::new(&inputs, scenery)? {
        Some(lists) => Ok(ProjectedView::Gpu(Arc::new(lists))),
        // The CPU's own check names tensor and row.
        None => {
            cpu::project_view::<CubeBackend>(means, log_scales, rotations, opacity_logits, call)
        }
    }
}

pub(super) fn view_colours(
    means: CubeTensor,
    sh: CubeTensor,
    degree: usize,
    view: ProjectedView,
    call: Arc<ViewCall>,
) -> Colours<CubeBackend> {
    match &view {
        ProjectedView::Gpu(lists) => {
            Colours::Done(lists.colours(into_contiguous(means), into_contiguous(sh), degree))
        }
        _ => cpu::view_colours(means, sh, degree, view, call),
    }
}

pub(super) fn blend_view(values: CubeTensor, view: ProjectedView) -> TensorPair<CubeBackend> {
    let ProjectedView::Gpu(lists) = &view else {
        return cpu::blend_view(values, view);
    };
    if values.dtype != DType::F32 {
        return TensorPair::Failed(cpu::other_kernels());
    }
    let channels = values.meta.shape()[1];
    if channels == 0 {
        return no_channels(&values, lists).into();
    }
    lists.blend(into_contiguous(values), channels).into()
}

/// The transmittance beside an image without channels: no kernel binds an empty buffer.
fn no_channels(values: &CubeTensor, lists: &Lists) -> Result<(CubeTensor, CubeTensor)> {
    let rows = values.meta.shape()[0];
    let zeros = CubeBackend::tensor::<f32>(vec![0.0; rows], &[rows, 1], &values.device);
    let (_, transmittance) = lists.blend(zeros, 1)?;
    let [height, width] = transmittance.meta.shape().dims::<2>();
    let image = CubeBackend::tensor::<f32>(Vec::new(), &[height, width, 0], &values.device);
    Ok((image, transmittance))
}

pub(super) fn blend_view_adjoint(
    image: CubeTensor,
    view: ProjectedView,
) -> TensorPair<CubeBackend> {
    let ProjectedView::Gpu(lists) = &view else {
        return cpu::blend_view_adjoint(image, view);
    };
    if image.dtype != DType::F32 {
        return TensorPair::Failed(cpu::other_kernels());
    }
    let channels = image.meta.shape()[2];
    if channels == 0 {
        let counts = lists.counts();
        let rows = counts.meta.num_elements();
        let sums = CubeBackend::tensor::<f32>(Vec::new(), &[rows, 0], &image.device);
        return TensorPair::Done(sums, counts);
    }
    lists.lift(&into_contiguous(image), channels).into()
}

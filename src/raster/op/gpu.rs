//! The operations by the GPU's kernels, or by the CPU's where the GPU's do not suffice.

use super::cpu;
use super::tensors::{
    BlendedView, PixelTensors, ProjectedView, RasterCall, RasterPass, RasterTensors, Rows,
    SavedForward, ViewCall,
};
use crate::backend::HostBackend;
use crate::error::Result;
use crate::raster::gpu::{self, Harmonics, Inputs, Prepared};
use burn::tensor::DType;
use burn_cubecl::CubeBackend;
use burn_cubecl::kernel::{cast, into_contiguous};
use burn_cubecl::tensor::CubeTensor;
use std::sync::Arc;

/// Whether the GPU's kernels take this call. They have sums of absolute screen-space gradients only for few channels. Without a
/// Gaussian or a channel there is no buffer to bind.
fn on_device(tensors: &RasterTensors<CubeBackend>, call: &RasterCall) -> bool {
    let channels = call.colours() + tensors.features.meta.shape()[1];
    let something = tensors.opacity_logits.meta.num_elements() > 0 && channels > 0;
    let absolute = !call.absolute_screen || channels <= gpu::ABSOLUTE_CHANNELS;
    something && absolute && gpu::covers(&tensors.means)
}

/// The tensors with SH up to `sh_degree`; without a degree, without SH.
fn inputs(tensors: &RasterTensors<CubeBackend>, sh_degree: Option<usize>) -> Inputs {
    let whole = |t: &CubeTensor| into_contiguous(t.clone());
    Inputs {
        means: whole(&tensors.means),
        log_scales: whole(&tensors.log_scales),
        rotations: whole(&tensors.rotations),
        logits: whole(&tensors.opacity_logits),
        sh: sh_degree.map(|degree| Harmonics::new(whole(&tensors.sh), degree)),
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
    let inputs = inputs(&tensors, call.shown_degree());
    match gpu::forward(&inputs, &call.camera, &call.settings, call.background) {
        Ok(Some((image, forward))) => RasterPass::Done {
            image,
            transmittance: forward.transmittance.clone(),
            radii: cast(forward.radii(), DType::F32),
            saved: SavedForward::Gpu(Arc::new(forward)),
        },
        // Something is not finite. The CPU's own check names tensor and row; if it finds none, the CPU renders.
        Ok(None) => cpu::raster_forward(tensors, call),
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
    let gradients = forward.backward(
        &inputs(&tensors, call.shown_degree()),
        &into_contiguous(pixels.image),
        &into_contiguous(pixels.d_image),
        &into_contiguous(pixels.d_transmittance),
        call.absolute_screen,
    );
    let geometry = gradients.geometry;
    RasterTensors {
        means: geometry.means,
        log_scales: geometry.log_scales,
        rotations: geometry.rotations,
        opacity_logits: geometry.logits,
        // An absent input is empty, and so is its gradient.
        sh: gradients.sh.unwrap_or(tensors.sh),
        features: gradients.features.unwrap_or(tensors.features),
        screen: if tensors.screen.meta.num_elements() > 0 {
            geometry.screen
        } else {
            tensors.screen
        },
    }
}

pub(super) fn project_view(
    tensors: RasterTensors<CubeBackend>,
    call: Arc<ViewCall>,
) -> Result<ProjectedView> {
    if tensors.opacity_logits.meta.num_elements() == 0 || !gpu::covers(&tensors.means) {
        return cpu::project_view(tensors, call);
    }
    let inputs = inputs(&tensors, None);
    match Prepared::new(&inputs, &call.camera, &call.settings, [0.0; 3])? {
        Some(prepared) => Ok(ProjectedView::Gpu(Arc::new(prepared))),
        // The CPU's own check names tensor and row.
        None => cpu::project_view(tensors, call),
    }
}

pub(super) fn view_colours(
    means: CubeTensor,
    sh: CubeTensor,
    degree: usize,
    view: ProjectedView,
    call: Arc<ViewCall>,
) -> Rows<CubeBackend> {
    match &view {
        ProjectedView::Gpu(prepared) => {
            Rows::Done(prepared.colours(into_contiguous(means), into_contiguous(sh), degree))
        }
        _ => cpu::view_colours(means, sh, degree, view, call),
    }
}

pub(super) fn blend_view(values: CubeTensor, view: ProjectedView) -> BlendedView<CubeBackend> {
    let ProjectedView::Gpu(prepared) = &view else {
        return cpu::blend_view(values, view);
    };
    if values.dtype != DType::F32 {
        return BlendedView::Failed(cpu::other_kernels());
    }
    let channels = values.meta.shape()[1];
    let blended = match channels {
        0 => no_channels(&values, prepared),
        _ => prepared.blend(into_contiguous(values), channels),
    };
    match blended {
        Ok((image, transmittance)) => BlendedView::Done(image, transmittance),
        Err(error) => BlendedView::Failed(error),
    }
}

/// The transmittance beside an image without channels: no kernel binds an empty buffer.
fn no_channels(values: &CubeTensor, prepared: &Prepared) -> Result<(CubeTensor, CubeTensor)> {
    let rows = values.meta.shape()[0];
    let zeros = CubeBackend::tensor::<f32>(vec![0.0; rows], &[rows, 1], &values.device);
    let (_, transmittance) = prepared.blend(zeros, 1)?;
    let [height, width] = transmittance.meta.shape().dims::<2>();
    let image = CubeBackend::tensor::<f32>(Vec::new(), &[height, width, 0], &values.device);
    Ok((image, transmittance))
}

pub(super) fn blend_view_adjoint(image: CubeTensor, view: ProjectedView) -> Rows<CubeBackend> {
    let ProjectedView::Gpu(prepared) = &view else {
        return cpu::blend_view_adjoint(image, view);
    };
    if image.dtype != DType::F32 {
        return Rows::Failed(cpu::other_kernels());
    }
    let channels = image.meta.shape()[2];
    if channels == 0 {
        let none = CubeBackend::tensor::<f32>(Vec::new(), &[prepared.len(), 0], &image.device);
        return Rows::Done(none);
    }
    match prepared.lift(&into_contiguous(image), channels) {
        Ok(sums) => Rows::Done(sums),
        Err(error) => Rows::Failed(error),
    }
}

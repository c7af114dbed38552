//! Rasterization as a differentiable burn operation.

mod autodiff;
mod backend;
mod call;
#[cfg(feature = "cube")]
mod cube;
mod frozen;
mod on_host;
mod radii;
mod room;
mod splats;

pub use self::backend::{RasterBackend, RasterTensors};
pub use self::call::RasterCall;
pub use self::frozen::{FrozenBackend, FrozenCall, FrozenTensors, Lifted, SplatView};
pub use self::radii::Radii;
pub use self::room::{ListCount, ListSummary, room_for};
pub use self::splats::SplatTensors;
use call::Way;

use super::settings::Settings;
use crate::error::{Error, Result};
use crate::splat::camera::Camera;
use burn::backend::Dispatch;
use burn::tensor::{DType, Tensor};
use std::sync::{Arc, Mutex};

/// What [`rasterize`] renders. All tensors have one float type and live on one device.
#[derive(Clone, Debug)]
pub struct RasterInput {
    /// `[N, 3]`, world units.
    pub means: Tensor<2>,
    /// `[N, 3]`, natural logarithms.
    pub log_scales: Tensor<2>,
    /// `[N, 4]` (w, x, y, z), not normalised.
    pub rotations: Tensor<2>,
    /// `[N]`.
    pub opacity_logits: Tensor<1>,
    /// `[N, K, 3]`, `K = (degree + 1)^2`, degree 0 to 3: adds three colour channels.
    pub sh: Option<Tensor<3>>,
    /// Highest SH degree in use; terms above it are left out and get a zero gradient.
    pub active_sh_degree: usize,
    /// `[N, C]`: adds C channels after the colour.
    pub features: Option<Tensor<2>>,
    /// `[N, 2]` or `[N, 4]`, any values: its gradient is the screen-space gradient `(dL/du W/2, dL/dv H/2)`, followed in four
    /// columns by the sums over pixels of the absolute values of both (AbsGS), on a GPU of no more than 8 channels.
    pub screen: Option<Tensor<2>>,
}

/// What [`rasterize`] gives.
#[derive(Clone, Debug)]
pub struct RasterOutput {
    /// `[H, W, 3 + C]`, colour first when SH were given; the background is part of the colour.
    pub image: Tensor<3>,
    /// What shows of the background, `[H, W]`.
    pub transmittance: Tensor<2>,
    /// Radius in pixels of every Gaussian.
    pub radii: Radii,
}

/// Renders `input` seen by `camera` (Eq. 1-4), with gradients to every input.
///
/// `background` is added to the colour channels as `T b`. Gradients also flow from the transmittance. The SH gradient
/// includes the path of the viewing direction to the means.
///
/// # Errors
/// [`Error::Argument`] for shapes or float types that disagree, neither `sh` nor `features`, or an SH degree above 3;
/// [`Error::NonFinite`] for a NaN or an infinity in any input; otherwise as [`Projected::new`](super::Projected::new).
pub fn rasterize(
    input: RasterInput,
    camera: &Camera,
    settings: &Settings,
    background: [f32; 3],
) -> Result<RasterOutput> {
    Ok(run(input, camera, settings, background, Way::default())?.0)
}

/// [`rasterize`] without a wait for a GPU, which otherwise counts the entries of the tile lists before the host makes room for
/// them: with `room` for that many, what came of it is in the summary, to be read with whatever is read next. Where
/// [`ListCount::is_sound`] is false then, neither the output nor its gradients mean anything, and the call is to be
/// repeated without `room`, which gives the image, or the error that names the non-finite input. Where room suffices the output
/// is that of [`rasterize`] bit by bit. Some 28 bytes an entry are taken while lists are sorted. The host's kernels do without
/// `room`, and so does a GPU none of whose buffers holds so many numbers.
///
/// # Errors
/// As [`rasterize`]; inputs that are not finite are an error only where `room` is done without.
pub fn rasterize_with_room(
    input: RasterInput,
    camera: &Camera,
    settings: &Settings,
    background: [f32; 3],
    room: Option<usize>,
) -> Result<(RasterOutput, ListSummary)> {
    run(
        input,
        camera,
        settings,
        background,
        Way {
            room,
            ..Way::default()
        },
    )
}

/// [`rasterize`] by the CPU's kernels wherever the tensors live, copying them from and to a GPU: what the GPU's kernels
/// are checked against, and the way around them.
///
/// # Errors
/// As [`rasterize`].
pub fn rasterize_on_host(
    input: RasterInput,
    camera: &Camera,
    settings: &Settings,
    background: [f32; 3],
) -> Result<RasterOutput> {
    Ok(run(
        input,
        camera,
        settings,
        background,
        Way {
            host_kernels: true,
            room: None,
        },
    )?
    .0)
}

fn run(
    input: RasterInput,
    camera: &Camera,
    settings: &Settings,
    background: [f32; 3],
    way: Way,
) -> Result<(RasterOutput, ListSummary)> {
    let RasterInput {
        means,
        log_scales,
        rotations,
        opacity_logits,
        sh,
        active_sh_degree,
        features,
        screen,
    } = input;
    let [n] = opacity_logits.dims();
    let shape = |name: &str, found: &[usize], expected: &[usize]| {
        if found == expected {
            return Ok(());
        }
        let (found, expected) = (format!("shape {found:?}"), format!("{expected:?}"));
        Err(Error::argument(
            format!("raster input {name}"),
            found,
            expected,
            "pass tensors of one scene",
        ))
    };
    shape("means", &means.dims(), &[n, 3])?;
    shape("log_scales", &log_scales.dims(), &[n, 3])?;
    shape("rotations", &rotations.dims(), &[n, 4])?;
    if sh.is_none() && features.is_none() {
        return Err(Error::argument(
            "raster input",
            "neither sh nor features",
            "at least one",
            "pass what to render",
        ));
    }
    let terms = sh.as_ref().map_or(1, |sh| sh.dims()[1]);
    if !matches!(terms, 1 | 4 | 9 | 16) {
        let found = format!("{terms} terms");
        return Err(Error::argument(
            "raster input sh",
            found,
            "1, 4, 9 or 16",
            "pass (degree + 1)^2 terms",
        ));
    }
    if let Some(sh) = &sh {
        shape("sh", &sh.dims(), &[n, terms, 3])?;
    }
    if let Some(features) = &features {
        shape("features", &features.dims(), &[n, features.dims()[1]])?;
    }
    let absolute_screen = screen.as_ref().is_some_and(|screen| screen.dims()[1] == 4);
    if let Some(screen) = &screen {
        shape(
            "screen",
            &screen.dims(),
            &[n, if absolute_screen { 4 } else { 2 }],
        )?;
    }
    let dtype = means.dtype();
    if !matches!(dtype, DType::F32 | DType::F64) {
        return Err(Error::argument(
            "raster input",
            format!("{dtype:?}"),
            "f32 or f64",
            "cast the tensors",
        ));
    }
    let types = [
        ("log_scales", log_scales.dtype()),
        ("rotations", rotations.dtype()),
        ("opacity_logits", opacity_logits.dtype()),
        ("sh", sh.as_ref().map_or(dtype, Tensor::dtype)),
        ("features", features.as_ref().map_or(dtype, Tensor::dtype)),
        ("screen", screen.as_ref().map_or(dtype, Tensor::dtype)),
    ];
    if let Some((name, found)) = types.into_iter().find(|(_, found)| *found != dtype) {
        let (found, expected) = (
            format!("{found:?}"),
            format!("{dtype:?}, as the means have"),
        );
        return Err(Error::argument(
            format!("raster input {name}"),
            found,
            expected,
            "cast the tensors",
        ));
    }
    let call = Arc::new(RasterCall {
        camera: camera.clone(),
        settings: *settings,
        background: background.map(f64::from),
        has_sh: sh.is_some(),
        has_features: features.is_some(),
        sh_degree: terms.isqrt() - 1,
        active_sh_degree,
        absolute_screen,
        way,
        state: Mutex::default(),
    });
    let device = means.device();
    let absent = || Tensor::<2>::zeros([n, 0], (&device, dtype)).into_dispatch();
    let tensors = RasterTensors {
        means: means.into_dispatch(),
        log_scales: log_scales.into_dispatch(),
        rotations: rotations.into_dispatch(),
        opacity_logits: opacity_logits.into_dispatch(),
        sh: sh.map_or_else(absent, Tensor::into_dispatch),
        features: features.map_or_else(absent, Tensor::into_dispatch),
        screen: screen.map_or_else(absent, Tensor::into_dispatch),
    };
    let image = Dispatch::raster_image(tensors, call.clone());
    if let Some(error) = call.state().error.take() {
        return Err(error);
    }
    let transmittance =
        Tensor::from_dispatch(Dispatch::raster_transmittance(image.clone(), call.clone()));
    let on_device = Tensor::<1>::from_dispatch(Dispatch::raster_radii(image.clone(), call.clone()));
    let radii = match on_device.dims() {
        [0] => call.state().radii.clone(),
        _ if on_device.device().is_autodiff() => Radii::on_device(on_device.inner()),
        _ => Radii::on_device(on_device),
    };
    let summary = Tensor::from_dispatch(Dispatch::raster_summary(image.clone(), call));
    Ok((
        RasterOutput {
            image: Tensor::from_dispatch(image),
            transmittance,
            radii,
        },
        ListSummary::new(summary),
    ))
}

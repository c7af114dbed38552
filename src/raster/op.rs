//! Rasterization as a differentiable burn operation.

use super::backward::{PixelGradients, SplatGradients};
use super::projected::{Blended, Projected};
use super::settings::{Settings, Splats, check_finite};
use super::sh::{ShBackward, eval_sh_rows};
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::ops::{HostBackend, HostValues, Real, device_of, real_kernel};
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::{
    Autodiff, Backend, Dispatch, ExtensionType, TensorMetadata, backend_extension, tensor::FloatTensor,
};
use burn::tensor::{DType, Tensor};
use std::any::Any;
use std::sync::{Arc, Mutex, PoisonError};

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
    /// `[N, 2]`, any values: its gradient is the screen-space gradient `(dL/du W/2, dL/dv H/2)`.
    pub screen: Option<Tensor<2>>,
}

/// What [`rasterize`] gives.
#[derive(Clone, Debug)]
pub struct RasterOutput {
    /// `[H, W, 3 + C]`, colour first when SH were given; the background is part of the colour.
    pub image: Tensor<3>,
    /// What shows of the background, `[H, W]`.
    pub transmittance: Tensor<2>,
    /// Radius in pixels, `[N]`; 0 = not visible.
    pub radii: Arc<Vec<u32>>,
}

/// The tensors of one call; absent ones are empty.
#[derive(Clone, Debug, ExtensionType)]
pub struct RasterTensors<B: Backend> {
    means: FloatTensor<B>,
    log_scales: FloatTensor<B>,
    rotations: FloatTensor<B>,
    opacity_logits: FloatTensor<B>,
    sh: FloatTensor<B>,
    features: FloatTensor<B>,
    screen: FloatTensor<B>,
}

/// Inputs of the operation, and the index of each among its parents.
const INPUTS: usize = 7;

impl<B: Backend> RasterTensors<B> {
    fn from_array(tensors: [FloatTensor<B>; INPUTS]) -> Self {
        let [means, log_scales, rotations, opacity_logits, sh, features, screen] = tensors;
        Self { means, log_scales, rotations, opacity_logits, sh, features, screen }
    }

    fn into_array(self) -> [FloatTensor<B>; INPUTS] {
        let Self { means, log_scales, rotations, opacity_logits, sh, features, screen } = self;
        [means, log_scales, rotations, opacity_logits, sh, features, screen]
    }
}

/// Host side of one call: what it is asked, and what the forward pass leaves for the backward pass, so that nothing is
/// projected twice.
#[derive(Debug)]
pub struct RasterCall {
    camera: Camera,
    settings: Settings,
    background: [f64; 3],
    has_sh: bool,
    has_features: bool,
    sh_degree: usize,
    active_sh_degree: usize,
    state: Mutex<CallState>,
}

#[derive(Debug, Default)]
struct CallState {
    radii: Arc<Vec<u32>>,
    /// A [`Forward`] of the element type of the tensors.
    forward: Option<Box<dyn Any + Send>>,
    /// dL/dT of the transmittance output, a `Vec` of the element type.
    d_transmittance: Option<Box<dyn Any + Send>>,
    error: Option<Error>,
}

/// What the forward pass computed.
struct Forward<E> {
    projected: Projected<E>,
    /// Blended values, `[N, channels]`; `None` where they are the features tensor itself.
    values: Option<Vec<E>>,
    transmittance: Vec<E>,
}

impl RasterCall {
    fn state(&self) -> std::sync::MutexGuard<'_, CallState> {
        // A panic elsewhere cannot leave the plain fields behind the lock half-written.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take<T: 'static>(slot: &mut Option<Box<dyn Any + Send>>) -> Option<T> {
        slot.take()?.downcast().ok().map(|b| *b)
    }

    fn size(&self) -> [usize; 2] {
        [self.camera.width, self.camera.height]
    }

    fn colours(&self) -> usize {
        if self.has_sh { 3 } else { 0 }
    }
}

/// Slices of the inputs.
struct HostInputs<E> {
    means: HostValues<E>,
    log_scales: HostValues<E>,
    rotations: HostValues<E>,
    opacity_logits: HostValues<E>,
    sh: HostValues<E>,
    features: HostValues<E>,
}

impl<E: Real> HostInputs<E> {
    fn read<B: HostBackend>(tensors: RasterTensors<B>) -> Self {
        Self {
            means: B::values(tensors.means),
            log_scales: B::values(tensors.log_scales),
            rotations: B::values(tensors.rotations),
            opacity_logits: B::values(tensors.opacity_logits),
            sh: B::values(tensors.sh),
            features: B::values(tensors.features),
        }
    }

    fn splats(&self) -> Splats<'_, E> {
        Splats {
            means: &self.means,
            log_scales: &self.log_scales,
            rotations: &self.rotations,
            opacity_logits: &self.opacity_logits,
        }
    }

    fn features_per_row(&self) -> usize {
        self.features.len() / self.opacity_logits.len().max(1)
    }

    /// Image `[H, W, channels]`, background included, and what the backward pass needs.
    fn forward(&self, call: &RasterCall) -> Result<(Vec<E>, Forward<E>)> {
        let n = self.opacity_logits.len();
        check_finite("sh", &self.sh, self.sh.len() / n.max(1))?;
        check_finite("features", &self.features, self.features_per_row())?;
        let projected = Projected::new(&self.splats(), &call.camera, &call.settings)?;
        let colours = call.colours();
        let extra = self.features_per_row();
        let channels = colours + extra;
        let center = call.camera.center.to_array();
        let mut values = call.has_sh.then(|| {
            eval_sh_rows(&self.means, &self.sh, call.sh_degree, call.active_sh_degree, center, projected.radii())
        });
        if let (Some(rgb), true) = (&values, extra > 0) {
            let rows = rgb.chunks_exact(3).zip(self.features.chunks_exact(extra));
            values = Some(rows.flat_map(|(rgb, features)| rgb.iter().chain(features).copied()).collect());
        }
        let Blended { mut image, transmittance } =
            projected.blend(values.as_deref().unwrap_or(&self.features), channels);
        let background = call.background.map(E::of);
        if colours > 0 && background != [E::zero(); 3] {
            for (pixel, &t) in image.chunks_exact_mut(channels).zip(&transmittance) {
                for (value, &b) in pixel.iter_mut().zip(&background) {
                    *value += t * b;
                }
            }
        }
        Ok((image, Forward { projected, values, transmittance }))
    }

    /// Gradients in the order of [`RasterTensors`].
    fn backward(&self, call: &RasterCall, forward: Forward<E>, image: &[E], d_image: &[E]) -> [Vec<E>; INPUTS] {
        let Forward { projected, values, transmittance } = forward;
        let d_transmittance: Option<Vec<E>> = RasterCall::take(&mut call.state().d_transmittance);
        let n = self.opacity_logits.len();
        let colours = call.colours();
        let channels = colours + self.features_per_row();
        let pixels = PixelGradients {
            image,
            transmittance: &transmittance,
            d_image,
            d_transmittance: d_transmittance.as_deref(),
        };
        let values = values.as_deref().unwrap_or(&self.features);
        let SplatGradients { mut means, log_scales, rotations, opacity_logits, values: d_values, screen } =
            projected.backward_slices(&self.splats(), values, channels, pixels);
        let d_sh = if call.has_sh {
            ShBackward {
                means: &self.means,
                sh: &self.sh,
                sh_degree: call.sh_degree,
                active_degree: call.active_sh_degree,
                center: call.camera.center.to_array(),
                colours: values,
                gradient: &d_values,
                stride: channels,
                wanted: projected.radii(),
            }
            .run(&mut means)
        } else {
            Vec::new()
        };
        let d_features = match (call.has_sh, call.has_features) {
            (_, false) => Vec::new(),
            (false, true) => d_values,
            (true, true) if channels > colours => {
                let mut out = Vec::with_capacity(n * (channels - colours));
                d_values.chunks_exact(channels).for_each(|row| out.extend_from_slice(&row[colours..]));
                out
            }
            (true, true) => Vec::new(),
        };
        [means, log_scales, rotations, opacity_logits, d_sh, d_features, screen]
    }
}

/// Backend side of [`rasterize`].
#[backend_extension(
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Cube: cfg(feature = "wgpu"),
    Autodiff
)]
pub trait RasterBackend: Backend {
    /// The image `[H, W, C]`; leaves the rest of the forward pass in `call`.
    fn raster_image(#[extension_type] tensors: RasterTensors<Self>, call: Arc<RasterCall>) -> FloatTensor<Self>;
    /// The transmittance `[H, W]` of the call that made `image`.
    fn raster_transmittance(image: FloatTensor<Self>, call: Arc<RasterCall>) -> FloatTensor<Self>;
    /// Keeps the gradient of the transmittance for [`RasterBackend::raster_backward`], and returns zeros like `image`.
    fn raster_transmittance_backward(
        image: FloatTensor<Self>,
        d_transmittance: FloatTensor<Self>,
        call: Arc<RasterCall>,
    ) -> FloatTensor<Self>;
    /// Gradients of all inputs.
    fn raster_backward(
        #[extension_type] tensors: RasterTensors<Self>,
        image: FloatTensor<Self>,
        d_image: FloatTensor<Self>,
        call: Arc<RasterCall>,
    ) -> RasterTensors<Self>;
}

impl<B: HostBackend> RasterBackend for B {
    fn raster_image(tensors: RasterTensors<Self>, call: Arc<RasterCall>) -> FloatTensor<Self> {
        let device = device_of::<B>(&tensors.means);
        let channels = call.colours() + tensors.features.shape().dims::<2>()[1];
        let [w, h] = call.size();
        real_kernel!(tensors.means, E => {
            let image = match HostInputs::<E>::read::<B>(tensors).forward(&call) {
                Ok((image, forward)) => {
                    let mut state = call.state();
                    state.radii = Arc::new(forward.projected.radii().to_vec());
                    state.forward = Some(Box::new(forward));
                    image
                }
                Err(error) => {
                    call.state().error = Some(error);
                    vec![E::default(); w * h * channels]
                }
            };
            B::tensor::<E>(image, &[h, w, channels], &device)
        })
    }

    fn raster_transmittance(image: FloatTensor<Self>, call: Arc<RasterCall>) -> FloatTensor<Self> {
        let device = device_of::<B>(&image);
        let [w, h] = call.size();
        real_kernel!(image, E => {
            let state = call.state();
            let forward = state.forward.as_ref().and_then(|f| f.downcast_ref::<Forward<E>>());
            let values = forward.map_or_else(|| vec![E::default(); w * h], |f| f.transmittance.clone());
            B::tensor::<E>(values, &[h, w], &device)
        })
    }

    fn raster_transmittance_backward(
        image: FloatTensor<Self>,
        d_transmittance: FloatTensor<Self>,
        call: Arc<RasterCall>,
    ) -> FloatTensor<Self> {
        let (device, shape) = (device_of::<B>(&image), image.shape());
        real_kernel!(image, E => {
            call.state().d_transmittance = Some(Box::new(B::values::<E>(d_transmittance).into_vec()));
            B::tensor::<E>(vec![E::default(); shape.num_elements()], &shape.dims::<3>(), &device)
        })
    }

    fn raster_backward(
        tensors: RasterTensors<Self>,
        image: FloatTensor<Self>,
        d_image: FloatTensor<Self>,
        call: Arc<RasterCall>,
    ) -> RasterTensors<Self> {
        let device = device_of::<B>(&image);
        let tensors = tensors.into_array();
        let shapes = tensors.each_ref().map(|t| t.shape());
        real_kernel!(image, E => {
            let forward: Option<Forward<E>> = RasterCall::take(&mut call.state().forward);
            let inputs = HostInputs::<E>::read::<B>(RasterTensors::from_array(tensors));
            let gradients = match forward {
                Some(forward) => inputs.backward(&call, forward, &B::values(image), &B::values(d_image)),
                // Only after an error, which the caller of `rasterize` has in hands.
                None => shapes.each_ref().map(|s| vec![E::default(); s.num_elements()]),
            };
            let mut at = 0;
            RasterTensors::from_array(gradients.map(|values| {
                let shape = &shapes[at];
                at += 1;
                // No screen tensor given: its gradient goes nowhere.
                let shape = if shape.num_elements() == values.len() { shape.to_vec() } else { vec![values.len()] };
                B::tensor::<E>(values, &shape, &device)
            }))
        })
    }
}

#[derive(Debug)]
struct ImageBackward;

impl<B: RasterBackend> Backward<B, INPUTS> for ImageBackward {
    type State = (RasterTensors<B>, FloatTensor<B>, Arc<RasterCall>);

    fn backward(self, ops: Ops<Self::State, INPUTS>, grads: &mut Gradients, _checkpointer: &mut Checkpointer) {
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

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _checkpointer: &mut Checkpointer) {
        let d_transmittance = grads.consume::<B>(&ops.node);
        let (image, call) = ops.state;
        let [parent] = ops.parents;
        if let Some(node) = parent {
            grads.register::<B>(node.id, B::raster_transmittance_backward(image, d_transmittance, call));
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

    fn raster_transmittance(image: FloatTensor<Self>, call: Arc<RasterCall>) -> FloatTensor<Self> {
        let (image, node) = image.into_parts();
        match TransmittanceBackward.prepare::<C>([node]).compute_bound().stateful() {
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

/// Renders `input` seen by `camera` (Eq. 1-4), with gradients to every input.
///
/// `background` is added to the colour channels as `T b`. Gradients also flow from the transmittance. The SH gradient
/// includes the path of the viewing direction to the means.
///
/// # Errors
/// [`Error::Config`] for shapes that disagree, neither `sh` nor `features`, or an SH degree above 3;
/// [`Error::NonFinite`] for a NaN or an infinity in any input; otherwise as [`Projected::new`].
pub fn rasterize(
    input: RasterInput,
    camera: &Camera,
    settings: &Settings,
    background: [f32; 3],
) -> Result<RasterOutput> {
    let RasterInput { means, log_scales, rotations, opacity_logits, sh, active_sh_degree, features, screen } = input;
    let [n] = opacity_logits.dims();
    let shape = |name: &str, found: &[usize], expected: &[usize]| {
        if found == expected {
            return Ok(());
        }
        let (found, expected) = (format!("shape {found:?}"), format!("{expected:?}"));
        Err(Error::config(format!("raster input {name}"), found, expected, "pass tensors of one scene"))
    };
    shape("means", &means.dims(), &[n, 3])?;
    shape("log_scales", &log_scales.dims(), &[n, 3])?;
    shape("rotations", &rotations.dims(), &[n, 4])?;
    if sh.is_none() && features.is_none() {
        return Err(Error::config("raster input", "neither sh nor features", "at least one", "pass what to render"));
    }
    let terms = sh.as_ref().map_or(1, |sh| sh.dims()[1]);
    if !matches!(terms, 1 | 4 | 9 | 16) {
        let found = format!("{terms} terms");
        return Err(Error::config("raster input sh", found, "1, 4, 9 or 16", "pass (degree + 1)^2 terms"));
    }
    if let Some(sh) = &sh {
        shape("sh", &sh.dims(), &[n, terms, 3])?;
    }
    if let Some(features) = &features {
        shape("features", &features.dims(), &[n, features.dims()[1]])?;
    }
    if let Some(screen) = &screen {
        shape("screen", &screen.dims(), &[n, 2])?;
    }
    let dtype = means.dtype();
    if !matches!(dtype, DType::F32 | DType::F64) {
        return Err(Error::config("raster input", format!("{dtype:?}"), "f32 or f64", "cast the tensors"));
    }
    let call = Arc::new(RasterCall {
        camera: camera.clone(),
        settings: *settings,
        background: background.map(f64::from),
        has_sh: sh.is_some(),
        has_features: features.is_some(),
        sh_degree: terms.isqrt() - 1,
        active_sh_degree,
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
    let transmittance = Tensor::from_dispatch(Dispatch::raster_transmittance(image.clone(), call.clone()));
    let radii = call.state().radii.clone();
    Ok(RasterOutput { image: Tensor::from_dispatch(image), transmittance, radii })
}

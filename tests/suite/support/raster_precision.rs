//! A view of random Gaussians rendered in f32 on every backend and in f64 on the CPU, with all gradients.

use crate::support::on_device;
use crate::support::raster_reference::{Cloud, numbers, render};
use burn::tensor::{DType, Device, Tensor, TensorData};
use coseg::raster::{RasterInput, Settings, rasterize};
use coseg::splat::camera::Camera;

/// What is rendered.
#[derive(Clone, Copy, Debug)]
pub struct Channels {
    /// Degree stored and in use.
    pub sh: Option<(usize, usize)>,
    pub features: usize,
}

impl Channels {
    pub fn count(self) -> usize {
        self.features + if self.sh.is_some() { 3 } else { 0 }
    }

    /// Columns of the screen tensor: with sums of absolute values where the GPU has them.
    pub fn screen(self) -> usize {
        if self.count() <= 8 { 4 } else { 2 }
    }
}

/// Leaves of `cloud`, rounded to f32, in `dtype`.
pub fn input(cloud: &Cloud, channels: Channels, device: &Device, dtype: DType) -> RasterInput {
    let n = cloud.len();
    let narrow = |v: &[f64]| v.iter().map(|&x| f64::from(x as f32)).collect::<Vec<_>>();
    let two = |v: &[f64], w: usize| {
        Tensor::<2>::from_data(TensorData::new(narrow(v), [n, w]), (device, dtype)).require_grad()
    };
    RasterInput {
        means: two(&cloud.means, 3),
        log_scales: two(&cloud.log_scales, 3),
        rotations: two(&cloud.rotations, 4),
        opacity_logits: Tensor::<1>::from_data(
            TensorData::new(narrow(&cloud.opacity_logits), [n]),
            (device, dtype),
        )
        .require_grad(),
        sh: channels.sh.map(|(degree, _)| {
            let terms = (degree + 1) * (degree + 1);
            let data = TensorData::new(narrow(&numbers(n * terms * 3, 21)), [n, terms, 3]);
            Tensor::<3>::from_data(data, (device, dtype)).require_grad()
        }),
        active_sh_degree: channels.sh.map_or(0, |(_, active)| active),
        features: (channels.features > 0)
            .then(|| two(&numbers(n * channels.features, 22), channels.features)),
        screen: Some(Tensor::<2>::zeros([n, channels.screen()], (device, dtype)).require_grad()),
    }
}

/// The values in f64.
pub fn values<const D: usize>(t: Tensor<D>) -> Vec<f64> {
    t.into_data().convert::<f64>().into_vec().expect("floats")
}

pub const NAMES: [&str; 10] = [
    "image",
    "transmittance",
    "means",
    "log_scales",
    "rotations",
    "opacity_logits",
    "sh",
    "features",
    "screen",
    "absolute screen",
];

/// A view to render, and which of its pixels take part.
pub struct Compared<'a> {
    pub cloud: &'a Cloud,
    pub channels: Channels,
    pub camera: &'a Camera,
    pub settings: &'a Settings,
    /// `[H, W]`.
    pub clear: &'a [bool],
}

/// Image, transmittance, gradients of a linear loss over both in the order of [`NAMES`]; and the radii.
#[cfg(feature = "wgpu")]
pub fn run(
    cloud: &Cloud,
    channels: Channels,
    camera: &Camera,
    settings: &Settings,
    device: &Device,
    dtype: DType,
) -> (Vec<Vec<f64>>, Vec<u32>) {
    let scene = Compared {
        cloud,
        channels,
        camera,
        settings,
        clear: &vec![true; camera.width * camera.height],
    };
    scene.run(device, dtype)
}

impl Compared<'_> {
    /// As [`run`]; pixels that take no part are 0 and have no weight in the loss.
    fn run(&self, device: &Device, dtype: DType) -> (Vec<Vec<f64>>, Vec<u32>) {
        let &Self {
            cloud,
            channels,
            camera,
            settings,
            clear,
        } = self;
        let device = device.clone().autodiff();
        let input = input(cloud, channels, &device, dtype);
        let w = camera.width;
        let h = camera.height;
        let c = channels.count();
        let out = rasterize(input.clone(), camera, settings, [0.3, 0.9, -0.4]).expect("valid");
        let radii = values(out.radii.clone())
            .into_iter()
            .map(|radius| radius as u32)
            .collect();
        let masked = |values: Vec<f64>, width: usize| -> Vec<f64> {
            let values = values.into_iter().enumerate();
            let kept = values.map(|(i, v)| if clear[i / width] { v } else { 0.0 });
            kept.collect()
        };
        let loss = |width: usize, seed: u64| -> Vec<f64> {
            let weights = numbers(w * h * width, seed).into_iter();
            masked(weights.map(|x| f64::from(x as f32)).collect(), width)
        };
        let d_image =
            Tensor::<3>::from_data(TensorData::new(loss(c, 77), [h, w, c]), (&device, dtype));
        let d_t = Tensor::<2>::from_data(TensorData::new(loss(1, 78), [h, w]), (&device, dtype));
        let grads = ((out.image.clone() * d_image).sum() + (out.transmittance.clone() * d_t).sum())
            .backward();
        macro_rules! grad {
            ($t:expr) => {
                values($t.grad(&grads).expect("tracked"))
            };
        }
        let screen = grad!(input.screen.expect("given"));
        let columns = |of: std::ops::Range<usize>| -> Vec<f64> {
            screen
                .chunks_exact(channels.screen())
                .flat_map(|row| row[of.clone()].to_vec())
                .collect()
        };
        let parts = vec![
            masked(values(out.image.inner()), c),
            masked(values(out.transmittance.inner()), 1),
            grad!(input.means),
            grad!(input.log_scales),
            grad!(input.rotations),
            grad!(input.opacity_logits),
            input.sh.map_or_else(Vec::new, |t| grad!(t)),
            input.features.map_or_else(Vec::new, |t| grad!(t)),
            columns(0..2),
            columns(2..channels.screen()),
        ];
        (parts, radii)
    }
}

/// Pixels closer than this to a cut-off, or to another order of depths, may go either way in f32.
const CUT_ROUNDING: f64 = 1e-4;
const DEPTH_ROUNDING: f64 = 1e-5;
/// How much a picture may be off, relative to its largest value, and a gradient, relative to its root mean square or its value.
const PICTURE: f64 = 1e-4;
const GRADIENT: f64 = 1e-3;
/// A position in an image of `width` pixels is rounded by up to `width` times this. At the edge of the smallest splat, of a
/// standard deviation of 0.55 pixels, that moves alpha' and gradients by up to six times as much of their values.
const POSITION_ROUNDING: f64 = 1.0 / (1_u64 << 23) as f64;
const ALPHA_PER_POSITION: f64 = 6.0;
/// Relative rounding of a radius before it is rounded up.
const RADIUS_ROUNDING: f64 = 1e-5;

/// The largest difference between `got` and `want`: in a picture relative to its largest value, in a gradient relative to the value
/// or to the root mean square of all, whichever is larger.
fn relative_error(part: usize, got: &[f64], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len(), "{}", NAMES[part]);
    assert!(
        got.iter().chain(want).all(|v| v.is_finite()),
        "{} is finite",
        NAMES[part]
    );
    let largest = want.iter().fold(0.0_f64, |a, v| a.max(v.abs()));
    let rms = (want.iter().map(|v| v * v).sum::<f64>() / want.len().max(1) as f64).sqrt();
    let errors = got.iter().zip(want).map(|(g, w)| {
        let size = if part < 2 { largest } else { w.abs().max(rms) };
        let difference = (g - w).abs();
        if difference == 0.0 {
            0.0
        } else {
            difference / size
        }
    });
    errors.fold(0.0, f64::max)
}

/// How much of [`relative_error`] the contract allows in an image whose positions have this rounding.
fn bound(part: usize, rounding: f64) -> f64 {
    if part < 2 {
        PICTURE.max(rounding)
    } else {
        GRADIENT.max(ALPHA_PER_POSITION * rounding)
    }
}

/// Checks f32 on every backend of this build against f64. Pixels in doubt take no part, neither in the pictures nor in the loss;
/// no more than the share `doubtful` of all may be. All others have to agree, without exception. Prints a row of a table for each
/// backend: its name, pixels in doubt, and the relative errors in the order of [`NAMES`].
pub fn compare(
    what: &str,
    cloud: &Cloud,
    channels: Channels,
    camera: &Camera,
    settings: &Settings,
    doubtful: f64,
) {
    let reference = render(cloud, &vec![0.0; cloud.len()], 1, camera, settings);
    let rounding = POSITION_ROUNDING * camera.width.max(camera.height) as f64;
    let cut_rounding = CUT_ROUNDING.max(ALPHA_PER_POSITION * rounding);
    let clear: Vec<bool> = reference
        .margins
        .iter()
        .zip(&reference.depth_gaps)
        .map(|(&margin, &gap)| margin > cut_rounding && gap > DEPTH_ROUNDING)
        .collect();
    let in_doubt = clear.iter().filter(|&&clear| !clear).count();
    assert!(
        in_doubt as f64 <= doubtful * clear.len() as f64,
        "{what}: {in_doubt} of {} pixels are in doubt",
        clear.len()
    );
    let scene = Compared {
        cloud,
        channels,
        camera,
        settings,
        clear: &clear,
    };
    let (want, want_radii) = scene.run(&crate::support::device(), DType::F64);
    for (name, device) in crate::support::devices() {
        let is_gpu = !coseg::backend::device::in_host_memory(&device);
        let (got, got_radii) =
            on_device(is_gpu.then_some(&device), || scene.run(&device, DType::F32));
        let parts = got.iter().zip(&want).enumerate();
        let errors: Vec<f64> = parts
            .map(|(part, (got, want))| relative_error(part, got, want))
            .collect();
        let cells: Vec<String> = errors.iter().map(|error| format!("{error:.1e}")).collect();
        println!("| {what} | {name} | {in_doubt} | {} |", cells.join(" | "));
        for (part, &error) in errors.iter().enumerate() {
            let bound = bound(part, rounding);
            assert!(
                error <= bound,
                "{what}, {channels:?} on {name}: {} is off by {error:e}, where {bound:e} is allowed",
                NAMES[part]
            );
        }
        for (i, (&got, &want)) in got_radii.iter().zip(&want_radii).enumerate() {
            let reach = reference.reaches[i];
            let rounded = [1.0 - RADIUS_ROUNDING, 1.0 + RADIUS_ROUNDING]
                .map(|factor| (reach * factor).ceil() as u32);
            // Those of millions of pixels have more digits than an f32.
            let close = f64::from(got.abs_diff(want)) <= 1e-6 * f64::from(want);
            assert!(
                close || want > 0 && rounded.contains(&got),
                "{what} on {name}: radius {got} for {want} of Gaussian {i}"
            );
        }
    }
}

pub const RGB: Channels = Channels {
    sh: Some((3, 3)),
    features: 0,
};
/// Without a cut-off that matters.
pub const SMOOTH: Settings = Settings {
    alpha_max: 1.0,
    alpha_min: 1e-14,
    t_min: 0.0,
    near: 0.01,
    low_pass: 0.3,
};

/// Feature channels alone.
pub fn plain(features: usize) -> Channels {
    Channels { sh: None, features }
}

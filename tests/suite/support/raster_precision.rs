//! A view of random Gaussians rendered in f32 on every backend and in f64 on the CPU, with all gradients.

use crate::support::on_device;
use crate::support::raster_errors::{Contract, Picture, gradient_error, picture_errors};
use crate::support::raster_reference::{Cloud, DOUBTFUL, Reference, numbers, render};
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

/// Behind all Gaussians.
pub const BACKGROUND: [f32; 3] = [0.3, 0.9, -0.4];

/// A view to render, and which of its pixels the loss reads.
#[derive(Clone, Copy)]
pub struct Compared<'a> {
    pub cloud: &'a Cloud,
    pub channels: Channels,
    pub camera: &'a Camera,
    pub settings: &'a Settings,
    /// `[H, W]`.
    pub clear: &'a [bool],
}

/// Image, transmittance, gradients of a linear loss over both in the order of [`NAMES`]; and the radii.
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
    /// Image and transmittance in f64.
    fn picture(&self, device: &Device) -> Picture {
        let device = device.clone().autodiff();
        let input = input(self.cloud, self.channels, &device, DType::F64);
        let out = rasterize(input, self.camera, self.settings, BACKGROUND).expect("valid");
        [values(out.image.inner()), values(out.transmittance.inner())]
    }

    /// As [`run`]; pixels that are not clear have no weight in the loss.
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
        let out = rasterize(input.clone(), camera, settings, BACKGROUND).expect("valid");
        let radii = values(out.radii.clone())
            .into_iter()
            .map(|radius| radius as u32)
            .collect();
        let loss = |width: usize, seed: u64| -> Vec<f64> {
            let weights = numbers(w * h * width, seed).into_iter().enumerate();
            let weight = |(i, x): (usize, f64)| if clear[i / width] { x } else { 0.0 };
            weights.map(weight).map(|x| f64::from(x as f32)).collect()
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
            values(out.image.inner()),
            values(out.transmittance.inner()),
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

/// Relative rounding of a radius before it is rounded up.
const RADIUS_ROUNDING: f64 = 1e-5;
/// How far a colour moves at most where the blending weights change by 1: features and their background lie in -1..1, and the SH
/// coefficients of [`input`] give colours of up to 4.71 before a background of -0.4.
const FEATURE_JUMP: f64 = 2.0;
const COLOR_JUMP: f64 = 5.2;

/// Checks f32 on every backend of this build against f64: all pixels, and the gradients of a loss over those without a decision in
/// doubt, of which there have to be at least the share `least_clear`. Prints a row of a table for each backend: its name, pixels in
/// doubt, and the relative errors in the order of [`NAMES`], then the bounds of pictures and gradients.
pub fn compare(
    what: &str,
    cloud: &Cloud,
    channels: Channels,
    camera: &Camera,
    settings: &Settings,
    least_clear: f64,
) {
    let reference = render(cloud, &vec![0.0; cloud.len()], 1, camera, settings);
    for (name, device) in crate::support::devices() {
        let is_gpu = !coseg::backend::device::in_host_memory(&device);
        let contract = Contract::of(camera, is_gpu);
        assert!(contract.cut < DOUBTFUL, "all doubts are recorded");
        let doubts = reference.doubts.iter();
        let clear: Vec<bool> = doubts
            .map(|doubts| !doubts.iter().any(|doubt| contract.may_turn(doubt)))
            .collect();
        let in_doubt = clear.iter().filter(|&&clear| !clear).count();
        assert!(
            in_doubt as f64 <= (1.0 - least_clear) * clear.len() as f64,
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
        let wide = crate::support::device();
        let (want, want_radii) = scene.run(&wide, DType::F64);
        let (got, got_radii) =
            on_device(is_gpu.then_some(&device), || scene.run(&device, DType::F32));
        let moved = contract.sides(settings);
        let moved = moved.iter().map(|settings| {
            let side = Compared { settings, ..scene };
            side.picture(&wide)
        });
        let base = [want[0].clone(), want[1].clone()];
        let sides: Vec<Picture> = [base].into_iter().chain(moved).collect();
        for values in got.iter().chain(&want).chain(sides.iter().flatten()) {
            assert!(values.iter().all(|v| v.is_finite()), "{what} on {name}");
        }
        let jump = match channels.sh {
            Some(_) => COLOR_JUMP,
            None => FEATURE_JUMP,
        };
        let picture = [&got[0][..], &got[1][..]];
        let mut errors =
            picture_errors(picture, &sides, &reference.doubts, &contract, jump).to_vec();
        for part in 2..NAMES.len() {
            assert_eq!(got[part].len(), want[part].len(), "{}", NAMES[part]);
            errors.push(gradient_error(&got[part], &want[part]));
        }
        let cells: Vec<String> = errors.iter().map(|error| format!("{error:.1e}")).collect();
        println!(
            "| {what} | {name} | {in_doubt} | {} | {:.1e} | {:.1e} |",
            cells.join(" | "),
            contract.picture,
            contract.gradient
        );
        for (part, &error) in errors.iter().enumerate() {
            let bound = contract.bound(part);
            assert!(
                error <= bound,
                "{what}, {channels:?} on {name}: {} is off by {error:e}, where {bound:e} is allowed",
                NAMES[part]
            );
        }
        assert_radii(what, &name.to_string(), &reference, &got_radii, &want_radii);
    }
}

/// Radii are equal, or where rounding decides, one of both.
fn assert_radii(what: &str, name: &str, reference: &Reference, got: &[u32], want: &[u32]) {
    for (i, (&got, &want)) in got.iter().zip(want).enumerate() {
        let rounded = [1.0 - RADIUS_ROUNDING, 1.0 + RADIUS_ROUNDING]
            .map(|factor| (reference.reaches[i] * factor).ceil() as u32);
        // Those of millions of pixels have more digits than an f32.
        let close = f64::from(got.abs_diff(want)) <= 1e-6 * f64::from(want);
        assert!(
            close || want > 0 && rounded.contains(&got),
            "{what} on {name}: radius {got} for {want} of Gaussian {i}"
        );
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

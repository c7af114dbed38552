//! A view of random Gaussians rendered in f32 on every backend and in f64 on the CPU, with all gradients.

use crate::support::on_device;
use crate::support::raster_reference::{Cloud, Doubt, Kind, Reference, numbers, render};
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
        let out = rasterize(input.clone(), camera, settings, [0.3, 0.9, -0.4]).expect("valid");
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

/// Decisions closer than this to a cut-off, or to another order of depths, may go either way in f32.
const CUT_ROUNDING: f64 = 1e-4;
const DEPTH_ROUNDING: f64 = 1e-5;
/// How much a picture may be off, relative to its largest value, and a gradient, relative to its root mean square or its value.
const PICTURE: f64 = 1e-4;
const GRADIENT: f64 = 1e-3;
/// A GPU rounds a position in an image of `width` pixels by up to `width` times this. At the edge of the smallest splat, of a standard
/// deviation of 0.55 pixels, that moves alpha' and gradients by up to six times as much of their values.
const POSITION_ROUNDING: f64 = 1.0 / (1_u64 << 23) as f64;
const ALPHA_PER_POSITION: f64 = 6.0;
/// Relative rounding of a radius before it is rounded up.
const RADIUS_ROUNDING: f64 = 1e-5;
/// The largest absolute value of a colour or feature that [`input`] makes: features lie in -1..1, and a colour sums SH terms.
const LARGEST_FEATURE: f64 = 1.0;
const LARGEST_COLOR: f64 = 8.0;

/// How far f32 may be from f64.
struct Contract {
    /// Relative distance from a cut-off within which either side is right.
    cut: f64,
    picture: f64,
    gradient: f64,
}

impl Contract {
    fn of(camera: &Camera, is_gpu: bool) -> Self {
        let width = camera.width.max(camera.height) as f64;
        let position = if is_gpu {
            POSITION_ROUNDING * width
        } else {
            0.0
        };
        Self {
            cut: CUT_ROUNDING.max(ALPHA_PER_POSITION * position),
            picture: PICTURE.max(position),
            gradient: GRADIENT.max(ALPHA_PER_POSITION * position),
        }
    }

    fn bound(&self, part: usize) -> f64 {
        if part < 2 {
            self.picture
        } else {
            self.gradient
        }
    }

    /// Whether f32 may decide otherwise.
    fn may_turn(&self, doubt: &Doubt) -> bool {
        let rounding = match doubt.kind {
            Kind::Cut | Kind::Cap => self.cut,
            Kind::Order => DEPTH_ROUNDING,
        };
        doubt.distance <= rounding
    }

    /// Both sides of the cut-offs.
    fn sides(&self, settings: &Settings) -> [Settings; 4] {
        let [below, above] = [1.0 - self.cut, 1.0 + self.cut];
        let alpha = |factor| Settings {
            alpha_min: settings.alpha_min * factor,
            ..*settings
        };
        let transmittance = |factor| Settings {
            t_min: settings.t_min * factor,
            ..*settings
        };
        [
            alpha(below),
            alpha(above),
            transmittance(below),
            transmittance(above),
        ]
    }
}

/// The largest difference between the gradients `got` and `want`, relative to the value or to the root mean square of all, whichever
/// is larger.
fn gradient_error(got: &[f64], want: &[f64]) -> f64 {
    let rms = (want.iter().map(|v| v * v).sum::<f64>() / want.len().max(1) as f64).sqrt();
    let errors = got.iter().zip(want).map(|(g, w)| {
        let difference = (g - w).abs();
        if difference == 0.0 {
            0.0
        } else {
            difference / w.abs().max(rms)
        }
    });
    errors.fold(0.0, f64::max)
}

/// The largest difference between the picture `got` and the first of `sides`, relative to its largest value. A pixel with one decision
/// in doubt may be that of any side. One with several, or with two Gaussians in another order, may be off by what these gain or lose.
fn picture_error(
    got: &[f64],
    sides: &[Vec<f64>],
    doubts: &[Vec<Doubt>],
    contract: &Contract,
    largest_value: f64,
) -> f64 {
    let want = &sides[0];
    let largest = want.iter().fold(0.0_f64, |a, v| a.max(v.abs()));
    let channels = got.len() / doubts.len();
    let mut worst = 0.0_f64;
    for (pixel, doubts) in doubts.iter().enumerate() {
        let part = pixel * channels..(pixel + 1) * channels;
        let off = |side: &Vec<f64>| {
            let pairs = got[part.clone()].iter().zip(&side[part.clone()]);
            pairs.map(|(g, w)| (g - w).abs()).fold(0.0, f64::max)
        };
        let turning: Vec<_> = doubts.iter().filter(|d| contract.may_turn(d)).collect();
        let jumps: f64 = turning.iter().map(|doubt| 2.0 * doubt.jump).sum();
        let difference = match &turning[..] {
            [] => off(want),
            [only] if only.kind != Kind::Order => {
                sides.iter().map(off).fold(f64::INFINITY, f64::min)
            }
            _ => (off(want) - jumps * largest_value).max(0.0),
        };
        worst = worst.max(difference);
    }
    if worst == 0.0 { 0.0 } else { worst / largest }
}

/// Checks f32 on every backend of this build against f64: all pixels, and the gradients of a loss over those without a decision in
/// doubt, of which there have to be at least the share `clear`. Prints a row of a table for each backend: its name, pixels in doubt,
/// and the relative errors in the order of [`NAMES`], then the bounds of pictures and gradients.
pub fn compare(
    what: &str,
    cloud: &Cloud,
    channels: Channels,
    camera: &Camera,
    settings: &Settings,
    clear: f64,
) {
    let reference = render(cloud, &vec![0.0; cloud.len()], 1, camera, settings);
    for (name, device) in crate::support::devices() {
        let is_gpu = !coseg::backend::device::in_host_memory(&device);
        let contract = Contract::of(camera, is_gpu);
        let doubts = reference.doubts.iter();
        let pixels: Vec<bool> = doubts
            .map(|doubts| !doubts.iter().any(|doubt| contract.may_turn(doubt)))
            .collect();
        let in_doubt = pixels.iter().filter(|&&clear| !clear).count();
        assert!(
            in_doubt as f64 <= (1.0 - clear) * pixels.len() as f64,
            "{what}: {in_doubt} of {} pixels are in doubt",
            pixels.len()
        );
        let scene = Compared {
            cloud,
            channels,
            camera,
            settings,
            clear: &pixels,
        };
        let wide = crate::support::device();
        let (want, want_radii) = scene.run(&wide, DType::F64);
        let sides = contract.sides(settings);
        let sides = sides.iter().map(|settings| {
            let side = Compared { settings, ..scene };
            side.run(&wide, DType::F64).0
        });
        let sides: Vec<_> = [want.clone()].into_iter().chain(sides).collect();
        let (got, got_radii) =
            on_device(is_gpu.then_some(&device), || scene.run(&device, DType::F32));
        let largest_value = match channels.sh {
            Some(_) => LARGEST_COLOR,
            None => LARGEST_FEATURE,
        };
        let error = |part: usize| {
            assert_eq!(got[part].len(), want[part].len(), "{}", NAMES[part]);
            assert!(
                got[part].iter().chain(&want[part]).all(|v| v.is_finite()),
                "{} is finite",
                NAMES[part]
            );
            if part < 2 {
                let sides: Vec<_> = sides.iter().map(|side| side[part].clone()).collect();
                picture_error(
                    &got[part],
                    &sides,
                    &reference.doubts,
                    &contract,
                    largest_value,
                )
            } else {
                gradient_error(&got[part], &want[part])
            }
        };
        let errors: Vec<f64> = (0..NAMES.len()).map(error).collect();
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

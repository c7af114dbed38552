//! A view of random Gaussians rendered on a GPU in f32 and on the CPU in f64, with all gradients.

use crate::support::device_tensors::on_device;
use crate::support::gpu;
use crate::support::raster_reference::{Cloud, numbers};
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

/// Image, transmittance, gradients of a linear loss over both in the order of [`NAMES`]; and the radii.
pub fn run(
    cloud: &Cloud,
    channels: Channels,
    camera: &Camera,
    settings: &Settings,
    device: &Device,
    dtype: DType,
) -> (Vec<Vec<f64>>, Vec<u32>) {
    let device = device.clone().autodiff();
    let input = input(cloud, channels, &device, dtype);
    let (w, h, c) = (camera.width, camera.height, channels.count());
    let out = rasterize(input.clone(), camera, settings, [0.3, 0.9, -0.4]).expect("valid");
    let radii = values(out.radii.clone())
        .into_iter()
        .map(|radius| radius as u32)
        .collect();
    let loss = |count: usize, seed: u64| -> Vec<f64> {
        numbers(count, seed)
            .iter()
            .map(|&x| f64::from(x as f32))
            .collect()
    };
    let d_image = Tensor::<3>::from_data(
        TensorData::new(loss(w * h * c, 77), [h, w, c]),
        (&device, dtype),
    );
    let d_t = Tensor::<2>::from_data(TensorData::new(loss(w * h, 78), [h, w]), (&device, dtype));
    let grads =
        ((out.image.clone() * d_image).sum() + (out.transmittance.clone() * d_t).sum()).backward();
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

/// Values further from `want` than the contract allows: 1e-4 of the largest for what is rendered, 1e-3 of the root mean
/// square (or of the value) for gradients.
fn outside(part: usize, got: &[f64], want: &[f64]) -> usize {
    assert_eq!(got.len(), want.len(), "{}", NAMES[part]);
    assert!(
        got.iter().all(|v| v.is_finite()),
        "{} is finite",
        NAMES[part]
    );
    let largest = want.iter().fold(0.0_f64, |a, v| a.max(v.abs()));
    let rms = (want.iter().map(|v| v * v).sum::<f64>() / want.len().max(1) as f64).sqrt();
    let off = |g: f64, w: f64| {
        (g - w).abs()
            > if part < 2 {
                1e-4 * largest
            } else {
                1e-3 * w.abs().max(rms)
            }
    };
    got.iter().zip(want).filter(|&(&g, &w)| off(g, w)).count()
}

/// Checks all parts; `allowed` is the share of values that a crossed cut-off or a depth flip may have moved.
pub fn compare(
    what: &str,
    cloud: &Cloud,
    channels: Channels,
    camera: &Camera,
    settings: &Settings,
    allowed: f64,
) {
    let Some(gpu) = gpu() else { return };
    let (want, want_radii) = run(
        cloud,
        channels,
        camera,
        settings,
        &crate::support::device(),
        DType::F64,
    );
    let (got, got_radii) = on_device(Some(&gpu), || {
        run(cloud, channels, camera, settings, &gpu, DType::F32)
    });
    for (part, (got, want)) in got.iter().zip(&want).enumerate() {
        let off = outside(part, got, want);
        let worst = got
            .iter()
            .zip(want)
            .map(|(g, w)| (g - w).abs())
            .fold(0.0, f64::max);
        eprintln!(
            "{what}, {channels:?}, {}: {off} of {} off, the worst by {worst:e}",
            NAMES[part],
            want.len()
        );
        assert!(
            off as f64 <= allowed * want.len() as f64,
            "{what}, {channels:?}: {off} of {} values of {} are off, the worst by {worst:e}",
            want.len(),
            NAMES[part]
        );
    }
    // Those of millions of pixels have more digits than an f32.
    let differ = |g: u32, w: u32| f64::from(g.abs_diff(w)) > 1e-6 * f64::from(w);
    let radii = got_radii
        .iter()
        .zip(&want_radii)
        .filter(|&(&g, &w)| differ(g, w))
        .count();
    assert!(
        radii as f64 <= allowed * want_radii.len() as f64,
        "{what}: {radii} radii differ"
    );
}

pub const RGB: Channels = Channels {
    sh: Some((3, 3)),
    features: 0,
};
/// Without any cut-off.
pub const SMOOTH: Settings = Settings {
    alpha_max: 1.0,
    alpha_min: 0.0,
    t_min: 0.0,
    near: 0.01,
    low_pass: 0.3,
};

/// Feature channels alone.
pub fn plain(features: usize) -> Channels {
    Channels { sh: None, features }
}

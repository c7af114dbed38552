//! Time against error: each setting of the rasterizer changed alone, against an exact rendering in f64.

use super::{Bench, Figures};
use crate::backend::device::{open_cpu, read_wide};
use crate::error::Result;
use crate::ops::sum_all;
use crate::raster::{RasterInput, Settings, rasterize};
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use burn::tensor::{DType, Device, Gradients, Tensor, TensorData};
use std::hint::black_box;
use std::time::Instant;

/// Views of a pass, at most, and their size.
const VIEWS: usize = 4;
const SIZE: [usize; 2] = [480, 360];
/// Stands for an alpha_min of 0, at which every Gaussian would meet every pixel. What a million Gaussians could add below
/// it is less than an f32 can show.
const NEARLY_ZERO: f64 = 1e-14;
const ALPHA_MIN: [f64; 6] = [
    NEARLY_ZERO,
    1.0 / 1024.0,
    1.0 / 255.0,
    1.0 / 128.0,
    1.0 / 64.0,
    1.0 / 32.0,
];
const T_MIN: [f64; 5] = [0.0, 1e-5, 1e-4, 1e-3, 1e-2];
const ALPHA_MAX: [f64; 4] = [1.0, 0.999, 0.99, 0.95];
/// Gradients of a [`Pass`].
const GRADIENTS: [&str; 5] = ["means", "log-scales", "rotations", "opacities", "SH"];

/// One point of the curve.
struct Point {
    name: String,
    settings: Settings,
    sh_degree: usize,
    /// Milliseconds of a view, for each pass over the views: forward, and forward and backward.
    times: [Vec<f64>; 2],
}

/// The Gaussians on a device, tracked by autodiff, and the views.
struct Subject<'a> {
    input: RasterInput,
    cameras: &'a [Camera],
}

/// A view and the gradients of its loss, in host memory.
struct Pass {
    image: Vec<f64>,
    gradients: [Vec<f64>; 5],
}

/// Times and errors of each point: forward, and forward and backward.
pub(super) fn measure(bench: &Bench, gaussians: &Gaussians) -> Result<Vec<Figures>> {
    let cameras = cameras(bench);
    let subject = |device: &Device, dtype| Subject {
        input: input(gaussians, device, dtype),
        cameras: &cameras,
    };
    let configured = Settings::from(&bench.config.raster);
    let exact = Settings {
        alpha_min: NEARLY_ZERO,
        t_min: 0.0,
        alpha_max: 1.0,
        ..configured
    };
    let mut points = points(&configured, &exact, gaussians.sh_degree);
    let found = subject(&bench.device, DType::F32);
    // Round by round, so that a slow moment of the machine affects all points alike. The first round is the warm-up.
    for round in 0..=bench.repeats {
        for point in &mut points {
            let seconds = [found.seconds(point, false)?, found.seconds(point, true)?];
            for (times, seconds) in point.times.iter_mut().zip(seconds) {
                if round > 0 {
                    times.push(1e3 * seconds / cameras.len() as f64);
                }
            }
        }
    }
    let reference = subject(&open_cpu()?, DType::F64);
    let truth = reference.passes(&exact, gaussians.sh_degree, None)?;
    let mut figures = tables(gaussians.len(), cameras.len());
    for point in &points {
        let passes = found.passes(&point.settings, point.sh_degree, Some(&truth))?;
        let errors = [
            image_errors(&passes, &truth),
            gradient_errors(&passes, &truth),
        ];
        for ((figures, times), errors) in figures.iter_mut().zip(&point.times).zip(errors) {
            figures.add(&point.name, "ms", times);
            if let Some(figure) = figures.figures.last_mut() {
                figure.errors = errors;
            }
        }
    }
    Ok(figures.into())
}

/// The tables of forward and of forward and backward passes, without rows.
fn tables(gaussians: usize, views: usize) -> [Figures; 2] {
    let [width, height] = SIZE;
    let mut forward = Figures::new("curve", gaussians);
    forward.error_names = &["mean", "largest"];
    forward.notes = vec![
        format!(
            "{views} views of {width}x{height} on black; the time of a view, until it is in host memory"
        ),
        "errors: absolute, of RGB, against f64 with alpha_min 1e-14, t_min 0, alpha_max 1"
            .to_owned(),
        "each line changes one of the configured settings".to_owned(),
    ];
    let mut backward = Figures::new("curve of gradients", gaussians);
    backward.error_names = &GRADIENTS;
    backward.notes = vec![
        "the same views, forward and backward; the loss is half the squared distance of RGB from grey".to_owned(),
        "errors: of each gradient, root mean square over that of the gradient in f64".to_owned(),
    ];
    [forward, backward]
}

/// Some of the training cameras, evenly chosen.
fn cameras(bench: &Bench) -> Vec<Camera> {
    let views = &bench.scene.views;
    let count = VIEWS.min(views.len());
    (0..count)
        .map(|i| {
            views[i * views.len() / count]
                .camera
                .with_size(SIZE[0], SIZE[1])
        })
        .collect()
}

/// `gaussians` as tensors of `dtype`, tracked by autodiff.
fn input(gaussians: &Gaussians, device: &Device, dtype: DType) -> RasterInput {
    let device = device.clone().autodiff();
    let n = gaussians.len();
    let data = |values: &[f32], shape: &[usize]| TensorData::new(values.to_vec(), shape.to_vec());
    let matrix = |values: &[f32], width| {
        Tensor::<2>::from_data(data(values, &[n, width]), (&device, dtype)).require_grad()
    };
    let sh = data(&gaussians.sh, &[n, gaussians.sh_len(), 3]);
    let logits = data(&gaussians.opacity_logits, &[n]);
    RasterInput {
        means: matrix(gaussians.means.as_flattened(), 3),
        log_scales: matrix(gaussians.log_scales.as_flattened(), 3),
        rotations: matrix(gaussians.rotations.as_flattened(), 4),
        opacity_logits: Tensor::from_data(logits, (&device, dtype)).require_grad(),
        sh: Some(Tensor::from_data(sh, (&device, dtype)).require_grad()),
        active_sh_degree: gaussians.sh_degree,
        features: None,
        screen: None,
    }
}

impl Subject<'_> {
    fn image(&self, camera: &Camera, settings: &Settings, sh_degree: usize) -> Result<Tensor<3>> {
        let input = RasterInput {
            active_sh_degree: sh_degree,
            ..self.input.clone()
        };
        Ok(rasterize(input, camera, settings, [0.0; 3])?.image)
    }

    /// Seconds of the views, or of the views and their gradients.
    fn seconds(&self, point: &Point, with_gradients: bool) -> Result<f64> {
        let start = Instant::now();
        for camera in self.cameras {
            let image = self.image(camera, &point.settings, point.sh_degree)?;
            let found = image.clone().inner();
            if with_gradients {
                let mut gradients = loss(image, found).backward();
                let last = self.input.opacity_logits.grad_remove(&mut gradients);
                // A device computes in order: with the last gradient all others are there.
                black_box(last.map(values).transpose()?);
            } else {
                black_box(values(found)?);
            }
        }
        Ok(start.elapsed().as_secs_f64())
    }

    /// All views with their gradients. The loss is that of the images of `truth`, where it is given, so that gradients differ by
    /// the backward pass alone.
    fn passes(
        &self,
        settings: &Settings,
        sh_degree: usize,
        truth: Option<&[Pass]>,
    ) -> Result<Vec<Pass>> {
        let pass = |(i, camera): (usize, &Camera)| {
            let image = self.image(camera, settings, sh_degree)?;
            let found = image.clone().inner();
            let at = match truth {
                Some(truth) => {
                    let data = TensorData::new(truth[i].image.clone(), found.dims());
                    Tensor::from_data(data, (&found.device(), found.dtype()))
                }
                None => found.clone(),
            };
            let mut gradients = loss(image, at).backward();
            let input = &self.input;
            let sh = input.sh.as_ref().map(|sh| gradient(sh, &mut gradients));
            Ok(Pass {
                image: values(found)?,
                gradients: [
                    gradient(&input.means, &mut gradients)?,
                    gradient(&input.log_scales, &mut gradients)?,
                    gradient(&input.rotations, &mut gradients)?,
                    gradient(&input.opacity_logits, &mut gradients)?,
                    sh.transpose()?.unwrap_or_default(),
                ],
            })
        };
        self.cameras.iter().enumerate().map(pass).collect()
    }
}

/// Has the gradient of half the squared distance between `at` and grey.
fn loss(image: Tensor<3>, at: Tensor<3>) -> Tensor<1> {
    sum_all(image * Tensor::from_inner(at - 0.5))
}

fn gradient<const D: usize>(leaf: &Tensor<D>, gradients: &mut Gradients) -> Result<Vec<f64>> {
    let found = leaf.grad_remove(gradients);
    values(found.unwrap_or_else(|| leaf.clone().inner().zeros_like()))
}

fn values<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f64>> {
    read_wide("the rasterizer's values", tensor)
}

/// Mean and largest absolute error of the images.
fn image_errors(found: &[Pass], truth: &[Pass]) -> Vec<f64> {
    let pairs = found.iter().zip(truth);
    let errors = pairs.flat_map(|(found, truth)| {
        let values = found.image.iter().zip(&truth.image);
        values.map(|(found, truth)| (found - truth).abs())
    });
    let errors: Vec<f64> = errors.collect();
    let mean = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
    vec![mean, errors.into_iter().fold(0.0, f64::max)]
}

/// Error of each gradient over all views, relative to the gradient.
fn gradient_errors(found: &[Pass], truth: &[Pass]) -> Vec<f64> {
    let of = |k: usize| {
        let mut squares = [0.0; 2];
        for (found, truth) in found.iter().zip(truth) {
            for (found, truth) in found.gradients[k].iter().zip(&truth.gradients[k]) {
                squares[0] += (found - truth).powi(2);
                squares[1] += truth.powi(2);
            }
        }
        (squares[0] / squares[1].max(f64::MIN_POSITIVE)).sqrt()
    };
    (0..GRADIENTS.len()).map(of).collect()
}

/// The settings to try: the configured ones, then each setting from exact to coarse, then all exact.
fn points(configured: &Settings, exact: &Settings, sh_degree: usize) -> Vec<Point> {
    let c = *configured;
    let alpha_min = ALPHA_MIN.map(|v| {
        (
            format!("alpha_min {}", number(v)),
            Settings { alpha_min: v, ..c },
        )
    });
    let t_min = T_MIN.map(|v| (format!("t_min {}", number(v)), Settings { t_min: v, ..c }));
    let alpha_max = ALPHA_MAX.map(|v| (format!("alpha_max {v}"), Settings { alpha_max: v, ..c }));
    let tried = alpha_min.into_iter().chain(t_min).chain(alpha_max);
    let tried = tried.chain([("all exact".to_owned(), *exact)]);
    let tried = tried.filter(|(_, settings)| settings != configured);
    let point = |(name, settings)| Point {
        name,
        settings,
        sh_degree,
        times: Default::default(),
    };
    let first = ("as configured".to_owned(), c);
    let mut points: Vec<Point> = [first].into_iter().chain(tried).map(point).collect();
    points.extend((0..sh_degree).map(|degree| Point {
        sh_degree: degree,
        ..point((format!("SH degree {degree} of {sh_degree}"), c))
    }));
    points
}

/// A number as `1/255` where it is the reciprocal of a whole number, else as `1e-5` where it is small.
fn number(value: f64) -> String {
    let parts = (1.0 / value).round();
    if (10.0..1e4).contains(&parts) && parts % 10.0 != 0.0 && value == 1.0 / parts {
        format!("1/{parts}")
    } else if value > 0.0 && value < 0.01 {
        format!("{value:e}")
    } else {
        value.to_string()
    }
}

//! Time against error: each setting of the rasterizer, the number of Gaussians and the size of the picture changed alone, against
//! an exact rendering in f64.

use super::{Bench, Figures};
use crate::backend::device::{open_cpu, read_wide};
use crate::error::Result;
use crate::ops::sum_all;
use crate::pipeline::{Keep, prune};
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
/// Shares of the Gaussians that stay when the others are pruned.
const SHARES: [f64; 2] = [0.75, 0.5];
/// Pixels of the reference that a pixel covers in each direction; divisors of [`SIZE`].
const PIXELS: [usize; 2] = [2, 4];
/// Gradients of a [`Pass`].
const GRADIENTS: [&str; 5] = ["means", "log-scales", "rotations", "opacities", "SH"];

/// One point of the curve.
struct Point {
    name: String,
    settings: Settings,
    /// Its Gaussians, tracked by autodiff.
    input: RasterInput,
    /// Which of the scene's they are; all if `None`.
    rows: Option<Vec<u32>>,
    /// A pixel of its pictures covers this many pixels of the reference in each direction.
    pixel: usize,
    /// Milliseconds of a view, for each pass over the views: forward, and forward and backward.
    times: [Vec<f64>; 2],
}

/// A view and the gradients of its loss, in host memory.
struct Pass {
    image: Vec<f64>,
    gradients: [Vec<f64>; 5],
}

/// Times and errors of each point: forward, and forward and backward.
pub(super) fn measure(bench: &Bench, gaussians: &Gaussians) -> Result<Vec<Figures>> {
    let cameras = cameras(bench);
    let mut points = points(bench, gaussians)?;
    // Round by round, so that a slow moment of the machine affects all points alike. The first round is the warm-up.
    for round in 0..=bench.repeats {
        for point in &mut points {
            let seconds = [
                point.seconds(&cameras, false)?,
                point.seconds(&cameras, true)?,
            ];
            for (times, seconds) in point.times.iter_mut().zip(seconds) {
                if round > 0 {
                    times.push(1e3 * seconds / cameras.len() as f64);
                }
            }
        }
    }
    let settings = exact(&Settings::from(&bench.config.raster));
    let reference = Point::new("f64", settings, input(gaussians, &open_cpu()?, DType::F64));
    let truth = reference.passes(&cameras, None, gaussians.len())?;
    let mut figures = tables(gaussians.len(), cameras.len());
    for point in &points {
        let passes = point.passes(&cameras, Some(&truth), gaussians.len())?;
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
        "each line changes one of the configured settings, or the Gaussians or pixels themselves".to_owned(),
        "shares of the Gaussians: those that `coseg prune --keep` leaves; image scales: each pixel shown as a square".to_owned(),
    ];
    let mut backward = Figures::new("curve of gradients", gaussians);
    backward.error_names = &GRADIENTS;
    backward.notes = vec![
        "the same views, forward and backward; the loss is half the squared distance of RGB from grey".to_owned(),
        "errors: of each gradient, root mean square over that of the gradient in f64; a Gaussian left out has the gradient 0".to_owned(),
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

impl Point {
    fn new(name: impl Into<String>, settings: Settings, input: RasterInput) -> Self {
        Self {
            name: name.into(),
            settings,
            input,
            rows: None,
            pixel: 1,
            times: Default::default(),
        }
    }

    fn image(&self, camera: &Camera) -> Result<Tensor<3>> {
        let camera = camera.with_size(SIZE[0] / self.pixel, SIZE[1] / self.pixel);
        Ok(rasterize(self.input.clone(), &camera, &self.settings, [0.0; 3])?.image)
    }

    /// Seconds of the views, or of the views and their gradients.
    fn seconds(&self, cameras: &[Camera], with_gradients: bool) -> Result<f64> {
        let start = Instant::now();
        for camera in cameras {
            let image = self.image(camera)?;
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

    /// All views, and the gradients of the scene's `count` Gaussians. The loss is that of the images of `truth`, where it is given:
    /// errors of the picture do not change it.
    fn passes(
        &self,
        cameras: &[Camera],
        truth: Option<&[Pass]>,
        count: usize,
    ) -> Result<Vec<Pass>> {
        let pass = |(i, camera): (usize, &Camera)| {
            let image = self.image(camera)?;
            let found = image.clone().inner();
            let at = match truth {
                Some(truth) => {
                    let data = TensorData::new(truth[i].image.clone(), [SIZE[1], SIZE[0], 3]);
                    let truth = Tensor::from_data(data, (&found.device(), found.dtype()));
                    coarser(truth, self.pixel)
                }
                None => found.clone(),
            };
            // Each pixel stands for as many terms of the loss as it covers pixels.
            let weight = (self.pixel * self.pixel) as f64;
            let mut gradients = (loss(image, at) * weight).backward();
            let input = &self.input;
            let sh = input.sh.as_ref().map(|sh| gradient(sh, &mut gradients));
            let own = [
                gradient(&input.means, &mut gradients)?,
                gradient(&input.log_scales, &mut gradients)?,
                gradient(&input.rotations, &mut gradients)?,
                gradient(&input.opacity_logits, &mut gradients)?,
                sh.transpose()?.unwrap_or_default(),
            ];
            Ok(Pass {
                image: values(finer(found, self.pixel))?,
                gradients: own.map(|own| self.of_the_scene(own, count)),
            })
        };
        cameras.iter().enumerate().map(pass).collect()
    }

    /// `own` has a gradient for each Gaussian of this point; of those that it leaves out the gradient is 0.
    fn of_the_scene(&self, own: Vec<f64>, count: usize) -> Vec<f64> {
        let Some(rows) = self.rows.as_ref().filter(|rows| !rows.is_empty()) else {
            return own;
        };
        let width = own.len() / rows.len();
        let mut all = vec![0.0; count * width];
        for (&row, own) in rows.iter().zip(own.chunks(width.max(1))) {
            all[row as usize * width..][..width].copy_from_slice(own);
        }
        all
    }
}

/// The mean of each square of `pixel` x `pixel` pixels.
fn coarser(image: Tensor<3>, pixel: usize) -> Tensor<3> {
    let [height, width, channels] = image.dims();
    let (rows, columns) = (height / pixel, width / pixel);
    image
        .reshape([rows, pixel, columns, pixel * channels])
        .mean_dim(1)
        .reshape([rows, columns, pixel, channels])
        .mean_dim(2)
        .reshape([rows, columns, channels])
}

/// Each pixel as a square of `pixel` x `pixel` pixels.
fn finer(image: Tensor<3>, pixel: usize) -> Tensor<3> {
    let [height, width, channels] = image.dims();
    image
        .reshape([height, 1, width, channels])
        .repeat(&[1, pixel, 1, pixel])
        .reshape([height * pixel, width * pixel, channels])
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

/// Without cut-offs and cap.
fn exact(configured: &Settings) -> Settings {
    Settings {
        alpha_min: NEARLY_ZERO,
        t_min: 0.0,
        alpha_max: 1.0,
        ..*configured
    }
}

/// The configured point; then each setting from exact to coarse, and all exact; then lower degrees, rounded coefficients, fewer
/// Gaussians and coarser pictures.
fn points(bench: &Bench, gaussians: &Gaussians) -> Result<Vec<Point>> {
    let c = Settings::from(&bench.config.raster);
    let all = input(gaussians, &bench.device, DType::F32);
    let point = |(name, settings)| Point::new(name, settings, all.clone());
    let first = ("as configured".to_owned(), c);
    let mut points: Vec<Point> = [first].into_iter().chain(tried(&c)).map(point).collect();
    let degree = gaussians.sh_degree;
    points.extend((0..degree).map(|lower| {
        let mut point = point((format!("SH degree {lower} of {degree}"), c));
        point.input.active_sh_degree = lower;
        point
    }));
    let mut rounded = gaussians.clone();
    rounded
        .sh
        .iter_mut()
        .for_each(|sh| *sh = half::f16::from_f32(*sh).to_f32());
    let rounded = input(&rounded, &bench.device, DType::F32);
    points.push(Point::new("SH rounded to f16", c, rounded));
    for share in SHARES {
        let keep = Keep::Share(share);
        let rows = prune(gaussians, &bench.scene, keep, &bench.config, &bench.device)?.kept;
        let left = input(&gaussians.select(&rows), &bench.device, DType::F32);
        points.push(Point {
            rows: Some(rows),
            ..Point::new(format!("{share} of the Gaussians"), c, left)
        });
    }
    points.extend(PIXELS.map(|pixel| Point {
        pixel,
        ..point((format!("image scale 1/{pixel}"), c))
    }));
    Ok(points)
}

/// Each setting changed alone, and all of them.
fn tried(configured: &Settings) -> Vec<(String, Settings)> {
    let c = *configured;
    let alpha_min = ALPHA_MIN.map(|v| {
        (
            format!("alpha_min {}", number(v)),
            Settings { alpha_min: v, ..c },
        )
    });
    let t_min = T_MIN.map(|v| (format!("t_min {}", number(v)), Settings { t_min: v, ..c }));
    let alpha_max = ALPHA_MAX.map(|v| (format!("alpha_max {v}"), Settings { alpha_max: v, ..c }));
    let mut tried: Vec<_> = alpha_min
        .into_iter()
        .chain(t_min)
        .chain(alpha_max)
        .collect();
    tried.push(("all exact".to_owned(), exact(&c)));
    tried.retain(|(_, settings)| settings != configured);
    tried
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

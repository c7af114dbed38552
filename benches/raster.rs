//! Milliseconds of a rendered view, forward and with the backward pass, on any trained scene:
//! `cargo bench --bench raster -- RUN --gaussians 10000,100000 --json coseg.json --export subject`.
//!
//! `--export` writes the Gaussians and cameras for other renderers, see `scripts/bench_gsplat.py`. `--errors` also compares f32 with f64,
//! for scenes and pictures that are too large for a test: `--gaussians 2000000 --errors`, `--sizes 4000x3000 --rgb --errors`.

#[path = "../src/cli/allocator.rs"]
mod allocator;

use burn::tensor::{DType, Device, Tensor, TensorData};
use clap::Parser;
use coseg::backend::device;
use coseg::backend::device::BackendName;
use coseg::bench::{Figures, Machine, resampled};
use coseg::data::formats::transforms::write_cameras;
use coseg::data::{NamedCamera, Split, read_cameras};
use coseg::error::{Error, Result};
use coseg::files::atomic;
use coseg::objects::{RenderOptions, Renderer};
use coseg::raster::{Projected, RasterInput, RasterOutput, Settings, rasterize};
use coseg::splat::camera::Camera;
use coseg::splat::{Gaussians, ply};
use glam::DVec3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Labels of a frame, and channels beside colour.
const LABELS: usize = 20;
/// A name, whether colour is rendered, and the number of channels beside it.
const CHANNELS: [(&str, bool, usize); 3] = [
    ("RGB", true, 0),
    ("RGB + 20 classes", true, LABELS),
    ("64 channels", false, 64),
];
const VIEWS: usize = 6;
/// Gradients whose errors are measured.
const GRADIENTS: [&str; 5] = ["means", "log-scales", "rotations", "opacities", "SH"];
/// A GPU that was idle needs time to reach its clock.
const WARM_UP: Duration = Duration::from_secs(1);

#[derive(Parser)]
struct Arguments {
    /// Folder that `coseg train` wrote
    run: PathBuf,
    /// Numbers of Gaussians [default: that of the scene]
    #[arg(long, value_delimiter = ',')]
    gaussians: Vec<usize>,
    /// Sizes of the pictures
    #[arg(long, value_delimiter = ',', default_value = "480x360,1920x1080", value_parser = size)]
    sizes: Vec<[usize; 2]>,
    /// Colour alone, without channels beside it
    #[arg(long)]
    rgb: bool,
    /// Print how far picture and gradients in f32 are from f64
    #[arg(long)]
    errors: bool,
    /// Measured passes behind each median
    #[arg(long, default_value_t = 5)]
    repeats: usize,
    /// Write the Gaussians and cameras into this folder
    #[arg(long)]
    export: Option<PathBuf>,
    /// Write the figures to this file
    #[arg(long)]
    json: Option<PathBuf>,
    /// Where to compute
    #[arg(long)]
    backend: Option<BackendName>,
    /// What `cargo bench` passes
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> Result<()> {
    allocator::keep_freed_memory();
    let mut arguments = Arguments::parse();
    let (backend, device) = device::choose(arguments.backend)?;
    let machine = Machine::here(device::described(backend));
    println!("{}", machine.text());
    let scene = ply::read(&arguments.run.join("scene.ply"))?;
    let cameras = read_cameras(&arguments.run, Some(Split::Train))?;
    let count = VIEWS.min(cameras.len());
    let cameras: Vec<Camera> = (0..count)
        .map(|i| cameras[i * cameras.len() / count].camera.clone())
        .map(|camera| Camera {
            center: camera.center - scene.origin,
            ..camera
        })
        .collect();
    if arguments.gaussians.is_empty() {
        arguments.gaussians.push(scene.gaussians.len());
    }
    let mut all = Vec::new();
    for &count in &arguments.gaussians {
        let gaussians = resampled(&scene.gaussians, count, 0);
        let mut figures = Figures::new("raster", count);
        for &[width, height] in &arguments.sizes {
            let cameras: Vec<Camera> = cameras
                .iter()
                .map(|camera| camera.with_size(width, height))
                .collect();
            if let Some(folder) = &arguments.export {
                export(folder, &gaussians, &cameras)?;
            }
            let view = View {
                gaussians: &gaussians,
                cameras: &cameras,
                repeats: arguments.repeats,
                channels: if arguments.rgb {
                    &CHANNELS[..1]
                } else {
                    &CHANNELS
                },
            };
            let size = format!("{width}x{height}");
            view.measure(&size, &device, &mut figures)?;
            if arguments.errors {
                view.errors(&size, &device, &mut figures)?;
            }
        }
        println!("\n{}", figures.text());
        all.push(figures);
    }
    if let Some(path) = &arguments.json {
        let json = serde_json::json!({ "machine": machine, "sections": all });
        atomic::write_bytes(path, format!("{json:#}\n").as_bytes())?;
    }
    Ok(())
}

/// Width and height of `text`, such as `480x360`.
fn size(text: &str) -> std::result::Result<[usize; 2], String> {
    let sides = text.split_once('x').map(|(w, h)| (w.parse(), h.parse()));
    match sides {
        Some((Ok(width), Ok(height))) if width > 0 && height > 0 => Ok([width, height]),
        _ => Err("expected WIDTHxHEIGHT".to_owned()),
    }
}

/// Writes `gaussians_N.ply` and `cameras_WxH.json`.
fn export(folder: &Path, gaussians: &Gaussians, cameras: &[Camera]) -> Result<()> {
    let file = folder.join(format!("gaussians_{}.ply", gaussians.len()));
    ply::write(&file, gaussians, DVec3::ZERO, None)?;
    let named: Vec<NamedCamera> = cameras
        .iter()
        .enumerate()
        .map(|(i, camera)| NamedCamera {
            name: format!("view_{i}"),
            split: Split::Train,
            camera: camera.clone(),
        })
        .collect();
    let [width, height] = [cameras[0].width, cameras[0].height];
    write_cameras(
        &folder.join(format!("cameras_{width}x{height}.json")),
        &named,
    )
}

/// Gaussians as cameras see them.
struct View<'a> {
    gaussians: &'a Gaussians,
    cameras: &'a [Camera],
    repeats: usize,
    channels: &'a [(&'static str, bool, usize)],
}

impl View<'_> {
    fn measure(&self, size: &str, device: &Device, figures: &mut Figures) -> Result<()> {
        for &(name, colour, channels) in self.channels {
            let input = self.input(colour, channels, device, DType::F32);
            let forward = self.timed(&input, |output| {
                Some(output.image.slice([0..1, 0..1, 0..1]))
            });
            let forward = match forward {
                // Smaller cases may fit all the same.
                Err(error @ Error::Limit { .. }) => {
                    figures
                        .notes
                        .push(format!("{size}, {name}: left out, {error}"));
                    continue;
                }
                forward => forward?,
            };
            figures.add(format!("{size}, {name}: forward"), "ms", &forward);
            let input = self.input(colour, channels, &device.clone().autodiff(), DType::F32);
            let both = self.timed(&input, |output| {
                let gradient = input.means.grad(&output.image.backward())?;
                Some(gradient.slice([0..1, 0..1]).unsqueeze())
            })?;
            figures.add(format!("{size}, {name}: forward + backward"), "ms", &both);
        }
        figures.add(
            format!("{size}: a frame with labels"),
            "ms",
            &self.frames(device)?,
        );
        let pairs = self.pairs()?;
        let pixels: usize = self.cameras.iter().map(|c| c.width * c.height).sum();
        let each = pairs as f64 / pixels as f64;
        figures.add(format!("{size}: pairs a pixel"), "", &[each]);
        Ok(())
    }

    /// Milliseconds of the mean view, for each pass after the [`WARM_UP`].
    fn passes(&self, mut pass: impl FnMut() -> Result<()>) -> Result<Vec<f64>> {
        let start = Instant::now();
        pass()?;
        while start.elapsed() < WARM_UP {
            pass()?;
        }
        let timed = (0..self.repeats.max(1)).map(|_| {
            let start = Instant::now();
            pass()?;
            Ok(1e3 * start.elapsed().as_secs_f64() / self.cameras.len() as f64)
        });
        timed.collect()
    }

    /// `finish` gives one value that is read back to wait for a GPU.
    fn timed(
        &self,
        input: &RasterInput,
        finish: impl Fn(RasterOutput) -> Option<Tensor<3>>,
    ) -> Result<Vec<f64>> {
        let settings = Settings::default();
        self.passes(|| {
            for camera in self.cameras {
                let output = rasterize(input.clone(), camera, &settings, [0.0; 3])?;
                let Some(value) = finish(output) else {
                    continue;
                };
                let value = if value.device().is_autodiff() {
                    value.inner()
                } else {
                    value
                };
                let value: Vec<f32> = value.into_data().to_vec().expect("floats");
                black_box(value);
            }
            Ok(())
        })
    }

    /// How far f32 on `device` is from f64 on the CPU with the same cut-offs, in the first view: the share of colours that differ by
    /// more than a ten-thousandth of the largest one, and for each gradient of half the squared distance to grey the root mean square
    /// of the difference over that of the gradient.
    fn errors(&self, size: &str, device: &Device, figures: &mut Figures) -> Result<()> {
        let [got, want] = [
            (device.clone(), DType::F32),
            (device::open_cpu()?, DType::F64),
        ]
        .map(|(device, dtype)| self.pass(&device.autodiff(), dtype));
        let (got, want) = (got?, want?);
        let largest = want[0].iter().fold(0.0_f64, |a, v| a.max(v.abs()));
        let pairs = got[0].iter().zip(&want[0]);
        // A NaN is off, too.
        let right = pairs.filter(|(a, b)| (*a - *b).abs() <= 1e-4 * largest);
        let share = 1.0 - right.count() as f64 / want[0].len() as f64;
        figures.add(
            format!("{size}: colours off by more than 1e-4"),
            "",
            &[share],
        );
        for (name, (got, want)) in GRADIENTS.iter().zip(got.iter().zip(&want).skip(1)) {
            let squares = |v: &mut dyn Iterator<Item = f64>| v.map(|v| v * v).sum::<f64>();
            let difference = squares(&mut got.iter().zip(want).map(|(a, b)| a - b));
            let squared_size = squares(&mut want.iter().copied());
            let error = (difference / squared_size.max(f64::MIN_POSITIVE)).sqrt();
            figures.add(
                format!("{size}: error of the gradient of {name}"),
                "",
                &[error],
            );
        }
        Ok(())
    }

    /// The picture of the first camera, and its gradients in the order of [`GRADIENTS`].
    fn pass(&self, device: &Device, dtype: DType) -> Result<Vec<Vec<f64>>> {
        let input = self.input(true, 0, device, dtype);
        let output = rasterize(
            input.clone(),
            &self.cameras[0],
            &Settings::default(),
            [0.0; 3],
        )?;
        let distance = output.image.clone() - 0.5;
        let gradients = (distance.clone() * distance)
            .sum()
            .mul_scalar(0.5)
            .backward();
        Ok(vec![
            wide(output.image.inner()),
            wide(input.means.grad(&gradients).expect("tracked")),
            wide(input.log_scales.grad(&gradients).expect("tracked")),
            wide(input.rotations.grad(&gradients).expect("tracked")),
            wide(input.opacity_logits.grad(&gradients).expect("tracked")),
            wide(
                input
                    .sh
                    .and_then(|sh| sh.grad(&gradients))
                    .expect("tracked"),
            ),
        ])
    }

    /// The Gaussians as tensors, tracked where `device` is for autodiff.
    fn input(&self, colour: bool, channels: usize, device: &Device, dtype: DType) -> RasterInput {
        let g = self.gaussians;
        let n = g.len();
        let features = (channels > 0).then(|| {
            let mut rng = ChaCha8Rng::seed_from_u64(0);
            let values: Vec<f32> = (0..n * channels).map(|_| rng.random()).collect();
            leaf(values, [n, channels], device, dtype)
        });
        RasterInput {
            means: leaf(g.means.as_flattened().to_vec(), [n, 3], device, dtype),
            log_scales: leaf(g.log_scales.as_flattened().to_vec(), [n, 3], device, dtype),
            rotations: leaf(g.rotations.as_flattened().to_vec(), [n, 4], device, dtype),
            opacity_logits: leaf(g.opacity_logits.clone(), [n], device, dtype),
            sh: colour.then(|| leaf(g.sh.clone(), [n, g.sh_len(), 3], device, dtype)),
            active_sh_degree: g.sh_degree,
            features,
            screen: None,
        }
    }

    /// Colour, coverage and label of each pixel in host memory, as `coseg render` makes them.
    fn frames(&self, device: &Device) -> Result<Vec<f64>> {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let labels = (0..self.gaussians.len()).map(|_| rng.random_range(1..=LABELS as u16));
        let labels = Some(labels.collect());
        let options = RenderOptions::default();
        let renderer = Renderer::new(self.gaussians.clone(), labels, options, device)?;
        self.passes(|| {
            for camera in self.cameras {
                black_box(renderer.frame(camera)?);
            }
            Ok(())
        })
    }

    /// A pair is a pixel and a Gaussian with alpha of alpha_min or more, before the pixel is full.
    fn pairs(&self) -> Result<usize> {
        let mut sum = 0;
        for camera in self.cameras {
            let projected = Projected::new(&self.gaussians.splats(), camera, &Settings::default())?;
            let pixels: Vec<u32> = (0..(camera.width * camera.height) as u32).collect();
            sum += projected.weights(&pixels).entries().1.len();
        }
        Ok(sum)
    }
}

fn wide<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    tensor
        .into_data()
        .convert::<f64>()
        .into_vec()
        .expect("floats")
}

fn leaf<const D: usize>(
    values: Vec<f32>,
    shape: [usize; D],
    device: &Device,
    dtype: DType,
) -> Tensor<D> {
    let tensor = Tensor::from_data(TensorData::new(values, shape), (device, dtype));
    if device.is_autodiff() {
        tensor.require_grad()
    } else {
        tensor
    }
}

//! Rendering of colour and labels together: the cost of channels, at two sizes.

use super::raster::{Leaves, finish};
use super::{Bench, Figure, Findings, Samples, Section, gaussians_in_words};
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::gaussians::Gaussians;
use crate::random::{Purpose, stream};
use crate::raster::{RasterInput, Settings, rasterize};
use burn::tensor::{Device, Tensor, TensorData};
use rand::Rng;

/// What is rendered: whether colour from SH, and how many channels besides.
pub(super) const CASES: [(bool, usize, &str); 3] =
    [(true, 0, "RGB"), (true, 20, "RGB + 20 classes"), (false, 64, "64 channels")];

pub(super) fn measure(bench: &Bench) -> Result<Findings> {
    let effort = &bench.effort;
    let notes = vec![
        format!("{} views of {}", effort.views, bench.subject.description),
        "one pass blends all channels; with backward: gradients of geometry, colour and channels".to_owned(),
    ];
    let mut findings = Findings::new(Section::Channels, notes);
    for gaussians in &effort.memory {
        for size in [effort.size, effort.channels_size] {
            for case in CASES {
                match one_case(bench, *gaussians, size, case) {
                    Ok(figures) => findings.figures.extend(figures),
                    // Smaller cases may fit all the same.
                    Err(error @ Error::Limit { .. }) => {
                        let [width, height] = size;
                        findings.notes.push(format!("{width}x{height}, {}: left out, {error}", case.2));
                    }
                    Err(error) => return Err(error),
                }
            }
        }
    }
    Ok(findings)
}

fn one_case(
    bench: &Bench,
    gaussians: usize,
    size: [usize; 2],
    (colour, channels, name): (bool, usize, &str),
) -> Result<[Figure; 3]> {
    let gaussians = &bench.subject.gaussians(gaussians)?;
    let cameras = &bench.subject.cameras(bench.effort.views, size);
    let [width, height] = size;
    let case = format!("{width}x{height}, {}, {name}", gaussians_in_words(gaussians.len()));
    let rendering = Rendering { bench, gaussians, cameras, colour, channels };
    let forward = rendering.forward()?;
    let both = rendering.both()?;
    Ok([
        Figure::measured(&case, "forward", "ms", &forward),
        Figure::counted(&case, "frames a second", "", 1e3 / forward.median()),
        Figure::measured(&case, "forward + backward", "ms", &both),
    ])
}

/// Gaussians seen by cameras: colour from SH or none, and channels besides.
pub(super) struct Rendering<'a> {
    pub bench: &'a Bench,
    pub gaussians: &'a Gaussians,
    pub cameras: &'a [Camera],
    pub colour: bool,
    pub channels: usize,
}

impl Rendering<'_> {
    /// Milliseconds of the mean view.
    pub fn forward(&self) -> Result<Samples> {
        let input = self.input(&self.bench.device);
        self.timed(|camera, settings, background| {
            finish(rasterize(input.clone(), camera, settings, background)?.image);
            Ok(())
        })
    }

    /// The same with the backward pass: gradients of geometry, colour and channels.
    pub fn both(&self) -> Result<Samples> {
        let input = self.input(&self.bench.device.clone().autodiff());
        self.timed(|camera, settings, background| {
            let gradients = rasterize(input.clone(), camera, settings, background)?.image.backward();
            if let Some(gradient) = input.means.grad(&gradients) {
                finish(gradient);
            }
            Ok(())
        })
    }

    fn timed(&self, one: impl Fn(&Camera, &Settings, [f32; 3]) -> Result<()>) -> Result<Samples> {
        let raster = &self.bench.config.raster;
        let (settings, background) = (Settings::from(raster), raster.background);
        let passes = Samples::of(self.bench.effort.repeats, || {
            self.cameras.iter().try_for_each(|camera| one(camera, &settings, background))
        })?;
        Ok(passes.scaled(1e3 / self.cameras.len().max(1) as f64))
    }

    fn input(&self, device: &Device) -> RasterInput {
        let leaves = Leaves::new(self.gaussians, device);
        let leaves = if device.is_autodiff() { leaves.tracked() } else { leaves };
        let input = leaves.input();
        let features = random_rows(self.gaussians.len(), self.channels, self.bench.config.seed, device);
        let sh = if self.colour { input.sh.clone() } else { None };
        RasterInput { sh, features, ..input }
    }
}

/// `[rows, channels]` random numbers, tracked where `device` tracks.
fn random_rows(rows: usize, channels: usize, seed: u64, device: &Device) -> Option<Tensor<2>> {
    let mut rng = stream(seed, Purpose::Benchmark, 0);
    let values: Vec<f32> = (0..rows * channels).map(|_| rng.random_range(0.0..1.0)).collect();
    let tensor = (channels > 0).then(|| Tensor::from_data(TensorData::new(values, [rows, channels]), device))?;
    Some(if device.is_autodiff() { tensor.require_grad() } else { tensor })
}

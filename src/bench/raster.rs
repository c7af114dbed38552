//! The rasterizer as training uses it, forward and with its backward pass, and whole frames as `coseg render` makes them.

use super::{Bench, Findings, Samples};
use crate::backend::device::read;
use crate::error::{Error, Result};
use crate::objects::{RenderOptions, Renderer};
use crate::random::{Purpose, stream};
use crate::raster::{
    ListCount, PairCounts, Projected, RasterInput, RasterOutput, Settings, rasterize_with_capacity,
    tile_capacity,
};
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use burn::tensor::{Device, Tensor, TensorData};
use rand::Rng;
use std::hint::black_box;

/// Labels of a frame, and channels beside colour.
const LABELS: usize = 20;
/// A name, whether colour is rendered, and the number of channels beside it.
const CHANNELS: [(&str, bool, usize); 3] = [
    ("RGB", true, 0),
    ("RGB + 20 classes", true, LABELS),
    ("64 channels", false, 64),
];

pub(super) fn measure(
    bench: &Bench,
    gaussians: &Gaussians,
    case: &str,
    findings: &mut Findings,
) -> Result<()> {
    let effort = &bench.effort;
    findings.note(format!(
        "times of a view, means of {} views; all channels in one pass; backward: gradients of all inputs",
        effort.views
    ));
    findings.note("a frame: colour, coverage and label of each pixel in host memory, 20 labels");
    findings.note(
        "a pair is a pixel and a Gaussian with alpha of alpha_min or more, before the pixel is full",
    );
    for [width, height] in [effort.size, effort.large_size] {
        let view = format!("{width}x{height}, {case}");
        let cameras = &bench.subject.cameras(effort.views, [width, height]);
        for (name, colour, channels) in CHANNELS {
            let rendering = Rendering {
                bench,
                gaussians,
                cameras,
                colour,
                channels,
            };
            let case = format!("{view}, {name}");
            match rendering.measure(&case, findings) {
                // Smaller cases may fit all the same.
                Err(error @ Error::Limit { .. }) => {
                    findings.note(format!("{case}: left out, {error}"));
                }
                other => other?,
            }
        }
        let case = format!("{view}, labels");
        let frames = frames(bench, gaussians, cameras)?;
        findings.measured(&case, "a frame", "ms", &frames);
        let pairs = count_pairs(bench, gaussians, cameras)?;
        let pixels = cameras.len() * width * height;
        let (contributing, evaluated) = (pairs.contributing as f64, pairs.evaluated as f64);
        findings.counted(&case, "pairs a pixel", "", contributing / pixels as f64);
        let ratio = evaluated / contributing.max(1.0);
        findings.counted(&case, "evaluated per pair", "", ratio);
    }
    Ok(())
}

/// Gaussians as cameras see them.
struct Rendering<'a> {
    bench: &'a Bench,
    gaussians: &'a Gaussians,
    cameras: &'a [Camera],
    colour: bool,
    channels: usize,
}

impl Rendering<'_> {
    fn measure(&self, case: &str, findings: &mut Findings) -> Result<()> {
        let input = self.input(&self.bench.device);
        let forward = self.timed(&input, |output| {
            Some(output.image.slice([0..1, 0..1, 0..1]))
        })?;
        findings.measured(case, "forward", "ms", &forward);
        let input = self.input(&self.bench.device.clone().autodiff());
        let both = self.timed(&input, |output| {
            let gradient = input.means.grad(&output.image.backward())?;
            Some(gradient.slice([0..1, 0..1]).unsqueeze())
        })?;
        findings.measured(case, "forward + backward", "ms", &both);
        Ok(())
    }

    /// Milliseconds of the mean view. `finish` gives one value that is read back to wait for a GPU.
    fn timed(
        &self,
        input: &RasterInput,
        finish: impl Fn(RasterOutput) -> Option<Tensor<3>>,
    ) -> Result<Samples> {
        let raster = &self.bench.config.raster;
        let settings = Settings::from(raster);
        // A view's tile lists have the capacity of the pass before, as in training.
        let mut capacities = vec![None; self.cameras.len()];
        let passes = Samples::of(self.bench.effort.repeats, || {
            for (camera, capacity) in self.cameras.iter().zip(&mut capacities) {
                let output = rasterize_with_capacity(
                    input.clone(),
                    camera,
                    &settings,
                    raster.background,
                    *capacity,
                )?;
                let tile_lists = output.tile_lists.clone();
                let Some(value) = finish(output) else {
                    continue;
                };
                let value = if value.device().is_autodiff() {
                    value.inner()
                } else {
                    value
                };
                let both = Tensor::cat(vec![value.reshape([1]), tile_lists], 0);
                let values = read("a rendered view", both)?;
                let count = ListCount::from_values(black_box(&values[1..]));
                *capacity = count.map(|count| tile_capacity(count.entries));
            }
            Ok(())
        })?;
        Ok(passes.scaled(1e3 / self.cameras.len().max(1) as f64))
    }

    /// The Gaussians as tensors, tracked where `device` is for autodiff.
    fn input(&self, device: &Device) -> RasterInput {
        let g = self.gaussians;
        let n = g.len();
        let features = (self.channels > 0).then(|| {
            let mut rng = stream(self.bench.config.seed, Purpose::Benchmark, 0);
            let values: Vec<f32> = (0..n * self.channels).map(|_| rng.random()).collect();
            leaf(values, [n, self.channels], device)
        });
        RasterInput {
            means: leaf(g.means.as_flattened().to_vec(), [n, 3], device),
            log_scales: leaf(g.log_scales.as_flattened().to_vec(), [n, 3], device),
            rotations: leaf(g.rotations.as_flattened().to_vec(), [n, 4], device),
            opacity_logits: leaf(g.opacity_logits.clone(), [n], device),
            sh: self
                .colour
                .then(|| leaf(g.sh.clone(), [n, g.sh_len(), 3], device)),
            active_sh_degree: g.sh_degree,
            features,
            screen: None,
        }
    }
}

fn leaf<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    let tensor = Tensor::from_data(TensorData::new(values, shape), device);
    if device.is_autodiff() {
        tensor.require_grad()
    } else {
        tensor
    }
}

/// Milliseconds of the mean frame that [`Renderer`] makes.
fn frames(bench: &Bench, gaussians: &Gaussians, cameras: &[Camera]) -> Result<Samples> {
    let mut rng = stream(bench.config.seed, Purpose::Benchmark, 1);
    let labels = (0..gaussians.len()).map(|_| rng.random_range(1..=LABELS as u16));
    let options = RenderOptions {
        settings: Settings::from(&bench.config.raster),
        background: bench.config.raster.background,
        ..RenderOptions::default()
    };
    let labels = Some(labels.collect());
    let renderer = Renderer::new(gaussians.clone(), labels, options, &bench.device)?;
    let passes = Samples::of(bench.effort.repeats, || {
        cameras.iter().try_for_each(|camera| {
            black_box(renderer.frame(camera)?);
            Ok(())
        })
    })?;
    Ok(passes.scaled(1e3 / cameras.len().max(1) as f64))
}

/// Pairs of all views together.
fn count_pairs(bench: &Bench, gaussians: &Gaussians, cameras: &[Camera]) -> Result<PairCounts> {
    let settings = Settings::from(&bench.config.raster);
    let mut sum = PairCounts::default();
    for camera in cameras {
        let pairs = Projected::new(&gaussians.splats(), camera, &settings)?.count_pairs();
        sum.evaluated += pairs.evaluated;
        sum.contributing += pairs.contributing;
    }
    Ok(sum)
}

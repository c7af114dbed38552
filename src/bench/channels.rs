//! Rendering of colour and labels together: the cost of channels, at two sizes.

use super::raster::Leaves;
use super::{Bench, Figure, Findings, Samples, Section, gaussians_in_words};
use crate::backend::device::read;
use crate::error::{Error, Result};
use crate::objects::{RenderOptions, Renderer};
use crate::random::{Purpose, stream};
use crate::raster::{ListCount, RasterInput, Settings, rasterize_with_capacity, tile_capacity};
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use burn::tensor::{Device, Tensor, TensorData};
use rand::Rng;
use std::hint::black_box;

/// What is rendered: whether colour from SH, and how many channels besides.
pub(super) const CASES: [(bool, usize, &str); 3] = [
    (true, 0, "RGB"),
    (true, 20, "RGB + 20 classes"),
    (false, 64, "64 channels"),
];

pub(super) fn measure(bench: &Bench) -> Result<Findings> {
    let effort = &bench.effort;
    let notes = vec![
        format!("{} views of {}", effort.views, bench.subject.description),
        "one pass blends all channels; with backward: gradients of geometry, colour and channels".to_owned(),
        "a frame: colour, coverage and the label of each pixel, all in host memory, of a scene of 20 labels".to_owned(),
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
                        findings
                            .notes
                            .push(format!("{width}x{height}, {}: left out, {error}", case.2));
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
) -> Result<Vec<Figure>> {
    let gaussians = &bench.subject.gaussians(gaussians)?;
    let cameras = &bench.subject.cameras(bench.effort.views, size);
    let [width, height] = size;
    let case = format!(
        "{width}x{height}, {}, {name}",
        gaussians_in_words(gaussians.len())
    );
    let rendering = Rendering {
        bench,
        gaussians,
        cameras,
        colour,
        channels,
    };
    let forward = rendering.forward()?;
    let both = rendering.both()?;
    let mut figures = vec![
        Figure::measured(&case, "forward", "ms", &forward),
        Figure::counted(&case, "frames a second", "", 1e3 / forward.median()),
        Figure::measured(&case, "forward + backward", "ms", &both),
    ];
    if colour && channels > 0 {
        let frame = rendering.frames(channels)?;
        figures.push(Figure::measured(&case, "a frame", "ms", &frame));
        figures.push(Figure::counted(
            &case,
            "whole frames a second",
            "",
            1e3 / frame.median(),
        ));
    }
    Ok(figures)
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
    /// Milliseconds of the mean view. On a GPU the tile lists have the capacity of the time before, as in training.
    pub fn forward(&self) -> Result<Samples> {
        let input = self.input(&self.bench.device);
        self.timed(|camera, settings, background, capacity| {
            let output =
                rasterize_with_capacity(input.clone(), camera, settings, background, capacity)?;
            finish_with(output.image, output.tile_lists)
        })
    }

    /// The same with the backward pass: gradients of geometry, colour and channels.
    pub fn both(&self) -> Result<Samples> {
        let input = self.input(&self.bench.device.clone().autodiff());
        self.timed(|camera, settings, background, capacity| {
            let output =
                rasterize_with_capacity(input.clone(), camera, settings, background, capacity)?;
            let gradients = output.image.backward();
            match input.means.grad(&gradients) {
                Some(gradient) => finish_with(gradient, output.tile_lists),
                None => Ok(None),
            }
        })
    }

    /// Milliseconds of the mean view as [`Renderer`] gives it, each Gaussian with one of so many labels.
    fn frames(&self, labels: usize) -> Result<Samples> {
        let mut rng = stream(self.bench.config.seed, Purpose::Benchmark, 1);
        let labels = self
            .gaussians
            .means
            .iter()
            .map(|_| rng.random_range(1..=labels as u16))
            .collect();
        let (settings, background) = self.settings();
        let options = RenderOptions {
            settings,
            background,
            ..RenderOptions::default()
        };
        let mut renderer = Renderer::new(
            self.gaussians.clone(),
            Some(labels),
            options,
            &self.bench.device,
        )?;
        let passes = Samples::of(self.bench.effort.repeats, || {
            self.cameras
                .iter()
                .try_for_each(|camera| renderer.frame(camera).map(|frame| drop(black_box(frame))))
        })?;
        Ok(passes.scaled(1e3 / self.cameras.len().max(1) as f64))
    }

    fn settings(&self) -> (Settings, [f32; 3]) {
        let raster = &self.bench.config.raster;
        (Settings::from(raster), raster.background)
    }

    /// `one` gets the capacity for the tile lists of a view that it counted before, and returns the count.
    fn timed(
        &self,
        one: impl Fn(&Camera, &Settings, [f32; 3], Option<usize>) -> Result<Option<ListCount>>,
    ) -> Result<Samples> {
        let (settings, background) = self.settings();
        let mut capacities = vec![None; self.cameras.len()];
        let passes = Samples::of(self.bench.effort.repeats, || {
            self.cameras
                .iter()
                .zip(&mut capacities)
                .try_for_each(|(camera, capacity)| {
                    *capacity = one(camera, &settings, background, *capacity)?
                        .map(|lists| tile_capacity(lists.entries));
                    Ok(())
                })
        })?;
        Ok(passes.scaled(1e3 / self.cameras.len().max(1) as f64))
    }

    fn input(&self, device: &Device) -> RasterInput {
        let leaves = Leaves::new(self.gaussians, device);
        let leaves = if device.is_autodiff() {
            leaves.tracked()
        } else {
            leaves
        };
        let input = leaves.input();
        let features = random_rows(
            self.gaussians.len(),
            self.channels,
            self.bench.config.seed,
            device,
        );
        let sh = if self.colour { input.sh.clone() } else { None };
        RasterInput {
            sh,
            features,
            ..input
        }
    }
}

/// `[rows, channels]` random numbers, tracked where `device` tracks.
fn random_rows(rows: usize, channels: usize, seed: u64, device: &Device) -> Option<Tensor<2>> {
    let mut rng = stream(seed, Purpose::Benchmark, 0);
    let values: Vec<f32> = (0..rows * channels)
        .map(|_| rng.random_range(0.0..1.0))
        .collect();
    let tensor = (channels > 0)
        .then(|| Tensor::from_data(TensorData::new(values, [rows, channels]), device))?;
    Some(if device.is_autodiff() {
        tensor.require_grad()
    } else {
        tensor
    })
}

/// Waits until `tensor` is computed: a GPU copies, and waits, when the bytes are touched. Copies one value and the count of
/// the tile lists.
fn finish_with<const D: usize>(
    tensor: Tensor<D>,
    tile_lists: Tensor<1>,
) -> Result<Option<ListCount>> {
    let value = tensor
        .slice(std::array::from_fn::<_, D, _>(|_| 0..1))
        .reshape([1]);
    let value = if value.device().is_autodiff() {
        value.inner()
    } else {
        value
    };
    let values = read("a rendered view", Tensor::cat(vec![value, tile_lists], 0))?;
    Ok(ListCount::from_values(black_box(&values[1..])))
}

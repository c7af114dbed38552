//! The rasterizer as training uses it: the burn operation, forward alone and with its backward pass.

use super::channels::Rendering;
use super::{Bench, Figure, Findings, Samples, Section, gaussians_in_words, reset_peak_memory};
use crate::error::{Error, Result};
use crate::raster::{PairCounts, Projected, RasterInput, Settings};
use crate::report::peak_memory_bytes;
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use burn::tensor::{Device, Tensor, TensorData};
use std::hint::black_box;

/// Gaussians that the bars in milliseconds are set for, and those bars: forward, forward and backward.
const BAR_SIZE: usize = 100_000;
const BARS: [f64; 2] = [30.0, 75.0];
/// Bars in nanoseconds a contributing pair and core: forward, backward.
const PAIR_BARS: [f64; 2] = [4.0, 12.0];
const MEANT_FOR: &str = "480x360";

/// Growth of time between two sizes, forward and with backward.
struct Before {
    gaussians: usize,
    medians: [f64; 2],
}

pub(super) fn measure(bench: &Bench) -> Result<Findings> {
    let effort = &bench.effort;
    let notes = vec![
        bench.views_in_words(effort.views),
        "time: the mean view of a pass. A pair is a pixel and a Gaussian with alpha' of alpha_min or more, before the stop;"
            .to_owned(),
        "its cost is time x threads / pairs, projection, sorting and SH included. backward = the difference of the two."
            .to_owned(),
    ];
    let mut findings = Findings::new(Section::Raster, notes);
    let cameras = bench.subject.cameras(effort.views, effort.size);
    let mut before: Option<Before> = None;
    for &size in &effort.sizes {
        let gaussians = bench.subject.gaussians(size)?;
        match one_size(
            bench,
            &gaussians,
            &cameras,
            before.as_ref(),
            &mut findings.figures,
        ) {
            Ok(medians) => {
                before = Some(Before {
                    gaussians: gaussians.len(),
                    medians,
                })
            }
            // What a device cannot hold does not make the rest worthless.
            Err(error @ Error::Limit { .. }) => {
                findings.notes.push(format!(
                    "{}: left out, {error}",
                    gaussians_in_words(gaussians.len())
                ));
            }
            Err(error) => return Err(error),
        }
    }
    Ok(findings)
}

fn one_size(
    bench: &Bench,
    gaussians: &Gaussians,
    cameras: &[Camera],
    before: Option<&Before>,
    figures: &mut Vec<Figure>,
) -> Result<[f64; 2]> {
    let (settings, repeats) = (Settings::from(&bench.config.raster), bench.effort.repeats);
    let case = gaussians_in_words(gaussians.len());
    let views = cameras.len().max(1) as f64;
    let pairs = count_pairs(gaussians, cameras, &settings)?;
    let alone = reset_peak_memory();

    let rendering = Rendering {
        bench,
        gaussians,
        cameras,
        colour: true,
        channels: 0,
    };
    let (forward, both) = (rendering.forward()?, rendering.both()?);
    let peak = peak_memory_bytes();
    let projection = Samples::of(repeats, || {
        for camera in cameras {
            black_box(Projected::new(&gaussians.splats(), camera, &settings)?);
        }
        Ok(())
    })?;

    let full = bench.is_full();
    let pixels = views * (bench.effort.size[0] * bench.effort.size[1]) as f64;
    let contributing = pairs.contributing.max(1) as f64;
    // Nanoseconds of a thread that each pair of all views takes, of a view's milliseconds.
    let each = 1e6 * views * rayon::current_num_threads() as f64 / contributing;
    let mut timed = |name: &str, samples: &Samples, bar: f64| {
        let figure = Figure::measured(&case, name, "ms", samples);
        let barred = gaussians.len() == BAR_SIZE;
        figures.push(if barred {
            figure.at_most_if(full, bar, MEANT_FOR)
        } else {
            figure
        });
    };
    timed("forward", &forward, BARS[0]);
    timed("forward + backward", &both, BARS[1]);
    figures.push(Figure::measured(
        &case,
        "projection, sorting and tiles alone",
        "ms",
        &projection.scaled(1e3 / views),
    ));
    let backward = (both.median() - forward.median()).max(0.0);
    let pair = |name: &str, milliseconds: f64, bar: f64| {
        Figure::counted(&case, name, "ns", milliseconds * each).at_most_if(full, bar, MEANT_FOR)
    };
    figures.push(pair(
        "forward, a pair and core",
        forward.median(),
        PAIR_BARS[0],
    ));
    figures.push(pair("backward, a pair and core", backward, PAIR_BARS[1]));
    figures.push(Figure::counted(
        &case,
        "pairs a pixel",
        "",
        pairs.contributing as f64 / pixels,
    ));
    figures.push(Figure::counted(
        &case,
        "evaluated a contributing pair",
        "",
        pairs.evaluated as f64 / contributing,
    ));
    let medians = [forward.median(), both.median()];
    if let Some(before) = before {
        let limit = gaussians.len() as f64 / before.gaussians.max(1) as f64;
        for (name, i) in [
            ("growth of forward", 0),
            ("growth of forward + backward", 1),
        ] {
            let name = format!(
                "{name} from {}",
                super::figures::thousands(before.gaussians as f64)
            );
            figures.push(
                Figure::counted(&case, &name, "x", medians[i] / before.medians[i]).at_most(limit),
            );
        }
    }
    if let Some(peak) = peak {
        let name = if alone {
            "peak memory meanwhile"
        } else {
            "peak memory so far"
        };
        figures.push(Figure::counted(&case, name, "MB", peak as f64 / 1e6));
    }
    Ok(medians)
}

/// Pairs of all views together.
pub(super) fn count_pairs(
    gaussians: &Gaussians,
    cameras: &[Camera],
    settings: &Settings,
) -> Result<PairCounts> {
    let mut sum = PairCounts::default();
    for camera in cameras {
        let pairs = Projected::new(&gaussians.splats(), camera, settings)?.count_pairs();
        sum.evaluated += pairs.evaluated;
        sum.contributing += pairs.contributing;
    }
    Ok(sum)
}

/// The Gaussians as tensors.
pub(super) struct Leaves {
    means: Tensor<2>,
    log_scales: Tensor<2>,
    rotations: Tensor<2>,
    opacity_logits: Tensor<1>,
    sh: Tensor<3>,
    sh_degree: usize,
}

impl Leaves {
    pub fn new(g: &Gaussians, device: &Device) -> Self {
        let n = g.len();
        let two = |v: &[f32], width: usize| {
            Tensor::from_data(TensorData::new(v.to_vec(), [n, width]), device)
        };
        Self {
            means: two(g.means.as_flattened(), 3),
            log_scales: two(g.log_scales.as_flattened(), 3),
            rotations: two(g.rotations.as_flattened(), 4),
            opacity_logits: Tensor::from_data(
                TensorData::new(g.opacity_logits.clone(), [n]),
                device,
            ),
            sh: Tensor::from_data(TensorData::new(g.sh.clone(), [n, g.sh_len(), 3]), device),
            sh_degree: g.sh_degree,
        }
    }

    pub fn tracked(self) -> Self {
        Self {
            means: self.means.require_grad(),
            log_scales: self.log_scales.require_grad(),
            rotations: self.rotations.require_grad(),
            opacity_logits: self.opacity_logits.require_grad(),
            sh: self.sh.require_grad(),
            ..self
        }
    }

    pub fn input(&self) -> RasterInput {
        RasterInput {
            means: self.means.clone(),
            log_scales: self.log_scales.clone(),
            rotations: self.rotations.clone(),
            opacity_logits: self.opacity_logits.clone(),
            sh: Some(self.sh.clone()),
            active_sh_degree: self.sh_degree,
            features: None,
            screen: None,
        }
    }
}

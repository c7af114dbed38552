//! The frozen point encoder: neighbours, random sampling, four residual blocks, interpolation weights.

use super::figures::thousands;
use super::{Bench, Figure, Findings, Samples, Section};
use crate::error::Result;
use crate::segmentation::encoder::{Cloud, encode, load_spatial, metres_per_unit};
use std::hint::black_box;

/// Points that the bar is set for, and the bar in seconds.
const BAR_POINTS: usize = 100_000;
const BAR: f64 = 5.0;

pub(super) fn measure(bench: &Bench) -> Result<Findings> {
    let gaussians = bench.subject.gaussians(bench.effort.gaussians)?;
    let colors = gaussians.base_colors();
    let (encoder, weights) = load_spatial(&bench.config.spatial, bench.config.seed, &bench.device)?;
    let scale = metres_per_unit(&bench.config.spatial, bench.subject.extent())?;
    let cloud = Cloud {
        positions: &gaussians.means,
        colors: Some(&colors),
        up: bench.subject.up,
        scale,
    };
    let samples = Samples::of(bench.effort.repeats, || {
        black_box(encode(&encoder, &cloud, bench.config.seed, &bench.device)?);
        Ok(())
    })?;
    let notes = vec![
        format!("centres of {}", bench.subject.description),
        format!("weights: {weights}; neighbour search and interpolation weights included"),
    ];
    let mut findings = Findings::new(Section::Encoding, notes);
    let case = format!("{} points", thousands(gaussians.len() as f64));
    let figure = Figure::measured(&case, "encoding", "s", &samples);
    findings
        .figures
        .push(figure.at_most_if(gaussians.len() == BAR_POINTS, BAR, "100,000 points"));
    Ok(findings)
}

//! Lifting feature maps onto the Gaussians (Algorithm 1).

use super::{Bench, Figure, Findings, Samples, Section, gaussians_in_words};
use crate::backend::device::in_host_memory;
use crate::config::Resolution;
use crate::error::Result;
use crate::features::{FeatureMap, SCALES};
use crate::random::{Purpose, stream};
use crate::raster::Settings;
use crate::segmentation::unprojection::Lifting;
use rand::Rng;
use std::hint::black_box;

/// Image pixels a cell, of each scale of the built-in descriptor.
const STEPS: [usize; SCALES] = [4, 4, 8, 16];
pub(super) const CHANNELS: usize = 64;
/// Different sets of maps; more of them than fit a cache.
const SETS: usize = 8;
/// Views that the bars are set for, and those bars in seconds.
const BAR_VIEWS: usize = 80;
const MEANT_FOR: &str = "80 views at 480x360";
const RESOLUTIONS: [(Resolution, &str, f64); 2] = [
    (Resolution::Feature, "`feature`", 5.0),
    (Resolution::Image, "`image`", 15.0),
];

pub(super) fn measure(bench: &Bench) -> Result<Findings> {
    let effort = &bench.effort;
    let gaussians = bench.subject.gaussians(effort.gaussians)?;
    let cameras = bench.subject.cameras(effort.lifted_views, effort.size);
    let own = bench.subject.cameras.len();
    let mut notes = vec![
        format!(
            "{}, {}",
            bench.views_in_words(cameras.len()),
            gaussians_in_words(gaussians.len())
        ),
        format!(
            "maps of {CHANNELS} random numbers at every {STEPS:?} pixels, as the built-in descriptor has them; one pass"
        ),
    ];
    if own < cameras.len() {
        notes.push(format!(
            "the scene has {own} training views; they come round again"
        ));
    }
    let mut findings = Findings::new(Section::Unprojection, notes);
    let sets: Vec<Vec<FeatureMap>> = (0..SETS.min(cameras.len()))
        .map(|set| maps(bench, set))
        .collect();
    let settings = Settings::from(&bench.config.raster);
    let comparable = bench.is_full() && cameras.len() == BAR_VIEWS;
    for (resolution, name, bar) in RESOLUTIONS {
        let case = format!("{name} resolution");
        // Warm-up.
        let mut first = Lifting::new(&gaussians, &[CHANNELS; SCALES], &bench.device);
        if let (Some(camera), Some(maps)) = (cameras.first(), sets.first()) {
            first.add(camera, maps, None, resolution, &settings)?;
        }
        black_box(first.finish()?);
        let mut sums = Lifting::new(&gaussians, &[CHANNELS; SCALES], &bench.device);
        let mut views = Samples::default();
        for (i, camera) in cameras.iter().enumerate() {
            views.time(|| sums.add(camera, &sets[i % sets.len()], None, resolution, &settings))?;
        }
        let mut end = Samples::default();
        end.time(|| {
            Ok(black_box(
                sums.finish()?
                    .normalised(bench.config.unprojection.normalisation),
            ))
        })?;
        let total = Figure::counted(&case, "all views", "s", views.sum() + end.sum());
        findings
            .figures
            .push(total.at_most_if(comparable, bar, MEANT_FOR));
        // A GPU works on after a view was handed to it.
        if in_host_memory(&bench.device) {
            findings
                .figures
                .push(Figure::measured(&case, "a view", "ms", &views.scaled(1e3)));
        }
    }
    Ok(findings)
}

/// One map a scale for images of the benchmark's size.
pub(super) fn maps(bench: &Bench, set: usize) -> Vec<FeatureMap> {
    let mut rng = stream(bench.config.seed, Purpose::Benchmark, set as u64);
    let [width, height] = bench.effort.size;
    let map = |step: usize| {
        let mut map = FeatureMap::zeros(height.div_ceil(step), width.div_ceil(step), CHANNELS);
        map.data.fill_with(|| rng.random_range(-1.0..1.0));
        map
    };
    STEPS.map(map).into()
}

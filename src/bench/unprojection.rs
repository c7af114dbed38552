//! Lifting of feature maps onto the Gaussians (Algorithm 1).

use super::{Bench, Findings, Samples};
use crate::config::Resolution;
use crate::error::Result;
use crate::features::{FeatureMap, SCALES};
use crate::random::{Purpose, stream};
use crate::raster::Settings;
use crate::segmentation::unprojection::LiftedViews;
use crate::splat::Gaussians;
use rand::Rng;
use std::hint::black_box;

/// Image pixels per cell, for each scale of the built-in descriptor.
const STEPS: [usize; SCALES] = [4, 4, 8, 16];
const CHANNELS: usize = 64;
/// Different sets of maps; more than fit a cache.
const SETS: usize = 8;
const RESOLUTIONS: [(Resolution, &str); 2] = [
    (Resolution::Feature, "feature"),
    (Resolution::Image, "image"),
];

pub(super) fn measure(
    bench: &Bench,
    gaussians: &Gaussians,
    case: &str,
    findings: &mut Findings,
) -> Result<()> {
    let effort = &bench.effort;
    let [width, height] = effort.size;
    let cameras = bench.subject.cameras(effort.lifted_views, effort.size);
    findings.note(format!(
        "{} views of {width}x{height}, with maps of {CHANNELS} random numbers at every {STEPS:?} pixels",
        cameras.len()
    ));
    let sets: Vec<Vec<FeatureMap>> = (0..SETS.min(cameras.len()))
        .map(|set| maps(bench, set))
        .collect();
    let settings = Settings::from(&bench.config.raster);
    for (resolution, name) in RESOLUTIONS {
        let lift = |views: usize| {
            let mut lifting = LiftedViews::new(gaussians, &[CHANNELS; SCALES], &bench.device);
            for (camera, maps) in cameras.iter().zip(sets.iter().cycle()).take(views) {
                lifting.add(camera, maps, None, resolution, &settings)?;
            }
            let sums = lifting.finish()?;
            black_box(sums.normalised(bench.config.unprojection.normalisation));
            Ok(())
        };
        lift(1)?;
        let mut all = Samples::default();
        all.time(|| lift(cameras.len()))?;
        let name = format!("all views, at {name} resolution");
        findings.measured(case, &name, "s", &all);
    }
    Ok(())
}

/// One map for each scale, for images of the benchmark's size.
fn maps(bench: &Bench, set: usize) -> Vec<FeatureMap> {
    let mut rng = stream(bench.config.seed, Purpose::Benchmark, set as u64);
    let [width, height] = bench.effort.size;
    let map = |step: usize| {
        let mut map = FeatureMap::zeros(height.div_ceil(step), width.div_ceil(step), CHANNELS);
        map.data.fill_with(|| rng.random_range(-1.0..1.0));
        map
    };
    STEPS.map(map).into()
}

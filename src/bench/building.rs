//! An iteration of stage one, everything included: rendering, loss, backward pass, Adam, densification.

use super::raster::count_pairs;
use super::{Bench, Figure, Findings, Samples, Section, gaussians_in_words};
use crate::data::Split;
use crate::error::Result;
use crate::raster::Settings;
use crate::reconstruction::{BuildingStage, BuildingState};

/// Length of the run whose middle is measured, iterations.
const RUN: usize = 7_000;
/// Views that pairs are counted on, at most.
const COUNTED_VIEWS: usize = 4;
/// Pixels of the views that the bars are set for.
const BAR_PIXELS: usize = 270 * 480;
const MEANT_FOR: &str = "270x480";

/// The bars at a number of Gaussians, milliseconds.
fn bars(gaussians: usize) -> &'static [(&'static str, f64)] {
    match gaussians {
        15_000 => &[("", 30.0)],
        50_000 => &[(" (floor)", 100.0), (" (aim)", 65.0)],
        _ => &[],
    }
}

pub(super) fn measure(bench: &Bench) -> Result<Findings> {
    let Some(scene) = &bench.subject.scene else {
        let why = "--scene and --cameras come without photos; use --run or --data";
        return Ok(Findings::skipped(Section::Building, why));
    };
    let effort = &bench.effort;
    let train: Vec<_> = scene
        .split(Split::Train)
        .map(|v| v.camera.clone())
        .collect();
    let (width, height) = train.first().map_or((0, 0), |c| (c.width, c.height));
    let steps = effort.steps * effort.repeats.max(1);
    let mut findings = Findings::new(
        Section::Building,
        vec![
            format!("{width}x{height}, {} training views of {}", train.len(), bench.subject.description),
            format!(
                "{steps} iterations of the middle of a run, all SH degrees on, after {} that are not",
                effort.settle
            ),
            "counted; densified on schedule, but never to more than at first. The mean over all of them is what a run pays."
                .to_owned(),
        ],
    );
    for &size in &effort.building {
        let gaussians = bench.subject.gaussians(size)?;
        let case = gaussians_in_words(gaussians.len());
        let mut config = bench.config.clone();
        config.building.sh_degree = gaussians.sh_degree;
        config.building.iterations = RUN;
        config.building.max_gaussians = gaussians.len();
        // Three eighths into the run, when the last SH degree comes on; a densification in the middle of what counts.
        let every = config.building.densify_every.max(1);
        let densified = (3 * RUN / 8 / every + 2) * every;
        let iteration = densified.saturating_sub(steps / 2 + effort.settle);
        let state = BuildingState {
            iteration,
            ..BuildingState::new(gaussians, config.seed)
        };
        let mut stage = BuildingStage::from_state(scene, &config, &bench.device, state)?;
        for _ in 0..effort.settle {
            stage.step()?;
        }
        let (mut all, mut densifying) = (Samples::default(), Samples::default());
        for _ in 0..steps {
            let mut one = Samples::default();
            let report = one.time(|| stage.step())?;
            all.push(one.sum());
            if report.densified.is_some() {
                densifying.push(one.sum());
            }
        }
        let comparable = width * height == BAR_PIXELS;
        let mean = Figure::counted(&case, "an iteration, mean", "ms", 1e3 * all.mean());
        match bars(size) {
            [] => findings.figures.push(mean),
            bars => findings.figures.extend(bars.iter().map(|(name, limit)| {
                let name = format!("{}{name}", mean.name);
                Figure {
                    name,
                    ..mean.clone()
                }
                .at_most_if(comparable, *limit, MEANT_FOR)
            })),
        }
        findings.figures.push(Figure::measured(
            &case,
            "an iteration",
            "ms",
            &all.scaled(1e3),
        ));
        if !densifying.is_empty() {
            let name = format!("one with densification, of {every}");
            findings.figures.push(Figure::measured(
                &case,
                &name,
                "ms",
                &densifying.scaled(1e3),
            ));
        }
        let cameras: Vec<_> = train
            .iter()
            .step_by(train.len().div_ceil(COUNTED_VIEWS).max(1))
            .cloned()
            .collect();
        let gaussians = stage.gaussians()?;
        let pairs = count_pairs(&gaussians, &cameras, &Settings::from(&config.raster))?;
        let pixels: usize = cameras.iter().map(|c| c.width * c.height).sum();
        let pairs = pairs.contributing as f64 / pixels.max(1) as f64;
        findings.figures.push(Figure::counted(
            &case,
            "pairs a pixel afterwards",
            "",
            pairs,
        ));
        findings.figures.push(Figure::counted(
            &case,
            "Gaussians afterwards",
            "",
            gaussians.len() as f64,
        ));
    }
    Ok(findings)
}

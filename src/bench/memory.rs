//! Memory and time of a step of stage two, as fewer Gaussians are decoded together.

use super::segmentation::{labelled_views, random_features};
use super::{
    Bench, Figure, Findings, Layout, Samples, Section, figures, gaussians_in_words,
    reset_peak_memory,
};
use crate::config::{Config, Variant};
use crate::data::Scene;
use crate::error::Result;
use crate::pipeline::train_decoder::{Plan, Recalls, train_step};
use crate::pipeline::{Inputs, Spatial, decoder_row};
use crate::raster::Settings;
use crate::report::peak_memory_bytes;
use crate::segmentation::loss::Kind;

/// Training views that the steps go through.
const VIEWS: usize = 4;
/// Gaussians decoded together, fewest first: memory that a larger step leaves with the allocator is not counted for a smaller
/// one. 0 is all of a view.
const CHUNKS: [usize; 4] = [4_096, 16_384, 65_536, 0];

pub(super) fn measure(bench: &Bench) -> Result<Findings> {
    let section = Section::Memory;
    let (few, _) = match labelled_views(bench, section, VIEWS) {
        Ok(found) => found,
        Err(skipped) => return Ok(skipped),
    };
    let camera = &few.views[0].camera;
    let mut findings = Findings::new(
        section,
        vec![
            format!(
                "{}x{}, {} labelled training views of {}",
                camera.width,
                camera.height,
                few.views.len(),
                bench.subject.description
            ),
            "a process with frozen features, kept weights and the step; image features random numbers".to_owned(),
        ],
    );
    findings.layout = Layout::Grid;
    if !reset_peak_memory() {
        findings.notes.push(
            "this system does not let the peak be reset: peaks are of the process so far"
                .to_owned(),
        );
    }
    for &count in &bench.effort.memory {
        findings.figures.extend(with_gaussians(bench, &few, count)?);
    }
    Ok(findings)
}

/// The figures of a scene of `count` Gaussians.
fn with_gaussians(bench: &Bench, few: &Scene, count: usize) -> Result<Vec<Figure>> {
    let gaussians = bench.subject.gaussians(count)?;
    let with = |decoder_chunk| {
        let mut config = bench.config.clone();
        config.segmentation.decoder_chunk = decoder_chunk;
        config
    };
    let configs: Vec<Config> = CHUNKS.map(with).into();
    let settings = Settings::from(&bench.config.raster);
    let seen = Some(random_features(gaussians.len(), &bench.config));
    let device = &bench.device;
    let mut inputs = Inputs {
        scene: few,
        gaussians: &gaussians,
        seen,
        semantics: None,
        config: &configs[0],
        settings,
        device,
    };
    let mut spatial = Spatial::default();
    let source = spatial.source(Variant::Ours, &inputs)?;
    let views = few.views.len();
    let mut found = Vec::new();
    for config in &configs {
        inputs.config = config;
        let segmentation = &config.segmentation;
        let plan = Plan::new(segmentation, Kind::from_config(segmentation)?, config.seed);
        let mut training = inputs.training_views();
        let mut model = decoder_row(
            Variant::Ours,
            segmentation.lr,
            &plan,
            source,
            &inputs,
            &mut training,
        )?;
        let mut recalls = Recalls::new(training.classes());
        // The first pass over the views makes their weights, which takes memory of its own.
        let first = plan.warmup.next_multiple_of(views);
        for i in 0..views {
            train_step(&mut model, &mut training, &plan, &mut recalls, first + i)?;
        }
        reset_peak_memory();
        let mut steps = Samples::default();
        for i in 0..bench.effort.repeats.max(1) * views {
            steps.time(|| {
                train_step(
                    &mut model,
                    &mut training,
                    &plan,
                    &mut recalls,
                    first + views + i,
                )
            })?;
        }
        let together = match segmentation.decoder_chunk {
            0 => "all".to_owned(),
            chunk => figures::thousands(chunk as f64),
        };
        let case = format!(
            "{}, {together} together",
            gaussians_in_words(gaussians.len())
        );
        found.push(Figure::measured(
            &case,
            "an iteration",
            "ms",
            &steps.scaled(1e3),
        ));
        if let Some(peak) = peak_memory_bytes() {
            found.push(Figure::counted(
                &case,
                "peak memory",
                "MB",
                peak as f64 / 1e6,
            ));
        }
    }
    Ok(found)
}

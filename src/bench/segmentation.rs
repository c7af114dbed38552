//! An iteration of stage two: decoder, blending, label loss, 3D regularisation, backward pass, Adam.

use super::{Bench, Figure, Findings, Samples, Section, gaussians_in_words};
use crate::backend::device::in_host_memory;
use crate::config::{Config, Preset, Variant};
use crate::data::{Scene, Split};
use crate::error::Result;
use crate::features::SCALES;
use crate::objects::Identities;
use crate::pipeline::train_decoder::{
    Drawn, Fused, Model, NamedValues, Plan, Prediction, Recalls, train_step,
};
use crate::pipeline::{Inputs, Seen, Spatial, decoder_row};
use crate::random::{Purpose, stream};
use crate::raster::Settings;
use crate::segmentation::loss::Kind;
use burn::tensor::{Gradients, Tensor};
use rand::Rng;
use std::time::Instant;

/// 15 minutes for 6,000 iterations, milliseconds.
const BAR: f64 = 150.0;
const MEANT_FOR: &str = "80 views at 480x360, preset fast";

/// `count` of the labelled training views, evenly chosen, or all of them where there are fewer; and how many there are.
/// Findings that say why instead, where there are none.
pub(super) fn labelled_views(
    bench: &Bench,
    section: Section,
    count: usize,
) -> std::result::Result<(Scene, usize), Findings> {
    let Some(scene) = &bench.subject.scene else {
        return Err(Findings::skipped(
            section,
            "--scene and --cameras come without labels; use --run or --data",
        ));
    };
    let labelled: Vec<_> = scene
        .split(Split::Train)
        .filter(|v| v.raw.is_some())
        .collect();
    if labelled.is_empty() || scene.classes.is_empty() {
        return Err(Findings::skipped(
            section,
            format!("{} has no raw labels", scene.name),
        ));
    }
    let views = count.min(labelled.len());
    let few = Scene {
        name: scene.name.clone(),
        views: (0..views)
            .map(|i| labelled[i * labelled.len() / views].clone())
            .collect(),
        classes: scene.classes.clone(),
        points: Default::default(),
        origin: scene.origin,
        up: scene.up,
    };
    Ok((few, labelled.len()))
}

/// Random numbers in place of the image features of `count` Gaussians.
pub(super) fn random_features(count: usize, config: &Config) -> Seen {
    let mut rng = stream(config.seed, Purpose::Benchmark, 0);
    let dimensions = config.features.dimensions;
    let mut rows = || {
        (0..count * dimensions)
            .map(|_| rng.random_range(-1.0_f32..1.0))
            .collect()
    };
    let lifted: [Vec<f32>; SCALES] = std::array::from_fn(|_| rows());
    let kept = (0..count as u32).collect();
    Seen {
        kept,
        lifted,
        dimensions,
        name: "random numbers".into(),
        content: String::new(),
        seconds: [0.0; 2],
    }
}

pub(super) fn measure(bench: &Bench) -> Result<Findings> {
    let section = Section::Segmentation;
    let (config, effort) = (&bench.config, &bench.effort);
    let (few, labelled) = match labelled_views(bench, section, effort.labelled_views) {
        Ok(found) => found,
        Err(skipped) => return Ok(skipped),
    };
    let gaussians = bench
        .subject
        .gaussians(bench.subject.trained().unwrap_or(effort.segmentation))?;
    let (n, views) = (gaussians.len(), few.views.len());
    let camera = &few.views[0].camera;
    let is_barred = labelled == 80 && (camera.width, camera.height) == (480, 360);
    let is_barred = is_barred && config.preset == Preset::Fast;
    let settings = Settings::from(&config.raster);
    let (seen, device) = (Some(random_features(n, config)), &bench.device);
    let inputs = Inputs {
        scene: &few,
        gaussians: &gaussians,
        seen,
        semantics: None,
        config,
        settings,
        device,
    };
    let mut spatial = Spatial::default();
    let source = spatial.source(Variant::Ours, &inputs)?;
    let segmentation = &config.segmentation;
    let mut training = inputs.training_views();
    let plan = Plan::new(segmentation, Kind::from_config(segmentation)?, config.seed);
    let mut model = Timed {
        model: decoder_row(
            Variant::Ours,
            segmentation.lr,
            &plan,
            source,
            &inputs,
            &mut training,
        )?,
        seconds: [0.0; 2],
    };

    let mut recalls = Recalls::new(training.classes());
    // The first pass over the views makes their weights and settles allocations; then the loss after the warm-up.
    let first = plan.warmup.next_multiple_of(views);
    let mut making = Samples::default();
    for i in 0..views {
        making.time(|| train_step(&mut model, &mut training, &plan, &mut recalls, first + i))?;
    }
    let (mut steps, mut forward, mut update) =
        (Samples::default(), Samples::default(), Samples::default());
    for i in 0..effort.repeats.max(1) * effort.steps {
        model.seconds = [0.0; 2];
        steps.time(|| {
            train_step(
                &mut model,
                &mut training,
                &plan,
                &mut recalls,
                first + views + i,
            )
        })?;
        forward.push(model.seconds[0]);
        update.push(model.seconds[1]);
    }
    let (width, height) = (few.views[0].camera.width, few.views[0].camera.height);
    let mut findings = Findings::new(
        section,
        vec![
            format!(
                "{width}x{height}, {views} of the labelled training views of {}",
                bench.subject.description
            ),
            format!(
                "{:.0} % of the pixels a step, {} classes, image features random numbers, lr and losses as configured",
                100.0 * segmentation.pixel_share,
                few.classes.len()
            ),
        ],
    );
    let case = gaussians_in_words(n);
    let share =
        |name: &str, part: f64| Figure::counted(&case, name, "%", 100.0 * part / steps.sum());
    let rest = steps.sum() - forward.sum() - update.sum();
    findings.figures.extend([
        Figure::measured(&case, "an iteration", "ms", &steps.scaled(1e3))
            .at_most_if(is_barred, BAR, MEANT_FOR),
        Figure::measured(
            &case,
            "the first on a view, which makes its weights",
            "ms",
            &making.scaled(1e3),
        ),
    ]);
    // A GPU works on while the host is elsewhere: only a whole iteration, which ends with a readback, has a time.
    if in_host_memory(device) {
        findings.figures.extend([
            share("of it forward: decoding and blending", forward.sum()),
            share("of it losses and backward", rest),
            share("of it Adam, and what is decoded in parts", update.sum()),
        ]);
    }
    Ok(findings)
}

/// A decoder row that notes where an iteration's time goes.
struct Timed<'a> {
    model: Fused<'a>,
    /// Seconds in [`Model::predict`] and in [`Model::step`].
    seconds: [f64; 2],
}

impl Model for Timed<'_> {
    fn predict(&mut self, view: usize, drawn: &Drawn) -> Result<Prediction> {
        let start = Instant::now();
        let prediction = self.model.predict(view, drawn);
        self.seconds[0] += start.elapsed().as_secs_f64();
        prediction
    }

    fn step(&mut self, loss: Tensor<1>, gradients: &mut Gradients, factor: f64) -> Result<f32> {
        let start = Instant::now();
        let done = self.model.step(loss, gradients, factor);
        self.seconds[1] += start.elapsed().as_secs_f64();
        done
    }

    fn identities(&mut self) -> Result<Identities> {
        self.model.identities()
    }

    fn learnable_bytes(&self) -> usize {
        self.model.learnable_bytes()
    }

    fn state(&self) -> NamedValues {
        self.model.state()
    }

    fn restore(&mut self, state: &dyn Fn(&str) -> Option<Vec<f32>>) -> Option<()> {
        self.model.restore(state)
    }
}

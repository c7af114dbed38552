//! A step of stage two: decoder, blending, label loss, 3D regularisation, backward pass, Adam.

use super::{Bench, Findings, Samples};
use crate::config::{Config, Variant};
use crate::data::{Scene, Split};
use crate::error::Result;
use crate::features::SCALES;
use crate::pipeline::train_decoder::Plan;
use crate::pipeline::{Inputs, LiftedFeatures, decoder_training, encode};
use crate::random::{Purpose, stream};
use crate::raster::Settings;
use crate::segmentation::loss::LabelLoss;
use crate::splat::Gaussians;
use rand::Rng;

pub(super) fn measure(
    bench: &Bench,
    gaussians: &Gaussians,
    case: &str,
    findings: &mut Findings,
) -> Result<()> {
    let Some(scene) = labelled_views(bench) else {
        findings.skipped = Some("no raw labels".to_owned());
        return Ok(());
    };
    let config = &bench.config;
    let (camera, views) = (&scene.views[0].camera, scene.views.len());
    findings.note(format!(
        "{views} training views of {}x{}, {} classes, image features random numbers",
        camera.width,
        camera.height,
        scene.classes.len()
    ));
    let inputs = Inputs {
        scene: &scene,
        gaussians,
        lifted: Some(random_features(gaussians.len(), config)),
        semantics: None,
        config,
        settings: Settings::from(&config.raster),
        device: &bench.device,
    };
    let mut encoding = Samples::default();
    let encodings = encoding.time(|| encode(&inputs, &config.spatial))?;
    findings.measured(case, "point encoder and its neighbours", "s", &encoding);
    let input = encodings.decoder_input(Variant::Ours, &inputs)?;
    let settings = &config.segmentation;
    let plan = Plan {
        // All steps are after the warm-up of the loss.
        warmup: 0,
        ..Plan::new(settings, LabelLoss::from_config(settings)?, config.seed)
    };
    let classes = scene.classes.len();
    let prior = vec![0.0; gaussians.len() * classes];
    let mut training = decoder_training(Variant::Ours, &plan, &input, Some(prior), &inputs, views);
    let mut training_views = inputs.training_views();
    // The first pass over the views computes their weights.
    let counted = bench.effort.repeats.max(1) * bench.effort.steps;
    let mut first = Samples::default();
    let mut rest = Samples::default();
    for i in 0..views + counted {
        let samples = if i < views { &mut first } else { &mut rest };
        samples.time(|| training.step(&mut training_views, &plan))?;
    }
    findings.measured(case, "a step", "ms", &rest.scaled(1e3));
    let name = "the first step on a view, with its weights";
    findings.measured(case, name, "ms", &first.scaled(1e3));
    Ok(())
}

/// The scene with some of its labelled training views, evenly chosen; `None` where there are none.
fn labelled_views(bench: &Bench) -> Option<Scene> {
    let scene = bench.subject.scene.as_ref()?;
    let train = scene.split(Split::Train);
    let labelled: Vec<_> = train.filter(|view| view.raw.is_some()).collect();
    let count = bench.effort.labelled_views.min(labelled.len());
    let views = (0..count).map(|i| labelled[i * labelled.len() / count].clone());
    (count > 0 && !scene.classes.is_empty()).then(|| Scene {
        name: scene.name.clone(),
        views: views.collect(),
        classes: scene.classes.clone(),
        points: Default::default(),
        origin: scene.origin,
        up: scene.up,
    })
}

/// Random numbers in place of the image features of `count` Gaussians.
fn random_features(count: usize, config: &Config) -> LiftedFeatures {
    let mut rng = stream(config.seed, Purpose::Benchmark, 0);
    let dimensions = config.features.dimensions;
    let lifted: [Vec<f32>; SCALES] = std::array::from_fn(|_| {
        (0..count * dimensions)
            .map(|_| rng.random_range(-1.0..1.0))
            .collect()
    });
    LiftedFeatures {
        kept: (0..count as u32).collect(),
        lifted,
        dimensions,
        name: "random numbers".into(),
        content: String::new(),
        seconds: [0.0; 2],
    }
}

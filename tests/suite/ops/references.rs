//! A whole step of a stage with all custom operations replaced by their plain-tensor references.

use crate::support::painted_plane::{config, scene};
use burn::module::{Module, ModuleVisitor, Param};
use burn::tensor::Tensor;
use coseg::checkpoint::Checkpoint;
use coseg::config::{Budget, BuildingConfig, Config, LabelSource, SCALES, Variant};
use coseg::data::{LabelMap, Split};
use coseg::objects::{Identities, LabelMaps, RenderOptions, Renderer, Votes, vote};
use coseg::ops::{CustomOp, with_references};
use coseg::pipeline::train_decoder::{DecoderModel, Training, TrainingPlan};
use coseg::pipeline::{LiftedFeatures, SegmentationInputs, decoder_training, encode};
use coseg::progress::Silent;
use coseg::raster::{Settings, SplatTensors};
use coseg::reconstruction::{Trainer, TrainerState};
use coseg::segmentation::loss::LabelLoss;

/// Loss of a step, and the state after it, whose first moments are a tenth of the gradients.
fn step(config: &Config) -> (f64, TrainerState) {
    let scene = scene();
    let device = crate::support::device();
    let mut start = Trainer::new(&scene, config, &device)
        .and_then(|trainer| trainer.state())
        .expect("a state");
    // Round Gaussians have no gradient to their rotations.
    for (i, scales) in start.gaussians.log_scales.iter_mut().enumerate() {
        *scales = [0.3, 1.1, 2.7].map(|by| scales[0] + 0.5 * (i as f32 * by).sin());
    }
    for (i, rotation) in start.gaussians.rotations.iter_mut().enumerate() {
        *rotation = [0.3, 0.9, 1.7, 2.3].map(|by| (i as f32 * by + 1.0).sin());
    }
    let mut trainer = Trainer::from_state(&scene, config, &device, start).expect("a trainer");
    let loss = trainer.step().expect("a step").loss;
    (loss, trainer.state().expect("readable"))
}

fn assert_close(name: &str, got: &[f32], want: &[f32], tolerance: f32) {
    let largest = want.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
    assert!(largest > 0.0, "{name}: all zero");
    let off = got.iter().zip(want).map(|(a, b)| (a - b).abs());
    let worst = off.fold(0.0, |m: f32, d| if d.is_nan() { d } else { m.max(d) }) / largest;
    assert!(worst < tolerance, "{name}: {worst} of the largest value");
}

#[test]
fn a_step_of_stage_one_equals_that_of_the_references() {
    for absgrad in [false, true] {
        let building = BuildingConfig {
            absgrad,
            max_gaussians: Budget::AtMost(1_000),
            ..config().building
        };
        let config = Config {
            building,
            ..config()
        };
        let (loss, got) = step(&config);
        let (want_loss, want) = with_references(&CustomOp::ALL, || step(&config));
        assert!(
            (loss - want_loss).abs() < 1e-5 * want_loss,
            "{loss} against {want_loss}"
        );
        let names = ["means", "log_scales", "rotations", "opacity_logits", "sh"];
        for (k, name) in names.iter().enumerate() {
            assert_close(name, &got.first[k], &want.first[k], 1e-3);
            assert_close(name, &got.second[k], &want.second[k], 1e-3);
        }
        let means = |state: &TrainerState| state.gaussians.means.as_flattened().to_vec();
        assert_close("means after the step", &means(&got), &means(&want), 1e-3);
    }
}

/// What stage two computes on the plates in one step: lifted features, votes, the loss, the decoder after the step with its
/// moments (a tenth of the gradients), and label maps.
struct StageTwo {
    lifted: LiftedFeatures,
    votes: Votes,
    loss: f32,
    /// First and second moments of each parameter.
    moments: Vec<[Vec<f32>; 2]>,
    maps: Vec<LabelMap>,
}

/// Adam's moments of each parameter of the decoder.
fn moments(training: &Training<DecoderModel>) -> Vec<[Vec<f32>; 2]> {
    struct Sizes(Vec<usize>);
    impl ModuleVisitor for Sizes {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            self.0.push(param.val().shape().num_elements());
        }
    }
    let mut sizes = Sizes(Vec::new());
    training.module.visit(&mut sizes);
    let count: usize = sizes.0.iter().sum();
    let mut state = Checkpoint::new("adam");
    training.adam.save(&mut state).expect("readable");
    let mut vector = |name: &str| -> Vec<f32> { state.take(name, &[count]).expect("a moment") };
    let [first, second] = [vector("first moment"), vector("second moment")];
    let mut start = 0;
    let of_parameter = |size| {
        let range = start..start + size;
        start = range.end;
        [first[range.clone()].to_vec(), second[range].to_vec()]
    };
    sizes.0.into_iter().map(of_parameter).collect()
}

fn stage_two(config: &Config) -> StageTwo {
    let (scene, gaussians, labels, _folder) = crate::support::plates::loaded();
    let device = crate::support::device();
    let settings = Settings::default();
    let lifted = LiftedFeatures::of_views(&scene, &gaussians, config, &device, &mut Silent)
        .expect("features");
    let inputs = SegmentationInputs {
        lifted: Some(lifted),
        settings,
        ..SegmentationInputs::new(&scene, &gaussians, config, &device)
    };
    let plan = TrainingPlan::new(&config.segmentation, LabelLoss::Ce, 0);
    let encodings = encode(&inputs).expect("encoded");
    let input = encodings.decoder_input(Variant::Ours, &inputs);
    let input = input.expect("the decoder's input");
    let votes = vote(
        &gaussians,
        scene.split(Split::Train),
        &scene.classes,
        &settings,
        &device,
    );
    let votes = votes.expect("votes");
    let prior = Some(votes.logits(0.3));
    let mut views = inputs.training_views();
    let mut training = decoder_training(&plan, &input, prior, &inputs);
    let loss = training.step(&mut views, &plan).expect("a step");
    let identities = Identities {
        scores: (0..gaussians.len() * scene.classes.len())
            .map(|i| (i as f32 * 1.7).sin())
            .collect(),
        classes: scene.classes.len(),
    };
    let splats = SplatTensors::new(&gaussians, &device);
    let renderer = Renderer::new(
        gaussians.clone(),
        Some(labels),
        RenderOptions::default(),
        &device,
    )
    .expect("a scene");
    let mut maps = Vec::new();
    for view in scene.split(Split::Test) {
        let seen = splats.seen_by(&view.camera, &settings);
        for source in [LabelSource::Labels, LabelSource::Scores] {
            let map = LabelMaps::new(&identities, &scene.classes, source, 0.5).of(&seen);
            maps.push(map.expect("a map"));
        }
        let frame = renderer.frame(&view.camera).expect("a frame");
        maps.push(frame.labels.expect("labels"));
    }
    let moments = moments(&training);
    StageTwo {
        loss,
        moments,
        maps,
        votes,
        lifted: inputs.lifted.expect("lifted"),
    }
}

#[test]
fn a_step_of_stage_two_equals_that_of_the_references() {
    let mut config = Config::default();
    // All scales, for Eq. 9 reads the coarse ones.
    config.features.scales = Some(SCALES);
    let got = stage_two(&config);
    let want = with_references(&CustomOp::ALL, || stage_two(&config));
    for (got, want) in got.lifted.lifted.iter().zip(&want.lifted.lifted) {
        assert_close("lifted features", got, want, 1e-4);
    }
    assert_close("votes", &got.votes.table, &want.votes.table, 1e-4);
    let (loss, want_loss) = (got.loss, want.loss);
    assert!(
        (loss - want_loss).abs() < 1e-4 * want_loss && want_loss > 0.0,
        "{loss} against {want_loss}"
    );
    // Moments alone: the first step of a parameter has only the sign of its gradient.
    let mut checked = 0;
    for (k, (got, want)) in got.moments.iter().zip(&want.moments).enumerate() {
        for (got, want) in got.iter().zip(want) {
            if want.iter().all(|moment| *moment == 0.0) {
                assert!(got.iter().all(|moment| *moment == 0.0), "parameter {k}");
            } else {
                assert_close(&format!("parameter {k}"), got, want, 2e-3);
                checked += 1;
            }
        }
    }
    assert!(checked > 8, "{checked} moments are not zero");
    for (got, want) in got.maps.iter().zip(&want.maps) {
        let differ = got.ids.iter().zip(&want.ids).filter(|(a, b)| a != b);
        let (differ, all) = (differ.count(), want.ids.len());
        assert!(differ * 500 <= all, "{differ} of {all} labels differ");
        assert!(want.ids.iter().any(|id| *id > 0), "no label");
    }
}

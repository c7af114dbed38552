//! Rows of stage two: what of them is trained, stored and shown.

use crate::support::hard_labels::hard_label_map;
use crate::support::plate_runs::{short, trained, whole};
use crate::support::plates::training_views;
use burn::tensor::{Tensor, TensorData};
use coseg::config::{Association, Config, LabelSource, SCALES, SegmentationConfig, Variant};
use coseg::data::{LoadOptions, Split, load};
use coseg::objects::{Identities, LabelMaps};
use coseg::pipeline::train_decoder::TrainingPlan;
use coseg::pipeline::{Outcome, SegmentationInputs, decoder_training, encode};
use coseg::random::{Purpose, stream};
use coseg::raster::{Projected, Settings, SplatTensors};
use coseg::segmentation::loss::LabelLoss;

#[test]
fn label_maps_show_the_labels_of_the_ply() {
    let outcome = trained(|s| s.rows = Some(vec![Variant::Vote]));
    let gaussians = &outcome.gaussians;
    let classes = &outcome.scene.classes;
    let scores = (0..gaussians.len() * classes.len())
        .map(|i| (i as f32 * 1.7).sin())
        .collect();
    let identities = Identities {
        scores,
        classes: classes.len(),
    };
    let (mut labelled, mut differ) = (0, 0);
    for view in outcome.scene.split(Split::Test) {
        let projected = Projected::new(&gaussians.splats(), &view.camera, &Settings::default())
            .expect("finite");
        let seen = SplatTensors::new(gaussians, &crate::support::device())
            .seen_by(&view.camera, &Settings::default());
        let map = |source| {
            LabelMaps::new(&identities, classes, source, 0.5)
                .of(&seen)
                .expect("a map")
                .ids
        };
        let labels = map(LabelSource::Labels);
        assert_eq!(
            labels,
            hard_label_map(&projected, &identities.ids(classes), 0.5).ids
        );
        labelled += labels.iter().filter(|id| **id != classes.ignore).count();
        differ += labels
            .iter()
            .zip(map(LabelSource::Scores))
            .filter(|(a, b)| *a != b)
            .count();
    }
    assert!(
        labelled > 1000 && differ > 100,
        "{labelled} labelled, {differ} otherwise by their scores"
    );
}

#[test]
fn averaged_parameters_differ_from_the_last_ones() {
    let scores = |average| {
        let outcome = trained(|s| {
            s.average = average;
            s.fine_tune = Some(false);
        });
        outcome.rows[0]
            .identities
            .as_ref()
            .expect("identities")
            .scores
            .clone()
    };
    assert_ne!(scores(true), scores(false));
}

#[test]
fn fine_tuned_gaussians_agree_better_with_the_raw_labels() {
    for scales in [1, SCALES] {
        let [tuned, decoded] = [true, false].map(|fine_tune| {
            let folder = tempfile::tempdir().expect("a folder");
            crate::support::plates::scene(folder.path());
            let mut config = short(folder.path(), 20, &[Variant::Ours]);
            config.features.scales = Some(scales);
            config.segmentation.fine_tune = Some(fine_tune);
            whole(&config, &folder.path().join("run"))
        });
        assert_eq!(tuned.rows[0].fine_tuning_steps, Some(100));
        assert_eq!(decoded.rows[0].fine_tuning_steps, None);
        let gain = agreement(&tuned) - agreement(&decoded);
        assert!(gain > 0.01, "{scales} scales, pixels: {gain}");
        let gain = likelihood(&tuned) - likelihood(&decoded);
        assert!(gain > 0.01, "{scales} scales, logarithms: {gain}");
    }
}

/// The share of the raw labels that the blended scores give back.
fn agreement(outcome: &Outcome) -> f64 {
    let classes = &outcome.scene.classes;
    let splats = SplatTensors::new(&outcome.gaussians, &crate::support::device());
    let identities = outcome.rows[0].identities.as_ref().expect("identities");
    let maps = LabelMaps::new(identities, classes, LabelSource::Scores, 0.0);
    let (mut agreeing, mut labelled) = (0_usize, 0_usize);
    for view in outcome.scene.split(Split::Train) {
        let seen = splats.seen_by(&view.camera, &Settings::default());
        let found = maps.of(&seen).expect("a map").ids;
        let raw = view.raw.as_ref().expect("raw labels").map().ids;
        for (raw, found) in raw.iter().zip(found) {
            labelled += usize::from(*raw != classes.ignore);
            agreeing += usize::from(*raw != classes.ignore && *raw == found);
        }
    }
    agreeing as f64 / labelled as f64
}

/// The mean log-probability of the raw labels by the blended scores of their pixels: what fine-tuning raises.
fn likelihood(outcome: &Outcome) -> f64 {
    let device = crate::support::device();
    let splats = SplatTensors::new(&outcome.gaussians, &device);
    let identities = outcome.rows[0].identities.as_ref().expect("identities");
    let classes = identities.classes;
    let size = [outcome.gaussians.len(), classes];
    let scores = TensorData::new(identities.scores.clone(), size);
    let scores = Tensor::<2>::from_data(scores, &device);
    let lookup = outcome.scene.classes.lookup();
    let (mut sum, mut labelled) = (0.0, 0_usize);
    for view in outcome.scene.split(Split::Train) {
        let seen = splats.seen_by(&view.camera, &Settings::default());
        let (image, transmittance) = seen.blend(scores.clone()).expect("an image");
        let image: Vec<f32> = image.into_data().into_vec().expect("f32");
        let transmittance: Vec<f32> = transmittance.into_data().into_vec().expect("f32");
        let raw = view.raw.as_ref().expect("raw labels").map().ids;
        for ((&id, row), t) in raw.iter().zip(image.chunks(classes)).zip(transmittance) {
            let class = usize::from(lookup[usize::from(id)]);
            if class < classes && t < 0.5 {
                sum += f64::from(row[class] / (1.0 - t) + 1e-8).ln();
                labelled += 1;
            }
        }
    }
    sum / labelled as f64
}

#[test]
fn without_truth_only_what_is_wanted_is_trained() {
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let mut config = crate::support::plate_runs::config(folder.path());
    config.segmentation.rows = None;
    let rows = |config: &Config, out: &str| -> Vec<Variant> {
        crate::support::plate_runs::whole(config, &folder.path().join(out))
            .rows
            .iter()
            .map(|row| row.variant)
            .collect()
    };
    assert_eq!(rows(&config, "scored"), Variant::COMPARED);
    let file = folder.path().join("transforms.json");
    let text = std::fs::read_to_string(&file)
        .expect("frames")
        .replace("\"label_path\"", "\"elsewhere\"");
    std::fs::write(&file, text).expect("written");
    assert_eq!(rows(&config, "unscored"), Variant::UNSCORED);
    config.segmentation.rows = Some(vec![Variant::PerGaussian]);
    assert_eq!(rows(&config, "asked for"), [Variant::PerGaussian]);
}

#[test]
fn a_truth_that_no_row_is_scored_by_is_none() {
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let mut config = crate::support::plate_runs::config(folder.path());
    config.segmentation.rows = None;
    config.segmentation.iterations = 4;
    let trained = |association: Association, out: &str| {
        let mut config = config.clone();
        config.data.association = association;
        let outcome = crate::support::plate_runs::whole(&config, &folder.path().join(out));
        let notes = coseg::report::Report::notes_of(&outcome).concat();
        let is_scored = |row: &coseg::pipeline::VariantOutcome| {
            row.scores.labels.pixels.miou.is_some() || row.scores.instances.is_some()
        };
        let scored = outcome.rows.iter().any(is_scored);
        assert_eq!(
            notes.contains("no row of labels is scored"),
            !scored,
            "{notes}"
        );
        (
            outcome
                .rows
                .iter()
                .map(|row| row.variant)
                .collect::<Vec<_>>(),
            scored,
        )
    };
    // Objects without classes are not scored by classes.
    assert_eq!(
        trained(Association::None, "classes"),
        (Variant::COMPARED.to_vec(), true)
    );
    assert_eq!(
        trained(Association::Gaussians, "objects of classes"),
        (Variant::UNSCORED.to_vec(), false)
    );
    // Nor are classes by instances.
    let file = folder.path().join("transforms.json");
    let text = std::fs::read_to_string(&file)
        .expect("frames")
        .replace("\"label_path\"", "\"instance_path\"");
    std::fs::write(&file, text).expect("written");
    assert_eq!(
        trained(Association::None, "instances"),
        (Variant::UNSCORED.to_vec(), false)
    );
    assert_eq!(
        trained(Association::Gaussians, "objects"),
        (Variant::COMPARED.to_vec(), true)
    );
}

#[test]
fn parameters_are_averaged_after_the_warm_up_of_the_plan_in_use() {
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let (gaussians, _) = crate::support::plates::plates();
    let scene = load(folder.path(), &LoadOptions::default()).expect("scene");
    let device = crate::support::device();
    let scores = |average: bool, iterations: usize| {
        let mut config = Config::default();
        config.segmentation.average = average;
        config.segmentation.warmup = 0.5;
        config.segmentation.iterations = 40;
        config.segmentation.lr = 1e-2;
        let mut plan = TrainingPlan::new(&config.segmentation, LabelLoss::Ce, 0);
        plan.config.iterations = iterations;
        let scene = &scene;
        let gaussians = &gaussians;
        let settings = Settings::default();
        let inputs = SegmentationInputs {
            settings,
            ..SegmentationInputs::new(scene, gaussians, &config, &device)
        };
        let variant = Variant::NoImageFeatures;
        let input = encode(&inputs).expect("encoded");
        let input = input.decoder_input(variant, &inputs).expect("features");
        let mut views = inputs.training_views();
        let prior = vec![0.0; gaussians.len() * scene.classes.len()];
        let mut training = decoder_training(&plan, &input, Some(prior), &inputs);
        for _ in 0..4 {
            training.step(&mut views, &plan).expect("a step");
        }
        training.identities().expect("identities").scores
    };
    assert_ne!(
        scores(true, 4),
        scores(false, 4),
        "two of four steps of a trial"
    );
    assert_eq!(
        scores(true, 40),
        scores(false, 40),
        "none of the first twenty"
    );
}

#[test]
fn scores_without_a_decoder_start_at_the_pooled_vote() {
    let outcome = trained(|s| {
        s.rows = Some(vec![Variant::PooledVote, Variant::NoDecoder]);
        s.iterations = 1;
        s.fine_tune = Some(false);
    });
    let [pooled, scores] =
        [0, 1].map(|row| outcome.rows[row].identities.as_ref().expect("identities"));
    assert_ne!(pooled, scores, "one step of Adam");
    for (p, q) in pooled.scores.iter().zip(&scores.scores) {
        // The floor of the prior, and a step of 0.05 in each logit.
        assert!((p - q).abs() < 0.06, "{p} {q}");
    }
}

#[test]
fn variants_without_image_features_extract_none() {
    let run = |rows: &[Variant]| trained(|s| s.rows = Some(rows.to_vec()));
    let outcome = run(&[Variant::NoImageFeatures, Variant::NoDecoder]);
    assert_eq!(outcome.features, "");
    assert!(outcome.feature_colors.is_none() && outcome.seconds.features == 0.0);
    let classes = outcome.scene.classes.len();
    let scores = 4 * outcome.gaussians.len() * classes;
    // The scores are learned twice: in place of the decoder, and in fine-tuning.
    assert_eq!(outcome.rows[1].learnable_bytes, 2 * scores);
    // Beside a variant that reads features, the scores are the same.
    let beside = run(&[Variant::Ours, Variant::NoImageFeatures]);
    assert_ne!(beside.features, "");
    assert_eq!(beside.rows[1].identities, outcome.rows[0].identities);
}

#[test]
fn a_share_of_the_pixels_of_a_view_is_drawn_anew_by_each_stream() {
    let (scene, gaussians, _, _folder) = crate::support::plates::loaded();
    for (name, device) in crate::support::devices() {
        let config = SegmentationConfig::default();
        let mut views = training_views(&gaussians, &scene, &config, &device);
        let mut draw = |share, stream_index: u64| {
            let mut rng = stream(1, Purpose::Pixels, stream_index);
            let sample = views.sample(0, share, &mut rng).expect("pixels");
            sample.numbers.to_vec()
        };
        let all = draw(Some(1.0), 0);
        let by_default = draw(None, 0).len();
        assert!(by_default.abs_diff(all.len().min(4_096)) <= 1, "{name}");
        let [first, again, other] = [0, 0, 1].map(|index| draw(Some(0.25), index));
        assert!(
            all.len() > 100 && first.len() == all.len().div_ceil(4),
            "{name}"
        );
        assert!(first.iter().all(|number| all.contains(number)), "{name}");
        assert_eq!(first, again, "{name}");
        assert_ne!(first, other, "{name}");
    }
}

//! Stage two on the plates: what the decoder starts from, what is stored, how learning rates are chosen.

use crate::support::hard_labels::hard_label_map;
use burn::tensor::Tensor;
use coseg::Error;
use coseg::config::{
    Association, Blend, BuildingConfig, Config, LabelSource, Prior, SegmentationConfig, Variant,
};
use coseg::data::{Classes, LabelMap, LabelRuns, LoadOptions, Split, load};
use coseg::objects::{Identities, LabelMaps, LabelRule, vote};
use coseg::pipeline::train_decoder::{Plan, TrainingViews};
use coseg::pipeline::{Inputs, Outcome, decoder_training, encode, run};
use coseg::progress::Silent;
use coseg::random::{Purpose, stream};
use coseg::raster::{Projected, Settings, SplatTensors};
use coseg::reconstruction::initialization;
use coseg::segmentation::loss::LabelLoss;
use coseg::segmentation::pixels::PixelWeights;
use std::sync::Arc;

fn trained(edit: impl Fn(&mut SegmentationConfig)) -> Outcome {
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let mut config = Config {
        building: BuildingConfig {
            iterations: 40,
            random_points: 400,
            ..BuildingConfig::default()
        },
        segmentation: SegmentationConfig {
            iterations: 20,
            rows: Some(vec![Variant::Ours]),
            ..SegmentationConfig::default()
        },
        ..Config::default()
    };
    edit(&mut config.segmentation);
    config.data.dir = Some(folder.path().to_owned());
    run(
        &config,
        &folder.path().join("run"),
        &crate::support::device(),
        &mut Silent,
    )
    .expect("a run")
}

/// A rate at which nothing is learned in 20 steps.
const STILL: f64 = 1e-12;

#[test]
fn a_decoder_that_has_learned_nothing_stores_the_shares_of_the_votes() {
    let outcome = trained(|s| (s.lr, s.prior) = (STILL, Prior::Votes));
    let scene = &outcome.scene;
    let votes = vote(
        &outcome.gaussians,
        scene.split(Split::Train),
        &scene.classes,
        &Settings::default(),
        &crate::support::device(),
    )
    .expect("votes");
    let identities = outcome.rows[0].identities.as_ref().expect("identities");
    let classes = scene.classes.len();
    let (mut checked, floor) = (0, 0.02_f32);
    for (stored, row) in identities
        .scores
        .chunks_exact(classes)
        .zip(votes.table.chunks_exact(classes))
    {
        let total: f32 = row.iter().sum();
        assert!(
            (stored.iter().sum::<f32>() - 1.0).abs() < 1e-5,
            "probabilities: {stored:?}"
        );
        for (s, v) in stored.iter().zip(row) {
            let share = if total > 0.0 { v / total } else { 0.0 };
            let expected = if total > 0.0 {
                (share + floor) / (1.0 + classes as f32 * floor)
            } else {
                1.0 / classes as f32
            };
            assert!((s - expected).abs() < 1e-5, "{stored:?} of {row:?}");
        }
        checked += usize::from(total > 0.0);
    }
    assert!(checked > 100, "{checked} Gaussians were voted on");
}

#[test]
fn a_decoder_that_has_learned_nothing_stores_the_pooled_vote() {
    let outcome = trained(|s| {
        s.lr = STILL;
        s.rows = Some(vec![Variant::PooledVote, Variant::Ours]);
    });
    let [pooled, ours] = [0, 1].map(|row: usize| outcome.rows[row].identities.as_ref().unwrap());
    let (classes, floor) = (pooled.classes, 0.02_f32);
    let rows = pooled.scores.chunks_exact(classes);
    let mut known = 0;
    for (pooled, stored) in rows.zip(ours.scores.chunks_exact(classes)) {
        let sum: f32 = pooled.iter().sum();
        assert!(sum == 0.0 || (sum - 1.0).abs() < 1e-5, "{pooled:?}");
        for (p, s) in pooled.iter().zip(stored) {
            let expected = (p + floor) / (sum + classes as f32 * floor);
            assert!((s - expected).abs() < 1e-5, "{stored:?} of {pooled:?}");
        }
        known += usize::from(sum > 0.0);
    }
    assert!(known > 100, "{known} Gaussians are known");
}

#[test]
fn labels_of_pixels_can_come_from_identities() {
    let (scene, gaussians, _, _folder) = crate::support::plates::loaded();
    let device = crate::support::device();
    let mut views = TrainingViews::new(
        &gaussians,
        scene.split(Split::Train),
        &scene.classes,
        Settings::default(),
        &SegmentationConfig::default(),
        &device,
    );
    let classes = scene.classes.len();
    let labels = |views: &mut TrainingViews| {
        let sample = views.sample(0, 1.0, &mut stream(1, Purpose::Pixels, 0));
        sample.expect("pixels").pixels.labels
    };
    let raw = labels(&mut views);
    assert!(raw.len() > 100 && raw.iter().any(|&label| label != 1));
    let of = |row: &[f32]| Identities {
        scores: row.repeat(gaussians.len()),
        classes,
    };
    let mut row = vec![0.1; classes];
    row[1] = 0.5;
    views.use_labels_of(&of(&row), &device);
    assert!(labels(&mut views).iter().all(|&label| label == 1));
    views.use_labels_of(&of(&vec![0.0; classes]), &device);
    assert_eq!(labels(&mut views), raw, "nothing is known");
    views.use_raw_labels();
    assert_eq!(labels(&mut views), raw);
}

#[test]
fn probabilities_are_blended_over_the_coverage_and_logits_as_they_are() {
    let (scene, mut gaussians, _, _folder) = crate::support::plates::loaded();
    gaussians.opacity_logits.fill(0.5);
    let device = crate::support::device();
    let camera = &scene.split(Split::Train).next().expect("a view").camera;
    let settings = Settings::default();
    let projected = Projected::<f32>::new(&gaussians.splats(), camera, &settings).expect("a view");
    let weights = projected.weights(None);
    // With stored weights, and with ones that each step computes.
    for (blend, weight_cache_mb) in [
        (Blend::Logits, 2_048),
        (Blend::Logits, 0),
        (Blend::Probabilities, 2_048),
        (Blend::Probabilities, 0),
    ] {
        let config = SegmentationConfig {
            blend,
            weight_cache_mb,
            min_coverage: 0.2,
            ..SegmentationConfig::default()
        };
        let views = scene.split(Split::Train);
        let mut views = TrainingViews::new(
            &gaussians,
            views,
            &scene.classes,
            settings,
            &config,
            &device,
        );
        for time in 0..2 {
            let sample = views.sample(0, 0.5, &mut stream(1, Purpose::Pixels, time));
            let sample = sample.expect("pixels");
            let ones = Tensor::<2>::ones([sample.visible.len(), 1], &device);
            let blended = sample.pixels.blend(ones).expect("blended");
            let blended: Vec<f32> = blended.into_data().into_vec().expect("numbers");
            let coverage = |&pixel: &u32| weights.row(pixel as usize).1.iter().sum::<f32>();
            let coverage: Vec<f32> = sample.numbers.iter().map(coverage).collect();
            assert!(coverage.iter().any(|&c| (0.2..0.9).contains(&c)));
            for (got, coverage) in blended.iter().zip(&coverage) {
                let want = match blend {
                    Blend::Logits => *coverage,
                    Blend::Probabilities => 1.0,
                };
                assert!((got - want).abs() < 1e-5, "{got} instead of {want}");
            }
        }
    }
}

#[test]
fn blended_logits_without_a_prior_are_the_papers_rule_and_learn() {
    let edit = |s: &mut SegmentationConfig| {
        (s.blend, s.prior) = (Blend::Logits, Prior::None);
        (s.rows, s.iterations, s.lr) = (Some(vec![Variant::OursCe]), 100, 1e-2);
    };
    let outcome = trained(edit);
    let scores = &outcome.rows[0]
        .identities
        .as_ref()
        .expect("identities")
        .scores;
    assert!(scores.iter().any(|s| *s < 0.0), "logits, not probabilities");
    let untaught = trained(|s| {
        edit(s);
        s.lr = STILL;
    });
    let miou = |o: &Outcome| o.rows[0].scores.labels.miou.expect("a score");
    assert!(
        miou(&outcome) > miou(&untaught) + 0.1,
        "{} against {}",
        miou(&outcome),
        miou(&untaught)
    );
}

#[test]
fn votes_under_blended_logits_are_refused() {
    let mut config = Config::default();
    config.segmentation.blend = Blend::Logits;
    let error = config.validate().expect_err("refused");
    assert!(
        matches!(error, Error::Config { .. }) && error.to_string().contains("segmentation.prior"),
        "{error}"
    );
}

#[test]
fn weights_made_again_at_each_step_give_the_same_bits_as_kept_ones() {
    let scores = |megabytes| {
        let outcome = trained(|s| {
            (s.weight_cache_mb, s.pixel_share) = (megabytes, 0.25);
            s.rows = Some(vec![Variant::PerGaussian, Variant::Ours]);
        });
        let bits = |row: &coseg::pipeline::VariantOutcome| -> Vec<u32> {
            row.identities
                .iter()
                .flat_map(|i| &i.scores)
                .map(|s| s.to_bits())
                .collect()
        };
        outcome.rows.iter().map(bits).collect::<Vec<_>>()
    };
    assert!(scores(0) == scores(2_048));
}

#[test]
fn the_vote_sums_weights_by_label_whatever_the_number_of_classes() {
    // 70 classes, of which a view shows from 1 to 60.
    let mut scene = crate::support::painted_plane::scene();
    scene.classes = Classes::from_names(0, (0..=70).map(|id| (id, format!("class {id}"))));
    for (v, view) in scene.views.iter_mut().enumerate() {
        let (width, height) = (view.camera.width, view.camera.height);
        let shown = [1, 60, 33, 32, 5, 2, 31, 64][v] as u16;
        let id = |i: usize| (i * 7919 / 11) as u16 % (shown + 1);
        let map = LabelMap {
            width,
            height,
            ids: (0..width * height).map(id).collect(),
        };
        view.raw = Some(LabelRuns::from(map));
    }
    let gaussians = initialization::from_points(&scene.points, 0, 2.0).expect("Gaussians");
    let (settings, c) = (Settings::default(), scene.classes.len());
    let votes = vote(
        &gaussians,
        scene.views.iter(),
        &scene.classes,
        &settings,
        &crate::support::device(),
    )
    .expect("votes");
    let lookup = scene.classes.lookup();
    let mut exact = vec![0.0_f64; gaussians.len() * c];
    for view in &scene.views {
        let weights = Projected::<f32>::new(&gaussians.splats(), &view.camera, &settings)
            .expect("a view")
            .weights(None);
        for (pixel, id) in view
            .raw
            .as_ref()
            .expect("labels")
            .map()
            .ids
            .into_iter()
            .enumerate()
        {
            let class = usize::from(lookup[usize::from(id)]);
            let (columns, values) = weights.row(pixel);
            for (&i, &w) in columns.iter().zip(values).filter(|_| class < c) {
                exact[i as usize * c + class] += f64::from(w);
            }
        }
    }
    assert_eq!((votes.classes, votes.table.len()), (c, exact.len()));
    let most = exact.iter().fold(0.0, |most: f64, &v| most.max(v));
    assert!(most > 1.0);
    for (got, exact) in votes.table.iter().zip(exact) {
        assert!(
            (f64::from(*got) - exact).abs() < 1e-5 * most,
            "{got} {exact}"
        );
    }
}

#[test]
fn label_maps_show_the_labels_of_the_ply() {
    let outcome = trained(|s| s.rows = Some(vec![Variant::Vote]));
    let (gaussians, classes) = (&outcome.gaussians, &outcome.scene.classes);
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
            let rule = LabelRule {
                source,
                min_coverage: 0.5,
            };
            LabelMaps::new(&identities, classes, rule)
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
        let outcome = trained(|s| s.average = average);
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
fn without_truth_only_what_is_wanted_is_trained() {
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let mut config = crate::support::plate_runs::config(folder.path());
    config.segmentation.rows = None;
    let rows = |config: &Config, out: &str| -> Vec<Variant> {
        crate::support::plate_runs::whole(config, &folder.path().join(out))
            .rows
            .iter()
            .map(|row| row.row)
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
    (config.segmentation.rows, config.segmentation.iterations) = (None, 4);
    let trained = |association: Association, out: &str| {
        let mut config = config.clone();
        config.data.association = association;
        let outcome = crate::support::plate_runs::whole(&config, &folder.path().join(out));
        let notes = coseg::report::Report::notes_of(&outcome, &config).concat();
        let is_scored = |row: &coseg::pipeline::VariantOutcome| {
            row.scores.labels.miou.is_some() || row.scores.instances.is_some()
        };
        let scored = outcome.rows.iter().any(is_scored);
        assert_eq!(
            notes.contains("no row of labels is scored"),
            !scored,
            "{notes}"
        );
        (
            outcome.rows.iter().map(|row| row.row).collect::<Vec<_>>(),
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
        let plan = Plan {
            iterations,
            ..Plan::new(&config.segmentation, LabelLoss::Ce, 0)
        };
        let (scene, gaussians, settings) = (&scene, &gaussians, Settings::default());
        let inputs = Inputs {
            settings,
            ..Inputs::new(scene, gaussians, &config, &device)
        };
        let variant = Variant::NoImageFeatures;
        let input = encode(&inputs, &config.spatial).expect("encoded");
        let input = input.decoder_input(variant, &inputs).expect("features");
        let mut views = inputs.training_views();
        let prior = vec![0.0; gaussians.len() * scene.classes.len()];
        let mut training =
            decoder_training(variant, &plan, &input, Some(prior), &inputs, views.len());
        for _ in 0..4 {
            training.step(&mut views, &plan).expect("a step");
        }
        training.identities().scores
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
fn what_a_view_shows_is_computed_once_as_far_as_the_budget_reaches() {
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let scene = load(folder.path(), &LoadOptions::default()).expect("scene");
    let (gaussians, _) = crate::support::plates::plates();
    #[cfg(feature = "wgpu")]
    let devices = [Some(crate::support::device()), crate::support::gpu()];
    #[cfg(not(feature = "wgpu"))]
    let devices = [Some(crate::support::device())];
    for device in devices.into_iter().flatten() {
        // Whether the same view's second draw has the weights of its first, where they are stored, and how many pixels were drawn.
        let draw = |weight_cache_mb: usize, share: f64| {
            let (train, settings) = (scene.split(Split::Train), Settings::default());
            let config = SegmentationConfig {
                weight_cache_mb,
                ..SegmentationConfig::default()
            };
            let mut views = TrainingViews::new(
                &gaussians,
                train,
                &scene.classes,
                settings,
                &config,
                &device,
            );
            let mut drawn = || {
                views
                    .sample(0, share, &mut stream(1, Purpose::Pixels, 0))
                    .expect("pixels")
                    .pixels
            };
            let (first, second) = (drawn(), drawn());
            assert_eq!(first.labels, second.labels, "{device:?}");
            // A GPU stores no weights.
            let kept = match (&first.weights, &second.weights) {
                (PixelWeights::Stored(first), PixelWeights::Stored(second)) => {
                    Some(Arc::ptr_eq(first, second))
                }
                _ => None,
            };
            (kept, first.len())
        };
        let (kept, all) = draw(16, 1.0);
        assert!(kept != Some(false) && all > 100, "{all} on {device:?}");
        assert_eq!(draw(0, 1.0), (kept.map(|_| false), all), "{device:?}");
        let (_, some) = draw(16, 0.25);
        assert!(some < all, "{some} of {all} on {device:?}");
    }
}

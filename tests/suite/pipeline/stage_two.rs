//! Stage two on the plates: what the decoder starts from, and how views are blended.

use crate::support::plate_runs::trained;
use crate::support::plates::training_views;
use crate::support::raster_reference::all_pixels;
use burn::tensor::Tensor;
use coseg::Error;
use coseg::config::{Blend, Config, LabelLoss, Prior, SegmentationConfig, Variant};
use coseg::data::{Classes, LabelMap, LabelRuns, Split};
use coseg::objects::{Identities, smoothed, vote};
use coseg::pipeline::Outcome;
use coseg::pipeline::train_decoder::TrainingViews;
use coseg::random::{Purpose, stream};
use coseg::raster::{Projected, Settings};
use coseg::reconstruction::initialization;

/// A rate at which nothing is learned in 20 steps.
const STILL: f64 = 1e-12;

#[test]
fn a_decoder_that_has_learned_nothing_stores_what_the_votes_say() {
    let outcome = trained(|s| {
        s.lr = STILL;
        s.prior = Some(Prior::Votes);
        s.fine_tune = Some(false);
    });
    let scene = &outcome.scene;
    let votes = vote(
        &outcome.gaussians,
        scene.split(Split::Train),
        &scene.classes,
        &Settings::default(),
        &crate::support::device(),
    )
    .expect("votes");
    let classes = scene.classes.len();
    let pseudo_votes = 0.3_f32;
    let shares = votes.rows().flat_map(|row| {
        let total = row.iter().sum::<f32>() + classes as f32 * pseudo_votes;
        row.iter().map(move |vote| (vote + pseudo_votes) / total)
    });
    let expected = Identities {
        scores: shares.collect(),
        classes,
    };
    let expected = smoothed(&outcome.gaussians, expected, &votes).expect("finite centres");
    let identities = outcome.rows[0].identities.as_ref().expect("identities");
    let stored = identities.scores.chunks_exact(classes);
    for (stored, expected) in stored.zip(expected.scores.chunks_exact(classes)) {
        let sum: f32 = stored.iter().sum();
        assert!((sum - 1.0).abs() < 1e-5, "probabilities: {stored:?}");
        let differences = stored.iter().zip(expected).map(|(s, e)| (s - e).abs());
        assert!(
            differences.fold(0.0, f32::max) < 1e-5,
            "{stored:?} for {expected:?}"
        );
    }
    let voted = votes.winners().into_iter().flatten().count();
    assert!(voted > 100, "{voted} Gaussians were voted on");
}

#[test]
fn a_decoder_that_has_learned_nothing_stores_the_pooled_vote() {
    let outcome = trained(|s| {
        s.lr = STILL;
        s.fine_tune = Some(false);
        s.rows = Some(vec![Variant::PooledVote, Variant::Ours]);
    });
    let [pooled, ours] = [0, 1].map(|row: usize| outcome.rows[row].identities.as_ref().unwrap());
    let classes = pooled.classes;
    let floor = 0.002_f32;
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
    let config = SegmentationConfig::default();
    let mut views = training_views(&gaussians, &scene, &config, &device);
    let classes = scene.classes.len();
    let labels = |views: &mut TrainingViews| {
        let sample = views.sample(0, Some(1.0), &mut stream(1, Purpose::Pixels, 0));
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
    let weights = projected.weights(&all_pixels(projected.size()));
    for blend in [Blend::Logits, Blend::Probabilities] {
        let config = SegmentationConfig {
            blend,
            min_coverage: 0.2,
            ..SegmentationConfig::default()
        };
        let mut views = training_views(&gaussians, &scene, &config, &device);
        for time in 0..2 {
            let sample = views.sample(0, Some(0.5), &mut stream(1, Purpose::Pixels, time));
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
        s.blend = Blend::Logits;
        s.prior = Some(Prior::None);
        s.rows = Some(vec![Variant::Ours]);
        s.loss = Some(LabelLoss::Ce);
        s.iterations = 100;
        s.lr = 1e-2;
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
        s.fine_tune = Some(false);
    });
    let miou = |o: &Outcome| o.rows[0].scores.labels.pixels.miou.expect("a score");
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
    let settings = Settings::default();
    let c = scene.classes.len();
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
        let projected = Projected::<f32>::new(&gaussians.splats(), &view.camera, &settings);
        let projected = projected.expect("a view");
        let weights = projected.weights(&all_pixels(projected.size()));
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

//! Scores of feature fields, on the plates.

use crate::support::{device, plates};
use coseg::config::Config;
use coseg::data::Scene;
use coseg::features::SCALES;
use coseg::pipeline::{FieldScores, LiftedFeatures, SegmentationInputs};
use coseg::splat::Gaussians;

const DIMENSIONS: usize = 5;

/// Features of Gaussians in all scales: an axis for each label, and a little that differs from Gaussian to Gaussian.
fn lifted(labels: &[u16], factor: f32) -> LiftedFeatures {
    let row = |(i, &label): (usize, &u16)| {
        let mut row = [0.0; DIMENSIONS];
        row[usize::from(label)] = factor;
        row[0] = factor * 0.1 * (i as f32 * 0.7).sin();
        row
    };
    let rows: Vec<f32> = labels.iter().enumerate().flat_map(row).collect();
    LiftedFeatures {
        lifted: vec![rows; SCALES],
        dimensions: DIMENSIONS,
        name: "made up".into(),
        content: String::new(),
        seconds: [1.5, 2.0],
    }
}

fn scores(scene: &Scene, gaussians: &Gaussians, lifted: LiftedFeatures) -> FieldScores {
    let config = Config::default();
    let device = device();
    let inputs = SegmentationInputs {
        lifted: Some(lifted),
        ..SegmentationInputs::new(scene, gaussians, &config, &device)
    };
    let scores = FieldScores::of_lifted(&inputs).expect("no error");
    scores.expect("scores of lifted features")
}

/// Calinski-Harabasz and Davies-Bouldin.
fn indices(scores: FieldScores) -> [f64; 2] {
    let found = scores.calinski_harabasz.zip(scores.davies_bouldin);
    found.expect("both indices").into()
}

#[test]
fn features_of_classes_separate_better_than_shuffled_ones() {
    let (scene, gaussians, labels, _keep) = plates::loaded();
    let shuffled: Vec<u16> = (0..labels.len())
        .map(|i| labels[(i * 53 + 17) % labels.len()])
        .collect();
    let apart = scores(&scene, &gaussians, lifted(&labels, 1.0));
    assert_eq!((apart.seconds, apart.learnable_bytes), (3.5, 0));
    let mixed = scores(&scene, &gaussians, lifted(&shuffled, 1.0));
    let ([ch, db], [mixed_ch, mixed_db]) = (indices(apart), indices(mixed));
    assert!(ch > 20.0 * mixed_ch, "{ch} {mixed_ch}");
    assert!(db < 0.5 && mixed_db > 2.0, "{db} {mixed_db}");
    // The same pixels each time; a scale of all features together does not count.
    let again = scores(&scene, &gaussians, lifted(&labels, 1.0));
    assert_eq!(again, apart);
    let larger = indices(scores(&scene, &gaussians, lifted(&labels, 8.0)));
    for (a, b) in larger.into_iter().zip([ch, db]) {
        assert!((a / b - 1.0).abs() < 1e-3, "{a} {b}");
    }
}

#[test]
fn pixels_without_a_true_class_are_left_out() {
    let (mut scene, gaussians, labels, _keep) = plates::loaded();
    // Only the red plate keeps its class: one cluster is left, and no index is known.
    for view in &mut scene.views {
        let Some(truth) = view.truth.as_mut() else {
            continue;
        };
        let mut map = truth.map();
        map.ids
            .iter_mut()
            .filter(|id| **id != 1)
            .for_each(|id| *id = 0);
        *truth = map.into();
    }
    let one = scores(&scene, &gaussians, lifted(&labels, 1.0));
    assert_eq!((one.calinski_harabasz, one.davies_bouldin), (None, None));
    for view in &mut scene.views {
        view.truth = None;
    }
    assert_eq!(scores(&scene, &gaussians, lifted(&labels, 1.0)), one);
}

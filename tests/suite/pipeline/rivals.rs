//! Methods of other papers, on the plates.

use crate::support::device;
use crate::support::plates;
use coseg::config::{Budget, BuildingConfig, Config, LabelSource, SegmentationConfig, Variant};
use coseg::pipeline::{Outcome, VariantOutcome, run};
use coseg::progress::Silent;

const RIVALS: [Variant; 3] = [
    Variant::Grouping,
    Variant::Distilled,
    Variant::PanopticLifting,
];

fn trained(rows: &[Variant], iterations: usize) -> Outcome {
    let folder = tempfile::tempdir().expect("a folder");
    plates::scene(folder.path());
    let mut config = Config {
        building: BuildingConfig {
            iterations: 40,
            random_points: 400,
            max_gaussians: Budget::Unlimited,
            ..BuildingConfig::default()
        },
        segmentation: SegmentationConfig {
            iterations,
            rows: Some(rows.to_vec()),
            render: LabelSource::Scores,
            ..SegmentationConfig::default()
        },
        ..Config::default()
    };
    config.data.dir = Some(folder.path().to_owned());
    run(&config, &folder.path().join("run"), &device(), &mut Silent).expect("a run")
}

fn miou(row: &VariantOutcome) -> f64 {
    row.scores.labels.pixels.miou.expect("held-out truth")
}

#[test]
fn rivals_learn_the_labels() {
    let [before, after] = [1, 150].map(|iterations| trained(&RIVALS, iterations));
    let vote = trained(&[Variant::Vote], 1);
    for (before, after) in before.rows.iter().zip(&after.rows) {
        let [before, after, vote] = [before, after, &vote.rows[0]].map(miou);
        assert!(
            after > before && after > 0.9 * vote,
            "{before} {after} {vote}"
        );
    }
}

#[test]
fn rivals_store_finite_scores_and_count_what_they_learn() {
    let outcome = trained(&RIVALS, 2);
    let gaussians = outcome.gaussians.len();
    let classes = outcome.scene.classes.len();
    let dimensions = outcome.config.features.dimensions;
    let floats = [
        16 * gaussians + 17 * classes,
        64 * gaussians + 65 * dimensions + 65 * classes,
        gaussians * classes,
    ];
    for (row, floats) in outcome.rows.iter().zip(floats) {
        let identities = row.identities.as_ref().expect("identities");
        assert_eq!(identities.classes, classes);
        assert_eq!(identities.scores.len(), gaussians * classes);
        assert!(identities.scores.iter().all(|score| score.is_finite()));
        assert_eq!(row.learnable_bytes, 4 * floats, "{}", row.name());
    }
}

#[test]
fn rivals_are_deterministic() {
    let [one, two] = [0, 1].map(|_| trained(&RIVALS, 3));
    for (one, two) in one.rows.iter().zip(&two.rows) {
        let [one, two] = [one, two].map(|row| row.identities.as_ref().expect("identities"));
        assert_eq!(one.scores, two.scores);
    }
}

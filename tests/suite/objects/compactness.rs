//! Compactness: how disagreement of neighbours is counted, and where a run reports it.

use crate::support::plate_runs::short;
use coseg::Error;
use coseg::config::Variant;
use coseg::objects::{Identities, NeighbourGraph};
use coseg::pipeline::run;
use coseg::progress::Silent;
use coseg::report::Metrics;

#[test]
fn disagreement_counts_borders_and_specks() {
    // A line of Gaussians of two labels, and one speck within the left half. Each has 8 neighbours: at an end the next 8,
    // else the 4 before and the 4 after.
    let n = 40;
    let means: Vec<[f32; 3]> = (0..n).map(|i| [i as f32 * 0.125, 0.0, 0.0]).collect();
    let labelled = |label: &dyn Fn(usize) -> usize| {
        let mut scores = vec![0.0; n * 2];
        (0..n).for_each(|i| scores[2 * i + label(i)] = 1.0);
        Identities { scores, classes: 2 }
    };
    let graph = NeighbourGraph::new(&means).expect("finite");
    let pairs = (n * 8) as f64;
    let halves = graph.disagreement(&labelled(&|i| usize::from(i >= n / 2)));
    // Across the border 4 + 3 + 2 + 1 pairs either way.
    assert!((halves - 20.0 / pairs).abs() < 1e-12, "{halves}");
    let speck = graph.disagreement(&labelled(&|i| usize::from(i >= n / 2 || i == 9)));
    // The speck's own 8 pairs, and those of the 8 that have it as a neighbour.
    assert!((speck - 36.0 / pairs).abs() < 1e-12, "{speck}");
    // Gaussians without a label are in no pair.
    let mut unknown = labelled(&|i| i % 2);
    unknown.scores.fill(0.0);
    assert_eq!(graph.disagreement(&unknown), 0.0);
}

#[test]
fn hard_cases_and_bad_input() {
    let none = NeighbourGraph::new(&[]).expect("empty");
    let empty = Identities {
        scores: Vec::new(),
        classes: 3,
    };
    assert_eq!(none.disagreement(&empty), 0.0);
    assert!(matches!(
        NeighbourGraph::new(&[[f32::NAN; 3]; 9]),
        Err(Error::NonFinite { .. })
    ));
}

#[test]
fn a_run_reports_compactness_and_agreement() {
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let rows = [
        Variant::Raw,
        Variant::Vote,
        Variant::PerGaussian,
        Variant::Ours,
    ];
    let config = short(folder.path(), 30, &rows);
    let out = folder.path().join("run");
    let plain = run(&config, &out, &crate::support::device(), &mut Silent).expect("a run");
    assert!(
        plain.rows[0].compactness.is_none(),
        "raw labels are of pixels"
    );
    let agreement = plain.rows[1].agreement.expect("of the vote");
    assert!(
        agreement.entropy > 0.0 && agreement.entropy < 2.0_f64.ln() * 3.0,
        "{agreement:?}"
    );
    assert!((0.0..1.0).contains(&agreement.contested));
    for row in &plain.rows[1..] {
        let compactness = row.compactness.expect("counted");
        assert!((0.0..1.0).contains(&compactness.neighbours_differ));
    }
    let metrics = serde_json::to_value(Metrics::of(&plain)).expect("plain data");
    let row = &metrics["test"]["labels"]["ours"]["compactness"];
    assert!(row["neighbours_differ"].is_number(), "{row}");
    assert!(metrics["test"]["labels"]["vote"]["agreement"]["contested"].is_number());
}

//! Compactness: diffusion of identities against the dense formula, what it must not do, and how disagreement is counted.

use coseg::Error;
use coseg::config::{BuildingConfig, Config, SegmentationConfig, Variant};
use coseg::objects::{Diffusion, Identities, NeighbourGraph};
use coseg::pipeline::run;
use coseg::progress::Silent;
use coseg::report::Metrics;

const CLASSES: usize = 3;
const K: usize = 4;
const GENTLE: Diffusion = Diffusion {
    steps: 3,
    strength: 0.4,
    temperature: 0.2,
};

fn cloud(n: usize) -> Vec<[f32; 3]> {
    (0..n)
        .map(|i| std::array::from_fn(|a| (i as f32 * [0.37, 0.61, 0.83][a]).sin()))
        .collect()
}

fn features(n: usize) -> Vec<f32> {
    (0..n * 5).map(|i| (i as f32 * 0.7).cos()).collect()
}

fn identities(n: usize) -> Identities {
    let scores = (0..n * CLASSES)
        .map(|i| (1.0 + (i as f32 * 1.9).sin()) * if i / CLASSES % 7 == 3 { 0.0 } else { 1.0 });
    Identities {
        scores: scores.collect(),
        classes: CLASSES,
    }
}

/// The formula of the module, in f64 and with a dense matrix.
fn dense(means: &[[f32; 3]], features: &[f32], x: &Identities, how: &Diffusion) -> Vec<f64> {
    let n = means.len();
    let d = features.len() / n;
    let distance = |i: usize, j: usize| -> f64 {
        (0..3)
            .map(|a| (f64::from(means[i][a]) - f64::from(means[j][a])).powi(2))
            .sum::<f64>()
            .sqrt()
    };
    let near: Vec<Vec<usize>> = (0..n)
        .map(|i| {
            let mut others: Vec<usize> = (0..n).filter(|&j| j != i).collect();
            others.sort_by(|&a, &b| distance(i, a).total_cmp(&distance(i, b)));
            others.truncate(K);
            others
        })
        .collect();
    let reach: Vec<f64> = (0..n)
        .map(|i| near[i].iter().map(|&j| distance(i, j)).sum::<f64>() / K as f64)
        .collect();
    let cos = |i: usize, j: usize| {
        let row = |i: usize| features[i * d..(i + 1) * d].iter().map(|&v| f64::from(v));
        let dot = |a: usize, b: usize| row(a).zip(row(b)).map(|(a, b)| a * b).sum::<f64>();
        if d == 0 {
            1.0
        } else {
            dot(i, j) / (dot(i, i) * dot(j, j)).sqrt()
        }
    };
    let start: Vec<f64> = x
        .scores
        .chunks_exact(CLASSES)
        .flat_map(|row| {
            let sum = row.iter().map(|&v| f64::from(v)).sum::<f64>();
            row.iter()
                .map(move |&v| if sum > 0.0 { f64::from(v) / sum } else { 0.0 })
        })
        .collect();
    let mut now = start.clone();
    for _ in 0..how.steps {
        let mut next = vec![0.0; n * CLASSES];
        for i in 0..n {
            let known =
                |x: &[f64], j: usize| x[j * CLASSES..(j + 1) * CLASSES].iter().any(|&v| v > 0.0);
            let weight = |j: usize| {
                (-distance(i, j).powi(2) / (2.0 * reach[i] * reach[j])
                    - (1.0 - cos(i, j)) / how.temperature)
                    .exp()
            };
            let neighbours: Vec<usize> = near[i]
                .iter()
                .copied()
                .filter(|&j| known(&now, j))
                .collect();
            let total: f64 = neighbours.iter().map(|&j| weight(j)).sum();
            let share = if total == 0.0 {
                0.0
            } else if known(&start, i) {
                how.strength
            } else {
                1.0
            };
            for c in 0..CLASSES {
                let mean: f64 = neighbours
                    .iter()
                    .map(|&j| weight(j) * now[j * CLASSES + c])
                    .sum();
                let mean = if total > 0.0 { mean / total } else { 0.0 };
                next[i * CLASSES + c] = share * mean + (1.0 - share) * start[i * CLASSES + c];
            }
        }
        now = next;
    }
    now
}

#[test]
fn diffusion_equals_the_dense_formula() {
    let (means, x) = (cloud(60), identities(60));
    for features in [features(60), Vec::new()] {
        let graph = NeighbourGraph::new(&means, &features, K).expect("finite");
        let found = graph.diffused(&x, &GENTLE).expect("fits");
        let want = dense(&means, &features, &x, &GENTLE);
        let worst = found
            .scores
            .iter()
            .zip(&want)
            .map(|(a, b)| (f64::from(*a) - b).abs())
            .fold(0.0, f64::max);
        assert!(worst < 1e-5, "{worst}");
        for row in found.scores.chunks_exact(CLASSES) {
            assert!(
                (row.iter().sum::<f32>() - 1.0).abs() < 1e-5,
                "rows stay distributions, unknown ones become some: {row:?}"
            );
        }
    }
}

#[test]
fn a_speck_within_an_object_goes_and_a_border_between_features_stays() {
    // A line of Gaussians; the left half looks one way, the right half another. One speck within the left half.
    let n = 40;
    let means: Vec<[f32; 3]> = (0..n).map(|i| [i as f32 * 0.1, 0.0, 0.0]).collect();
    let features: Vec<f32> = (0..n)
        .flat_map(|i| if i < n / 2 { [1.0, 0.0] } else { [0.0, 1.0] })
        .collect();
    let label = |i: usize| usize::from(i >= n / 2);
    let mut x = Identities {
        scores: vec![0.0; n * 2],
        classes: 2,
    };
    for i in 0..n {
        x.scores[2 * i + if i == 8 { 1 } else { label(i) }] = 1.0;
    }
    let graph = NeighbourGraph::new(&means, &features, K).expect("finite");
    let how = Diffusion {
        steps: 10,
        strength: 0.7,
        temperature: 0.1,
    };
    let smooth = graph.diffused(&x, &how).expect("fits");
    let labels: Vec<Option<u16>> = smooth.labels();
    assert!(
        (0..n).all(|i| labels[i] == Some(label(i) as u16)),
        "{labels:?}"
    );
    // Pairs across the border, and around the speck: 4 of its own and those of which it is a neighbour.
    let (before, after) = (graph.disagreement(&x), graph.disagreement(&smooth));
    assert!(
        (before - after - 8.0 / (n * K) as f64).abs() < 1e-9,
        "{before} {after}"
    );
    assert!(after > 0.0, "the border is still there");
}

#[test]
fn hard_cases_and_bad_input() {
    let none = NeighbourGraph::new(&[], &[], K).expect("empty");
    let empty = Identities {
        scores: Vec::new(),
        classes: CLASSES,
    };
    assert_eq!(none.diffused(&empty, &GENTLE).expect("empty"), empty);
    assert_eq!(none.disagreement(&empty), 0.0);
    // All at one place, one without any label.
    let same = [[1.0_f32; 3]; 6];
    let graph = NeighbourGraph::new(&same, &[], K).expect("finite");
    let mut x = identities(6);
    x.scores[..CLASSES].fill(0.0);
    let found = graph.diffused(&x, &GENTLE).expect("fits");
    assert!(
        found.scores.iter().all(|v| v.is_finite()) && found.labels()[0].is_some(),
        "{found:?}"
    );
    assert!(matches!(
        NeighbourGraph::new(&cloud(9), &[0.0; 10], K),
        Err(Error::Argument { .. })
    ));
    assert!(matches!(
        NeighbourGraph::new(&cloud(9), &[f32::NAN; 9], K),
        Err(Error::NonFinite { .. })
    ));
    assert!(matches!(
        NeighbourGraph::new(&[[f32::NAN; 3]; 9], &[], K),
        Err(Error::NonFinite { .. })
    ));
    assert!(matches!(
        graph.diffused(&identities(7), &GENTLE),
        Err(Error::Argument { .. })
    ));
    x.scores[4] = -1.0;
    assert!(matches!(
        graph.diffused(&x, &GENTLE),
        Err(Error::NonFinite { .. })
    ));
}

#[test]
fn one_thread_gives_the_same_bits_as_two() {
    let (means, features, x) = (cloud(3000), features(3000), identities(3000));
    let at = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        pool.install(|| {
            NeighbourGraph::new(&means, &features, 8)
                .and_then(|g| g.diffused(&x, &GENTLE))
                .expect("fits")
        })
    };
    assert!(at(1) == at(2));
}

#[test]
fn a_run_reports_how_compact_identities_are() {
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let mut config = Config {
        building: BuildingConfig {
            iterations: 40,
            random_points: 400,
            ..BuildingConfig::default()
        },
        segmentation: SegmentationConfig {
            iterations: 30,
            rows: Some(vec![
                Variant::Raw,
                Variant::Vote,
                Variant::PerGaussian,
                Variant::Ours,
            ]),
            ..SegmentationConfig::default()
        },
        ..Config::default()
    };
    config.data.dir = Some(folder.path().to_owned());
    let out = folder.path().join("run");
    let go =
        |config: &Config| run(config, &out, &crate::support::device(), &mut Silent).expect("a run");
    let plain = go(&config);
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
        let differ = row.compactness.expect("counted").neighbours_differ;
        assert!((0.0..1.0).contains(&differ), "{}: {differ}", row.name());
    }
    let metrics = serde_json::to_value(Metrics::of(&plain)).expect("plain data");
    let row = &metrics["test"]["labels"]["ours"]["compactness"];
    assert!(row["neighbours_differ"].is_number(), "{row}");
    assert!(metrics["test"]["labels"]["vote"]["agreement"]["contested"].is_number());
}

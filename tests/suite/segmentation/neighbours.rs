//! Nearest neighbours and interpolation against brute force, and on hard clouds.

use coseg::Error;
use coseg::segmentation::interpolation::interpolation;
use coseg::segmentation::neighbours::PointIndex;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn cloud(count: usize, seed: u64) -> Vec<[f32; 3]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|_| std::array::from_fn(|_| rng.random_range(-1.0f32..1.0)))
        .collect()
}

fn squared(a: [f32; 3], b: [f32; 3]) -> f64 {
    (0..3)
        .map(|i| (f64::from(a[i]) - f64::from(b[i])).powi(2))
        .sum()
}

/// Indices by (distance, index), itself first; repeated when there are fewer than k.
fn brute(points: &[[f32; 3]], i: usize, k: usize) -> Vec<u32> {
    let mut all: Vec<usize> = (0..points.len()).collect();
    all.sort_by(|&a, &b| {
        (a != i)
            .cmp(&(b != i))
            .then(squared(points[a], points[i]).total_cmp(&squared(points[b], points[i])))
            .then(a.cmp(&b))
    });
    all.truncate(k);
    (0..k).map(|j| all[j % all.len()] as u32).collect()
}

fn assert_brute(name: &str, points: &[[f32; 3]], k: usize) {
    let found = PointIndex::new(points).expect("finite").neighbours(k);
    assert_eq!(found.len(), points.len());
    for i in 0..points.len() {
        assert_eq!(found.row(i), brute(points, i, k), "{name}, point {i}");
    }
}

#[test]
fn equals_brute_force_on_random_and_degenerate_clouds() {
    assert_brute("random", &cloud(700, 1), 16);
    assert_brute("fewer than k", &cloud(5, 2), 16);
    assert_brute("one point", &cloud(1, 3), 16);
    assert_brute("identical", &[[0.25, -1.0, 3.0]; 90], 16);
    let plane: Vec<_> = cloud(500, 4)
        .into_iter()
        .map(|[x, y, _]| [x, y, 0.5])
        .collect();
    assert_brute("coplanar", &plane, 16);
    let line: Vec<_> = (0..200).map(|i| [0.0, 0.0, i as f32 * 0.5]).collect();
    assert_brute("line", &line, 16);
    let grid: Vec<_> = (0..6 * 6 * 6)
        .map(|i| [(i % 6) as f32, (i / 6 % 6) as f32, (i / 36) as f32])
        .collect();
    assert_brute("grid: many equal distances", &grid, 16);
    let pairs: Vec<_> = cloud(150, 5).into_iter().flat_map(|p| [p, p, p]).collect();
    assert_brute("triples", &pairs, 16);
    let zeros = [
        [0.0, 0.0, 0.0],
        [-0.0, 0.0, -0.0],
        [0.0, -0.0, 0.0],
        [1.0, 0.0, 0.0],
    ];
    assert_brute("signed zeros", &zeros, 3);
    let far: Vec<_> = cloud(300, 6)
        .into_iter()
        .map(|p| p.map(|v| v * 1e30))
        .collect();
    assert_brute("squares beyond f32", &far, 16);
}

#[test]
fn nothing_to_search_and_nothing_to_find() {
    let empty = PointIndex::new(&[]).expect("no points is fine");
    assert!(empty.is_empty() && empty.neighbours(16).is_empty());
    assert!(matches!(
        empty.nearest(&[[0.0; 3]], 3),
        Err(Error::Argument { .. })
    ));
    assert!(
        empty
            .nearest(&[], 3)
            .expect("no queries is fine")
            .0
            .is_empty()
    );
}

#[test]
fn non_finite_points_and_queries_are_named() {
    let mut points = cloud(20, 7);
    let index = PointIndex::new(&points).expect("finite");
    points[13][1] = f32::NAN;
    assert!(matches!(
        PointIndex::new(&points),
        Err(Error::NonFinite { row: 13, .. })
    ));
    points[13][1] = f32::INFINITY;
    assert!(matches!(
        index.nearest(&points, 3),
        Err(Error::NonFinite { row: 13, .. })
    ));
}

#[test]
fn same_at_one_and_two_threads() {
    let points = cloud(20_000, 8);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        pool.install(|| PointIndex::new(&points).expect("finite").neighbours(16))
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn a_hundred_thousand_identical_points_have_neighbours_too() {
    let found = PointIndex::new(&[[1.0; 3]; 100_000])
        .expect("finite")
        .neighbours(16);
    assert_eq!(found.row(99_999)[..3], [99_999, 0, 1]);
}

#[test]
fn interpolation_is_inverse_squared_distance_of_the_three_nearest() {
    let (coarse, fine) = (cloud(60, 9), cloud(400, 10));
    let m = interpolation(&coarse, &fine).expect("finite");
    assert_eq!((m.rows(), m.columns()), (400, 60));
    for (i, &p) in fine.iter().enumerate() {
        let mut all: Vec<usize> = (0..coarse.len()).collect();
        all.sort_by(|&a, &b| squared(coarse[a], p).total_cmp(&squared(coarse[b], p)));
        let inverse: Vec<f64> = all[..3]
            .iter()
            .map(|&j| 1.0 / squared(coarse[j], p))
            .collect();
        let (columns, values) = m.row(i);
        for j in 0..3 {
            assert_eq!(columns[j] as usize, all[j]);
            assert!((f64::from(values[j]) - inverse[j] / inverse.iter().sum::<f64>()).abs() < 1e-6);
        }
    }
}

#[test]
fn interpolation_of_a_constant_is_that_constant_and_a_shared_point_keeps_its_feature() {
    for (coarse, fine) in [
        (cloud(60, 11), cloud(400, 12)),
        (cloud(2, 13), cloud(50, 14)),
        (vec![[0.5; 3]; 40], cloud(50, 15)),
        (vec![[0.5; 3]; 40], vec![[0.5; 3]; 90]),
    ] {
        let m = interpolation(&coarse, &fine).expect("finite");
        for v in m.apply(&vec![2.5f32; coarse.len()], 1) {
            assert!((v - 2.5).abs() < 1e-6, "{v}");
        }
    }
    let coarse = cloud(60, 16);
    let m = interpolation(&coarse, &coarse[20..30]).expect("finite");
    let values: Vec<f32> = (0..60).map(|i| i as f32).collect();
    assert_eq!(
        m.apply(&values, 1),
        (20..30).map(|i| i as f32).collect::<Vec<_>>()
    );
}

//! PCA: against known covariance, rank-deficient and constant features, signs, large means, threads.

use coseg::features::{FeatureMap, Moments, Pca};

/// Rows with independent columns of the given amplitudes after a rotation in planes (0,1), (1,2), ...
fn rows(n: usize, amplitudes: &[f64], offset: f64) -> Vec<f32> {
    let c = amplitudes.len();
    let mut out = Vec::with_capacity(n * c);
    for i in 0..n {
        let mut x: Vec<f64> = (0..c)
            .map(|k| amplitudes[k] * ((i as f64 + 1.0) * (k as f64 + 1.3) * 0.754_877).sin())
            .collect();
        for k in 1..c {
            let (a, b) = (x[k - 1], x[k]);
            (x[k - 1], x[k]) = (0.8 * a - 0.6 * b, 0.6 * a + 0.8 * b);
        }
        out.extend(x.iter().map(|v| (v + offset) as f32));
    }
    out
}

fn fit(data: &[f32], channels: usize, dimensions: usize) -> Pca {
    let mut moments = Moments::new(channels);
    for part in data.chunks(channels * 700) {
        moments.add(part, "rows", channels).expect("finite");
    }
    Pca::fit(&moments, dimensions)
}

fn map(data: Vec<f32>, channels: usize) -> FeatureMap {
    FeatureMap {
        height: 1,
        width: data.len() / channels,
        channels,
        data,
        steps: None,
    }
}

#[test]
fn components_diagonalise_a_plain_covariance() {
    let (c, n) = (6, 5000);
    let data = rows(n, &[5.0, 3.0, 2.0, 1.0, 0.5, 0.1], 40.0);
    let pca = fit(&data, c, 4);
    assert_eq!((pca.rank, pca.channels, pca.dimensions), (4, c, 4));
    let mean: Vec<f64> = (0..c)
        .map(|k| {
            data.iter()
                .skip(k)
                .step_by(c)
                .map(|&x| f64::from(x))
                .sum::<f64>()
                / n as f64
        })
        .collect();
    let covariance = |a: &[f64], b: &[f64]| -> f64 {
        let along = |row: &[f32], v: &[f64]| {
            (0..c)
                .map(|k| (f64::from(row[k]) - mean[k]) * v[k])
                .sum::<f64>()
        };
        data.chunks_exact(c)
            .map(|row| along(row, a) * along(row, b))
            .sum::<f64>()
            / n as f64
    };
    for (i, a) in pca.components.chunks_exact(c).enumerate() {
        let peak = a
            .iter()
            .fold(0.0_f64, |p, &x| if x.abs() > p.abs() { x } else { p });
        assert!(peak > 0.0, "component {i} has its largest entry negative");
        for (j, b) in pca.components.chunks_exact(c).enumerate() {
            let dot: f64 = a.iter().zip(b).map(|(x, y)| x * y).sum();
            let expected = if i == j { pca.variances[i] } else { 0.0 };
            assert!((dot - f64::from(u8::from(i == j))).abs() < 1e-12);
            assert!(
                (covariance(a, b) - expected).abs() < 1e-9 * pca.variances[0],
                "{i} {j}"
            );
        }
    }
    assert!(pca.variances.is_sorted_by(|a, b| a >= b));
    let total: f64 = (0..c)
        .map(|k| {
            let mut e = vec![0.0; c];
            e[k] = 1.0;
            covariance(&e, &e)
        })
        .sum();
    assert!((pca.explained - pca.variances.iter().sum::<f64>() / total).abs() < 1e-9);
}

#[test]
fn a_mean_far_from_zero_does_not_cancel() {
    let near = fit(&rows(3000, &[2.0, 1.0, 0.5], 0.0), 3, 3);
    let far = fit(&rows(3000, &[2.0, 1.0, 0.5], 30_000.0), 3, 3);
    for (a, b) in near.variances.iter().zip(&far.variances) {
        assert!((a - b).abs() < 3e-3 * a, "{a} {b}"); // f32 rounding of the inputs themselves at 3e4
    }
}

#[test]
fn cells_have_unit_length_and_missing_dimensions_are_zero() {
    let data = rows(2000, &[3.0, 1.0, 0.3], 2.0);
    let pca = fit(&data, 3, 8);
    assert_eq!(pca.rank, 3);
    let out = pca.apply(&map(data, 3), "map").expect("same channels");
    assert_eq!(out.channels, 8);
    for cell in out.data.chunks_exact(8) {
        assert!((cell.iter().map(|x| x * x).sum::<f32>() - 1.0).abs() < 1e-5);
        assert!(cell[3..].iter().all(|&x| x == 0.0));
    }
}

#[test]
fn rank_deficient_and_constant_features_give_no_nan() {
    // Third column = first + second, fourth constant.
    let data: Vec<f32> = rows(2000, &[3.0, 1.0], 0.0)
        .chunks_exact(2)
        .flat_map(|r| [r[0], r[1], r[0] + r[1], 7.5])
        .collect();
    let pca = fit(&data, 4, 4);
    assert_eq!(pca.rank, 2);
    let out = pca.apply(&map(data, 4), "map").expect("same channels");
    assert!(out.data.iter().all(|x| x.is_finite()));

    let constant = vec![0.1_f32; 3 * 1000];
    let pca = fit(&constant, 3, 2);
    assert_eq!(pca.rank, 0);
    assert!(
        pca.apply(&map(constant, 3), "map")
            .expect("same channels")
            .data
            .iter()
            .all(|&x| x == 0.0)
    );
    assert_eq!(fit(&[], 3, 2).rank, 0);
    assert_eq!(Pca::fit(&Moments::new(0), 2).rank, 0, "no channels at all");
    assert_eq!(
        fit(&[1.0, 2.0, 3.0], 3, 2).rank,
        0,
        "one row has no variance"
    );
}

#[test]
fn bad_values_and_channels_are_named() {
    let mut data = rows(100, &[3.0, 1.0], 0.0);
    data[51] = f32::NAN;
    let error = Moments::new(2)
        .add(&data, "features of view a, scale 2", 2)
        .expect_err("NaN")
        .to_string();
    assert!(
        error.contains("view a, scale 2") && error.contains("row 25"),
        "{error}"
    );
    let pca = fit(&rows(100, &[3.0, 1.0], 0.0), 2, 2);
    assert!(
        pca.apply(&map(vec![0.0; 9], 3), "map b")
            .expect_err("channels")
            .to_string()
            .contains("map b")
    );
    let infinite = map(vec![0.0, f32::INFINITY], 2);
    assert!(pca.apply(&infinite, "map c").is_err());
}

#[test]
fn the_same_bits_at_one_and_two_threads() {
    let data = rows(20_000, &[5.0, 3.0, 2.0, 1.0, 0.5, 0.1, 0.1], 3.0);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        pool.install(|| {
            let pca = fit(&data, 7, 5);
            let out = pca
                .apply(&map(data.clone(), 7), "map")
                .expect("same channels");
            (pca, out)
        })
    };
    assert_eq!(with(1), with(2));
}

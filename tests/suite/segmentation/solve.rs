//! Unprojection by conjugate gradients, against a dense solution of the same equations.

use coseg::raster::{Projected, Settings, Splats};
use coseg::segmentation::unprojection::Problem;
use coseg::splat::camera::Camera;
use glam::{DMat3, DQuat, DVec3};
use nalgebra::{DMatrix, DVector};

const CHANNELS: usize = 3;

/// A cloud of `n`; the last is behind all cameras.
struct Cloud {
    means: Vec<f64>,
    log_scales: Vec<f64>,
    rotations: Vec<f64>,
    opacity_logits: Vec<f64>,
}

impl Cloud {
    fn new(n: usize) -> Self {
        let wave = |i: usize, k: usize| ((i * 7 + k * 3) as f64 * 1.37 + 0.2).sin();
        let each = |f: &dyn Fn(usize) -> Vec<f64>| (0..n).flat_map(f).collect::<Vec<f64>>();
        let behind = |i: usize| if i + 1 == n { -40.0 } else { 4.0 + wave(i, 2) };
        Self {
            means: each(&|i| vec![1.5 * wave(i, 0), 1.1 * wave(i, 1), behind(i)]),
            log_scales: each(&|i| (3..6).map(|k| -1.6 + 0.5 * wave(i, k)).collect()),
            rotations: each(&|i| vec![1.0, wave(i, 6), wave(i, 7), wave(i, 8)]),
            opacity_logits: each(&|i| vec![0.5 + wave(i, 9)]),
        }
    }

    fn splats(&self) -> Splats<'_, f64> {
        Splats {
            means: &self.means,
            log_scales: &self.log_scales,
            rotations: &self.rotations,
            opacity_logits: &self.opacity_logits,
        }
    }
}

fn cameras() -> Vec<Camera> {
    (0..3)
        .map(|i| {
            let rotation = DMat3::from_quat(DQuat::from_rotation_y(0.2 * (f64::from(i) - 1.0)));
            let center = DVec3::new(0.5 * (f64::from(i) - 1.0), 0.0, 0.0);
            Camera {
                rotation,
                center,
                fx: 20.0,
                fy: 21.0,
                cx: 12.0,
                cy: 9.0,
                width: 24,
                height: 18,
            }
        })
        .collect()
}

/// The maps, `W` in full, and what is lifted: `W^T F` and `W^T 1`.
struct Case {
    cloud: Cloud,
    cameras: Vec<Camera>,
    w: DMatrix<f64>,
    f: DMatrix<f64>,
    buffer: Vec<f64>,
    weights: Vec<f64>,
}

/// `maps` makes the `[pixels, CHANNELS]` maps of all views from `W`.
fn case(n: usize, maps: impl Fn(&DMatrix<f64>) -> DMatrix<f64>) -> Case {
    let (cloud, cameras, settings) = (Cloud::new(n), cameras(), Settings::default());
    let pixels = 24 * 18;
    let mut w = DMatrix::zeros(pixels * cameras.len(), n);
    for (view, camera) in cameras.iter().enumerate() {
        let projected = Projected::new(&cloud.splats(), camera, &settings).expect("projects");
        let one_hot: Vec<f64> = (0..n * n)
            .map(|i| f64::from(u8::from(i / n == i % n)))
            .collect();
        let image = projected.blend(&one_hot, n).image;
        for (i, row) in image.chunks_exact(n).enumerate() {
            w.row_mut(view * pixels + i).copy_from_slice(row);
        }
    }
    let f = maps(&w);
    let lifted = w.transpose() * &f;
    let buffer = lifted
        .row_iter()
        .flat_map(|row| row.iter().copied().collect::<Vec<f64>>())
        .collect();
    let weights = w.row_sum().iter().copied().collect();
    Case {
        cloud,
        cameras,
        w,
        f,
        buffer,
        weights,
    }
}

fn noise(w: &DMatrix<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(w.nrows(), CHANNELS, |i, c| {
        ((i * CHANNELS + c) as f64 * 12.9898).sin() * 3.0
    })
}

fn row_copy(values: &[f64], c: usize) -> DVector<f64> {
    DVector::from_iterator(
        values.len() / CHANNELS,
        values.iter().skip(c).step_by(CHANNELS).copied(),
    )
}

#[test]
fn solution_is_that_of_the_dense_equations() {
    let settings = Settings::default();
    let case = case(14, noise);
    for ridge in [0.03, 0.3, 3.0] {
        let problem = Problem {
            splats: case.cloud.splats(),
            cameras: &case.cameras,
            masks: &[],
            settings: &settings,
            weights: &case.weights,
            ridge,
        };
        let done = problem.solve(&case.buffer, CHANNELS, 200).expect("solves");
        assert!(
            done.residual <= 1e-4 && done.iterations < 60,
            "ridge {ridge}: {done:?}"
        );
        // The last Gaussian is seen by no view and has no equation.
        let n = case.weights.len() - 1;
        assert!(done.features[n * CHANNELS..].iter().all(|&x| x == 0.0));
        let w = case.w.columns(0, n).into_owned();
        let d = DMatrix::from_diagonal(&DVector::from_column_slice(&case.weights[..n]));
        let matrix = w.transpose() * &w + &d * ridge;
        let factor = matrix.cholesky().expect("positive definite");
        for c in 0..CHANNELS {
            let lifted = w.transpose() * case.f.column(c);
            let mean = d.clone().try_inverse().expect("all are seen") * &lifted;
            let want = factor.solve(&(&lifted + &d * &mean * ridge));
            let got = row_copy(&done.features, c).rows(0, n).into_owned();
            let error = (&got - &want).amax() / want.amax();
            assert!(error < 1e-3, "ridge {ridge}, channel {c}: {error}");
            assert!(
                (&mean - &want).amax() / want.amax() > 0.02,
                "the mean must not pass for the solution"
            );
        }
    }
}

#[test]
fn features_that_were_rendered_come_back() {
    let settings = Settings::default();
    let truth = |j: usize, c: usize| ((j * 5 + c * 11) as f64 * 0.77).cos();
    let case = case(14, |w| w * DMatrix::from_fn(w.ncols(), CHANNELS, truth));
    let problem = Problem {
        splats: case.cloud.splats(),
        cameras: &case.cameras,
        masks: &[],
        settings: &settings,
        weights: &case.weights,
        ridge: 1e-6,
    };
    let error = |features: &[f64]| {
        let misses =
            (0..13 * CHANNELS).map(|i| (features[i] - truth(i / CHANNELS, i % CHANNELS)).abs());
        misses.fold(0.0, f64::max)
    };
    let mean = problem.solve(&case.buffer, CHANNELS, 0).expect("the mean");
    assert_eq!(mean.iterations, 0);
    let solved = problem.solve(&case.buffer, CHANNELS, 500).expect("solves");
    let (before, after) = (error(&mean.features), error(&solved.features));
    assert!(
        after < 0.01 && before > 0.2,
        "largest error of the mean {before}, of the solution {after}"
    );
}

#[test]
fn the_same_bits_at_one_and_two_threads_and_nothing_from_nothing() {
    let settings = Settings::default();
    let case = case(14, noise);
    let solve = |buffer: &[f64]| {
        let (splats, cameras, weights) =
            (case.cloud.splats(), &case.cameras[..], &case.weights[..]);
        Problem {
            splats,
            cameras,
            masks: &[],
            settings: &settings,
            weights,
            ridge: 0.1,
        }
        .solve(buffer, CHANNELS, 7)
        .expect("solves")
    };
    let [one, two] = [1, 2].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        pool.install(|| solve(&case.buffer))
    });
    assert_eq!(one, two);
    let nothing = solve(&vec![0.0; case.buffer.len()]);
    assert!(
        nothing.iterations == 0 && nothing.features.iter().all(|&x| x == 0.0),
        "{nothing:?}"
    );
}

//! Sums over pixels of absolute screen-space gradients (AbsGS) against finite differences of every pixel's own loss.

use crate::support::raster_reference::{
    self as reference, Cloud, camera, cloud, cloud_far_from_cuts, numbers,
};
use burn::tensor::{DType, Tensor, TensorData};
use coseg::raster::{RasterInput, Settings, rasterize};
use coseg::splat::camera::Camera;

/// Gradient of the screen tensor, `[N, columns]`, for the linear loss of `weights` `[H, W, C]` and `d_t` `[H, W]`.
fn screen_gradient(
    c: &Cloud,
    values: &[f64],
    camera: &Camera,
    settings: &Settings,
    [weights, d_t]: [&[f64]; 2],
    columns: usize,
) -> Vec<f64> {
    let device = crate::support::device().autodiff();
    let n = c.len();
    let w = camera.width;
    let h = camera.height;
    let two = |v: &[f64], shape: [usize; 2]| {
        Tensor::<2>::from_data(TensorData::new(v.to_vec(), shape), (&device, DType::F64))
            .require_grad()
    };
    let screen = Tensor::<2>::zeros([n, columns], (&device, DType::F64)).require_grad();
    let logits = TensorData::new(c.opacity_logits.clone(), [n]);
    let input = RasterInput {
        means: two(&c.means, [n, 3]),
        log_scales: two(&c.log_scales, [n, 3]),
        rotations: two(&c.rotations, [n, 4]),
        opacity_logits: Tensor::<1>::from_data(logits, (&device, DType::F64)).require_grad(),
        sh: None,
        active_sh_degree: 0,
        features: Some(two(values, [n, values.len() / n])),
        screen: Some(screen.clone()),
    };
    let out = rasterize(input, camera, settings, [0.0; 3]).expect("valid");
    let weights = TensorData::new(weights.to_vec(), [h, w, values.len() / n]);
    let d_t = TensorData::new(d_t.to_vec(), [h, w]);
    let image = out.image * Tensor::<3>::from_data(weights, (&device, DType::F64));
    let t = out.transmittance * Tensor::<2>::from_data(d_t, (&device, DType::F64));
    let gradient = screen
        .grad(&(image.sum() + t.sum()).backward())
        .expect("tracked");
    gradient.into_data().into_vec().expect("f64")
}

/// Sums over pixels, of the image and of the transmittance, of the derivative by each shift of a projected centre, and of its
/// absolute value, in units of half the image; by a renderer that shares no code with the crate.
fn by_differences(
    c: &Cloud,
    values: &[f64],
    camera: &Camera,
    settings: &Settings,
    [weights, d_t]: [&[f64]; 2],
    step: f64,
) -> [Vec<f64>; 2] {
    let channels = values.len() / c.len();
    let mut shifts = vec![0.0; 2 * c.len()];
    let mut sums = [vec![0.0; shifts.len()], vec![0.0; shifts.len()]];
    for i in 0..shifts.len() {
        let mut losses = |shift: f64| -> Vec<f64> {
            shifts[i] = shift * step;
            let out = reference::render_shifted(c, values, channels, camera, settings, &shifts);
            let colour = out
                .image
                .chunks_exact(channels)
                .zip(weights.chunks_exact(channels));
            let colour = colour.map(|(a, b)| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>());
            let transmittance = out.transmittance.iter().zip(d_t).map(|(t, d)| t * d);
            colour.chain(transmittance).collect()
        };
        let [a, b, c, d] = [1.0, -1.0, 2.0, -2.0].map(&mut losses);
        shifts[i] = 0.0;
        let half = 0.5
            * if i % 2 == 0 {
                camera.width
            } else {
                camera.height
            } as f64;
        for p in 0..a.len() {
            let slope = half * (8.0 * (a[p] - b[p]) - (c[p] - d[p])) / (12.0 * step);
            sums[0][i] += slope;
            sums[1][i] += slope.abs();
        }
    }
    sums
}

fn agree(got: &[f64], want: &[f64]) -> bool {
    let rms = (want.iter().map(|v| v * v).sum::<f64>() / want.len() as f64).sqrt();
    got.iter()
        .zip(want)
        .all(|(g, w)| (g - w).abs() <= 1e-6 * w.abs().max(rms))
}

fn columns(rows: &[f64], of: std::ops::Range<usize>) -> Vec<f64> {
    rows.chunks_exact(4)
        .flat_map(|row| row[of.clone()].to_vec())
        .collect()
}

#[test]
fn absolute_sums_equal_finite_differences_pixel_by_pixel() {
    const SMOOTH: Settings = Settings {
        alpha_max: 1.0,
        alpha_min: 1e-14,
        t_min: 0.0,
        near: 0.01,
        low_pass: 0.3,
    };
    let camera = camera(23, 18);
    let cut = Settings {
        alpha_max: 0.5,
        t_min: 0.2,
        ..Settings::default()
    };
    for (settings, step) in [(SMOOTH, 1e-4), (cut, 1e-6)] {
        let c = cloud_far_from_cuts(10, &camera, &settings, 4e-4);
        let pixels = camera.width * camera.height;
        for channels in [1, 3, 9] {
            let values = numbers(c.len() * channels, 5);
            let weights = [&numbers(pixels * channels, 77)[..], &numbers(pixels, 78)];
            let got = screen_gradient(&c, &values, &camera, &settings, weights, 4);
            let [sum, absolute] = by_differences(&c, &values, &camera, &settings, weights, step);
            assert!(
                agree(&columns(&got, 0..2), &sum),
                "{channels} channels, {settings:?}: the sums"
            );
            let got = columns(&got, 2..4);
            assert!(
                agree(&got, &absolute),
                "{channels} channels, {settings:?}: {got:?} against {absolute:?}"
            );
            let off: Vec<f64> = got.iter().map(|v| 1.01 * v).collect();
            assert!(!agree(&off, &absolute), "1 % off goes unnoticed");
            assert!(
                got.iter().zip(&sum).any(|(a, s)| *a > 1.5 * s.abs()),
                "no signs cancel: the check would be empty"
            );
        }
    }
}

#[test]
fn the_usual_gradients_do_not_depend_on_it() {
    let camera = camera(40, 31);
    let c = cloud(60, 0.04, &camera, 12);
    for channels in [1, 3, 6] {
        let values = numbers(c.len() * channels, 4);
        let weights = [&numbers(40 * 31 * channels, 77)[..], &numbers(40 * 31, 78)];
        let two = screen_gradient(&c, &values, &camera, &Settings::default(), weights, 2);
        let four = screen_gradient(&c, &values, &camera, &Settings::default(), weights, 4);
        assert_eq!(two, columns(&four, 0..2), "bit for bit");
        let bound = columns(&four, 2..4);
        let above = two
            .iter()
            .zip(&bound)
            .filter(|(sum, absolute)| sum.abs() > **absolute * (1.0 + 1e-9))
            .count();
        assert_eq!(above, 0, "a sum is never above the sum of absolute values");
        assert_eq!(
            two.iter().filter(|v| **v == 0.0).count(),
            bound.iter().filter(|v| **v == 0.0).count()
        );
    }
}

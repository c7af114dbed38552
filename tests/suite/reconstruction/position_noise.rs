//! Noise of 3DGS-MCMC on positions: its shape, its formula, and what it spares.

use crate::support::population::population;
use burn::tensor::Device;
use coseg::random::{Purpose, normals, stream};
use coseg::raster::SplatTensors;
use coseg::reconstruction::initialization;
use coseg::reconstruction::mcmc::PositionNoise;
use glam::{DQuat, DVec3};

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

#[test]
fn noise_has_the_shape_of_the_gaussian_and_spares_the_opaque() {
    let n = 6000;
    let mut g = population(&vec![0.005; n + 2]);
    let turned = [0.5_f32.sqrt(), 0.0, 0.0, 0.5_f32.sqrt()]; // 90 degrees about z: local x becomes world y
    g.means.fill([1.0, 2.0, 3.0]);
    g.rotations.fill(turned.map(|v| 7.0 * v)); // unnormalised
    g.log_scales
        .fill([0.5_f32.ln(), 0.2_f32.ln(), 0.1_f32.ln()]);
    g.opacity_logits[n] = initialization::logit(0.1);
    g.opacity_logits[n + 1] = initialization::logit(0.5);
    let noise = PositionNoise {
        scale: 0.8,
        sharpness: 100.0,
        opacity: 0.005,
    };
    let moved = |device: &Device, threads, seed| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        let mut rng = stream(seed, Purpose::PositionNoise, 9);
        let splats = SplatTensors::new(&g, device);
        let means = pool.install(|| noise.apply(&splats, &mut rng));
        means.into_data().into_vec::<f32>().expect("f32")
    };
    let devices = [
        Some(crate::support::device()),
        #[cfg(feature = "wgpu")]
        crate::support::gpu(),
    ];
    for device in devices.into_iter().flatten() {
        let means = moved(&device, 1, 1);
        let rows = means.as_chunks::<3>().0;
        // Half the noise is left at t; along each axis the variance takes the place of the deviation.
        for (axis, mean, variance) in [(0, 1.0, 0.04), (1, 2.0, 0.25), (2, 3.0, 0.01)] {
            let deviation = 0.5 * 0.8 * variance;
            let offsets = rows[..n].iter().map(|m| f64::from(m[axis]) - mean);
            let average = offsets.clone().sum::<f64>() / n as f64;
            let spread = (offsets.map(|v| v * v).sum::<f64>() / n as f64).sqrt();
            assert!(
                average.abs() < 4.0 * deviation / (n as f64).sqrt(),
                "axis {axis}: mean {average}"
            );
            assert!(
                (spread / deviation - 1.0).abs() < 4.0 / (2.0 * n as f64).sqrt(),
                "axis {axis}: {spread}"
            );
        }
        assert_ne!(rows[n], [1.0, 2.0, 3.0], "a little noise is left at 0.1");
        assert_eq!(rows[n + 1], [1.0, 2.0, 3.0], "and none at 0.5");
        assert_eq!(means, moved(&device, 2, 1), "at any number of threads");
        assert_ne!(means, moved(&device, 1, 2));
    }
}

#[test]
fn noise_is_that_of_the_formula() {
    let n = 3000;
    let opacities: Vec<f32> = (0..n)
        .map(|i| 0.001 + 0.2 * (i as f32 * 0.7).sin().abs().powi(3))
        .collect();
    let mut g = population(&opacities);
    for (i, rotation) in g.rotations.iter_mut().enumerate() {
        *rotation = [0.3, 0.9, 1.7, 2.3].map(|by| 3.0 * (i as f32 * by).sin());
    }
    g.rotations[5] = [0.0; 4];
    for (i, scales) in g.log_scales.iter_mut().enumerate() {
        *scales = [0.4, 1.1, 0.7].map(|by| (i as f32 * by).cos() - 1.0);
    }
    let noise = PositionNoise {
        scale: 0.8,
        sharpness: 100.0,
        opacity: 0.005,
    };
    let devices = [
        Some(crate::support::device()),
        #[cfg(feature = "wgpu")]
        crate::support::gpu(),
    ];
    for device in devices.into_iter().flatten() {
        let rng = || stream(4, Purpose::PositionNoise, 2);
        let drawn = normals([n, 3], &mut rng(), &device);
        let drawn: Vec<f32> = drawn.into_data().into_vec().expect("f32");
        let moved = noise.apply(&SplatTensors::new(&g, &device), &mut rng());
        let got: Vec<f32> = moved.into_data().into_vec().expect("f32");
        let want: Vec<f32> = (0..n)
            .flat_map(|i| {
                let [w, x, y, z] = g.rotations[i].map(f64::from);
                let raw = DQuat::from_xyzw(x, y, z, w);
                let rotation = if raw.length_squared() < 1e-12 {
                    DQuat::IDENTITY
                } else {
                    raw.normalize()
                };
                let eta = DVec3::from_slice(&[0, 1, 2].map(|k| f64::from(drawn[3 * i + k])));
                let variance = DVec3::from(g.log_scales[i].map(|s| (2.0 * f64::from(s)).exp()));
                let gate = sigmoid(-100.0 * (sigmoid(f64::from(g.opacity_logits[i])) - 0.005));
                let noise = rotation * (variance * (rotation.inverse() * eta)) * 0.8 * gate;
                let mean = DVec3::from(g.means[i].map(f64::from));
                (mean + noise).as_vec3().to_array()
            })
            .collect();
        let moves = want.iter().zip(g.means.as_flattened());
        let moves: Vec<f32> = moves.map(|(to, from)| to - from).collect();
        let largest = moves.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        assert!(
            moves.contains(&0.0) && largest > 0.1,
            "some rest, some move: {largest}"
        );
        for (i, (got, want)) in got.iter().zip(&want).enumerate() {
            // means of hundreds in f32, and a move of f32
            assert!(
                (got - want).abs() < 1e-5 * largest + f32::EPSILON * want.abs(),
                "{i}: {got} for {want}"
            );
        }
    }
}

//! Gaussians with hard numbers, all in one scene: pictures and gradients stay finite on every backend.

use crate::support::raster_precision::{NAMES, RGB, plain, run};
use crate::support::raster_reference::{Cloud, camera, numbers};
use burn::tensor::DType;
use coseg::raster::{Projected, Settings, Splats};
use coseg::splat::camera::Camera;

/// Gaussians with hard depths, scales, rotations and opacities in all combinations, and opaque layers at one depth.
fn hard_cases(camera: &Camera) -> Cloud {
    let forward = camera.rotation.transpose() * glam::DVec3::Z;
    let at = |depth: f64| (camera.center + forward * depth).to_array();
    let turn = [0.9, 0.1, -0.3, 0.2];
    let mut c = Cloud::default();
    for depth in [-3.0, -0.01, 0.0, 0.01, 0.010_001, 0.5, 1e6] {
        for scale in [[1e-8; 3], [1e4; 3], [1.0, 1e-6, 1e-6], [0.1; 3]] {
            for logit in [-50.0, 0.0, 50.0] {
                c.push(at(depth), scale, turn, logit);
                c.push(at(depth), scale, [0.0; 4], logit);
                c.push(at(depth), scale, [1e30, -1e30, 1e29, 3e30], logit);
            }
        }
    }
    for _ in 0..3_000 {
        c.push(at(2.0), [0.5; 3], turn, 20.0);
    }
    c.rounded()
}

#[test]
fn hard_cases_have_finite_gradients() {
    let camera = camera(47, 33);
    let c = hard_cases(&camera);
    for channels in [RGB, plain(64)] {
        for (name, device) in crate::support::devices() {
            let (parts, _) = run(
                &c,
                channels,
                &camera,
                &Settings::default(),
                &device,
                DType::F32,
            );
            for (part, values) in NAMES.iter().zip(&parts) {
                assert!(values.iter().all(|v| v.is_finite()), "{name}: {part}");
            }
            assert!(parts[1].iter().all(|t| (0.0..=1.0).contains(t)), "{name}");
        }
    }
}

#[test]
fn hard_cases_stay_finite() {
    let camera = camera(47, 33);
    let c = hard_cases(&camera);
    let [means, log_scales, rotations, opacity_logits] = &c.single();
    let splats = Splats {
        means,
        log_scales,
        rotations,
        opacity_logits,
    };
    let settings = Settings::default();
    let projected = Projected::new(&splats, &camera, &settings).expect("finite input");
    for channels in [1, 3, 64] {
        let values: Vec<f32> = numbers(c.len() * channels, 3)
            .iter()
            .map(|&v| 1e4 * v as f32)
            .collect();
        let out = projected.blend(&values, channels);
        assert!(
            out.image
                .iter()
                .chain(&out.transmittance)
                .all(|v| v.is_finite())
        );
        assert!(out.transmittance.iter().all(|t| (0.0..=1.0).contains(t)));
        assert!(
            projected
                .blend_adjoint(&out.image, channels)
                .iter()
                .all(|v| v.is_finite())
        );
    }
    let wide = Projected::new(&c.splats(), &camera, &settings).expect("finite input");
    assert!(
        wide.blend(&numbers(c.len() * 3, 3), 3)
            .image
            .iter()
            .all(|v| v.is_finite())
    );
}

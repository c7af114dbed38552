//! Blending: against a plain reference, as a linear map, and on hard cases.

use crate::support::raster_reference::{camera, cloud, numbers, render};
use coseg::raster::{Projected, Settings};

fn close(got: &[f64], want: &[f64], tolerance: f64, what: &str) {
    assert_eq!(got.len(), want.len(), "{what}");
    for (i, (g, w)) in got.iter().zip(want).enumerate() {
        assert!((g - w).abs() <= tolerance, "{what}[{i}]: {g}, expected {w}");
    }
}

#[test]
fn lists_of_many_gaussians_equal_the_plain_reference() {
    // More than are binned by one task.
    let camera = camera(33, 24);
    let n = 13_000;
    let cloud = cloud(n, 0.004, &camera, 5);
    let projected = Projected::new(&cloud.splats(), &camera, &Settings::default()).expect("valid");
    let visible = projected
        .radii()
        .iter()
        .filter(|radius| **radius > 0)
        .count();
    assert!(visible > 9_000, "{visible}");
    let values = numbers(3 * n, 15);
    let want = render(&cloud, &values, 3, &camera, &Settings::default());
    close(
        &projected.blend(&values, 3).image,
        &want.image,
        1e-10,
        "image",
    );
}

#[test]
fn blending_equals_the_plain_reference() {
    for (width, height, n, scale, seed) in [
        (50, 37, 300, 0.02, 1),
        (16, 16, 40, 0.2, 2),
        (1, 1, 20, 0.5, 3),
        (33, 70, 500, 0.004, 4),
    ] {
        let camera = camera(width, height);
        let cloud = cloud(n, scale, &camera, seed);
        for settings in [
            Settings::default(),
            Settings {
                alpha_max: 0.99,
                ..Settings::default()
            },
            Settings {
                alpha_max: 1.0,
                alpha_min: 1e-14,
                t_min: 0.0,
                ..Settings::default()
            },
        ] {
            let projected = Projected::new(&cloud.splats(), &camera, &settings).expect("valid");
            for channels in [0, 1, 2, 3, 4, 5, 8, 9, 16, 17, 19, 24, 25, 48, 64, 75] {
                let values = numbers(n * channels, seed + 10);
                let want = render(&cloud, &values, channels, &camera, &settings);
                let got = projected.blend(&values, channels);
                close(&got.image, &want.image, 1e-10, "image");
                close(
                    &got.transmittance,
                    &want.transmittance,
                    1e-10,
                    "transmittance",
                );
            }
        }
    }
}

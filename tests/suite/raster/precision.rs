//! f32 against f64 on every backend: pictures and all gradients, on random scenes and on hard cases.

use crate::support::raster_precision::{BACKGROUND, Channels, RGB, SMOOTH, compare, plain, run};
use crate::support::raster_reference::{Cloud, camera, cloud, cloud_far_from_cuts};
use burn::tensor::DType;
use coseg::raster::Settings;
use coseg::splat::camera::Camera;

#[test]
fn scenes_far_from_every_cut_off_agree_without_exception() {
    let camera = camera(37, 29);
    for settings in [
        Settings::default(),
        Settings {
            alpha_max: 0.5,
            t_min: 0.2,
            ..Settings::default()
        },
        SMOOTH,
    ] {
        let scene = cloud_far_from_cuts(12, &camera, &settings, 2e-4);
        for channels in [
            RGB,
            plain(1),
            plain(3),
            Channels {
                sh: Some((1, 0)),
                features: 2,
            },
        ] {
            compare(
                "far from every cut-off",
                &scene,
                channels,
                &camera,
                &settings,
                1.0,
            );
        }
    }
}

#[test]
fn any_number_of_channels() {
    let camera = camera(40, 31);
    let scene = cloud(80, 0.04, &camera, 12).rounded();
    let channels = [1, 2, 3, 4, 5, 8, 9, 20, 33, 64, 150, 512].map(plain);
    let mixed = [(0, 0, 20), (2, 1, 1), (3, 2, 64)].map(|(d, a, features)| Channels {
        sh: Some((d, a)),
        features,
    });
    for channels in channels.into_iter().chain(mixed) {
        compare(
            "1 to 512 channels",
            &scene,
            channels,
            &camera,
            &Settings::default(),
            0.98,
        );
    }
}

#[test]
fn images_of_any_size() {
    for (width, height, n, scale, seed) in [
        (1, 1, 20, 0.5, 3),
        (16, 16, 40, 0.2, 2),
        (33, 70, 500, 0.004, 4),
        (97, 61, 2_000, 0.01, 5),
        (3, 10_000, 200, 0.02, 6),
    ] {
        let camera = camera(width, height);
        compare(
            &format!("{width}x{height} pixels"),
            &cloud(n, scale, &camera, seed).rounded(),
            RGB,
            &camera,
            &Settings::default(),
            0.98,
        );
    }
}

#[test]
fn thousands_of_gaussians_in_a_tile() {
    let camera = camera(30, 20);
    let mut scene = cloud(3_000, 0.05, &camera, 6);
    // Faint ones, so that the lists are read to their end. Many pixels have one that is close to the cut-off.
    scene.opacity_logits.iter_mut().for_each(|l| *l -= 4.0);
    compare(
        "3,000 faint Gaussians in a tile",
        &scene.rounded(),
        Channels {
            sh: Some((0, 0)),
            features: 5,
        },
        &camera,
        &Settings::default(),
        0.4,
    );
    // Opaque ones: each pixel ends within a few.
    let mut opaque = cloud(3_000, 0.05, &camera, 8);
    opaque.opacity_logits.iter_mut().for_each(|l| *l += 20.0);
    compare(
        "3,000 opaque Gaussians in a tile",
        &opaque.rounded(),
        RGB,
        &camera,
        &Settings::default(),
        0.4,
    );
    compare(
        "3,000 Gaussians in a tile",
        &cloud(3_000, 0.05, &camera, 7).rounded(),
        RGB,
        &camera,
        &Settings::default(),
        0.4,
    );
}

#[test]
fn hard_cases_agree() {
    let camera = camera(47, 33);
    let forward = camera.rotation.transpose() * glam::DVec3::Z;
    let at = |depth: f64| (camera.center + forward * depth).to_array();
    let turn = [0.9, 0.1, -0.3, 0.2];
    let beside = (camera.center + camera.ray(-60.0, 12.0) * 3.0).to_array();
    let right = (camera.center + camera.ray(30.0, 8.0) * 2.0).to_array();
    let size = [0.1, 0.2, 0.3];
    let huge = [1e4, 2e4, 1.5e4];
    let cases = [
        ("just past the near plane", at(0.010_01), size, turn, 0.0),
        ("scales of 1e-8", at(2.0), [1e-8, 2e-8, 3e-8], turn, 2.0),
        ("scales of 1e4", at(2.0), huge, turn, 0.0),
        ("a needle, 1 to 1e-6", at(2.0), [1.0, 1e-6, 1e-6], turn, 1.0),
        ("a zero quaternion", at(2.0), size, [0.0; 4], 1.0),
        (
            "a quaternion of 1e30",
            at(2.0),
            size,
            [1e30, -1e30, 1e29, 3e30],
            1.0,
        ),
        (
            "an opacity logit of 50",
            at(2.0),
            [0.5, 0.3, 0.4],
            turn,
            50.0,
        ),
        (
            "an opacity logit of -5.3",
            at(2.0),
            [0.3, 0.2, 0.1],
            turn,
            -5.3,
        ),
        ("an opacity logit of -50", at(2.0), size, turn, -50.0),
        ("behind the camera", at(-3.0), size, turn, 1.0),
        (
            "a centre beside the image",
            beside,
            [2.0, 1.5, 1.0],
            turn,
            1.0,
        ),
        (
            "scales of 1e4 past the near plane",
            at(0.010_01),
            huge,
            turn,
            0.0,
        ),
        ("scales of 1e4 at 1e6", at(1e6), huge, turn, 2.0),
        (
            "a needle, 1e6 to 1, off the axis",
            right,
            [3.0, 3e-6, 3e-6],
            turn,
            3.0,
        ),
    ];
    // One at a time, so that nothing hides behind something else.
    for (what, mean, scale, rotation, logit) in cases {
        let mut scene = Cloud::default();
        scene.push(mean, scale, rotation, logit);
        compare(
            what,
            &scene.rounded(),
            plain(3),
            &camera,
            &Settings::default(),
            0.98,
        );
    }
}

#[test]
fn a_gaussian_on_the_near_plane_is_not_seen() {
    // Numbers that f32 holds, so that its depth is that of the plane on every backend.
    let camera = Camera {
        rotation: glam::DMat3::IDENTITY,
        center: glam::DVec3::ZERO,
        ..camera(24, 17)
    };
    let settings = Settings {
        near: 0.015_625,
        ..Settings::default()
    };
    let turn = [0.9, 0.1, -0.3, 0.2];
    for (what, depth) in [
        ("on the near plane", 0.015_625),
        ("at the camera's centre", 0.0),
    ] {
        let mut scene = Cloud::default();
        scene.push([0.0, 0.0, depth], [0.01; 3], turn, 1.0);
        scene.push([0.0, 0.0, 1.0], [0.1, 0.2, 0.05], turn, 1.0);
        let scene = scene.rounded();
        compare(what, &scene, plain(3), &camera, &settings, 0.98);
        for (name, device) in crate::support::devices() {
            let (_, radii) = run(&scene, plain(3), &camera, &settings, &device, DType::F32);
            assert!(radii[0] == 0 && radii[1] > 0, "{what} on {name}: {radii:?}");
        }
    }
}

#[test]
fn no_gaussians_have_no_gradients() {
    let camera = camera(24, 17);
    for (name, device) in crate::support::devices() {
        for channels in [RGB, plain(5)] {
            let none = Cloud::default();
            let settings = Settings::default();
            let (parts, _) = run(&none, channels, &camera, &settings, &device, DType::F32);
            let [image, transmittance, gradients @ ..] = &parts[..] else {
                panic!("{name}: {} parts", parts.len());
            };
            if channels.sh.is_some() {
                let background = BACKGROUND.map(f64::from);
                assert!(image.chunks(3).all(|pixel| pixel == background), "{name}");
            }
            assert!(transmittance.iter().all(|&t| t == 1.0), "{name}");
            assert!(gradients.iter().all(Vec::is_empty), "{name}");
        }
    }
}

#[test]
fn equal_depths_blend_in_the_order_of_the_scene() {
    let camera = camera(24, 17);
    let forward = camera.rotation.transpose() * glam::DVec3::Z;
    let mut scene = Cloud::default();
    for i in 0..40 {
        scene.push(
            (camera.center + forward * 2.0).to_array(),
            [0.2, 0.1, 0.3],
            [1.0, 0.1, 0.2, 0.0],
            0.05 * f64::from(i) - 1.0,
        );
    }
    compare(
        "40 Gaussians at one depth",
        &scene.rounded(),
        plain(4),
        &camera,
        &Settings::default(),
        0.98,
    );
}

#[test]
fn a_far_away_scene_keeps_its_digits() {
    // The centre of the camera has digits that f32 does not hold.
    let near = camera(41, 30);
    let far = Camera {
        center: near.center + glam::DVec3::new(1000.1, -700.3, 300.7),
        ..near.clone()
    };
    let scene = cloud(60, 0.05, &far, 4).rounded();
    compare(
        "a camera 1,260 units from the origin",
        &scene,
        RGB,
        &far,
        &Settings::default(),
        0.98,
    );
}

#[test]
fn a_wide_image_keeps_its_digits() {
    // At pixel 1900 an f32 holds a ten-thousandth of a pixel, and small splats see it.
    let mut camera = camera(1920, 40);
    camera.cy = 20.0;
    for (n, scale, seed) in [(1500, 0.003, 1), (1500, 0.0003, 2)] {
        compare(
            "1,920 pixels wide, small Gaussians",
            &cloud(n, scale, &camera, seed).rounded(),
            plain(3),
            &camera,
            &Settings::default(),
            0.98,
        );
    }
}

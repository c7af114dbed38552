//! Circles of cameras around a scene or an object.

use crate::support::turned_cameras::{assert_rotation, camera, looking};
use coseg::splat::camera::{Camera, level_up};
use coseg::splat::camera_path::{Orbit, focus, is_front_facing, sway};
use glam::{DQuat, DVec3};
use std::f64::consts::TAU;

/// Cameras on two rings of radius 2 and 3, 1.5 above `at`.
fn rings(at: DVec3) -> Vec<Camera> {
    let eye = |i: usize| {
        let (sin, cos) = (TAU * i as f64 / 10.0).sin_cos();
        at + DVec3::new((2 + i % 2) as f64 * cos, (2 + i % 2) as f64 * sin, 1.5)
    };
    (0..10).map(|i| looking(eye(i), at)).collect()
}

#[test]
fn an_orbit_goes_around_what_the_cameras_look_at() {
    let at = DVec3::new(4e5, 5e6, 12.0);
    let cameras = rings(at);
    assert!(focus(&cameras).unwrap().distance(at) < 1e-6);
    assert!(level_up(&cameras).distance(DVec3::Z) < 1e-9);
    let orbit = Orbit::of_cameras(&cameras, DVec3::ZERO).unwrap();
    assert!(
        (orbit.radius - 3.0).abs() < 1e-6 && (orbit.height - 1.5).abs() < 1e-6,
        "{orbit:?}"
    );
    let frames = orbit.frames(&cameras[0], 8).unwrap();
    for (i, frame) in frames.iter().enumerate() {
        assert_rotation(frame);
        let (sin, cos) = (TAU * i as f64 / 8.0).sin_cos();
        let want = at + DVec3::new(3.0 * cos, 3.0 * sin, 1.5);
        assert!(
            frame.center.distance(want) < 1e-5,
            "frame {i}: {}",
            frame.center - at
        );
        let (u, v, _) = frame.project(at).expect("in front");
        assert!(
            (u - 40.0).abs() < 1e-4 && (v - 30.0).abs() < 1e-4,
            "frame {i} looks at {u}, {v}"
        );
        let (_, above, _) = frame.project(at + DVec3::Z).expect("in front");
        assert!(above < 29.0, "up is up in frame {i}");
        assert_eq!(
            (frame.fx, frame.fy, frame.cx, frame.width),
            (80.0, 81.0, 40.0, 80)
        );
    }
    assert!(orbit.frames(&cameras[0], 0).unwrap().is_empty());
    for bad in [
        Orbit {
            radius: 0.0,
            ..orbit
        },
        Orbit {
            radius: f64::NAN,
            ..orbit
        },
        Orbit {
            up: DVec3::ZERO,
            ..orbit
        },
    ] {
        crate::support::assert_names(
            &bad.frames(&cameras[0], 3).expect_err("no circle"),
            &["orbit"],
        );
    }
}

#[test]
fn where_the_cameras_look_at_nothing_the_scene_is_orbited() {
    let center = DVec3::new(1.0, 2.0, 0.0);
    // Side by side; one alone; outwards from one place.
    let parallel: Vec<Camera> = (0..4)
        .map(|i| {
            looking(
                DVec3::new(f64::from(i), -5.0, 1.0),
                DVec3::new(f64::from(i), 9.0, 1.0),
            )
        })
        .collect();
    let outwards: Vec<Camera> = (0..6)
        .map(|i| DVec3::new(f64::from(i).sin(), f64::from(i).cos(), 0.3))
        .map(|d| looking(0.1 * d, 5.0 * d))
        .collect();
    for cameras in [&parallel, &outwards, &parallel[..1].to_vec()] {
        assert_eq!(focus(cameras), None);
        let orbit = Orbit::of_cameras(cameras, center).unwrap();
        assert_eq!(orbit.target, center);
        let farthest = cameras
            .iter()
            .map(|c| c.center.distance(center))
            .fold(0.0, f64::max);
        assert!(orbit.radius <= farthest + 1e-9, "{orbit:?}");
    }
    let error = Orbit::of_cameras(&parallel[..1], parallel[0].center).expect_err("no radius");
    crate::support::assert_names(&error, &["orbit", "radius"]);
}

#[test]
fn an_object_fills_its_orbit() {
    let cameras = rings(DVec3::ZERO);
    let ball =
        |half: f64| Orbit::of_box(&cameras, DVec3::splat(-half), DVec3::splat(half)).unwrap();
    let small = ball(0.3);
    let far = DVec3::new(3.0, 0.0, 1.5).length();
    let distance = small.radius.hypot(small.height);
    assert!(
        distance < 0.9 * far && (small.height / small.radius - 0.5).abs() < 1e-9,
        "{small:?}"
    );
    // Its corners are within each image, nearly as large as it.
    let mut largest = 0.0_f64;
    for frame in small.frames(&cameras[0], 12).unwrap() {
        for corner in 0..8 {
            let sign = |bit: usize| if corner >> bit & 1 == 1 { 0.3 } else { -0.3 };
            let (u, v, _) = frame
                .project(DVec3::new(sign(0), sign(1), sign(2)))
                .expect("in front");
            assert!(
                (0.0..80.0).contains(&u) && (0.0..60.0).contains(&v),
                "{u}, {v}"
            );
            largest = largest.max((v - 30.0).abs());
        }
    }
    assert!(largest > 20.0, "{largest}");
    // One as large as the scene is seen from where the cameras are, one without a size not from within it.
    let (large, point) = (ball(50.0), ball(0.0));
    assert!(
        (large.radius.hypot(large.height) - far).abs() < 1e-9,
        "{large:?}"
    );
    assert!(
        (point.radius.hypot(point.height) - 0.1 * far).abs() < 1e-9,
        "{point:?}"
    );
}

#[test]
fn another_size_keeps_pixels_square() {
    let one = camera(DVec3::ZERO, DQuat::IDENTITY);
    assert_eq!(one.with_size(160, 120), one.resized(160, 120));
    let wide = one.with_size(200, 120);
    assert_eq!(
        (wide.fx, wide.fy, wide.cx, wide.cy, wide.width, wide.height),
        (160.0, 162.0, 100.0, 60.0, 200, 120)
    );
    let p = DVec3::new(0.1, -0.05, 1.0);
    let ((u, v, _), (wide_u, wide_v, _)) = (one.project(p).unwrap(), wide.project(p).unwrap());
    assert!(
        (wide_u - (2.0 * u + 20.0)).abs() < 1e-12 && (wide_v - 2.0 * v).abs() < 1e-12,
        "{wide_u} {wide_v}"
    );
}

#[test]
fn strays_do_not_move_the_middle_of_a_scene() {
    let (mut gaussians, _) = crate::support::plates::plates();
    let before = gaussians.median_center().expect("Gaussians");
    let mut middle: Vec<f32> = gaussians.means.iter().map(|mean| mean[1]).collect();
    middle.sort_by(f32::total_cmp);
    assert_eq!(before[1], middle[middle.len() / 2]);
    gaussians.means[0] = [1e30, -1e30, 1e30];
    let moved = gaussians.median_center().expect("Gaussians");
    assert!(
        before.iter().zip(moved).all(|(a, b)| (a - b).abs() < 0.3),
        "{before:?} became {moved:?}"
    );
    assert_eq!(gaussians.select(&[]).median_center(), None);
}

#[test]
fn cameras_that_look_one_way_sway_among_themselves() {
    let at = DVec3::new(4e5, 5e6, 12.0);
    let arc = |half: f64| -> Vec<Camera> {
        let angle = |i: usize| half.to_radians() * (i as f64 / 4.0 - 1.0);
        let eye = |i: usize| at + 5.0 * DVec3::new(angle(i).sin(), -angle(i).cos(), 0.0);
        (0..9).map(|i| looking(eye(i), at)).collect()
    };
    assert!(!is_front_facing(&rings(at)) && !is_front_facing(&arc(90.0)));
    assert!(is_front_facing(&arc(45.0)) && is_front_facing(&arc(0.0)));
    let cameras = arc(20.0);
    let frames = sway(&cameras, DVec3::ZERO, 8).unwrap();
    let wide = 5.0 * 20_f64.to_radians().sin();
    for (i, frame) in frames.iter().enumerate() {
        assert_rotation(frame);
        let offset = frame.center - at;
        assert!(
            offset.x.abs() < wide && offset.y < -4.5,
            "frame {i}: {offset}"
        );
        let (u, v, _) = frame.project(at).expect("in front");
        assert!(
            (u - 40.0).abs() < 1e-3 && (v - 30.0).abs() < 1e-3,
            "frame {i} looks at {u}, {v}"
        );
        let (_, above, _) = frame.project(at + DVec3::Z).expect("in front");
        assert!(above < 29.0, "up is up in frame {i}");
    }
    let [left, right] = [2, 6].map(|i| frames[i].center.x - at.x);
    assert!(
        left * right < 0.0 && left.abs() > 0.5 * wide,
        "{left} {right}"
    );
    // One place and one direction: parallel, or at the centre of the scene where that is ahead.
    let alone = sway(&arc(0.0), at + DVec3::NEG_Y * 9.0, 3).unwrap();
    assert!(alone.iter().all(|frame| frame.center == alone[0].center));
    assert!(sway(&[], at, 3).is_err());
}

//! Paths through cameras and circles around things.

use coseg::splat::camera::{Camera, level_up};
use coseg::splat::camera_path::{CameraPath, Orbit, focus};
use glam::{DMat3, DQuat, DVec3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// A camera at `center` whose axes in the world are those of `rotation`.
fn camera(center: DVec3, rotation: DQuat) -> Camera {
    let rotation = DMat3::from_quat(rotation).transpose();
    Camera {
        rotation,
        center,
        fx: 80.0,
        fy: 81.0,
        cx: 40.0,
        cy: 30.0,
        width: 80,
        height: 60,
    }
}

/// A camera at `eye` that looks at `at`, z up.
fn looking(eye: DVec3, at: DVec3) -> Camera {
    let forward = (at - eye).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let axes = DMat3::from_cols(right, forward.cross(right), forward);
    camera(eye, DQuat::from_mat3(&axes))
}

/// Cameras here and there, none where another is.
fn some(count: usize) -> Vec<Camera> {
    let pose = |i: usize| {
        let t = i as f64;
        let center =
            DVec3::new(3.0 * (1.3 * t).sin(), 2.0 * (0.7 * t).cos(), 0.4 * t) + DVec3::splat(1e5);
        camera(
            center,
            DQuat::from_euler(glam::EulerRot::ZYX, 0.8 * t, 0.3 * (2.0 * t).sin(), 0.2 * t),
        )
    };
    (0..count).map(pose).collect()
}

fn angle(a: &Camera, b: &Camera) -> f64 {
    let trace = (a.rotation * b.rotation.transpose()).to_cols_array();
    let from_trace = (0.5 * (trace[0] + trace[4] + trace[8] - 1.0))
        .clamp(-1.0, 1.0)
        .acos();
    // The arc cosine has few digits near 0.
    let (a, b) = (a.rotation.to_cols_array(), b.rotation.to_cols_array());
    let chord = a
        .iter()
        .zip(b)
        .map(|(a, b)| (a - b).powi(2))
        .sum::<f64>()
        .sqrt();
    if from_trace < 0.1 {
        chord / 2.0_f64.sqrt()
    } else {
        from_trace
    }
}

fn assert_same_pose(a: &Camera, b: &Camera, what: &str) {
    assert!(
        a.center.distance(b.center) < 1e-9 && angle(a, b) < 1e-9,
        "{what}: {a:?} is not {b:?}"
    );
}

fn assert_rotation(camera: &Camera) {
    let off = camera.rotation.transpose() * camera.rotation - DMat3::IDENTITY;
    assert!(
        off.to_cols_array().iter().all(|v| v.abs() < 1e-12),
        "{camera:?}"
    );
    assert!(
        camera.rotation.determinant() > 0.0 && camera.center.is_finite(),
        "{camera:?}"
    );
}

#[test]
fn a_path_goes_through_its_cameras_in_order() {
    let keys = some(9);
    let path = CameraPath::through(&keys).unwrap();
    let at = path.key_lengths();
    assert_eq!((at.len(), at[0], at[8]), (9, 0.0, path.length()));
    assert!(at.windows(2).all(|pair| pair[0] < pair[1]), "{at:?}");
    for (i, (key, &length)) in keys.iter().zip(&at).enumerate() {
        assert_same_pose(&path.at(length), key, &format!("key {i}"));
    }
    let frames = path.frames(50);
    assert_eq!(frames.len(), 50);
    assert_same_pose(&frames[0], &keys[0], "start");
    assert_same_pose(&frames[49], &keys[8], "end");
    assert!(
        frames
            .iter()
            .all(|frame| (frame.width, frame.height, frame.fx, frame.fy) == (80, 60, 80.0, 81.0))
    );
    path.frames(333).iter().for_each(assert_rotation);
    // Beyond the ends there are the ends.
    assert_same_pose(&path.at(-1.0), &keys[0], "before");
    assert_same_pose(&path.at(1e9), &keys[8], "after");
    assert!(path.at(f64::NAN).center.is_finite());
}

#[test]
fn frames_are_evenly_spaced_and_nothing_jumps() {
    let keys = some(7);
    let path = CameraPath::through(&keys).unwrap();
    let mean = keys.iter().map(|key| key.center / 7.0).sum::<DVec3>();
    let spread = (keys
        .iter()
        .map(|key| key.center.distance_squared(mean))
        .sum::<f64>()
        / 7.0)
        .sqrt();
    let frames = path.frames(2001);
    let steps: Vec<f64> = frames
        .windows(2)
        .map(|f| {
            f[0].center
                .distance(f[1].center)
                .hypot(spread * angle(&f[0], &f[1]))
        })
        .collect();
    let even = path.length() / 2000.0;
    let worst = steps
        .iter()
        .map(|step| (step / even - 1.0).abs())
        .fold(0.0, f64::max);
    assert!(worst < 0.02, "steps differ from {even} by up to {worst}");
    // Directions of travel and of turning change no more from step to step anywhere, at the keys either.
    let moved: Vec<DVec3> = frames
        .windows(2)
        .map(|f| (f[1].center - f[0].center) / even)
        .collect();
    let bend = moved
        .windows(2)
        .map(|m| m[0].distance(m[1]))
        .fold(0.0, f64::max);
    assert!(bend < 0.05, "travel bends by {bend} a step");
    let turned = |f: &[Camera]| (f[1].rotation * f[0].rotation.transpose()).to_cols_array();
    let turns: Vec<[f64; 9]> = frames.windows(2).map(turned).collect();
    let change = |t: &[[f64; 9]]| {
        t[0].iter()
            .zip(t[1])
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max)
            * spread
            / even
    };
    let bend = turns.windows(2).map(change).fold(0.0, f64::max);
    assert!(bend < 0.05, "turning changes by {bend} a step");
}

#[test]
fn two_cameras_give_a_straight_line_the_shorter_way_round() {
    let (a, b) = (
        camera(DVec3::ZERO, DQuat::IDENTITY),
        camera(DVec3::X, DQuat::from_rotation_z(-0.75 * TAU)),
    );
    let frames = CameraPath::through(&[a.clone(), b]).unwrap().frames(5);
    for (i, frame) in frames.iter().enumerate() {
        let part = i as f64 / 4.0;
        let want = camera(DVec3::X * part, DQuat::from_rotation_z(part * FRAC_PI_2));
        assert_same_pose(frame, &want, &format!("frame {i}"));
    }
    // Intrinsics go along; an image of another size is brought to the first one's.
    let zoomed = Camera {
        fx: 320.0,
        fy: 324.0,
        cx: 70.0,
        cy: 60.0,
        width: 140,
        height: 120,
        center: DVec3::Y,
        ..a.clone()
    };
    let path = CameraPath::through(&[a, zoomed]).unwrap();
    let (middle, end) = (path.at(0.5 * path.length()), path.at(path.length()));
    assert_eq!(
        (end.width, end.height, end.fx, end.fy, end.cx, end.cy),
        (80, 60, 160.0, 162.0, 40.0, 30.0)
    );
    assert!(
        (middle.fx - 120.0).abs() < 1e-9 && (middle.fy - 121.5).abs() < 1e-9,
        "{middle:?}"
    );
}

#[test]
fn turning_on_the_spot_counts() {
    let at = DVec3::new(1e5, -2.0, 0.1);
    let keys = [0.0, 0.1, 1.1, 1.2].map(|turn| camera(at, DQuat::from_rotation_y(turn)));
    let path = CameraPath::through(&keys).unwrap();
    assert!((path.length() - 1.2).abs() < 1e-6, "{}", path.length());
    let frames = path.frames(13);
    for (i, pair) in frames.windows(2).enumerate() {
        assert!(
            (angle(&pair[0], &pair[1]) - 0.1).abs() < 2e-3,
            "step {i}: {}",
            angle(&pair[0], &pair[1])
        );
        assert!(pair[1].center.distance(at) < 1e-9);
    }
}

#[test]
fn paths_of_few_repeated_and_opposite_cameras() {
    let one = camera(DVec3::splat(2.0), DQuat::from_rotation_x(1.0));
    for keys in [
        vec![one.clone()],
        vec![one.clone(); 2],
        vec![one.clone(); 5],
    ] {
        let path = CameraPath::through(&keys).unwrap();
        assert_eq!((path.length(), path.key_lengths()), (0.0, vec![0.0]));
        let frames = path.frames(3);
        assert_eq!(frames.len(), 3);
        frames
            .iter()
            .for_each(|frame| assert_same_pose(frame, &one, "the only camera"));
        assert!(path.frames(0).is_empty());
    }
    // Repeated ones are passed once, without a stop.
    let keys = some(4);
    let repeated = [0, 0, 1, 2, 2, 2, 3, 3].map(|i: usize| keys[i].clone());
    let (once, again) = (
        CameraPath::through(&keys).unwrap(),
        CameraPath::through(&repeated).unwrap(),
    );
    assert_eq!(once.key_lengths(), again.key_lengths());
    assert_eq!(once.frames(20), again.frames(20));
    assert_eq!(once.frames(1).len(), 1);
    assert_same_pose(&once.frames(1)[0], &keys[0], "one frame");
    // Opposite directions, and there and back again.
    let back = camera(
        DVec3::splat(2.0),
        DQuat::from_rotation_x(1.0) * DQuat::from_rotation_y(PI),
    );
    let away = camera(DVec3::new(5.0, 2.0, 2.0), DQuat::from_rotation_z(PI));
    let keys = [one.clone(), back.clone(), one.clone(), away, one];
    let path = CameraPath::through(&keys).unwrap();
    for (key, length) in keys.iter().zip(path.key_lengths()) {
        assert_same_pose(&path.at(length), key, "opposite");
    }
    let frames = path.frames(400);
    frames.iter().for_each(assert_rotation);
    let most = frames
        .windows(2)
        .map(|f| angle(&f[0], &f[1]))
        .fold(0.0, f64::max);
    assert!(most < 0.1, "a step turns by {most}");
}

#[test]
fn unusable_cameras_are_named() {
    let refused = |cameras: &[Camera], parts: &[&str]| {
        crate::support::assert_names(&CameraPath::through(cameras).expect_err("no path"), parts);
        crate::support::assert_names(
            &Orbit::of_cameras(cameras, DVec3::ZERO).expect_err("no orbit"),
            parts,
        );
        crate::support::assert_names(
            &Orbit::of_box(cameras, DVec3::ZERO, DVec3::ONE).expect_err("no orbit"),
            parts,
        );
    };
    refused(&[], &["cameras", "none"]);
    let good = camera(DVec3::X, DQuat::IDENTITY);
    let second = |change: fn(&mut Camera)| {
        let mut bad = good.clone();
        change(&mut bad);
        [good.clone(), bad]
    };
    refused(
        &second(|c| c.center.y = f64::NAN),
        &["cameras[1]", "pose", "finite"],
    );
    refused(&second(|c| c.fx = 0.0), &["cameras[1]", "fx"]);
    refused(&second(|c| c.height = 0), &["cameras[1]", "height"]);
    refused(&second(|c| c.rotation *= 2.0), &["cameras[1]", "rotation"]);
    refused(
        &second(|c| c.rotation = -c.rotation),
        &["cameras[1]", "rotation"],
    );
    let far = second(|c| c.center.x = 1e300);
    crate::support::assert_names(
        &CameraPath::through(&far).expect_err("no path"),
        &["further apart"],
    );
}

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

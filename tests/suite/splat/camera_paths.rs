//! Paths through cameras.

use crate::support::turned_cameras::{assert_rotation, camera, some};
use coseg::splat::camera::Camera;
use coseg::splat::camera_path::{CameraPath, Orbit};
use glam::{DQuat, DVec3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

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

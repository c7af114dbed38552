//! Which way cameras say is up.

use coseg::data::{LoadOptions, load_cameras};
use coseg::splat::camera::{Camera, level_up};
use glam::{DMat3, DQuat, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A camera that looks along the horizontal `azimuth`, `tilt` above it, rolled, all in radians; z is up.
fn camera(azimuth: f64, tilt: f64, roll: f64) -> Camera {
    let level = DVec3::new(azimuth.cos(), azimuth.sin(), 0.0);
    let right = level.cross(DVec3::Z);
    let forward = level * tilt.cos() + DVec3::Z * tilt.sin();
    let axes =
        DMat3::from_cols(right, forward.cross(right), forward) * DMat3::from_rotation_z(roll);
    let rotation = axes.transpose();
    Camera {
        rotation,
        center: DVec3::ZERO,
        fx: 80.0,
        fy: 80.0,
        cx: 40.0,
        cy: 30.0,
        width: 80,
        height: 60,
    }
}

fn degrees(cameras: &[Camera]) -> f64 {
    let up = level_up(cameras);
    assert!((up.length() - 1.0).abs() < 1e-12, "{up}");
    up.angle_between(DVec3::Z).to_degrees()
}

#[test]
fn a_common_tilt_of_level_cameras_does_not_tilt_the_world() {
    // A sixth of a circle around something, looked down at: the cameras' own mean is 24 degrees off.
    let arc = |roll: &mut dyn FnMut() -> f64| -> Vec<Camera> {
        (0..30)
            .map(|i| camera(f64::from(i) / 30.0, -0.45, roll()))
            .collect()
    };
    assert!(degrees(&arc(&mut || 0.0)) < 1.2);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let held = arc(&mut || rng.random_range(-0.07..0.07));
    assert!(degrees(&held) < 4.0, "{}", degrees(&held));
    // All around, tilted and rolled at random.
    let room: Vec<Camera> = (0..60)
        .map(|i| {
            camera(
                f64::from(i),
                rng.random_range(-0.6..0.2),
                rng.random_range(-0.1..0.1),
            )
        })
        .collect();
    assert!(degrees(&room) < 1.0, "{}", degrees(&room));
    // In another world.
    let turn = DQuat::from_euler(glam::EulerRot::XYZ, 2.0, -1.0, 0.5);
    let turned: Vec<Camera> = room
        .iter()
        .map(|c| Camera {
            rotation: c.rotation * DMat3::from_quat(turn).transpose(),
            ..c.clone()
        })
        .collect();
    assert!(level_up(&turned).distance(turn * level_up(&room)) < 1e-9);
}

#[test]
fn a_short_row_held_by_hand_is_not_much_worse_than_its_mean() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut normal =
        |sd: f64| sd.to_radians() * (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
    for (count, yaw) in [(3, 3.0), (5, 5.0), (20, 5.0)] {
        let mut worse = [0.0; 2];
        for _ in 0..50 {
            let row: Vec<Camera> = (0..count)
                .map(|_| camera(normal(yaw), normal(3.0), normal(3.0)))
                .collect();
            let mean = -row.iter().map(|c| c.rotation.row(1)).sum::<DVec3>();
            worse[0] += degrees(&row) / 50.0;
            worse[1] += mean.angle_between(DVec3::Z).to_degrees() / 50.0;
        }
        println!(
            "{count} cameras, {yaw} degrees apart: {:.2} degrees off, their mean {:.2}",
            worse[0], worse[1]
        );
        // Without a common tilt the mean is the best there is, and a short row leaves little else to go by.
        assert!(worse[0] < worse[1] + 4.0, "{count}: {worse:?}");
    }
}

#[test]
fn where_levelness_says_nothing_the_cameras_own_up_does() {
    // One camera, and a row of parallel ones: nobody can know their tilt.
    let tilt = 0.2_f64;
    for count in [1, 5] {
        let row = vec![camera(0.7, tilt, 0.0); count];
        assert!((degrees(&row) - tilt.to_degrees()).abs() < 1e-9);
    }
    // Every other photo turned by 90 degrees: no levelness, but a mean of both.
    let turned: Vec<Camera> = (0..40)
        .map(|i| {
            camera(
                f64::from(i),
                0.0,
                if i % 2 == 0 {
                    0.0
                } else {
                    std::f64::consts::FRAC_PI_2
                },
            )
        })
        .collect();
    assert!(degrees(&turned) < 5.0, "{}", degrees(&turned));
    // Straight down, as a drone has them: all around, and to and fro.
    let down = |heading: f64| camera(heading, -std::f64::consts::FRAC_PI_2, 0.0);
    let around: Vec<Camera> = (0..20).map(|i| down(f64::from(i))).collect();
    let rows: Vec<Camera> = (0..20)
        .map(|i| down(f64::from(i % 2) * std::f64::consts::PI))
        .collect();
    assert!(degrees(&around) < 1e-3 && degrees(&rows) < 1e-3);
    // Nothing; opposites, of which the first counts; and what is not a rotation.
    assert!(level_up(&[]).distance(DVec3::Z) < 1e-12);
    assert!(
        degrees(&[
            camera(0.0, 0.0, 0.0),
            camera(2.0, 0.0, std::f64::consts::PI)
        ]) < 1e-3
    );
    let broken = Camera {
        rotation: DMat3::from_cols_array(&[f64::NAN; 9]),
        ..camera(0.0, 0.0, 0.0)
    };
    assert!(level_up(&[broken]).is_finite());
}

#[test]
fn real_rooms_stand_upright() {
    let Some(shared) = crate::support::shared_dir() else {
        return;
    };
    for room in ["house_living", "house_kitchen", "studio"] {
        let named = load_cameras(
            &shared.join("data").join(room),
            &LoadOptions::default(),
            None,
        )
        .expect("cameras");
        let cameras: Vec<Camera> = named.into_iter().map(|named| named.camera).collect();
        let mean = -cameras.iter().map(|c| c.rotation.row(1)).sum::<DVec3>();
        let own = mean.angle_between(DVec3::Z).to_degrees();
        println!(
            "{room}: {:.2} degrees off, the cameras' mean {own:.2}",
            degrees(&cameras)
        );
        assert!(degrees(&cameras) < 0.6 && own > 2.0);
    }
}

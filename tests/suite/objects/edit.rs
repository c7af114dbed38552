//! Objects of a labelled scene: listed, picked, removed, turned and moved.

use crate::support::hard_labels::hard_label_map;
use crate::support::plates::{HEIGHT, WIDTH, camera, plates};
use coseg::objects::{inventory, pick};
use coseg::raster::{Projected, Settings, render};
use coseg::splat::camera::Camera;
use coseg::splat::{Gaussians, Motion};
use glam::{DMat3, DQuat, DVec3};

/// The plates with long axes in all directions and colours of degree 3.
fn colourful() -> Gaussians {
    let (mut g, _) = plates();
    g.sh_degree = 3;
    let waves = |seed: f32| move |i: usize| (1.7 * i as f32 + seed).sin();
    g.sh = (0..48 * g.len()).map(waves(0.2)).map(|v| 0.3 * v).collect();
    for i in 0..g.len() {
        g.rotations[i] = [0.3, 1.1, 2.3, 0.7].map(|seed| 1.5 * waves(seed)(i));
        g.log_scales[i][0] -= 1.0;
        g.log_scales[i][1] += 0.5;
    }
    g
}

fn rows(g: &Gaussians) -> Vec<u32> {
    (0..g.len() as u32).collect()
}

#[test]
fn a_camera_that_moves_along_sees_the_same() {
    let before = colourful();
    let turn = DQuat::from_axis_angle(DVec3::new(0.3, -0.8, 0.5).normalize(), 2.1);
    let motion = Motion {
        rotation: turn,
        pivot: DVec3::new(0.4, -0.2, 0.9),
        translation: DVec3::new(-1.0, 0.5, 2.0),
    };
    let mut after = before.clone();
    motion.apply(&mut after, &rows(&before));
    let still = camera(2);
    let moved = Camera {
        rotation: still.rotation * DMat3::from_quat(turn).transpose(),
        center: turn * (still.center - motion.pivot) + motion.pivot + motion.translation,
        ..still.clone()
    };
    let image = |g, camera| render(g, camera, &Settings::default(), [0.0; 3]).unwrap();
    let (want, got) = (image(&before, &still), image(&after, &moved));
    let largest = want
        .rgb
        .iter()
        .zip(&got.rgb)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max);
    assert!(largest < 2e-4, "a colour moved by {largest}");
    // The scene is seen from elsewhere when the camera stays.
    let other = image(&after, &still);
    assert!(
        want.rgb
            .iter()
            .zip(&other.rgb)
            .any(|(a, b)| (a - b).abs() > 0.1)
    );
}

#[test]
fn colours_do_not_turn_with_a_mere_shift() {
    let before = colourful();
    let mut after = before.clone();
    let shift = DVec3::new(0.25, -0.5, 2.0);
    let motion = Motion {
        rotation: DQuat::IDENTITY,
        pivot: DVec3::new(3.0, 4.0, 5.0),
        translation: shift,
    };
    motion.apply(&mut after, &[3, 7]);
    assert_eq!(
        (&after.sh, &after.rotations, &after.log_scales),
        (&before.sh, &before.rotations, &before.log_scales)
    );
    for (i, (a, b)) in after.means.iter().zip(&before.means).enumerate() {
        let by = if [3, 7].contains(&i) {
            shift
        } else {
            DVec3::ZERO
        };
        let want = (DVec3::from(b.map(f64::from)) + by).as_vec3().to_array();
        assert!(
            a.iter().zip(want).all(|(a, w)| (a - w).abs() <= 1e-6),
            "{i}: {a:?} for {want:?}"
        );
    }
}

#[test]
fn a_turn_of_four_quarters_is_none_and_zero_quaternions_stay_harmless() {
    let mut before = colourful();
    before.rotations[5] = [0.0; 4];
    before.rotations[6] = [0.0, 1e-7, 0.0, 0.0];
    let mut after = before.clone();
    let quarter = DQuat::from_axis_angle(DVec3::Y, std::f64::consts::FRAC_PI_2);
    let motion = Motion {
        rotation: quarter,
        pivot: DVec3::splat(0.3),
        translation: DVec3::ZERO,
    };
    for _ in 0..4 {
        motion.apply(&mut after, &rows(&before));
    }
    let close = |a: &[f32], b: &[f32]| {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5)
    };
    assert!(
        close(&after.sh, &before.sh)
            && close(after.means.as_flattened(), before.means.as_flattened())
    );
    for (a, b) in after.rotations.iter().zip(&before.rotations) {
        // q and -q are one rotation; a zero quaternion stands for none.
        let b = if b.iter().all(|v| v.abs() < 1e-6) {
            [1.0, 0.0, 0.0, 0.0]
        } else {
            *b
        };
        assert!(close(a, &b) || close(a, &b.map(|v| -v)), "{a:?} for {b:?}");
    }
}

#[test]
fn a_pixel_gives_the_label_that_is_rendered_there() {
    let (gaussians, labels) = plates();
    let projected = Projected::new(&gaussians.splats(), &camera(3), &Settings::default()).unwrap();
    let map = hard_label_map(&projected, &labels, 0.0);
    let objects = inventory(&gaussians, &labels);
    assert_eq!(
        objects
            .iter()
            .map(|o| (o.id, o.rows.len()))
            .collect::<Vec<_>>(),
        [(1, 25), (2, 25), (3, 25), (4, 36)]
    );
    let mut seen = 0;
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let Some(picked) = pick(&projected, &gaussians, &labels, [x, y]) else {
                continue;
            };
            assert_eq!(picked.id, map.ids[y * WIDTH + x], "{x}, {y}");
            assert!(picked.weight > 0.0 && picked.weight <= 1.0 + 1e-5);
            let own = objects[usize::from(picked.id) - 1]
                .rows
                .iter()
                .map(|&row| gaussians.means[row as usize]);
            let (low, high) = own.fold(([f64::MAX; 3], [f64::MIN; 3]), |(low, high), mean| {
                let wide = mean.map(f64::from);
                (
                    [0, 1, 2].map(|c| low[c].min(wide[c])),
                    [0, 1, 2].map(|c| high[c].max(wide[c])),
                )
            });
            let slack = DVec3::splat(1e-4);
            let inside = picked.point.cmpge(DVec3::from(low) - slack)
                & picked.point.cmple(DVec3::from(high) + slack);
            assert!(inside.all(), "{picked:?} in {low:?}, {high:?}");
            seen += 1;
        }
    }
    assert!(seen > WIDTH * HEIGHT / 2, "{seen}");
}

#[test]
fn a_box_leaves_strays_out() {
    let mut gaussians = plates().0.select(&[0; 300]);
    for (i, mean) in gaussians.means.iter_mut().enumerate() {
        *mean = [i as f32 / 299.0, 0.0, 1.0];
    }
    gaussians.means[7] = [1e6, -1e6, 50.0];
    let objects = inventory(&gaussians, &[9; 300]);
    let [object] = objects.as_slice() else {
        panic!("one object")
    };
    assert!(
        object.low.x > 0.0 && object.low.x < 0.02 && object.high.x > 0.98 && object.high.x < 1.0,
        "{object:?}"
    );
    assert_eq!(
        (object.low.y, object.high.y, object.low.z, object.high.z),
        (0.0, 0.0, 1.0, 1.0)
    );
    // Of few Gaussians at least the outermost one.
    let few = inventory(&gaussians.select(&(0..30).collect::<Vec<u32>>()), &[9; 30]);
    assert!(few[0].high.x < 0.1 && few[0].low.x > 0.0, "{few:?}");
    let one = inventory(&gaussians.select(&[4]), &[9]);
    assert_eq!(
        (one[0].low, one[0].high),
        (one[0].center(), one[0].center())
    );
}

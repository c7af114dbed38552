//! Gradients of the rasterizer against finite differences in f64.

use crate::support::finite_differences::{Loss, SMOOTH, check, differences, gradients, loss_of};
use crate::support::raster_reference::{
    self as reference, Cloud, camera, cloud, cloud_far_from_cuts, numbers,
};
use coseg::raster::Settings;
use coseg::splat::camera::Camera;

/// Checks every input of one scene.
fn check_scene(what: &str, c: &Cloud, channels: usize, camera: &Camera, s: &Settings, step: f64) {
    let values = numbers(c.len() * channels, 5);
    let loss = Loss::new(camera, channels);
    let got = gradients(c, &values, channels, camera, s, &loss);
    let varied = |pick: fn(&mut Cloud) -> &mut Vec<f64>| {
        let mut c = c.clone();
        let x = pick(&mut c).clone();
        differences(&x, step, |x| {
            pick(&mut c).copy_from_slice(x);
            loss_of(&c, &values, channels, camera, s, &loss)
        })
    };
    let name = |tensor: &str| format!("{what}, {channels} channels, {tensor}");
    check(&name("means"), &got.means, &varied(|c| &mut c.means));
    check(
        &name("log_scales"),
        &got.log_scales,
        &varied(|c| &mut c.log_scales),
    );
    check(
        &name("rotations"),
        &got.rotations,
        &varied(|c| &mut c.rotations),
    );
    check(
        &name("opacity_logits"),
        &got.opacity_logits,
        &varied(|c| &mut c.opacity_logits),
    );
    if channels > 0 {
        let d_values = differences(&values, step, |v| loss_of(c, v, channels, camera, s, &loss));
        check(&name("values"), &got.values, &d_values);
    }
    // The projected centres: the reference renderer can move them one by one.
    let mut shifts = vec![0.0; 2 * c.len()];
    let screen = differences(&shifts.clone(), step, |x| {
        shifts.copy_from_slice(x);
        let out = reference::render_shifted(c, &values, channels, camera, s, &shifts);
        loss.of(&out.image, &out.transmittance)
    });
    let half = [camera.width as f64 / 2.0, camera.height as f64 / 2.0];
    let screen: Vec<f64> = screen
        .iter()
        .enumerate()
        .map(|(i, d)| d * half[i % 2])
        .collect();
    check(&name("screen"), &got.screen, &screen);
}

#[test]
fn smooth_gradients_equal_finite_differences() {
    let camera = camera(23, 18);
    for channels in [0, 1, 2, 3, 4, 5, 13, 23, 70] {
        let scene = cloud(12, 0.06, &camera, 3);
        check_scene("smooth", &scene, channels, &camera, &SMOOTH, 1e-4);
    }
}

#[test]
fn gradients_with_the_default_cut_offs_equal_finite_differences() {
    let camera = camera(23, 18);
    for settings in [
        Settings::default(),
        Settings {
            alpha_max: 0.5,
            t_min: 0.2,
            ..Settings::default()
        },
    ] {
        let scene = cloud_far_from_cuts(10, &camera, &settings, 4e-4);
        for channels in [3, 9] {
            check_scene("cut-offs", &scene, channels, &camera, &settings, 1e-6);
        }
    }
}

#[test]
fn gradients_of_awkward_geometry_equal_finite_differences() {
    let camera = camera(23, 18);
    let at = |u: f64, v: f64, z: f64| (camera.center + camera.ray(u, v) * z).to_array();
    let mut c = Cloud::default();
    // Needles and plates, a quaternion far from unit length, and centres outside the limits of the Jacobian.
    c.push(
        at(8.0, 9.0, 2.0),
        [1e-4, 1e-4, 0.3],
        [0.3, -0.5, 0.8, 0.1],
        1.0,
    );
    c.push(
        at(12.0, 5.0, 2.5),
        [1e-5, 0.4, 0.3],
        [3.0, 40.0, -25.0, 11.0],
        -0.5,
    );
    c.push(
        at(-9.0, 8.0, 3.0),
        [0.9, 0.8, 1.1],
        [0.9, 0.2, 0.1, -0.3],
        0.5,
    );
    c.push(
        at(12.0, 32.0, 2.2),
        [0.8, 0.9, 0.7],
        [0.1, 0.2, -0.7, 0.4],
        0.3,
    );
    c.push(
        at(14.0, 12.0, 4.0),
        [0.2, 0.2, 0.2],
        [0.5, 0.5, 0.5, 0.5],
        4.0,
    );
    check_scene("awkward", &c, 3, &camera, &SMOOTH, 1e-5);
}

//! Normals of views, against the axes of the Gaussians in f64.

use crate::support::raster_reference::{camera, colored_gaussians};
use burn::tensor::Device;
use coseg::objects::{RenderOptions, Renderer};
use coseg::raster::{Projected, Settings};
use glam::{DQuat, DVec3, Vec3};

/// The CPU, and the GPU if there is one.
fn devices() -> Vec<Device> {
    let cpu = crate::support::device();
    #[cfg(feature = "wgpu")]
    return [Some(cpu), crate::support::gpu()]
        .into_iter()
        .flatten()
        .collect();
    #[cfg(not(feature = "wgpu"))]
    vec![cpu]
}

#[test]
fn normals_are_the_shortest_axes_turned_towards_the_camera() {
    let camera = camera(90, 70);
    let gaussians = colored_gaussians(&camera, 0.03);
    let axis = |i: usize| -> DVec3 {
        let scales = gaussians.log_scales[i];
        let shortest = (0..3)
            .min_by(|&a, &b| scales[a].total_cmp(&scales[b]))
            .unwrap();
        let [w, x, y, z] = gaussians.rotations[i].map(f64::from);
        let axis = DQuat::from_xyzw(x, y, z, w).normalize() * DVec3::AXES[shortest];
        let ahead = camera.center - Vec3::from(gaussians.means[i]).as_dvec3();
        axis * ahead.dot(axis).signum()
    };
    let axes: Vec<f32> = (0..gaussians.len())
        .flat_map(|i| axis(i).as_vec3().to_array())
        .collect();
    let projected = Projected::new(&gaussians.splats(), &camera, &Settings::default()).unwrap();
    let blended = projected.blend(&axes, 3);
    let options = RenderOptions::default();
    let mut seen = 0;
    for device in devices() {
        let renderer = Renderer::new(gaussians.clone(), None, options, &device).unwrap();
        let normals = renderer.normals(&camera).unwrap();
        let pixels = blended.image.chunks_exact(3).zip(&blended.transmittance);
        for (normal, (sum, t)) in normals.chunks_exact(3).zip(pixels) {
            let (normal, sum) = (Vec3::from_slice(normal), Vec3::from_slice(sum));
            // At the threshold of coverage, and where normals cancel out, the last digit decides.
            if (1.0 - t - options.min_coverage).abs() < 1e-4 || sum.length() < 1e-2 {
                continue;
            }
            let is_seen = 1.0 - t > options.min_coverage;
            let want = if is_seen { sum.normalize() } else { Vec3::ZERO };
            assert!(normal.distance(want) < 1e-3, "{normal} instead of {want}");
            seen += usize::from(is_seen);
        }
    }
    assert!(seen > 500, "{seen}");
}

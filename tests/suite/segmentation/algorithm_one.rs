//! Lifting by `count` is Algorithm 1 of the paper.

use super::unprojection::Wide;
use crate::support::feature_maps::{cloud, features, map, views};
use crate::support::lifting::unproject;
use crate::support::raster_reference::all_pixels;
use coseg::config::{Normalisation, UnprojectionConfig};
use coseg::raster::{Projected, Settings};
use coseg::segmentation::unprojection::{EPSILON, attended};
use glam::DVec3;

#[test]
fn count_is_algorithm_one_by_brute_force() {
    // Every pixel, every Gaussian, in depth order, from the formulas of the blending alone.
    let scene = cloud(12);
    let views = views(40, 30);
    let wide = Wide::of(&scene);
    let settings = Settings::default();
    let maps = |i: usize| {
        [
            map(40, 30, 3, i),
            map(20, 15, 2, i + 7),
            map(10, 8, 2, i + 8),
            map(5, 4, 2, i + 9),
        ]
    };
    let set = features(&views, maps);
    let device = crate::support::device();
    let lifted = unproject(&scene, views.iter(), &set, Normalisation::Count, &device);
    let lifted = lifted.expect("features");
    let config = UnprojectionConfig {
        attendance: 0.02,
        attendance_pixels: 0.0,
        ..UnprojectionConfig::default()
    };
    let go_on = &mut || Ok(());
    let kept = attended(&scene, views.iter(), &config, &settings, &device, go_on).expect("counts");
    let n = scene.len();
    for (scale, features) in lifted.iter().enumerate() {
        let c = set.views[0].maps[scale].channels;
        let mut counter = vec![0_u64; n];
        let mut buffer = vec![0.0; n * c];
        let mut pixels = 0;
        for (view, features) in views.iter().zip(&set.views) {
            let map = &features.maps[scale];
            let camera = view.camera.resized(map.width, map.height);
            pixels += map.cells();
            let projected =
                Projected::<f64>::new(&wide.splats(), &camera, &settings).expect("view");
            let w = projected.weights(&all_pixels(projected.size()));
            for p in 0..map.cells() {
                let (x, y) = ((p % map.width) as f64 + 0.5, (p / map.width) as f64 + 0.5);
                for i in 0..n {
                    let radius = f64::from(projected.radii()[i]);
                    if radius == 0.0 {
                        continue;
                    }
                    let m = scene.means[i].map(f64::from);
                    let (u, v, _) = camera
                        .project(DVec3::from_array(m))
                        .expect("before the camera");
                    counter[i] += u64::from((x - u).powi(2) + (y - v).powi(2) <= radius * radius);
                    // The buffer is W^T F: a splat more opaque than 0.35 reaches a little beyond its 3 sigma radius.
                    let (columns, weights) = w.row(p);
                    let weight = columns
                        .iter()
                        .zip(weights)
                        .find(|(id, _)| **id as usize == i)
                        .map_or(0.0, |(_, w)| f64::from(*w));
                    for k in 0..c {
                        buffer[i * c + k] += weight * f64::from(map.data[p * c + k]);
                    }
                }
            }
        }
        let expected = |k: usize| buffer[k] / (counter[k / c] as f64 + f64::from(EPSILON));
        let largest = (0..n * c).map(|k| expected(k).abs()).fold(0.0, f64::max);
        for (k, &feature) in features.iter().enumerate() {
            let expected = expected(k);
            assert!(
                (f64::from(feature) - expected).abs() < 1e-4 * largest,
                "{scale} {k}: {feature} {expected}"
            );
        }
        // The finest map has a cell for each pixel.
        if scale == 0 {
            let is_kept = |count: &u64| *count as f64 >= 0.02 * pixels as f64;
            assert_eq!(kept, counter.iter().map(is_kept).collect::<Vec<_>>());
            let pruned = kept.iter().filter(|k| !**k).count();
            assert!(
                pruned > 0 && pruned < n,
                "{pruned} pruned of {n}: the threshold decides something"
            );
        }
    }
}

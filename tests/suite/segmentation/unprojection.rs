//! Unprojection: adjointness at both resolutions, constants, Algorithm 1 by brute force, pruning, unseen Gaussians.

use crate::support::feature_maps::{cameras, cloud, features, map, maps, noise, views};
use crate::support::lifting::{FeatureSet, unproject};
use coseg::config::{Normalisation, Resolution, UnprojectionConfig};
use coseg::data::View;
use coseg::features::{FeatureMap, Steps};
use coseg::raster::{Projected, Settings, Splats};
use coseg::segmentation::unprojection::{EPSILON, Sums};
use coseg::splat::Gaussians;
use glam::DVec3;

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&x| f64::from(x)).collect()
}

/// The geometry in f64.
struct Wide([Vec<f64>; 4]);

impl Wide {
    fn of(g: &Gaussians) -> Self {
        let s = g.splats();
        Self([s.means, s.log_scales, s.rotations, s.opacity_logits].map(wide))
    }
    fn splats(&self) -> Splats<'_, f64> {
        let [means, log_scales, rotations, opacity_logits] = &self.0;
        Splats {
            means,
            log_scales,
            rotations,
            opacity_logits,
        }
    }
}

#[test]
fn buffers_are_the_adjoint_of_rendering() {
    let (scene, cameras, settings) = (cloud(300), cameras(97, 71), Settings::default());
    let (wide, n) = (Wide::of(&scene), scene.len());
    for resolution in [Resolution::Image, Resolution::Feature] {
        let mut sums = Sums::<f64>::new(n, &maps(0).each_ref().map(|m| m.channels));
        let mut left = [0.0; 4];
        let x = |i: usize| noise(i, 99);
        for (v, camera) in cameras.iter().enumerate() {
            let maps = maps(10 * v);
            sums.add(&wide.splats(), camera, &maps, None, resolution, &settings)
                .expect("sums");
            for (scale, map) in maps.iter().enumerate() {
                let c = map.channels;
                let camera = match resolution {
                    Resolution::Image => camera.clone(),
                    Resolution::Feature => map.lattice().camera(camera),
                };
                let values: Vec<f64> = (0..n * c).map(x).collect();
                let image = Projected::<f64>::new(&wide.splats(), &camera, &settings)
                    .expect("view")
                    .blend(&values, c)
                    .image;
                for (p, rendered) in image.chunks_exact(c).enumerate() {
                    let (u, v) = (
                        (p % camera.width) as f64 + 0.5,
                        (p / camera.width) as f64 + 0.5,
                    );
                    let mut read = vec![0.0_f32; c];
                    match resolution {
                        Resolution::Image => {
                            map.sample(u, v, camera.width, camera.height, &mut read)
                        }
                        Resolution::Feature => {
                            read.copy_from_slice(map.cell(p % map.width, p / map.width))
                        }
                    }
                    left[scale] += rendered
                        .iter()
                        .zip(&read)
                        .map(|(a, &b)| a * f64::from(b))
                        .sum::<f64>();
                }
            }
        }
        for (scale, &left) in left.iter().enumerate() {
            let right: f64 = sums.buffers[scale]
                .iter()
                .enumerate()
                .map(|(i, b)| b * x(i))
                .sum();
            let size: f64 = sums.buffers[scale]
                .iter()
                .enumerate()
                .map(|(i, b)| (b * x(i)).powi(2))
                .sum::<f64>()
                .sqrt();
            assert!(size > 1.0, "the test sees something");
            // The read is rounded to f32 in the test, the only rounding of note.
            assert!(
                (left - right).abs() < 1e-6 * size.max(right.abs()),
                "{resolution:?} {scale}: {left} {right}",
            );
        }
    }
}

#[test]
fn feature_resolution_is_the_adjoint_blend_of_the_scaled_camera() {
    let (scene, settings) = (cloud(200), Settings::default());
    let camera = &cameras(97, 71)[1];
    let mut sums = Sums::<f32>::new(scene.len(), &maps(0).each_ref().map(|m| m.channels));
    sums.add(
        &scene.splats(),
        camera,
        &maps(4),
        None,
        Resolution::Feature,
        &settings,
    )
    .expect("sums");
    for (scale, map) in maps(4).iter().enumerate() {
        let scaled = map.lattice().camera(camera);
        let view = Projected::<f32>::new(&scene.splats(), &scaled, &settings).expect("view");
        let expected = view.blend_adjoint(&map.data, map.channels);
        let largest = expected.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
        for (a, b) in sums.buffers[scale].iter().zip(&expected) {
            assert!((a - b).abs() <= 1e-5 * largest);
        }
        assert_eq!(
            sums.counts[scale],
            view.counts()
                .iter()
                .map(|&c| u64::from(c))
                .collect::<Vec<_>>()
        );
        for (a, b) in sums.weights[scale].iter().zip(view.weight_sums()) {
            assert!((a - b).abs() <= 1e-5 * b.max(1.0));
        }
    }
}

#[test]
fn small_gaussians_read_the_cells_that_lie_under_them() {
    // Each cell holds the image point of its centre, so a small Gaussian must get the point at which it is seen.
    let camera = &cameras(480, 360)[0];
    let strides = [4.0, 8.0, 16.0, 32.0];
    let maps: [FeatureMap; 4] = strides.map(|stride| {
        let steps = Some(Steps {
            stride,
            offset: 0.5,
        });
        let (width, height) = (
            480_usize.div_ceil(stride as usize),
            360_usize.div_ceil(stride as usize),
        );
        let cells = (0..height).flat_map(|y| (0..width).map(move |x| [x, y]));
        let data = cells
            .flat_map(|cell| cell.map(|i| (stride * i as f64 + 0.5) as f32))
            .collect();
        FeatureMap {
            width,
            height,
            channels: 2,
            data,
            steps,
        }
    });
    let even = |n: usize| FeatureMap {
        steps: None,
        ..maps[n].clone()
    };
    assert_eq!(maps[3].lattice().center(2, 1, 480, 360), (64.5, 32.5));
    assert_eq!(even(3).lattice().center(2, 0, 480, 360), (80.0, 15.0));
    let settings = Settings {
        alpha_min: 0.0,
        ..Settings::default()
    };
    for (u, v) in [
        (131.0, 107.3),
        (222.7, 180.5),
        (300.1, 140.9),
        (352.4, 236.2),
    ] {
        let at = camera.center + 4.0 * camera.ray(u, v);
        let gaussian = Gaussians {
            means: vec![at.as_vec3().to_array()],
            log_scales: vec![[-7.0; 3]],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]],
            opacity_logits: vec![-1.0],
            sh: vec![0.0; 3],
            sh_degree: 0,
        };
        for resolution in [Resolution::Image, Resolution::Feature] {
            let mut sums = Sums::<f32>::new(1, &[2; 4]);
            sums.add(
                &gaussian.splats(),
                camera,
                &maps,
                None,
                resolution,
                &settings,
            )
            .expect("sums");
            let features = sums.normalised(Normalisation::Weight).buffers;
            for (stride, found) in strides.iter().zip(&features) {
                // A splat of half a pixel (half a cell) is not an integral: a few hundredths of one are lost.
                let tolerance = 0.03
                    * if resolution == Resolution::Image {
                        1.0
                    } else {
                        *stride
                    };
                let off = [f64::from(found[0]) - u, f64::from(found[1]) - v];
                assert!(
                    off.iter().all(|d| d.abs() < tolerance),
                    "{resolution:?} {stride}: {found:?} for {u} {v}"
                );
            }
        }
    }
}

#[test]
fn a_constant_map_unprojects_to_that_constant() {
    let (scene, views) = (cloud(500), views(160, 120));
    let constant = |c: usize| 0.3 + 0.01 * c as f32;
    let set = features(&views, |i| {
        maps(i).map(|m| FeatureMap {
            data: (0..m.data.len())
                .map(|k| constant(k % m.channels))
                .collect(),
            ..m
        })
    });
    for resolution in [Resolution::Image, Resolution::Feature] {
        let config = UnprojectionConfig {
            normalisation: Normalisation::Weight,
            resolution,
            ..UnprojectionConfig::default()
        };
        let lifted = unproject(
            &scene,
            views.iter(),
            &set,
            &config,
            &Settings::default(),
            &crate::support::device(),
        )
        .expect("features");
        let mut seen = 0;
        for (scale, features) in lifted.features.iter().enumerate() {
            let channels = features.len() / scene.len();
            for (i, row) in features.chunks_exact(channels).enumerate() {
                if lifted.weights[scale][i] > 0.0 {
                    seen += 1;
                    for (c, &x) in row.iter().enumerate() {
                        assert!(
                            (x - constant(c)).abs() < 1e-5,
                            "{resolution:?} {scale} {i} {c}: {x}"
                        );
                    }
                } else {
                    assert!(row.iter().all(|&x| x == 0.0) && !lifted.seen[i]);
                }
            }
        }
        assert!(seen > 1500, "{seen}");
        assert!(
            !lifted.seen[scene.len() - 1] && !lifted.keep[scene.len() - 1],
            "nobody sees the last one"
        );
    }
}

#[test]
fn count_is_algorithm_one_by_brute_force() {
    // Every pixel, every Gaussian, in depth order, from the formulas of the blending alone.
    let (scene, views) = (cloud(12), views(40, 30));
    let (wide, settings) = (Wide::of(&scene), Settings::default());
    let maps = |i: usize| {
        [
            map(40, 30, 3, i),
            map(20, 15, 2, i + 7),
            map(10, 8, 2, i + 8),
            map(5, 4, 2, i + 9),
        ]
    };
    let set = features(&views, maps);
    let config = UnprojectionConfig {
        normalisation: Normalisation::Count,
        resolution: Resolution::Feature,
        attendance: 0.02,
        attendance_pixels: 0.0,
    };
    let mut exact = Sums::<f64>::new(scene.len(), &maps(0).each_ref().map(|m| m.channels));
    for (view, features) in views.iter().zip(&set.views) {
        exact
            .add(
                &wide.splats(),
                &view.camera,
                &features.maps,
                None,
                config.resolution,
                &settings,
            )
            .expect("sums");
    }
    let exact = exact.normalised(Normalisation::Count).buffers;
    let lifted = unproject(
        &scene,
        views.iter(),
        &set,
        &config,
        &settings,
        &crate::support::device(),
    )
    .expect("features");
    let n = scene.len();
    for (scale, exact) in exact.iter().enumerate() {
        let c = set.views[0].maps[scale].channels;
        let (mut counter, mut buffer, mut pixels) = (vec![0_u64; n], vec![0.0; n * c], 0);
        for (view, features) in views.iter().zip(&set.views) {
            let map = &features.maps[scale];
            let camera = view.camera.resized(map.width, map.height);
            pixels += map.cells();
            let projected =
                Projected::<f64>::new(&wide.splats(), &camera, &settings).expect("view");
            let w = projected.weights(None);
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
        assert_eq!(lifted.counts[scale], counter);
        let largest = buffer
            .iter()
            .zip(0..)
            .map(|(b, k)| (b / (counter[k / c] as f64 + EPSILON)).abs())
            .fold(0.0, f64::max);
        for (k, (&x, &single)) in exact.iter().zip(&lifted.features[scale]).enumerate() {
            let expected = buffer[k] / (counter[k / c] as f64 + EPSILON);
            assert!(
                (x - expected).abs() < 1e-6 * largest,
                "{scale} {k}: {x} {expected}"
            ); // W is rounded to f32 here
            assert!(
                (f64::from(single) - expected).abs() < 1e-4 * largest,
                "{scale} {k}: {single} {expected}"
            );
        }
        if scale == 0 {
            let keep: Vec<bool> = counter
                .iter()
                .map(|&n| n as f64 >= 0.02 * pixels as f64)
                .collect();
            assert_eq!(lifted.keep, keep);
            let pruned = keep.iter().filter(|k| !**k).count();
            assert!(
                pruned > 0 && pruned < n,
                "{pruned} pruned of {n}: the threshold decides something"
            );
            assert!((lifted.pruned_share() - pruned as f64 / n as f64).abs() < 1e-12);
        }
    }
}

#[test]
fn the_same_bits_at_one_and_two_threads() {
    let (scene, views) = (cloud(800), views(160, 120));
    let set = features(&views, maps);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        let run = || {
            unproject(
                &scene,
                views.iter(),
                &set,
                &UnprojectionConfig::default(),
                &Settings::default(),
                &crate::support::device(),
            )
        };
        pool.install(run).expect("features")
    };
    assert!(with(1) == with(2));
}

#[test]
fn views_and_maps_that_do_not_match_are_refused() {
    let (scene, views) = (cloud(20), views(40, 30));
    let config = UnprojectionConfig::default();
    let error = |views: &[View], set: &FeatureSet| {
        unproject(
            &scene,
            views.iter(),
            set,
            &config,
            &Settings::default(),
            &crate::support::device(),
        )
        .expect_err("refused")
        .to_string()
    };
    let set = features(&views, maps);
    assert!(error(&views[..2], &set).contains("views of the unprojection"));
    let mut other = views.clone();
    other.swap(0, 1);
    assert!(error(&other, &set).contains("v1"));
    let mut bad = set.clone();
    bad.views[1].maps[2].data[70] = f32::NAN;
    assert!(error(&views, &bad).contains("scale 3"));
    bad.views[1].maps[2] = map(7, 5, 63, 0);
    assert!(error(&views, &bad).contains("63"));
}

//! Unprojection: adjointness at both resolutions, constants, Algorithm 1 by brute force, pruning, unseen Gaussians.

use crate::support::feature_maps::{cameras, cloud, features, map, maps, noise, views};
use crate::support::lifting::{FeatureSet, unproject};
use coseg::config::{Normalisation, Resolution, UnprojectionConfig};
use coseg::data::View;
use coseg::features::{FeatureMap, Steps};
use coseg::raster::{Projected, Settings, Splats};
use coseg::segmentation::unprojection::Sums;
use coseg::splat::Gaussians;

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&x| f64::from(x)).collect()
}

/// The geometry in f64.
pub(super) struct Wide([Vec<f64>; 4]);

impl Wide {
    pub(super) fn of(g: &Gaussians) -> Self {
        let s = g.splats();
        Self([s.means, s.log_scales, s.rotations, s.opacity_logits].map(wide))
    }
    pub(super) fn splats(&self) -> Splats<'_, f64> {
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
    let scene = cloud(300);
    let cameras = cameras(97, 71);
    let settings = Settings::default();
    let wide = Wide::of(&scene);
    let n = scene.len();
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
    let scene = cloud(200);
    let settings = Settings::default();
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
        alpha_min: 1e-14,
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
    let scene = cloud(500);
    let views = views(160, 120);
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
        let is_seen = |i: usize| lifted.sums.weights.iter().all(|w| w[i] > 0.0);
        let mut seen = 0;
        for (scale, features) in lifted.sums.buffers.iter().enumerate() {
            let channels = features.len() / scene.len();
            for (i, row) in features.chunks_exact(channels).enumerate() {
                if lifted.sums.weights[scale][i] > 0.0 {
                    seen += 1;
                    for (c, &x) in row.iter().enumerate() {
                        assert!(
                            (x - constant(c)).abs() < 1e-5,
                            "{resolution:?} {scale} {i} {c}: {x}"
                        );
                    }
                } else {
                    assert!(row.iter().all(|&x| x == 0.0) && !is_seen(i));
                }
            }
        }
        assert!(seen > 1500, "{seen}");
        assert!(
            !is_seen(scene.len() - 1) && !lifted.keep[scene.len() - 1],
            "nobody sees the last one"
        );
    }
}

#[test]
fn the_same_bits_at_one_and_two_threads() {
    let scene = cloud(800);
    let views = views(160, 120);
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
    let scene = cloud(20);
    let views = views(40, 30);
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

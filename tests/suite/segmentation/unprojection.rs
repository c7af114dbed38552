//! Unprojection: adjointness, constants, unseen Gaussians, what does not match.

use crate::support::feature_maps::{cameras, cloud, features, map, maps, noise, views};
use crate::support::lifting::{FeatureSet, unproject};
use coseg::config::Normalisation;
use coseg::data::View;
use coseg::features::{FeatureMap, Steps};
use coseg::raster::{Projected, Settings, Splats};
use coseg::segmentation::unprojection::{EPSILON, LiftedViews};
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
fn features_are_the_adjoint_of_rendering_over_weights_or_counts() {
    let scene = cloud(300);
    let wide = Wide::of(&scene);
    let cameras = cameras(97, 71);
    let settings = Settings::default();
    let channels = maps(0).map(|map| map.channels);
    let lifted = |normalisation| {
        let device = crate::support::device();
        let mut lifted = LiftedViews::new(&scene, &channels, normalisation, &device);
        for (v, camera) in cameras.iter().enumerate() {
            let added = lifted.add(camera, &maps(10 * v), None, &settings);
            added.expect("a view");
        }
        lifted.features().expect("features")
    };
    let by_weight = lifted(Normalisation::Weight);
    let by_count = lifted(Normalisation::Count);
    for (scale, &channels) in channels.iter().enumerate() {
        let n = scene.len();
        let x: Vec<f64> = (0..n * channels).map(|i| noise(i, 99)).collect();
        // <W x, F> in f64, and what divides the sums.
        let mut left = 0.0;
        let mut weights = vec![0.0; n];
        let mut counts = vec![0.0; n];
        for (v, camera) in cameras.iter().enumerate() {
            let map = &maps(10 * v)[scale];
            let cells = map.lattice().camera(camera);
            let view = Projected::<f64>::new(&wide.splats(), &cells, &settings).expect("view");
            let rendered = view.blend(&x, channels).image;
            left += rendered
                .iter()
                .zip(&map.data)
                .map(|(a, &b)| a * f64::from(b))
                .sum::<f64>();
            for (sum, weight) in weights.iter_mut().zip(view.weight_sums()) {
                *sum += weight;
            }
            for (sum, count) in counts.iter_mut().zip(view.counts()) {
                *sum += f64::from(count) + f64::from(EPSILON) / cameras.len() as f64;
            }
        }
        for (features, divisors) in [(&by_weight, &weights), (&by_count, &counts)] {
            let terms = features[scale].iter().zip(&x).enumerate();
            let terms = terms.map(|(k, (&f, x))| f64::from(f) * x * divisors[k / channels]);
            let (right, size) = terms.fold((0.0, 0.0), |(sum, size), t| (sum + t, size + t * t));
            let size = f64::sqrt(size);
            assert!(size > 1.0, "the test sees something");
            assert!(
                (left - right).abs() < 1e-5 * size.max(right.abs()),
                "{scale}: {left} {right}"
            );
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
        let device = crate::support::device();
        let mut lifted = LiftedViews::new(&gaussian, &[2; 4], Normalisation::Weight, &device);
        lifted.add(camera, &maps, None, &settings).expect("a view");
        let features = lifted.features().expect("features");
        for (stride, found) in strides.iter().zip(&features) {
            // A splat of half a cell is not an integral: a few hundredths of one are lost.
            let off = [f64::from(found[0]) - u, f64::from(found[1]) - v];
            assert!(
                off.iter().all(|d| d.abs() < 0.03 * stride),
                "{stride}: {found:?} for {u} {v}"
            );
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
    let device = crate::support::device();
    let lifted = unproject(&scene, views.iter(), &set, Normalisation::Weight, &device);
    let mut seen = 0;
    for (scale, features) in lifted.expect("features").iter().enumerate() {
        let channels = features.len() / scene.len();
        for (i, row) in features.chunks_exact(channels).enumerate() {
            if row.iter().all(|&x| x == 0.0) {
                continue;
            }
            seen += 1;
            for (c, &x) in row.iter().enumerate() {
                assert!((x - constant(c)).abs() < 1e-5, "{scale} {i} {c}: {x}");
            }
        }
        let last = &features[(scene.len() - 1) * channels..];
        assert!(last.iter().all(|&x| x == 0.0), "nobody sees the last one");
    }
    assert!(seen > 1500, "{seen}");
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
            let device = crate::support::device();
            unproject(&scene, views.iter(), &set, Normalisation::Weight, &device)
        };
        pool.install(run).expect("features")
    };
    assert!(with(1) == with(2));
}

#[test]
fn views_and_maps_that_do_not_match_are_refused() {
    let scene = cloud(20);
    let views = views(40, 30);
    let device = crate::support::device();
    let error = |views: &[View], set: &FeatureSet| {
        let lifted = unproject(&scene, views.iter(), set, Normalisation::Weight, &device);
        lifted.expect_err("refused").to_string()
    };
    let set = features(&views, maps);
    assert!(error(&views[..2], &set).contains("views of the unprojection"));
    let none = features(&[], maps);
    assert!(error(&[], &none).contains("one or more"));
    let mut other = views.clone();
    other.swap(0, 1);
    assert!(error(&other, &set).contains("v1"));
    let mut bad = set.clone();
    bad.views[1].maps[2].data[70] = f32::NAN;
    assert!(error(&views, &bad).contains("scale 3"));
    bad.views[1].maps[2] = map(7, 5, 63, 0);
    assert!(error(&views, &bad).contains("63"));
}

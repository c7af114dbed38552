//! Image features of pixels that masks leave out are lifted onto no Gaussian.

use crate::support::feature_maps::{cameras, cloud, features, map, maps, views};
use crate::support::lifting::unproject;
use coseg::config::{Normalisation, UnprojectionConfig};
use coseg::data::mask::Mask;
use coseg::raster::{Projected, Settings};
use coseg::segmentation::unprojection::{EPSILON, LiftedViews, attended};
use coseg::splat::Gaussians;
use coseg::splat::camera::Camera;

const SIZE: (usize, usize) = (97, 71);

/// A block, a few columns and single pixels.
fn used(pixel: usize) -> bool {
    let (x, y) = (pixel % SIZE.0, pixel / SIZE.0);
    !((30..60).contains(&x) && y > 20 || (80..84).contains(&x) || pixel.is_multiple_of(53))
}

fn mask() -> Mask {
    Mask::new(SIZE.0, SIZE.1, used)
}

#[test]
fn features_are_of_cells_whose_centre_is_used() {
    let scene = cloud(300);
    let settings = Settings::default();
    let camera = &cameras(SIZE.0, SIZE.1)[1];
    let maps = maps(3);
    let channels = maps.each_ref().map(|map| map.channels);
    let lifted = |normalisation| {
        let device = crate::support::device();
        let mut lifted = LiftedViews::new(&scene, &channels, normalisation, &device);
        let added = lifted.add(camera, &maps, Some(&mask()), &settings);
        added.expect("a view");
        lifted.features().expect("features")
    };
    let by_weight = lifted(Normalisation::Weight);
    let by_count = lifted(Normalisation::Count);
    for (scale, map) in maps.iter().enumerate() {
        let cells = map.lattice().camera(camera);
        let is_used = |cell: usize| {
            let (x, y) = (cell % map.width, cell / map.width);
            let (u, v) = map.lattice().center(x, y, SIZE.0, SIZE.1);
            let at = |p: f64, pixels: usize| (p.max(0.0) as usize).min(pixels - 1);
            used(at(v, SIZE.1) * SIZE.0 + at(u, SIZE.0))
        };
        let ones: Vec<f32> = (0..map.cells())
            .map(|cell| f32::from(u8::from(is_used(cell))))
            .collect();
        let c = map.channels;
        let values: Vec<f32> = (0..map.data.len())
            .map(|k| map.data[k] * ones[k / c])
            .collect();
        let view = projected(&scene, &cells, &settings);
        let sums = view.blend_adjoint(&values, c);
        let weights = view.blend_adjoint(&ones, 1);
        let used_cells = Mask::new(map.width, map.height, is_used);
        let counts = view.used_counts(Some(&used_cells));
        let counts: Vec<f32> = counts.iter().map(|&n| n as f32 + EPSILON).collect();
        for (found, divisors) in [(&by_weight[scale], &weights), (&by_count[scale], &counts)] {
            let mut seen = 0;
            for (k, &found) in found.iter().enumerate() {
                let expected = match weights[k / c] {
                    w if w > 0.0 => sums[k] / divisors[k / c],
                    _ => 0.0,
                };
                seen += usize::from(expected != 0.0);
                assert!(
                    (found - expected).abs() <= 1e-4 * (1.0 + expected.abs()),
                    "{scale} {k}: {found} {expected}"
                );
            }
            assert!(seen > 20, "{scale}: {seen}");
        }
    }
}

#[test]
fn counts_are_of_pixels_that_are_used() {
    let scene = cloud(120);
    let settings = Settings::default();
    let camera = &cameras(SIZE.0, SIZE.1)[1];
    let view = projected(&scene, camera, &settings);
    assert_eq!(
        view.used_counts(Some(&Mask::new(SIZE.0, SIZE.1, |_| true))),
        view.counts()
    );
    let counts = view.used_counts(Some(&mask()));
    for (i, mean) in scene.means.iter().enumerate() {
        let Some((x, y, _)) = camera.project(glam::Vec3::from(*mean).as_dvec3()) else {
            continue;
        };
        let radius = f64::from(view.radii()[i]);
        let width = SIZE.0;
        let inside = |pixel: &usize| {
            let (px, py) = ((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
            radius > 0.0 && (px - x).hypot(py - y) <= radius
        };
        let want = (0..SIZE.0 * SIZE.1)
            .filter(|&pixel| used(pixel))
            .filter(inside)
            .count();
        // A pixel on the rim may go either way.
        assert!(
            want.abs_diff(counts[i] as usize) <= 2,
            "Gaussian {i}: {} of {want}",
            counts[i]
        );
    }
    assert!(
        counts
            .iter()
            .zip(view.counts())
            .filter(|(part, whole)| **part < *whole)
            .count()
            > 20
    );
}

#[test]
fn a_mask_of_another_size_is_refused() {
    let scene = cloud(30);
    let mut views = views(SIZE.0, SIZE.1);
    views[1].mask = Some(Mask::new(SIZE.1, SIZE.0, |i| i > 9));
    let set = features(&views, maps);
    for device in devices() {
        let error = unproject(&scene, views.iter(), &set, Normalisation::Weight, &device);
        crate::support::assert_names(
            &error.unwrap_err(),
            &["a mask of 71x97", &views[1].name, "97x71"],
        );
    }
    let maps = &set.views[1].maps;
    let channels: Vec<usize> = maps.iter().map(|map| map.channels).collect();
    let device = crate::support::device();
    let mut lifted = LiftedViews::new(&scene, &channels, Normalisation::Weight, &device);
    let mask = views[1].mask.as_ref();
    let error = lifted.add(&views[1].camera, maps, mask, &Settings::default());
    crate::support::assert_names(&error.unwrap_err(), &["a mask of 71x97", "97x71"]);
}

/// The CPU, and a GPU, if any.
fn devices() -> Vec<burn::tensor::Device> {
    #[cfg(feature = "wgpu")]
    return crate::support::gpu()
        .into_iter()
        .chain([crate::support::device()])
        .collect();
    #[cfg(not(feature = "wgpu"))]
    return vec![crate::support::device()];
}

fn projected(scene: &Gaussians, camera: &Camera, settings: &Settings) -> Projected<f32> {
    Projected::new(&scene.splats(), camera, settings).expect("view")
}

#[test]
fn what_is_left_out_has_no_influence_on_features() {
    let scene = cloud(300);
    let mut views = views(SIZE.0, SIZE.1);
    let lift = |views: &[_], salt: usize| {
        // Maps of pixels, which differ in what is left out of the second view.
        let of = |i: usize| {
            [0, 1, 2, 3].map(|scale| {
                let mut map = map(SIZE.0, SIZE.1, 3, 10 * i + scale);
                if i == 1 {
                    let hidden = map
                        .data
                        .chunks_mut(3)
                        .enumerate()
                        .filter(|(pixel, _)| !used(*pixel));
                    hidden.for_each(|(_, cell)| cell.iter_mut().for_each(|v| *v += salt as f32));
                }
                map
            })
        };
        let set = features(views, of);
        let device = crate::support::device();
        let lifted = unproject(&scene, views.iter(), &set, Normalisation::Weight, &device);
        lifted.expect("features")
    };
    views[1].mask = Some(mask());
    assert_eq!(lift(&views, 0), lift(&views, 5));
    views[1].mask = None;
    assert_ne!(lift(&views, 0), lift(&views, 5));
}

#[test]
fn attendance_is_of_pixels_that_are_used() {
    let scene = cloud(300);
    let settings = Settings::default();
    let device = crate::support::device();
    for masked in [false, true] {
        let mut views = views(SIZE.0, SIZE.1);
        let others = views.iter_mut().skip(1);
        others.for_each(|view| view.mask = masked.then(mask));
        let mut counts = vec![0.0; scene.len()];
        let mut pixels = 0.0;
        for view in &views {
            let seen = projected(&scene, &view.camera, &settings);
            let counted = seen.used_counts(view.mask.as_ref());
            let sums = counts.iter_mut().zip(counted);
            sums.for_each(|(sum, count)| *sum += f64::from(count));
            let all = SIZE.0 * SIZE.1;
            pixels += view.mask.as_ref().map_or(all, Mask::kept) as f64;
        }
        for attendance in [0.0, 1e-5, 1e-3, 0.01] {
            let config = UnprojectionConfig {
                attendance,
                attendance_pixels: 0.0,
                ..UnprojectionConfig::default()
            };
            let go_on = &mut || Ok(());
            let kept = attended(&scene, views.iter(), &config, &settings, &device, go_on);
            let kept = kept.expect("counts");
            let expected: Vec<bool> = counts.iter().map(|n| *n >= attendance * pixels).collect();
            assert_eq!(kept, expected, "{attendance}, masked: {masked}");
            // One is behind all cameras.
            assert_eq!(kept.contains(&false), attendance > 0.0);
        }
    }
}

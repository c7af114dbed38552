//! Image features of pixels that masks leave out are lifted onto no Gaussian.

use crate::support::feature_maps::{cameras, cloud, features, map, maps, views};
use crate::support::lifting::unproject;
use coseg::config::{Resolution, UnprojectionConfig};
use coseg::data::mask::Mask;
use coseg::raster::{Projected, Settings};
use coseg::segmentation::unprojection::{Sums, Unprojected, attended};
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
fn sums_are_the_adjoint_of_rendering_what_is_used() {
    let scene = cloud(300);
    let settings = Settings::default();
    let camera = &cameras(SIZE.0, SIZE.1)[1];
    let maps = maps(3);
    let channels = maps.each_ref().map(|map| map.channels);
    let sums = |mask: Option<&Mask>, resolution| {
        let mut sums = Sums::<f32>::new(scene.len(), &channels);
        sums.add(&scene.splats(), camera, &maps, mask, resolution, &settings)
            .expect("sums");
        sums
    };
    for resolution in [Resolution::Image, Resolution::Feature] {
        let (part, whole) = (sums(Some(&mask()), resolution), sums(None, resolution));
        // What is left out makes up for the rest. Counts are divisors of the sums with `normalisation = "count"`: pixels that add
        // nothing must not count, or they would average in as zeros.
        let rest = sums(
            Some(&Mask::new(SIZE.0, SIZE.1, |pixel| !used(pixel))),
            resolution,
        );
        let counts = |sums: &Sums<f32>| -> Vec<u64> {
            sums.counts
                .concat()
                .into_iter()
                .chain(sums.pixels.clone())
                .collect()
        };
        let both = counts(&part)
            .into_iter()
            .zip(counts(&rest))
            .map(|(a, b)| a + b);
        assert!(
            both.eq(counts(&whole)) && part.pixels != whole.pixels && part.counts != whole.counts
        );
        for scale in 0..maps.len() {
            let of = |sums: &Sums<f32>| [sums.buffers[scale].clone(), sums.weights[scale].clone()];
            for ((part, rest), whole) in of(&part).iter().zip(&of(&rest)).zip(&of(&whole)) {
                let largest = whole.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
                let off = part
                    .iter()
                    .zip(rest)
                    .zip(whole)
                    .map(|((a, b), c)| (a + b - c).abs())
                    .fold(0.0, f32::max);
                assert!(
                    off < 1e-5 * largest,
                    "{resolution:?} {scale}: {off} of {largest}"
                );
                assert!(
                    part.iter()
                        .zip(whole)
                        .any(|(a, b)| (a - b).abs() > 0.1 * largest)
                );
            }
        }
        // The weights are those of the pixels, or cells, whose centre is used.
        if resolution == Resolution::Image {
            let ones: Vec<f32> = (0..SIZE.0 * SIZE.1)
                .map(|pixel| f32::from(u8::from(used(pixel))))
                .collect();
            let want = projected(&scene, camera, &settings).blend_adjoint(&ones, 1);
            assert!(
                want.iter()
                    .zip(&part.weights[0])
                    .all(|(a, b)| (a - b).abs() < 1e-4 * (1.0 + a))
            );
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
        for resolution in [Resolution::Image, Resolution::Feature] {
            let config = UnprojectionConfig {
                resolution,
                ..UnprojectionConfig::default()
            };
            let error = unproject(
                &scene,
                views.iter(),
                &set,
                &config,
                &Settings::default(),
                &device,
            )
            .unwrap_err();
            crate::support::assert_names(&error, &["a mask of 71x97", &views[1].name, "97x71"]);
        }
    }
    let channels: Vec<usize> = set.views[1].maps.iter().map(|map| map.channels).collect();
    let mut sums = Sums::<f32>::new(scene.len(), &channels);
    let camera = &views[1].camera;
    let mask = views[1].mask.as_ref();
    let maps = &set.views[1].maps;
    let error = sums
        .add(
            &scene.splats(),
            camera,
            maps,
            mask,
            Resolution::Image,
            &Settings::default(),
        )
        .unwrap_err();
    crate::support::assert_names(&error, &["a mask of 71x97", "97x71"]);
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
    let lift = |views: &[_], salt: usize, config: &UnprojectionConfig| -> Unprojected {
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
        unproject(
            &scene,
            views.iter(),
            &set,
            config,
            &Settings::default(),
            &crate::support::device(),
        )
        .expect("features")
    };
    for resolution in [Resolution::Image, Resolution::Feature] {
        let config = UnprojectionConfig {
            resolution,
            ..UnprojectionConfig::default()
        };
        views[1].mask = Some(mask());
        assert_eq!(
            lift(&views, 0, &config),
            lift(&views, 5, &config),
            "{resolution:?}"
        );
        views[1].mask = None;
        assert_ne!(
            lift(&views, 0, &config),
            lift(&views, 5, &config),
            "{resolution:?}"
        );
    }
}

#[test]
fn attendance_by_itself_is_that_of_the_unprojection() {
    let scene = cloud(300);
    let settings = Settings::default();
    let device = crate::support::device();
    for masked in [false, true] {
        let mut views = views(SIZE.0, SIZE.1);
        views
            .iter_mut()
            .skip(1)
            .for_each(|view| view.mask = masked.then(mask));
        let set = features(&views, maps);
        for attendance in [0.0, 1e-5, 1e-3, 0.01] {
            let config = UnprojectionConfig {
                attendance,
                ..UnprojectionConfig::default()
            };
            let lifted = unproject(&scene, views.iter(), &set, &config, &settings, &device)
                .expect("features");
            let alone = attended(
                &scene,
                views.iter(),
                &config,
                &settings,
                &device,
                &mut || Ok(()),
            )
            .expect("counts");
            assert_eq!(alone, lifted.keep, "{attendance}, masked: {masked}");
            // One is behind all cameras.
            assert_eq!(alone.contains(&false), attendance > 0.0);
        }
    }
}

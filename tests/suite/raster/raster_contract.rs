//! The rasterizer's numerical contract: one operator in two directions, hard cases, thread counts.

use crate::support::raster_reference::{Cloud, all_pixels, camera, cloud, numbers};
use burn::tensor::{DType, Tensor};
use coseg::Error;
use coseg::raster::{Projected, RasterInput, Settings, Splats, rasterize};
use coseg::splat::camera::Camera;

fn single(c: &Cloud) -> [Vec<f32>; 4] {
    c.single()
}

fn splats(v: &[Vec<f32>; 4]) -> Splats<'_, f32> {
    Splats {
        means: &v[0],
        log_scales: &v[1],
        rotations: &v[2],
        opacity_logits: &v[3],
    }
}

#[test]
fn blending_and_its_adjoint_are_one_operator() {
    let camera = camera(53, 38);
    let c = cloud(500, 0.05, &camera, 8);
    let projected = Projected::new(&c.splats(), &camera, &Settings::default()).expect("finite");
    let w = projected.weights(&all_pixels(projected.size()));
    for channels in [1, 3, 4, 7, 64, 150] {
        let x = numbers(c.len() * channels, 5);
        let y = numbers(camera.width * camera.height * channels, 6);
        let wx = projected.blend(&x, channels).image;
        let wty = projected.blend_adjoint(&y, channels);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (left, right) = (dot(&wx, &y), dot(&x, &wty));
        let size = dot(&wx, &wx).sqrt() * dot(&y, &y).sqrt();
        assert!(
            (left - right).abs() < 1e-10 * size,
            "{channels}: {left} {right}"
        );
        // The stored weights are f32.
        for (stored, blended) in w.apply(&x, channels).iter().zip(&wx) {
            assert!(
                (stored - blended).abs() < 1e-5,
                "{channels}: {stored} {blended}"
            );
        }
    }
    let ones = vec![1.0; camera.width * camera.height];
    assert_eq!(projected.weight_sums(), projected.blend_adjoint(&ones, 1));
}

#[test]
fn counts_are_pixel_centres_within_the_radius() {
    let camera = camera(41, 29);
    let c = cloud(80, 0.08, &camera, 4);
    let projected = Projected::new(&c.splats(), &camera, &Settings::default()).expect("finite");
    for (i, (&count, &radius)) in projected.counts().iter().zip(projected.radii()).enumerate() {
        let mean = glam::DVec3::from_slice(&c.means[3 * i..]);
        let Some((u, v, _)) = camera.project(mean).filter(|_| radius > 0) else {
            assert_eq!(count, 0);
            continue;
        };
        let inside = |p: &usize| {
            let (x, y) = (
                (p % camera.width) as f64 + 0.5,
                (p / camera.width) as f64 + 0.5,
            );
            (x - u).powi(2) + (y - v).powi(2) <= f64::from(radius).powi(2)
        };
        let want = (0..camera.width * camera.height).filter(inside).count();
        assert_eq!(count as usize, want, "Gaussian {i}");
    }
}

/// Gaussians with every fate, in mixed order: more than one task projects, and no multiple of what a loop takes.
fn every_fate(camera: &Camera) -> Cloud {
    let forward = camera.rotation.transpose() * glam::DVec3::Z;
    let side = camera.rotation.transpose() * glam::DVec3::X;
    let at = |depth: f64, aside: f64| (camera.center + forward * depth + side * aside).to_array();
    let turn = [0.9, 0.1, -0.3, 0.2];
    let seen = cloud(1_200, 0.05, camera, 8);
    let mut c = Cloud::default();
    for i in 0..seen.len() {
        let row = |v: &[f64], width: usize| v[width * i..width * (i + 1)].to_vec();
        c.means.extend(row(&seen.means, 3));
        c.log_scales.extend(row(&seen.log_scales, 3));
        c.rotations.extend(row(&seen.rotations, 4));
        c.opacity_logits.push(seen.opacity_logits[i]);
        let depth = 1.0 + 0.01 * i as f64;
        match i % 8 {
            0 => c.push(at(-depth, 0.0), [0.1; 3], turn, 1.0),
            1 => c.push(at(depth, 50.0 * depth), [0.1; 3], turn, 1.0),
            2 => c.push(at(depth, 50.0 * depth), [0.1; 3], [0.0; 4], 1.0),
            3 => c.push(at(depth, 0.2), [1e300; 3], turn, 1.0),
            4 => c.push(at(depth, 0.2), [0.1; 3], [0.0; 4], 1.0),
            5 => c.push(at(depth, 0.2), [0.1; 3], turn, -9.0),
            6 => c.push(at(depth, 0.8 * depth), [0.01, 0.2, 0.01], turn, 1.0),
            _ => {}
        }
    }
    c.rounded()
}

#[test]
fn each_gaussian_meets_the_fate_it_meets_alone() {
    let camera = camera(97, 61);
    let all = every_fate(&camera);
    let visible = [Settings::default().alpha_min, 1e-14].map(|alpha_min| {
        let settings = Settings {
            alpha_min,
            ..Settings::default()
        };
        let floats = single(&all);
        let narrow = Projected::new(&splats(&floats), &camera, &settings).expect("finite");
        let wide = Projected::new(&all.splats(), &camera, &settings).expect("finite");
        assert_eq!(
            (narrow.tile_entries(), narrow.radii()),
            (wide.tile_entries(), wide.radii()),
            "f32 against f64"
        );
        let mut entries = 0;
        for (i, &radius) in wide.radii().iter().enumerate() {
            let alone = Splats {
                means: &all.means[3 * i..3 * i + 3],
                log_scales: &all.log_scales[3 * i..3 * i + 3],
                rotations: &all.rotations[4 * i..4 * i + 4],
                opacity_logits: &all.opacity_logits[i..=i],
            };
            let one = Projected::new(&alone, &camera, &settings).expect("finite");
            assert_eq!(one.radii(), [radius], "Gaussian {i}");
            entries += one.tile_entries();
        }
        assert_eq!(wide.tile_entries(), entries);
        let visible = wide.radii().iter().filter(|radius| **radius > 0).count();
        // Behind the camera, or beyond what numbers hold, are 150 each, and far aside are 300.
        assert!(visible > 1_200 && visible <= all.len() - 600, "{visible}");
        visible
    });
    assert!(
        visible[1] >= visible[0] + 150,
        "the faint ones are seen at the low alpha_min alone: {visible:?}"
    );
}

#[test]
fn gaussians_without_an_end_are_refused() {
    for alpha_min in [0.0, -1.0, 1.0, f64::NAN] {
        let settings = Settings {
            alpha_min,
            ..Settings::default()
        };
        let none = Default::default();
        let error = Projected::<f32>::new(&splats(&none), &camera(15, 17), &settings)
            .expect_err("out of range");
        crate::support::assert_names(&error, &["raster.alpha_min", "(0, 1)"]);
    }
}

#[test]
fn nothing_to_see_is_an_empty_image() {
    for (width, height) in [(1, 1), (15, 17), (64, 48)] {
        let camera = camera(width, height);
        let none =
            Projected::<f32>::new(&splats(&Default::default()), &camera, &Settings::default())
                .expect("none");
        let out = none.blend(&[], 3);
        assert!(out.image.iter().all(|&v| v == 0.0) && out.transmittance.iter().all(|&t| t == 1.0));
        assert_eq!(out.transmittance.len(), width * height);
        let weights = none.weights(&all_pixels(none.size()));
        assert!(weights.entries().1.is_empty() && none.counts().is_empty());
    }
}

#[test]
fn features_of_no_gaussians_are_the_background() {
    for (name, device) in crate::support::devices() {
        let zeros = |width| Tensor::<2>::zeros([0, width], &device);
        let input = RasterInput {
            means: zeros(3),
            log_scales: zeros(3),
            rotations: zeros(4),
            opacity_logits: Tensor::zeros([0], &device),
            sh: Some(Tensor::zeros([0, 1, 3], &device)),
            active_sh_degree: 0,
            features: Some(zeros(5)),
            screen: None,
        };
        let out = rasterize(
            input,
            &camera(9, 7),
            &Settings::default(),
            [0.25, 0.5, 0.75],
        );
        let out = out.unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(out.image.dims(), [7, 9, 8], "{name}");
        let image: Vec<f32> = out.image.into_data().into_vec().expect("f32");
        let pixel = [0.25, 0.5, 0.75, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert!(image.chunks(8).all(|p| p == pixel), "{name}");
    }
}

#[test]
fn non_finite_input_is_named() {
    let camera = camera(20, 20);
    for (part, name) in ["means", "log_scales", "rotations", "opacity_logits"]
        .into_iter()
        .enumerate()
    {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut floats = single(&cloud(30, 0.1, &camera, 1));
            let width = floats[part].len() / 30;
            floats[part][7 * width] = bad;
            match Projected::new(&splats(&floats), &camera, &Settings::default()) {
                Err(Error::NonFinite { tensor, row, .. }) => {
                    assert_eq!((tensor.as_str(), row), (name, 7))
                }
                other => panic!("{name}: {:?}", other.map(|p| p.radii().to_vec())),
            }
        }
    }
}

#[test]
fn non_finite_colours_are_named_seen_or_not() {
    let (g, _) = crate::support::plates::plates();
    let many = g.select(&(0..1_500).map(|i| i % g.len() as u32).collect::<Vec<_>>());
    let view = crate::support::plates::camera(0);
    let away = Camera {
        rotation: glam::DMat3::from_rotation_y(std::f64::consts::PI) * view.rotation,
        ..view.clone()
    };
    for (camera, bad, row) in [
        (&view, f32::NAN, 7),
        (&view, f32::INFINITY, 1_300),
        (&away, f32::NAN, 1_499),
    ] {
        let seen = Projected::new(&many.splats(), camera, &Settings::default()).expect("finite");
        let seen = seen.radii().iter().filter(|radius| **radius > 0).count();
        assert_eq!(seen == 0, std::ptr::eq(camera, &away), "{seen}");
        let mut spoilt = many.clone();
        spoilt.sh[3 * row + 1] = bad;
        match coseg::raster::render(&spoilt, camera, &Settings::default(), [0.0; 3]) {
            Err(Error::NonFinite {
                tensor, row: named, ..
            }) => assert_eq!((tensor.as_str(), named), ("sh", row)),
            other => panic!("row {row}: {:?}", other.map(|r| r.rgb.len())),
        }
    }
}

#[test]
fn f32_culls_and_counts_as_f64_does() {
    let camera = camera(131, 97);
    let c = cloud(4_000, 0.03, &camera, 21).rounded();
    let single = single(&c);
    let wide = Projected::new(&splats(&single), &camera, &Settings::default()).expect("finite");
    let plain = Projected::new(&c.splats(), &camera, &Settings::default()).expect("finite");
    assert_eq!(wide.tile_entries(), plain.tile_entries());
    assert_eq!(
        (wide.counts(), wide.radii()),
        (plain.counts(), plain.radii())
    );
    assert!(plain.counts().iter().any(|&count| count > 1_000));
}

#[test]
fn thread_count_changes_no_bit() {
    let camera = camera(130, 90);
    let floats = single(&cloud(9_500, 0.03, &camera, 12));
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        pool.install(|| {
            let projected =
                Projected::new(&splats(&floats), &camera, &Settings::default()).expect("finite");
            let values: Vec<f32> = numbers(9_500 * 19, 2).iter().map(|&v| v as f32).collect();
            let image = projected.blend(&values, 19).image;
            let sums = projected.blend_adjoint(&image, 19);
            let bits = |v: Vec<f32>| v.into_iter().map(f32::to_bits).collect::<Vec<_>>();
            let weights = projected.weights(&all_pixels(projected.size()));
            (bits(image), bits(sums), weights)
        })
    };
    assert!(run(1) == run(2));
}

#[test]
fn tensors_of_two_float_types_are_refused() {
    let device = crate::support::device();
    let zeros = |width: usize, dtype: DType| Tensor::<2>::zeros([5, width], (&device, dtype));
    let input = RasterInput {
        means: zeros(3, DType::F32),
        log_scales: zeros(3, DType::F32),
        rotations: zeros(4, DType::F32),
        opacity_logits: Tensor::zeros([5], (&device, DType::F32)),
        sh: None,
        active_sh_degree: 0,
        features: Some(zeros(2, DType::F64)),
        screen: None,
    };
    match rasterize(input, &camera(8, 8), &Settings::default(), [0.0; 3]) {
        Err(Error::Argument { name, .. }) => assert_eq!(name, "raster input features"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn lists_of_huge_gaussians_are_refused_before_they_take_the_memory() {
    let n = 60_000;
    let means = [0.0, 0.0, 3.0].repeat(n);
    let values = [
        means,
        vec![20.0; 3 * n],
        [1.0, 0.0, 0.0, 0.0].repeat(n),
        vec![0.0; n],
    ];
    // 8,160 tiles.
    let camera = Camera::centred([1_000.0; 2], [1_920, 1_080]);
    let refused = Projected::new(&splats(&values), &camera, &Settings::default());
    let error = refused.expect_err("489.6 million entries");
    assert!(matches!(error, Error::Limit { .. }), "{error}");
    let message = error.to_string();
    for part in ["16 bytes each", "of 60000 visible Gaussians", "268435456"] {
        assert!(message.contains(part), "{part}: {message}");
    }
}

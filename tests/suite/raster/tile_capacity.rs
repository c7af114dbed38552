//! Rendering with a given capacity for the tile lists: the same bits where it suffices, and a report where it does not.

use crate::support::raster_reference::{camera, cloud, numbers};
use burn::tensor::{Device, Tensor, TensorData};
use coseg::ops::FiniteCheck;
use coseg::raster::{ListCount, RasterInput, Settings, rasterize, rasterize_with_capacity};
use coseg::splat::camera::Camera;

/// 300 random Gaussians; the mean of the sixth is `broken` where it says so.
fn input(device: &Device, camera: &Camera, broken: Option<f32>) -> RasterInput {
    let cloud = cloud(300, 0.05, camera, 5);
    let n = cloud.len();
    let two = |v: &[f64], w: usize| {
        let v: Vec<f32> = v.iter().map(|&x| x as f32).collect();
        Tensor::<2>::from_data(TensorData::new(v, [n, w]), device)
    };
    let mut means = cloud.means.clone();
    if let Some(broken) = broken {
        means[3 * 5] = f64::from(broken);
    }
    let logits: Vec<f32> = cloud.opacity_logits.iter().map(|&x| x as f32).collect();
    RasterInput {
        means: two(&means, 3).require_grad(),
        log_scales: two(&cloud.log_scales, 3).require_grad(),
        rotations: two(&cloud.rotations, 4).require_grad(),
        opacity_logits: Tensor::<1>::from_data(TensorData::new(logits, [n]), device).require_grad(),
        sh: None,
        active_sh_degree: 0,
        features: Some(two(&numbers(n * 5, 3), 5).require_grad()),
        screen: None,
    }
}

fn bits<const D: usize>(tensor: Tensor<D>) -> Vec<u32> {
    tensor
        .into_data()
        .into_vec::<f32>()
        .expect("floats")
        .into_iter()
        .map(f32::to_bits)
        .collect()
}

/// Image, gradients of the means and features of its squares, and the count.
fn run(
    device: &Device,
    camera: &Camera,
    broken: Option<f32>,
    capacity: Option<usize>,
) -> ([Vec<u32>; 3], ListCount) {
    let input = input(device, camera, broken);
    let output = rasterize_with_capacity(
        input.clone(),
        camera,
        &Settings::default(),
        [0.0; 3],
        capacity,
    )
    .expect("valid");
    let loss = output.image.clone().powi_scalar(2).sum();
    let gradients = loss.backward();
    let of = |t: &Tensor<2>| t.grad(&gradients).expect("tracked");
    let (means, features) = (of(&input.means), of(&input.features.expect("given")));
    let mut check = FiniteCheck::default();
    check.add(&means);
    let (value, _, words) = check
        .read_with(loss.clone().inner(), Some(output.tile_lists.clone()))
        .expect("a working device");
    assert_eq!(
        value.to_bits(),
        bits(loss.inner())[0],
        "the loss comes first"
    );
    let count = ListCount::from_values(&words).expect("three values");
    (
        [bits(output.image.inner()), bits(means), bits(features)],
        count,
    )
}

#[test]
fn enough_capacity_changes_no_bit() {
    let Some(device) = crate::support::gpu().map(Device::autodiff) else {
        return;
    };
    let camera = camera(150, 90);
    let (want, count) = run(&device, &camera, None, None);
    assert!(count.is_sound && count.entries > 500, "{count:?}");
    for capacity in [
        count.entries,
        count.entries + 1,
        2 * count.entries + 4096,
        100_000,
    ] {
        let (got, found) = run(&device, &camera, None, Some(capacity));
        assert_eq!(found, count, "capacity {capacity}");
        assert!(got == want, "capacity {capacity}");
    }
    // More than any device holds: counted first, as without a capacity.
    let (got, found) = run(&device, &camera, None, Some(usize::MAX / 8));
    assert!(found == count && got == want);
}

#[test]
fn too_little_capacity_is_reported() {
    let Some(device) = crate::support::gpu().map(Device::autodiff) else {
        return;
    };
    let camera = camera(150, 90);
    let (_, count) = run(&device, &camera, None, None);
    for capacity in [1, 64, count.entries / 2, count.entries - 1] {
        let (_, found) = run(&device, &camera, None, Some(capacity));
        assert_eq!(
            found,
            ListCount {
                is_sound: false,
                ..count
            },
            "capacity {capacity} of {count:?}"
        );
    }
}

#[test]
fn non_finite_input_is_reported_and_then_named() {
    let Some(device) = crate::support::gpu().map(Device::autodiff) else {
        return;
    };
    let camera = camera(60, 40);
    for broken in [f32::NAN, f32::INFINITY] {
        let (_, count) = run(&device, &camera, Some(broken), Some(10_000));
        assert!(!count.is_sound, "{count:?}");
        let error = rasterize(
            input(&device, &camera, Some(broken)),
            &camera,
            &Settings::default(),
            [0.0; 3],
        )
        .expect_err("bad");
        assert!(
            error.to_string().contains("means") && error.to_string().contains('5'),
            "{error}"
        );
    }
}

#[test]
fn the_cpu_ignores_the_capacity() {
    let device = crate::support::device().autodiff();
    let camera = camera(60, 40);
    let settings = Settings::default();
    let want =
        rasterize(input(&device, &camera, None), &camera, &settings, [0.0; 3]).expect("valid");
    let got = rasterize_with_capacity(
        input(&device, &camera, None),
        &camera,
        &settings,
        [0.0; 3],
        Some(1),
    )
    .expect("valid");
    let counts: Vec<f32> = got.tile_lists.into_data().into_vec().expect("floats");
    assert!(
        ListCount::from_values(&counts).is_some_and(|count| count.is_sound && count.entries > 50)
    );
    assert!(bits(got.image.inner()) == bits(want.image.inner()));
    assert_eq!(ListCount::from_values(&[]), None);
    assert_eq!(
        ListCount::from_values(&[0.0, 0.0, 9.0]),
        Some(ListCount {
            entries: 9,
            is_sound: true
        })
    );
}

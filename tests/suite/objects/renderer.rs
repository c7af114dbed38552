//! Frames of a labelled scene: those of separate passes on the host, and the same on a GPU.

use crate::support::hard_labels::hard_label_map;
use crate::support::raster_reference::{camera, colored_gaussians};
use burn::tensor::Device;
use coseg::objects::{RenderOptions, Renderer};
use coseg::raster::{Projected, Settings, render};
use coseg::splat::Gaussians;
use coseg::splat::camera::Camera;

/// As many different labels, in no order, not all numbers among them.
fn labels(gaussians: usize, different: usize) -> Vec<u16> {
    (0..gaussians)
        .map(|i| 3 * (i * 37 % different) as u16 + 2)
        .collect()
}

fn options() -> RenderOptions {
    RenderOptions {
        background: [0.25, 0.5, 1.0],
        min_coverage: 0.3,
        ..RenderOptions::default()
    }
}

/// The label map by blending a channel for every id from 0 on.
fn by_channels(projected: &Projected<f32>, labels: &[u16], min_coverage: f32) -> Vec<u16> {
    let channels = usize::from(*labels.iter().max().unwrap()) + 1;
    let one_hot: Vec<f32> = labels
        .iter()
        .flat_map(|&label| (0..channels).map(move |c| f32::from(c == usize::from(label))))
        .collect();
    let blended = projected.blend(&one_hot, channels);
    let pixels = blended
        .image
        .chunks_exact(channels)
        .zip(&blended.transmittance);
    let largest = |(pixel, t): (&[f32], &f32)| {
        let best = (0..channels).fold(0, |best, c| if pixel[c] > pixel[best] { c } else { best });
        if 1.0 - t >= min_coverage {
            best as u16
        } else {
            0
        }
    };
    pixels.map(largest).collect()
}

/// The GPU, if there is one.
fn extra_device() -> Option<Device> {
    #[cfg(feature = "wgpu")]
    return crate::support::gpu();
    #[cfg(not(feature = "wgpu"))]
    None
}

fn largest_difference(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max)
}

#[test]
fn a_frame_is_what_separate_passes_render() {
    let camera = camera(90, 70);
    let gaussians = colored_gaussians(&camera, 0.03);
    let rendered = render(
        &gaussians,
        &camera,
        &Settings::default(),
        options().background,
    )
    .unwrap();
    let alpha: Vec<f32> = rendered.transmittance.iter().map(|t| 1.0 - t).collect();
    let projected = Projected::new(&gaussians.splats(), &camera, &Settings::default()).unwrap();
    for different in [1, 2, 12, 13, 14, 30, 400] {
        let labels = labels(gaussians.len(), different);
        let renderer = Renderer::new(
            gaussians.clone(),
            Some(labels.clone()),
            options(),
            &crate::support::device(),
        )
        .unwrap();
        let frame = renderer.frame(&camera).unwrap();
        assert_eq!([frame.width, frame.height], [90, 70]);
        assert!(
            largest_difference(&frame.rgb, &rendered.rgb) < 1e-6,
            "{different} labels"
        );
        assert!(
            largest_difference(&frame.alpha, &alpha) < 1e-6,
            "{different} labels"
        );
        let map = frame.labels.expect("the scene has labels");
        assert_eq!(
            map.ids,
            by_channels(&projected, &labels, 0.3),
            "{different} labels"
        );
        assert_eq!(
            map,
            hard_label_map(&projected, &labels, 0.3),
            "{different} labels"
        );
        let none = map.ids.iter().filter(|&&id| id == 0).count();
        assert!(
            none > 0 && none < map.ids.len() / 2,
            "{none} without a label"
        );
    }
    let frame = Renderer::new(gaussians, None, options(), &crate::support::device())
        .unwrap()
        .frame(&camera)
        .unwrap();
    assert!(frame.labels.is_none() && largest_difference(&frame.rgb, &rendered.rgb) == 0.0);
}

#[test]
fn equal_weights_go_to_the_lower_label() {
    let camera = camera(30, 20);
    // Two Gaussians at one place, so thin that the one behind weighs no less in f32.
    let mut pair = colored_gaussians(&camera, 0.3).select(&[3, 3]);
    pair.opacity_logits.fill(-20.0);
    let settings = Settings {
        alpha_min: 1e-14,
        ..Settings::default()
    };
    let projected = Projected::new(&pair.splats(), &camera, &settings).unwrap();
    let of_equals = |labels: [u16; 2]| {
        let (_, ids) = projected.blend_labels::<1>(&[], &labels);
        let (front, behind) = (
            projected.blend(&[1.0, 0.0], 1).image,
            projected.blend(&[0.0, 1.0], 1).image,
        );
        let equal: Vec<u16> = (0..ids.len())
            .filter(|&i| front[i] == behind[i] && front[i] > 0.0)
            .map(|i| ids[i])
            .collect();
        assert!(
            equal.len() > 20,
            "{} pixels with equal weights",
            equal.len()
        );
        equal
    };
    for labels in [[4, 9], [9, 4]] {
        assert!(of_equals(labels).iter().all(|&id| id == 4), "{labels:?}");
    }
    // A device's weights are as equal, up to the few pixels where rounding differs.
    if let Some(gpu) = extra_device() {
        let options = RenderOptions {
            settings,
            min_coverage: 0.0,
            ..options()
        };
        let renderer = Renderer::new(pair, Some(vec![9, 4]), options, &gpu).unwrap();
        let ids = renderer.frame(&camera).unwrap().labels.expect("labels").ids;
        let lower = ids.iter().filter(|&&id| id == 4).count();
        assert!(
            lower > 20 && lower * 10 > ids.len() * 8,
            "{lower} of {}",
            ids.len()
        );
    }
}

#[test]
fn labels_of_another_scene_are_refused() {
    let gaussians = colored_gaussians(&camera(20, 20), 0.1);
    let error = Renderer::new(
        gaussians,
        Some(vec![1; 7]),
        options(),
        &crate::support::device(),
    )
    .expect_err("7 labels");
    crate::support::assert_names(&error, &["labels", "7", "400"]);
}

#[test]
fn what_is_no_scene_is_refused() {
    let whole = colored_gaussians(&camera(20, 20), 0.1);
    let refused = |gaussians, options, parts: &[&str]| {
        let error = Renderer::new(gaussians, None, options, &crate::support::device())
            .expect_err("unusable");
        crate::support::assert_names(&error, parts);
    };
    let mut nan = whole.clone();
    nan.means[17][2] = f32::NAN;
    refused(nan, options(), &["means", "17"]);
    refused(
        Gaussians {
            sh: Vec::new(),
            ..whole.clone()
        },
        options(),
        &["sh"],
    );
    refused(
        Gaussians {
            sh_degree: usize::MAX,
            ..whole.clone()
        },
        options(),
        &["sh_degree", "0 to 3"],
    );
    refused(
        whole.clone(),
        RenderOptions {
            min_coverage: f32::NAN,
            ..options()
        },
        &["min_coverage NaN"],
    );
    for device in extra_device().into_iter().chain([crate::support::device()]) {
        let renderer =
            Renderer::new(whole.clone(), Some(labels(400, 5)), options(), &device).unwrap();
        for (width, height) in [(0, 20), (20, 0), (1 << 33, 1 << 33)] {
            let error = renderer
                .frame(&Camera {
                    width,
                    height,
                    ..camera(20, 20)
                })
                .expect_err("no image");
            crate::support::assert_names(&error, &["camera.width, height"]);
        }
        assert_eq!(renderer.frame(&camera(1, 1)).unwrap().rgb.len(), 3);
    }
}

#[test]
fn labels_from_end_to_end_and_any_coverage() {
    let camera = camera(60, 50);
    let gaussians = colored_gaussians(&camera, 0.03);
    let labels: Vec<u16> = (0..gaussians.len()).map(|i| [0, u16::MAX][i % 2]).collect();
    for device in extra_device().into_iter().chain([crate::support::device()]) {
        let map = |min_coverage| {
            let options = RenderOptions {
                min_coverage,
                unlabelled: 9,
                ..options()
            };
            let renderer =
                Renderer::new(gaussians.clone(), Some(labels.clone()), options, &device).unwrap();
            renderer.frame(&camera).unwrap().labels.expect("labels").ids
        };
        assert!(map(1.1).iter().all(|&id| id == 9), "{device:?}");
        let count = |ids: Vec<u16>| ids.iter().filter(|&&id| id == u16::MAX).count();
        let (all, some, none) = (count(map(0.0)), count(map(0.5)), count(map(1.1)));
        assert!(
            all > some && some > 100 && none == 0,
            "{all}, {some}, {none} on {device:?}"
        );
    }
}

#[test]
fn a_scene_without_gaussians_shows_the_background() {
    let empty = colored_gaussians(&camera(20, 20), 0.1).select(&[]);
    for device in extra_device().into_iter().chain([crate::support::device()]) {
        for labels in [None, Some(Vec::new())] {
            let with_labels = labels.is_some();
            let options = RenderOptions {
                unlabelled: 9,
                min_coverage: 0.0,
                ..options()
            };
            let renderer = Renderer::new(empty.clone(), labels, options, &device).unwrap();
            let frame = renderer.frame(&camera(20, 15)).unwrap();
            assert_eq!(frame.rgb, options.background.repeat(300), "{device:?}");
            assert!(frame.alpha.iter().all(|&alpha| alpha == 0.0));
            assert_eq!(
                frame.labels.map(|map| map.ids),
                with_labels.then(|| vec![9; 300]),
                "{device:?}"
            );
        }
    }
}

#[cfg(feature = "wgpu")]
mod on_gpu {
    use super::*;
    use crate::support::on_device;
    use coseg::objects::Frame;

    /// Apart from rounding, a pixel may differ where a Gaussian is at a cut-off (by 1 / 255 at most), and a label where two weigh
    /// the same.
    fn assert_alike(got: &Frame, want: &Frame, what: &str) {
        for (got, want) in [(&got.rgb, &want.rgb), (&got.alpha, &want.alpha)] {
            let differ = got
                .iter()
                .zip(want)
                .filter(|(a, b)| (*a - *b).abs() > 2e-5)
                .count();
            assert!(
                differ * 10_000 <= got.len(),
                "{what}: {differ} of {}",
                got.len()
            );
            assert!(largest_difference(got, want) < 0.01, "{what}");
        }
        let ids = |frame: &Frame| frame.labels.as_ref().map(|map| map.ids.clone());
        let (got, want) = (ids(got), ids(want));
        assert_eq!(got.is_some(), want.is_some(), "{what}");
        let (got, want) = (got.unwrap_or_default(), want.unwrap_or_default());
        let differ = got.iter().zip(&want).filter(|(a, b)| a != b).count();
        assert!(
            got.len() == want.len() && differ * 1000 <= got.len(),
            "{what}: {differ} labels differ"
        );
    }

    #[test]
    fn frames_agree_whatever_was_rendered_before() {
        let Some(gpu) = crate::support::gpu() else {
            return;
        };
        let near = camera(160, 120);
        let away = Camera {
            center: near.center + near.rotation.transpose().z_axis * 1e3,
            ..near.clone()
        };
        let gaussians = colored_gaussians(&near, 0.4);
        for different in [None, Some(1), Some(9), Some(60)] {
            let labels = different.map(|different| labels(gaussians.len(), different));
            let start = |device| {
                Renderer::new(gaussians.clone(), labels.clone(), options(), device).unwrap()
            };
            let (renderer, host) = (start(&gpu), start(&crate::support::device()));
            // Nothing to see, then more entries than there is room for, twice, and little again.
            for (i, camera) in [&away, &near, &near, &away, &near].into_iter().enumerate() {
                let frame = on_device(Some(&gpu), || renderer.frame(camera).unwrap());
                assert_alike(
                    &frame,
                    &host.frame(camera).unwrap(),
                    &format!("frame {i}, {different:?} labels"),
                );
            }
        }
    }

    #[test]
    fn more_labels_than_one_image_holds() {
        let Some(gpu) = crate::support::gpu() else {
            return;
        };
        let camera = camera(1200, 900);
        let gaussians = colored_gaussians(&camera, 0.1);
        let labels = Some(labels(gaussians.len(), 260));
        let render = |device| {
            Renderer::new(gaussians.clone(), labels.clone(), options(), device)
                .unwrap()
                .frame(&camera)
        };
        assert_alike(
            &render(&gpu).unwrap(),
            &render(&crate::support::device()).unwrap(),
            "260 labels",
        );
    }
}

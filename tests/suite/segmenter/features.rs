//! A tensor within the segmenter as image features.

use crate::support::onnx::{NAMES, Onnx, STRIDE};
use crate::support::{assert_names, device};
use coseg::config::{FeatureConfig, FeatureSource};
use coseg::features::{Extractor, Tap};
use image::{Rgb, RgbImage};

#[test]
fn a_tensor_of_the_network_lies_over_the_photo() {
    let folder = tempfile::tempdir().expect("folder");
    let file = Onnx::write_sound(folder.path(), 16, 12);
    let config = FeatureConfig {
        source: FeatureSource::Segmenter("logits".into()),
        weights: Some(file.clone()),
        ..FeatureConfig::default()
    };
    let extractor = Extractor::open(&config, &device()).expect("network");
    assert!(
        extractor.name.starts_with("segmenter ") && extractor.name.ends_with("net.onnx, logits")
    );
    // The left half is red, the right one blue.
    let photo = RgbImage::from_fn(32, 24, |x, _| {
        if x < 16 {
            Rgb([255, 0, 0])
        } else {
            Rgb([0, 0, 255])
        }
    });
    let map = Tap::load(&file, None, "logits")
        .expect("tap")
        .map(&photo)
        .expect("map");
    assert_eq!(
        (map.width, map.height, map.channels),
        (16 / STRIDE, 12 / STRIDE, NAMES.len())
    );
    let red = &map.data[..NAMES.len()];
    let blue = &map.data[map.data.len() - NAMES.len()..];
    assert!(
        (red[1] - 40.0).abs() < 1e-3 && (red[3] + 20.0).abs() < 1e-3,
        "{red:?}"
    );
    assert!(
        (blue[3] - 40.0).abs() < 1e-3 && (blue[1] + 20.0).abs() < 1e-3,
        "{blue:?}"
    );
    // Features of another contract are others: a cache must not mix them.
    let digest = || Tap::load(&file, None, "logits").expect("tap").digest();
    let before = digest();
    assert_eq!(before, digest());
    let contract = file.with_extension("toml");
    let text = std::fs::read_to_string(&contract).expect("contract");
    assert!(text.contains("mean = ["), "{text}");
    std::fs::write(&contract, text.replace("mean = [", "mean = [1")).expect("written");
    assert_ne!(before, digest());
    let error = Tap::load(&file, None, "logit").expect_err("no such tensor");
    assert_names(&error, &["net.onnx", "\"logit\"", "such as logits"]);
}

#[test]
fn the_decoder_of_the_real_network_is_a_map() {
    let Some(file) = crate::support::shared_file("weights/deeplab_ade20k/deeplab_mnv2_ade20k.onnx")
    else {
        return;
    };
    let photo = RgbImage::from_pixel(48, 36, Rgb([90, 120, 60]));
    let tensor = "decoder.conv1.point.relu";
    let map = Tap::load(&file, None, tensor)
        .expect("tap")
        .map(&photo)
        .expect("map");
    assert!(
        map.width > 120 && map.channels > 100 && map.data.iter().all(|v| v.is_finite()),
        "{tensor}: {}",
        map.width
    );
    assert!(
        (map.width as f64 / map.height as f64 - 4.0 / 3.0).abs() < 0.05,
        "{} {}",
        map.width,
        map.height
    );
}

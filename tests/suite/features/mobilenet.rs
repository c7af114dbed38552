//! MobileNetV2: parity with stored activations, key layouts, sizes, damaged weights.

use crate::support::mobilenet_weights::write_blur_weights;
use burn::tensor::{Tensor, TensorData};
use coseg::features::mobilenet::{MobileNetV2, STEPS};
use coseg::features::{FeatureMap, Steps};
use safetensors::tensor::{SafeTensors, TensorView};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

fn weights() -> Option<PathBuf> {
    crate::support::shared_file("weights/mobilenetv2/mobilenetv2_imagenet.safetensors")
}

fn stored(path: &Path) -> BTreeMap<String, (Vec<usize>, Vec<f32>)> {
    let bytes = std::fs::read(path).expect("stored activations");
    let file = SafeTensors::deserialize(&bytes).expect("safetensors");
    let values = |data: &[u8]| {
        data.as_chunks::<4>()
            .0
            .iter()
            .map(|b| f32::from_le_bytes(*b))
            .collect()
    };
    file.iter()
        .map(|(name, v)| (name.to_owned(), (v.shape().to_vec(), values(v.data()))))
        .collect()
}

#[test]
fn activations_equal_the_stored_ones() {
    let Some(path) = weights() else { return };
    let device = crate::support::device();
    let net = MobileNetV2::load(&path, &device).expect("weights");
    let stored = stored(&path.with_file_name("mobilenetv2_parity_fox224.safetensors"));
    let (shape, input) = stored["input"].clone();
    let input = Tensor::<4>::from_data(TensorData::new(input, shape), &device);
    let names = ["features.3", "features.6", "features.13", "features.17"];
    for (name, scale) in names.iter().zip(net.forward(input)) {
        let (shape, expected) = &stored[*name];
        assert_eq!(scale.dims().to_vec(), *shape, "{name}");
        compare(name, &planes(scale), expected);
    }
}

fn planes(x: Tensor<4>) -> Vec<f32> {
    x.into_data().into_vec::<f32>().expect("f32")
}

/// Centre of mass of a weight per cell, image coordinates.
fn center_of_mass(
    map: &FeatureMap,
    [width, height]: [usize; 2],
    weight: impl Fn(&[f32], usize) -> f64,
) -> [f64; 2] {
    let mut total = 0.0;
    let mut sum = [0.0; 2];
    for (cell, values) in map.data.chunks_exact(map.channels).enumerate() {
        let (u, v) = map
            .lattice()
            .center(cell % map.width, cell / map.width, width, height);
        let weight = weight(values, cell);
        total += weight;
        sum = [sum[0] + weight * u, sum[1] + weight * v];
    }
    sum.map(|s| s / total)
}

/// The map of planes `[1, C, H, W]`.
fn cells((scale, steps): (Tensor<4>, Steps)) -> FeatureMap {
    let [_, channels, height, width] = scale.dims();
    FeatureMap {
        height,
        width,
        channels,
        data: planes(scale.permute([0, 2, 3, 1])),
        steps: Some(steps),
    }
}

#[test]
fn cells_keep_their_stride_at_any_image_size() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let path = dir.path().join("blur.safetensors");
    write_blur_weights(&path);
    let net = MobileNetV2::load(&path, &crate::support::device()).expect("weights");
    // A single bright pixel further from every border than the network sees (245 pixels).
    let (width, height) = (541_usize, 525_usize);
    for (x, y) in [(256_usize, 256_usize), (271, 262), (263, 268)] {
        let mut image = vec![0.0_f32; 3 * width * height];
        (0..3).for_each(|c| image[(c * height + y) * width + x] = 1.0);
        let image = TensorData::new(image, [1, 3, height, width]);
        let scales = net.forward(Tensor::from_data(image, &crate::support::device()));
        let maps: Vec<FeatureMap> = scales.into_iter().zip(STEPS).map(cells).collect();
        for (map, steps) in maps.iter().zip(STEPS) {
            let stride = steps.stride as usize;
            assert_eq!(
                (map.width, map.height),
                (width.div_ceil(stride), height.div_ceil(stride))
            );
            // Symmetric kernels see it where padding puts it: half a pixel into the first cell, not at the trained offset.
            let [u, v] = center_of_mass(map, [width, height], |values, _| f64::from(values[0]));
            let (at_u, at_v) = (x as f64 + steps.offset, y as f64 + steps.offset);
            assert!(
                (u - at_u).hypot(v - at_v) < 0.02,
                "stride {stride}: {at_u} {at_v} is seen at {u} {v}"
            );
        }
        // What is read at the centre of a cell is that cell.
        let map = &maps[2];
        let (u, v) = map.lattice().center(16, 17, width, height);
        let mut read = vec![0.0; map.channels];
        map.sample(u, v, width, height, &mut read);
        assert!(
            read.iter()
                .zip(map.cell(16, 17))
                .all(|(a, b)| (a - b).abs() <= 1e-6 * b.abs())
        );
    }
}

#[test]
fn cells_are_where_the_maps_say() {
    let Some(path) = weights() else { return };
    let net = MobileNetV2::load(&path, &crate::support::device()).expect("weights");
    let small = net.maps(&image::RgbImage::new(37, 51)).expect("maps");
    let steps: Vec<_> = small.iter().map(|map| map.steps).collect();
    assert_eq!(steps, STEPS.map(Some));
    // Where maps change when a small patch of a photo changes colour.
    let mut sums = [[0.0; 2]; 4];
    let mut patches = 0.0;
    for photo in ["train_000", "train_032", "train_064"] {
        let file = format!("data/house_living/images/{photo}.jpg");
        let Some(file) = crate::support::shared_file(&file) else {
            return;
        };
        let photo = image::open(&file).expect("a photo");
        let photo = photo.into_rgb8();
        let size = [photo.width() as usize, photo.height() as usize];
        let before = net.maps(&photo).expect("maps");
        // At every phase of the coarsest cells.
        for k in 0..8_u32 {
            let (x, y) = (200 + 37 * k % 81, 150 + 23 * k % 59);
            let mut other = photo.clone();
            for (i, j) in (0..12).flat_map(|j| (0..12).map(move |i| (i, j))) {
                let pixel = other.get_pixel_mut(x - 6 + i, y - 6 + j);
                pixel.0 = [
                    pixel.0[0] / 2 + 100,
                    pixel.0[1] / 2,
                    pixel.0[2] / 2 + 40 * (k as u8 % 2),
                ];
            }
            let after = net.maps(&other).expect("maps");
            patches += 1.0;
            for ((sum, a), b) in sums.iter_mut().zip(&before).zip(&after) {
                let change = |values: &[f32], cell: usize| -> f64 {
                    let old = &a.data[cell * a.channels..][..a.channels];
                    values
                        .iter()
                        .zip(old)
                        .map(|(p, q)| f64::from(p - q).powi(2))
                        .sum()
                };
                let [u, v] = center_of_mass(b, size, change);
                *sum = [sum[0] + u - f64::from(x), sum[1] + v - f64::from(y)];
            }
        }
    }
    for (sum, steps) in sums.iter().zip(STEPS) {
        let off = sum.map(|s| s / patches);
        eprintln!("stride {}: off by {off:?} pixels", steps.stride);
        assert!(
            off.iter().all(|d| d.abs() < 0.12 * steps.stride),
            "stride {}: off by {off:?} pixels",
            steps.stride
        );
    }
}

fn compare(name: &str, found: &[f32], expected: &[f32]) {
    assert_eq!(found.len(), expected.len());
    let largest = expected.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
    let mut worst = 0.0_f32;
    for (a, b) in found.iter().zip(expected) {
        assert!(a.is_finite());
        worst = worst.max((a - b).abs());
    }
    eprintln!("{name}: largest difference {worst:.2e}, largest value {largest:.2}");
    assert!(worst <= 1e-4 * largest, "{name}: {worst} of {largest}");
}

/// The weights under other names, without those that `rename` drops.
fn rewritten(path: &Path, to: &Path, rename: impl Fn(&str) -> Option<String>) {
    let bytes = std::fs::read(path).expect("weights");
    let file = SafeTensors::deserialize(&bytes).expect("safetensors");
    let views: Vec<(String, TensorView)> = file
        .iter()
        .filter_map(|(name, view)| Some((rename(name)?, view)))
        .collect();
    std::fs::write(to, safetensors::serialize(views, None).expect("serialize")).expect("write");
}

/// Flat keys to torchvision's.
fn nested(name: &str) -> String {
    let parts: Vec<&str> = name.split('.').collect();
    match parts.as_slice() {
        ["features", block, "conv", index, last] => {
            let index = match (*block, *index) {
                ("1", "0") | (_, "0") => "0.0",
                ("1", "1") | (_, "1") => "0.1",
                ("1", "3") => "1",
                ("1", "4") => "2",
                (_, "3") => "1.0",
                (_, "4") => "1.1",
                (_, "6") => "2",
                (_, "7") => "3",
                other => panic!("no such layer {other:?}"),
            };
            format!("features.{block}.conv.{index}.{last}")
        }
        _ => name.to_owned(),
    }
}

#[test]
fn nested_keys_and_prefixes_load_to_the_same_network() {
    let Some(path) = weights() else { return };
    let device = crate::support::device();
    let dir = tempfile::tempdir().expect("temporary folder");
    let other = dir.path().join("torchvision.safetensors");
    rewritten(&path, &other, |name| {
        Some(format!("module.{}", nested(name)))
    });
    let input = Tensor::<4>::from_data(
        TensorData::new(
            (0..3 * 37 * 51)
                .map(|i| (i as f32 * 0.37).sin())
                .collect::<Vec<_>>(),
            [1, 3, 37, 51],
        ),
        &device,
    );
    let scales = |path: &Path| -> Vec<(Vec<usize>, Vec<f32>)> {
        let net = MobileNetV2::load(path, &device).expect("weights");
        let maps = net.forward(input.clone()).into_iter();
        maps.map(|x| {
            (
                x.dims().to_vec(),
                x.into_data().into_vec::<f32>().expect("f32"),
            )
        })
        .collect()
    };
    let (a, b) = (scales(&path), scales(&other));
    assert!(a == b);
    // 37 x 51 is not a multiple of anything: sizes round up, as PyTorch's do.
    let sizes: Vec<&[usize]> = a.iter().map(|(shape, _)| &shape[2..]).collect();
    assert_eq!(sizes, [[10, 13], [5, 7], [3, 4], [2, 2]]);
}

#[test]
fn unusable_weights_are_named() {
    let Some(path) = weights() else { return };
    let device = crate::support::device();
    let dir = tempfile::tempdir().expect("temporary folder");
    let file = dir.path().join("w.safetensors");
    let error = |path: &Path| {
        MobileNetV2::load(path, &device)
            .expect_err("unusable")
            .to_string()
    };
    assert!(error(&dir.path().join("absent.pth")).contains("absent.pth"));
    rewritten(&path, &file, |name| {
        (name != "features.5.conv.3.weight").then(|| name.to_owned())
    });
    assert!(
        error(&file).contains("features.5.conv.3.weight"),
        "{}",
        error(&file)
    );
    rewritten(&path, &file, |name| {
        Some(if name == "features.18.0.weight" {
            "features.4.conv.9.weight".into()
        } else {
            name.to_owned()
        })
    });
    assert!(
        error(&file).contains("features.4.conv.9.weight"),
        "{}",
        error(&file)
    );
    let swap = |name: &str| match name {
        "features.7.conv.6.weight" => "features.8.conv.6.weight".to_owned(),
        "features.8.conv.6.weight" => "features.7.conv.6.weight".to_owned(),
        _ => name.to_owned(),
    };
    rewritten(&path, &file, |name| Some(swap(name)));
    assert!(
        error(&file).contains("features.7.conv.6.weight"),
        "{}",
        error(&file)
    );
    let bytes = std::fs::read(&path).expect("weights");
    for cut in [0, 7, 1000, bytes.len() / 2] {
        for name in ["cut.safetensors", "cut.pth"] {
            let cut_file = dir.path().join(name);
            std::fs::write(&cut_file, &bytes[..cut]).expect("write");
            assert!(error(&cut_file).contains(name), "{}", error(&cut_file));
        }
    }
    let (header, metadata) = SafeTensors::read_metadata(&bytes).expect("header");
    let offset = metadata
        .info("features.9.conv.1.bias")
        .expect("tensor")
        .data_offsets
        .0;
    let mut nan = bytes.clone();
    nan[8 + header + offset..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(&file, nan).expect("write");
    assert!(error(&file).contains("NaN"), "{}", error(&file));
}

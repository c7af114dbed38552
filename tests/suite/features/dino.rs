//! DINO's ViT: parity with stored activations and with plain loops, any image size, memory, weight files.

use crate::support::dino_reference::by_plain_loops;
use crate::support::dino_weights::{Size, Tensors, generated, write};
use crate::support::lifting::extract;
use crate::support::pictures::picture;
use burn::tensor::{Tensor, TensorData};
use coseg::Error;
use coseg::config::{FeatureConfig, FeatureSource};
use coseg::data::{Classes, Points, Scene, Split, View, WorldUnit};
use coseg::features::Steps;
use coseg::features::dino::Vit;
use coseg::splat::camera::Camera;
use glam::{DMat3, DVec3};
use image::RgbImage;
use safetensors::tensor::SafeTensors;
use std::path::Path;

const SMALL_8: Size = Size {
    width: 384,
    patch: 8,
    depth: 12,
    side: 28,
    hidden: 1536,
};
const TINY: Size = Size {
    width: 128,
    patch: 4,
    depth: 5,
    side: 3,
    hidden: 96,
};

fn read(path: &Path) -> Tensors {
    let bytes = std::fs::read(path).expect("stored tensors");
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

fn net(size: Size) -> Vit {
    let dir = tempfile::tempdir().expect("temporary folder");
    let path = dir.path().join("vit.safetensors");
    write(&path, &generated(size));
    Vit::load(&path, &crate::support::device()).expect("weights")
}

/// The largest difference relative to the largest value.
fn difference(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len());
    assert!(found.iter().all(|x| x.is_finite()));
    let largest = expected.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
    found
        .iter()
        .zip(expected)
        .fold(0.0_f32, |a, (x, y)| a.max((x - y).abs()))
        / largest
}

fn image_tensor(planes: &[f32], [height, width]: [usize; 2]) -> Tensor<4> {
    let data = TensorData::new(planes.to_vec(), [1, 3, height, width]);
    Tensor::from_data(data, &crate::support::device())
}

fn values(tokens: Tensor<3>) -> Vec<f32> {
    tokens.into_data().into_vec::<f32>().expect("f32")
}

#[test]
fn activations_equal_the_stored_ones() {
    let file = "weights/dino_arch_only/dino_vit192_depth4_RANDOM.safetensors";
    let Some(path) = crate::support::shared_file(file) else {
        return;
    };
    let net = Vit::load(&path, &crate::support::device()).expect("weights");
    assert_eq!([net.width(), net.patch(), net.depth()], [192, 16, 4]);
    assert_eq!(net.taps(), [1, 2, 3, 4]);
    let stored = read(&path.with_file_name("dino_vit192_depth4_RANDOM_parity.safetensors"));
    for (input, name) in [("input_224", "224"), ("input_192x256", "192x256")] {
        let (shape, planes) = &stored[input];
        let tokens = net.forward(image_tensor(planes, [shape[2], shape[3]]));
        assert_eq!(tokens.len(), 5);
        let names = ["tokens", "block0", "block1", "block2", "block3"].map(str::to_owned);
        for (part, tokens) in names.iter().zip(&tokens) {
            compare(&format!("{name}.{part}"), &values(tokens.clone()), &stored);
        }
        let last = net.normalized(tokens[4].clone());
        compare(&format!("{name}.norm"), &values(last), &stored);
    }
}

fn compare(name: &str, found: &[f32], stored: &Tensors) {
    let worst = difference(found, &stored[name].1);
    eprintln!("{name}: largest difference {worst:.1e} of the largest value");
    assert!(worst <= 1e-5, "{name}: {worst}");
}

#[test]
fn the_network_equals_plain_loops_in_f64() {
    let weights = generated(TINY);
    let pixels = TINY.patch * TINY.side;
    let planes: Vec<f32> = (0..3 * pixels * pixels)
        .map(|i| 2.0 * (i as f32 * 0.37).sin())
        .collect();
    let expected: Vec<f32> = by_plain_loops(&weights, TINY, &planes)
        .iter()
        .map(|&x| x as f32)
        .collect();
    let net = net(TINY);
    let tokens = net.forward(image_tensor(&planes, [pixels; 2]));
    let last = net.normalized(tokens[TINY.depth].clone());
    let worst = difference(&values(last), &expected);
    eprintln!("f32 against f64: {worst:.1e}");
    assert!(worst < 1e-5, "{worst}");
}

#[test]
fn official_small_8_loads_and_gives_four_scales() {
    let net = net(SMALL_8);
    assert_eq!([net.width(), net.patch(), net.depth()], [384, 8, 12]);
    assert_eq!(net.taps(), [3, 6, 9, 12]);
    for map in net.maps(&picture(41, 32, 0)).expect("maps") {
        assert_eq!([map.height, map.width, map.channels], [4, 6, 768]);
    }
}

#[test]
fn maps_of_any_image_size_cover_the_image() {
    let net = net(TINY);
    assert_eq!(net.taps(), [2, 3, 4, 5]);
    for (width, height) in [(1, 1), (3, 2), (12, 12), (13, 4), (18, 31)] {
        let image = picture(width, height, 3);
        let maps = net.maps(&image).expect("maps");
        for map in &maps {
            assert_eq!(
                (map.width, map.height),
                (width.div_ceil(4) as usize, height.div_ceil(4) as usize)
            );
            assert_eq!(
                map.steps,
                Some(Steps {
                    stride: 4.0,
                    offset: 2.0
                })
            );
            // The class token's half is the same everywhere.
            let class = &map.cell(0, 0)[128..];
            assert!(map.data.chunks_exact(256).all(|cell| cell[128..] == *class));
        }
        assert!(maps[0] != maps[1] && maps[2] != maps[3]);
        // What does not fill a patch is filled up with the border's pixels.
        let whole = RgbImage::from_fn(4 * width.div_ceil(4), 4 * height.div_ceil(4), |x, y| {
            *image.get_pixel(x.min(width - 1), y.min(height - 1))
        });
        assert_eq!(net.maps(&whole).expect("maps"), maps);
    }
    assert!(matches!(
        net.maps(&RgbImage::new(0, 5)),
        Err(Error::Argument { .. })
    ));
}

#[test]
fn a_cell_is_centred_on_its_patch() {
    // Only the patch's own token, no other, sees a pixel change where attention passes nothing on.
    let mut weights = generated(TINY);
    for (name, (_, values)) in &mut weights {
        if name.contains("attn.proj") {
            values.fill(0.0);
        }
    }
    let dir = tempfile::tempdir().expect("temporary folder");
    let path = dir.path().join("vit.safetensors");
    write(&path, &weights);
    let net = Vit::load(&path, &crate::support::device()).expect("weights");
    let image = picture(22, 19, 0);
    let before = net.maps(&image).expect("maps");
    for (x, y) in [(0, 0), (7, 3), (8, 4), (21, 18)] {
        let mut other = image.clone();
        other.get_pixel_mut(x, y).0[1] ^= 0x80;
        for (a, b) in before.iter().zip(net.maps(&other).expect("maps")) {
            let differ = |(a, b): (&[f32], &[f32])| a != b;
            let changed: Vec<usize> = a
                .data
                .chunks(256)
                .zip(b.data.chunks(256))
                .map(differ)
                .enumerate()
                .filter(|c| c.1)
                .map(|c| c.0)
                .collect();
            assert_eq!(changed, [y as usize / 4 * a.width + x as usize / 4]);
            let (u, v) = b
                .lattice()
                .center(changed[0] % a.width, changed[0] / a.width, 22, 19);
            assert!((u - f64::from(x) - 0.5).abs() <= 1.5 && (v - f64::from(y) - 0.5).abs() <= 1.5);
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let net = net(TINY);
    let image = picture(90, 70, 1);
    let pool = |threads| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool")
    };
    let run = |threads| pool(threads).install(|| net.maps(&image).expect("maps"));
    assert!(run(1) == run(3));
}

#[test]
fn extraction_reduces_the_maps_and_names_the_file() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let path = dir.path().join("random_vit.safetensors");
    write(&path, &generated(TINY));
    let view = |n: u32| {
        let camera = Camera {
            rotation: DMat3::IDENTITY,
            center: DVec3::ZERO,
            fx: 50.0,
            fy: 50.0,
            cx: 19.0,
            cy: 13.0,
            width: 38,
            height: 26,
        };
        let split = if n == 3 { Split::Test } else { Split::Train };
        View {
            name: format!("v{n}"),
            split,
            camera,
            image: picture(38, 26, n).into(),
            mask: None,
            truth: None,
            raw: None,
            scores: None,
            segments: Vec::new(),
            corrected: None,
            instances: None,
        }
    };
    let scene = Scene {
        name: "test".into(),
        views: (0..4).map(view).collect(),
        classes: Classes::default(),
        points: Points::default(),
        drawn: false,
        origin: DVec3::ZERO,
        up: DVec3::Z,
        unit: WorldUnit::Metre,
    };
    let cached = Some(dir.path().join("cache"));
    let config = FeatureConfig {
        source: FeatureSource::Dino,
        contract: None,
        weights: Some(path.clone()),
        dimensions: 16,
        scales: None,
        cache_dir: cached.clone(),
    };
    let run = |config: &FeatureConfig| extract(&scene, config, 0, &crate::support::device());
    let set = run(&config).expect("features");
    assert_eq!(set.name, format!("dino {}", path.display()));
    assert_eq!(set.views.len(), 3);
    for map in set.views.iter().flat_map(|v| &v.maps) {
        assert_eq!([map.height, map.width, map.channels], [7, 10, 16]);
        assert_eq!(
            map.steps,
            Some(Steps {
                stride: 4.0,
                offset: 2.0
            })
        );
        let unit = |cell: &[f32]| (cell.iter().map(|x| x * x).sum::<f32>() - 1.0).abs() < 1e-4;
        assert!(map.data.chunks_exact(16).all(unit));
    }
    let entries = || {
        std::fs::read_dir(dir.path().join("cache"))
            .expect("a cache")
            .count()
    };
    assert_eq!(entries(), 3);
    assert!(run(&config).expect("features").views == set.views);
    assert!(
        run(&FeatureConfig {
            cache_dir: None,
            ..config.clone()
        })
        .expect("features")
        .views
            == set.views
    );
    assert_eq!(entries(), 3);
    let error = run(&FeatureConfig {
        weights: None,
        ..config.clone()
    })
    .expect_err("no weights")
    .to_string();
    assert!(
        error.contains("features.weights") && error.contains("DINO"),
        "{error}"
    );
    let error = run(&FeatureConfig {
        source: FeatureSource::Auto,
        ..config
    })
    .expect_err("taken for MobileNetV2")
    .to_string();
    assert!(
        error.contains("features.source") && error.contains("\"dino\""),
        "{error}"
    );
}

#[test]
fn overflowing_activations_are_errors() {
    for (name, factor) in [
        ("blocks.1.attn.qkv.weight", 1e25),
        ("blocks.2.mlp.fc2.weight", 3e38),
        ("norm.weight", 3e38),
    ] {
        let mut weights = generated(TINY);
        weights
            .get_mut(name)
            .expect("a tensor")
            .1
            .iter_mut()
            .for_each(|v| *v = (*v * factor).clamp(-3e38, 3e38));
        let dir = tempfile::tempdir().expect("temporary folder");
        let path = dir.path().join("vit.safetensors");
        write(&path, &weights);
        let error = Vit::load(&path, &crate::support::device())
            .expect("finite weights")
            .maps(&picture(20, 20, 0))
            .expect_err(name);
        assert!(
            matches!(&error, Error::NonFinite { tensor, .. } if tensor.contains("DINO")),
            "{name}: {error}"
        );
    }
}

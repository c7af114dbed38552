//! DINO's ViT: parity with stored activations and with plain loops, any image size, memory, weight files.

use crate::support::dino_reference::by_plain_loops;
use crate::support::lifting::extract;
use burn::tensor::{Tensor, TensorData};
use coseg::Error;
use coseg::config::{FeatureConfig, FeatureSource};
use coseg::data::{Classes, Points, Scene, Split, View};
use coseg::features::Steps;
use coseg::features::dino::Vit;
use coseg::splat::camera::Camera;
use glam::{DMat3, DVec3};
use image::RgbImage;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use std::collections::BTreeMap;
use std::path::Path;

pub type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// Dimensions of a network.
#[derive(Clone, Copy)]
pub struct Size {
    pub width: usize,
    pub patch: usize,
    pub depth: usize,
    pub side: usize,
    pub hidden: usize,
}

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

/// Tensors with the names and shapes of the official code; values from a hash of name and place, the size of trained ones.
pub fn generated(size: Size) -> Tensors {
    let Size {
        width: d,
        patch,
        depth,
        side,
        hidden,
    } = size;
    let mut shapes: Vec<(String, Vec<usize>)> = vec![
        ("cls_token".into(), vec![1, 1, d]),
        ("pos_embed".into(), vec![1, 1 + side * side, d]),
        ("patch_embed.proj.weight".into(), vec![d, 3, patch, patch]),
        ("patch_embed.proj.bias".into(), vec![d]),
    ];
    let mut layer = |name: String, weight: Vec<usize>| {
        shapes.push((format!("{name}.bias"), vec![weight[0]]));
        shapes.push((format!("{name}.weight"), weight));
    };
    for n in 0..depth {
        layer(format!("blocks.{n}.norm1"), vec![d]);
        layer(format!("blocks.{n}.attn.qkv"), vec![3 * d, d]);
        layer(format!("blocks.{n}.attn.proj"), vec![d, d]);
        layer(format!("blocks.{n}.norm2"), vec![d]);
        layer(format!("blocks.{n}.mlp.fc1"), vec![hidden, d]);
        layer(format!("blocks.{n}.mlp.fc2"), vec![d, hidden]);
    }
    layer("norm".into(), vec![d]);
    let tensors = shapes.into_iter().map(|(name, shape)| {
        let mut state = name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| {
            (h ^ u64::from(b)).wrapping_mul(0x100_0000_01b3)
        });
        let fan: usize = shape[1..].iter().product();
        let norm = name.contains("norm") && name.ends_with("weight");
        let (mean, spread) = if norm {
            (1.0, 0.3)
        } else {
            (0.0, 2.0 / (fan as f32).sqrt().clamp(4.0, 40.0))
        };
        let values = (0..shape.iter().product()).map(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            mean + spread * ((state >> 40) as f32 / (1_u64 << 23) as f32 - 1.0)
        });
        (name, (shape.clone(), values.collect()))
    });
    tensors.collect()
}

pub fn write(path: &Path, tensors: &Tensors) {
    let bytes: Vec<Vec<u8>> = tensors
        .values()
        .map(|(_, v)| v.iter().flat_map(|x| x.to_le_bytes()).collect())
        .collect();
    let views = tensors
        .iter()
        .zip(&bytes)
        .map(|((name, (shape, _)), bytes)| {
            (
                name.clone(),
                TensorView::new(Dtype::F32, shape.clone(), bytes).expect("a tensor"),
            )
        });
    std::fs::write(
        path,
        safetensors::serialize(views, None).expect("serialize"),
    )
    .expect("write");
}

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

pub fn picture(width: u32, height: u32, seed: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let n = (x.wrapping_mul(73) ^ y.wrapping_mul(151) ^ seed.wrapping_mul(977))
            .wrapping_mul(2_654_435_761)
            >> 24;
        image::Rgb([
            (x * 255 / width) as u8,
            (n / 2 + y * 100 / height) as u8,
            ((x / 7 + y / 5 + seed) % 2 * 180) as u8,
        ])
    })
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
    assert_eq!(
        [net.width(), net.patch(), net.depth(), net.heads()],
        [192, 16, 4, 3]
    );
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
    assert_eq!(
        [net.width(), net.patch(), net.depth(), net.heads()],
        [384, 8, 12, 6]
    );
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
fn attention_in_chunks_equals_attention_at_once() {
    let net = net(TINY);
    let image = picture(90, 70, 1);
    let at_once = net
        .clone()
        .with_query_chunk(usize::MAX >> 20)
        .maps(&image)
        .expect("maps");
    for queries in [1, 7, 64] {
        for (a, b) in at_once.iter().zip(
            net.clone()
                .with_query_chunk(queries)
                .maps(&image)
                .expect("maps"),
        ) {
            let worst = difference(&b.data, &a.data);
            assert!(worst < 2e-6, "{queries}: {worst}");
        }
    }
    // The number of threads changes no bit.
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
    };
    let cached = Some(dir.path().join("cache"));
    let config = FeatureConfig {
        source: FeatureSource::Dino,
        weights: Some(path.clone()),
        dimensions: 16,
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
        ..config
    })
    .expect_err("no weights")
    .to_string();
    assert!(
        error.contains("features.weights") && error.contains("DINO"),
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

//! The RandLA encoder against stored activations of the published one.

use burn::tensor::{Tensor, TensorData};
use coseg::device;
use coseg::segmentation::checkpoint::Checkpoint;
use coseg::segmentation::neighbours::Neighbours;
use coseg::segmentation::pyramid::{Pyramid, PyramidLevel};
use coseg::segmentation::randla::{Form, LAYERS, RandlaEncoder};
use safetensors::SafeTensors;

/// The stored cloud with its stored indices, and its stored activations as `[N, channels]`.
struct Reference {
    pyramid: Pyramid,
    input: Vec<f32>,
    levels: Vec<Vec<f32>>,
    coarsest: Vec<f32>,
}

fn floats(file: &SafeTensors, name: &str) -> Vec<f32> {
    let view = file.tensor(name).expect(name);
    view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

fn integers(file: &SafeTensors, name: &str) -> Vec<u32> {
    let view = file.tensor(name).expect(name);
    view.data().chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

/// `[channels, points]` to `[points, channels]`.
fn rows(values: &[f32], points: usize) -> Vec<f32> {
    let channels = values.len() / points;
    (0..values.len()).map(|i| values[i % channels * points + i / channels]).collect()
}

fn reference(bytes: &[u8]) -> Reference {
    let file = SafeTensors::deserialize(bytes).expect("a safetensors file");
    let mut pyramid = Pyramid::default();
    for n in 0..LAYERS {
        let xyz = floats(&file, &format!("xyz.{n}"));
        let positions: Vec<[f32; 3]> = xyz.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
        let neighbours = Neighbours { k: 16, indices: integers(&file, &format!("neigh_idx.{n}")) };
        let kept = positions.len() / 4;
        assert_eq!(
            neighbours.indices[..kept * 16],
            integers(&file, &format!("sub_idx.{n}")),
            "the first quarter is kept"
        );
        let indices = (0..positions.len() as u32).collect();
        pyramid.levels.push(PyramidLevel { indices, positions, neighbours, kept: (0..kept as u32).collect() });
    }
    let points = |n: usize| pyramid.levels[n].positions.len();
    let levels = (0..LAYERS).map(|n| rows(&floats(&file, &format!("enc_out.{n}")), points(n))).collect();
    let input = rows(&floats(&file, "features_in"), points(0));
    let coarsest = rows(&floats(&file, "enc_sampled.3"), points(3) / 4);
    Reference { pyramid, input, levels, coarsest }
}

fn largest_difference(found: Tensor<2>, stored: &[f32]) -> f64 {
    let found: Vec<f32> = found.into_data().into_vec().expect("f32");
    assert_eq!(found.len(), stored.len());
    assert!(found.iter().all(|v| v.is_finite()));
    found.iter().zip(stored).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max)
}

#[test]
fn encoder_equals_the_published_one_on_its_stored_activations() {
    let Some(dir) = crate::shared_dir() else { return };
    let dir = dir.join("weights/randlanet");
    let weights = Checkpoint::open(dir.join("randlanet_semantickitti.safetensors")).expect("weights");
    let bytes = std::fs::read(dir.join("randlanet_parity_4096.safetensors")).expect("reference");
    let reference = reference(&bytes);
    let device = device::open(None).expect("a backend");
    for (form, chunked) in [(Form::Frozen, false), (Form::Frozen, true), (Form::Trainable, false)] {
        let encoder = RandlaEncoder::load(&weights, form, &device).expect("RandLA weights");
        assert_eq!((encoder.inputs(), encoder.widths()), (3, vec![32, 128, 256, 512]));
        let input = Tensor::<2>::from_data(TensorData::new(reference.input.clone(), [4096, 3]), &device);
        let (levels, coarsest) = encoder.encode_levels(input, &reference.pyramid, chunked);
        for (n, (found, stored)) in levels.into_iter().zip(&reference.levels).enumerate() {
            let difference = largest_difference(found, stored);
            eprintln!("{form:?}, chunked {chunked}, level {}: largest difference {difference:.2e}", n + 1);
            assert!(difference < 2e-3, "level {}: {difference}", n + 1);
        }
        let difference = largest_difference(coarsest, &reference.coarsest);
        eprintln!("{form:?}, chunked {chunked}, coarsest: largest difference {difference:.2e}");
        assert!(difference < 2e-3, "coarsest: {difference}");
    }
}

//! The decoder: against Eq. 7 written out, its switches, its restriction, what it learns.

use crate::support::joined_pyramid;
use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use coseg::Error;
use coseg::config::{SpatialConfig, SpatialSource};
use coseg::segmentation::decoder::{Decoder, DecoderConfig, HIDDEN};
use coseg::segmentation::encoder::{Cloud, Encoding, encode, load_spatial};
use coseg::segmentation::pyramid::{Dependencies, Pyramid, Switches};
use glam::DVec3;

const POINTS: usize = 1_500;

fn plain_device() -> Device {
    crate::support::device()
}

fn values(t: Tensor<2>) -> Vec<f32> {
    t.into_data().into_vec().expect("f32")
}

fn largest_difference(a: Tensor<2>, b: Tensor<2>) -> f32 {
    assert_eq!(a.dims(), b.dims());
    let (a, b) = (values(a), values(b));
    assert!(a.iter().chain(&b).all(|v| v.is_finite()));
    a.iter()
        .zip(&b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max)
}

fn make(input: &Pyramid, layer_norm: bool, seed: u64, device: &Device) -> Decoder {
    DecoderConfig::for_pyramid(input, 6)
        .with_layer_norm(layer_norm)
        .with_seed(seed)
        .init(device)
}

fn scene(device: &Device) -> (Encoding, Vec<Tensor<2>>) {
    let positions: Vec<[f32; 3]> = (0..POINTS)
        .map(|i| std::array::from_fn(|a| (i as f32 * [0.37, 0.61, 0.83][a]).sin()))
        .collect();
    let config = SpatialConfig {
        source: SpatialSource::Random,
        ..SpatialConfig::default()
    };
    let (encoder, name) = load_spatial(&config, 5, device).expect("random weights");
    assert_eq!(name, "random");
    let cloud = Cloud {
        positions: &positions,
        colors: None,
        up: DVec3::Y,
        scale: 1.0,
    };
    let image = (0..4)
        .map(|n| {
            let values: Vec<f32> = (0..POINTS * 8)
                .map(|i| (i as f32 * 0.13 + n as f32).cos())
                .collect();
            Tensor::from_data(TensorData::new(values, [POINTS, 8]), device)
        })
        .collect();
    (encode(&encoder, &cloud, 3, device).expect("finite"), image)
}

#[test]
fn decodes_as_equation_7_says() {
    let device = plain_device();
    let (encoding, image) = scene(&device);
    let input = joined_pyramid(&encoding, &image, Switches::default());
    let decoder = make(&input, false, 1, &device);
    let decoded = decoder.forward(&input);
    let logits = decoder.classify(decoded.hidden.clone());
    assert_eq!(
        (decoded.hidden.dims(), logits.dims()),
        ([POINTS, HIDDEN], [POINTS, 6])
    );

    // MLP(f_d + f_s + US(below)) by concatenation, weights and biases read off the module
    let mut parameters: Vec<Vec<f32>> = Vec::new();
    struct Collect<'a>(&'a mut Vec<Vec<f32>>);
    impl burn::module::ModuleVisitor for Collect<'_> {
        fn visit_float<const D: usize>(&mut self, param: &burn::module::Param<Tensor<D>>) {
            self.0
                .push(param.val().into_data().into_vec().expect("f32"));
        }
    }
    decoder.visit(&mut Collect(&mut parameters));
    let mut below: Vec<Vec<f32>> = values(encoding.coarsest.features.clone())
        .chunks_exact(encoding.coarsest.features.dims()[1])
        .map(<[f32]>::to_vec)
        .collect();
    for n in (0..4).rev() {
        let [weights @ .., bias] = &parameters[3 * n..3 * n + 3] else {
            panic!("three tensors a layer")
        };
        let width = bias.len();
        let level = &encoding.levels[n];
        let lifted = values(image[n].clone());
        let spatial = values(level.features.clone());
        let spatial_width = level.features.dims()[1];
        let all = weights.concat();
        below = (0..level.indices.len())
            .map(|i| {
                let mut x = lifted[level.indices[i] as usize * 8..][..8].to_vec();
                x.extend_from_slice(&spatial[i * spatial_width..][..spatial_width]);
                let (columns, weights) = encoding.upsample[n].row(i);
                let upsampled = |c: usize| {
                    columns
                        .iter()
                        .zip(weights)
                        .map(|(&j, w)| w * below[j as usize][c])
                        .sum::<f32>()
                };
                x.extend((0..below[0].len()).map(upsampled));
                (0..width)
                    .map(|o| {
                        let y: f32 = bias[o]
                            + x.iter()
                                .enumerate()
                                .map(|(j, x)| x * all[j * width + o])
                                .sum::<f32>();
                        if y > 0.0 { y } else { 0.2 * y }
                    })
                    .collect()
            })
            .collect();
        let want: Vec<f32> = below.concat();
        let scale = want.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        let want = Tensor::from_data(TensorData::new(want, [level.indices.len(), width]), &device);
        let difference = largest_difference(decoded.fused[n].clone(), want);
        assert!(
            difference < 1e-5 * scale.max(1.0),
            "scale {}: {difference} of {scale}",
            n + 1
        );
    }
}

#[test]
fn a_restricted_input_decodes_to_the_same_rows() {
    let device = plain_device();
    let (encoding, image) = scene(&device);
    let rows: Vec<u32> = (0..POINTS as u32).rev().step_by(7).collect();
    for switches in [
        Switches::default(),
        Switches {
            spatial: false,
            ..Switches::default()
        },
        Switches {
            scales: 1,
            ..Switches::default()
        },
        Switches {
            scales: 3,
            ..Switches::default()
        },
    ] {
        let input = joined_pyramid(&encoding, &image, switches);
        let decoder = make(&input, true, 1, &device);
        let whole = decoder.forward(&input);
        let dependencies = Dependencies::new(&input, rows.clone());
        let part = decoder.forward(&input.part(&dependencies));
        let kept = |n: usize| dependencies.rows(n);
        assert!(kept(0).len() == rows.len() && part.fused.len() == input.levels.len());
        for (n, (part, whole)) in part.fused.into_iter().zip(whole.fused).enumerate() {
            let index: Vec<i64> = kept(n).iter().map(|&r| i64::from(r)).collect();
            let index = Tensor::from_data(TensorData::new(index, [kept(n).len()]), &device);
            assert!(
                largest_difference(part, whole.select(0, index)) < 1e-5,
                "{switches:?}, scale {}",
                n + 1
            );
        }
    }
}

#[test]
fn switches_leave_features_out() {
    let device = plain_device();
    let (encoding, image) = scene(&device);
    let count = |switches| {
        let input = joined_pyramid(&encoding, &image, switches);
        let decoder = make(&input, false, 1, &device);
        decoder.num_params()
    };
    let spatial: Vec<usize> = encoding
        .levels
        .iter()
        .map(|l| l.features.dims()[1])
        .collect();
    let coarsest = spatial[3];
    let widths = [64, 64, 128, 256];
    let want = |image: usize, spatial: &[usize], coarsest: usize| -> usize {
        let below = [widths[1], widths[2], widths[3], coarsest];
        (0..4)
            .map(|n| (image + spatial[n] + below[n] + 1) * widths[n])
            .sum::<usize>()
            + 65 * 6
    };
    assert_eq!(count(Switches::default()), want(8, &spatial, coarsest));
    assert_eq!(
        count(Switches {
            image: false,
            ..Switches::default()
        }),
        want(0, &spatial, coarsest)
    );
    assert_eq!(
        count(Switches {
            spatial: false,
            ..Switches::default()
        }),
        want(8, &[0; 4], 0)
    );
    let finest = |scales| Switches {
        scales,
        ..Switches::default()
    };
    assert_eq!(count(finest(1)), (8 + spatial[0] + 1) * 64 + 65 * 6);
    let two = (8 + spatial[0] + widths[1] + 1) * widths[0] + (8 + spatial[1] + 1) * widths[1];
    assert_eq!(count(finest(2)), two + 65 * 6);
    let nothing = Switches {
        image: false,
        spatial: false,
        ..Switches::default()
    };
    assert!(matches!(
        Pyramid::new(&encoding, nothing, |_, _| unreachable!(
            "nothing reads images"
        )),
        Err(Error::Argument { .. })
    ));
}

#[test]
fn gradients_reach_every_parameter_and_equal_seeds_equal_weights() {
    let device = plain_device().autodiff();
    let (encoding, image) = scene(&device.clone().inner());
    let input = joined_pyramid(&encoding, &image, Switches::default());
    let make = |seed| make(&input, true, seed, &device);
    let logits = |decoder: &Decoder| decoder.classify(decoder.forward(&input).hidden);
    let decoder = make(1);
    assert_eq!(
        values(logits(&decoder).inner()),
        values(logits(&make(1)).inner())
    );
    assert_ne!(
        values(logits(&decoder).inner()),
        values(logits(&make(2)).inner())
    );
    let gradients = logits(&decoder).powi_scalar(2).mean().backward();
    struct Check<'a>(&'a burn::tensor::Gradients, usize);
    impl burn::module::ModuleVisitor for Check<'_> {
        fn visit_float<const D: usize>(&mut self, param: &burn::module::Param<Tensor<D>>) {
            let g: Vec<f32> = param
                .val()
                .grad(self.0)
                .expect("a gradient")
                .into_data()
                .into_vec()
                .expect("f32");
            assert!(g.iter().all(|g| g.is_finite()) && g.iter().any(|g| *g != 0.0));
            self.1 += 1;
        }
    }
    let mut check = Check(&gradients, 0);
    decoder.visit(&mut check);
    assert_eq!(check.1, 4 * (3 + 2) + 2);
}

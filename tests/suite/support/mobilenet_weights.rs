//! Weights of MobileNetV2 under which every layer is a mean.

use safetensors::tensor::TensorView;
use std::path::Path;

/// Writes weights under which every layer is a mean: of its channels, and of its 3x3 neighbourhood with binomial weights.
/// At any stride these pass on all inputs alike, so that the centre of mass of what is passed on stays.
pub fn write_blur_weights(path: &Path) {
    let mut tensors: Vec<(String, Vec<usize>, Vec<f32>)> = Vec::new();
    let mut layer = |conv: String, norm: String, shape: [usize; 4]| {
        let fan: usize = shape[1..].iter().product();
        let kernel: &[f32] = if shape[2] == 3 {
            &[
                0.0625, 0.125, 0.0625, 0.125, 0.25, 0.125, 0.0625, 0.125, 0.0625,
            ]
        } else {
            &[1.0]
        };
        let planes = kernel
            .iter()
            .cycle()
            .take(shape[0] * fan)
            .map(|v| v / shape[1] as f32);
        tensors.push((format!("{conv}.weight"), shape.to_vec(), planes.collect()));
        // The variance that batch normalisation with epsilon 1e-5 leaves alone.
        for (name, value) in [
            ("weight", 1.0),
            ("bias", 0.0),
            ("running_mean", 0.0),
            ("running_var", 1.0 - 1e-5),
        ] {
            tensors.push((
                format!("{norm}.{name}"),
                vec![shape[0]],
                vec![value; shape[0]],
            ));
        }
    };
    layer("features.0.0".into(), "features.0.1".into(), [32, 3, 3, 3]);
    let outputs = [
        16, 24, 24, 32, 32, 32, 64, 64, 64, 64, 96, 96, 96, 160, 160, 160, 320,
    ];
    let mut input = 32;
    for (n, output) in (1..).zip(outputs) {
        let hidden = if n == 1 { input } else { 6 * input };
        let mut next = 0;
        let mut add = |shape| {
            layer(
                format!("features.{n}.conv.{next}"),
                format!("features.{n}.conv.{}", next + 1),
                shape,
            );
            next += 3;
        };
        if n > 1 {
            add([hidden, input, 1, 1]);
        }
        add([hidden, 1, 3, 3]);
        add([output, hidden, 1, 1]);
        input = output;
    }
    let bytes: Vec<Vec<u8>> = tensors
        .iter()
        .map(|(_, _, values)| values.iter().flat_map(|v| v.to_le_bytes()).collect())
        .collect();
    let views = tensors.iter().zip(&bytes).map(|((name, shape, _), bytes)| {
        (
            name.clone(),
            TensorView::new(safetensors::Dtype::F32, shape.clone(), bytes).expect("a tensor"),
        )
    });
    std::fs::write(
        path,
        safetensors::serialize(views, None).expect("serialize"),
    )
    .expect("write");
}

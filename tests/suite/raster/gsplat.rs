//! Another program's pictures and gradients: gsplat 1.5.3's, by `scripts/reference_gsplat.py`, in f64.
//!
//! 110 Gaussians, of which some lie behind the camera or beyond its rim, are flat, or are more opaque than the cap; SH of degree 3;
//! 27 of the 45x31 pixels end early.

use burn::tensor::{DType, Device, Tensor, TensorData};
use coseg::raster::{RasterInput, Settings, rasterize};
use coseg::splat::camera::Camera;
use glam::{DMat3, DVec3};
use safetensors::{Dtype, SafeTensors};

const FILE: &[u8] = include_bytes!("../../fixtures/gsplat.safetensors");
const WIDTH: usize = 45;
const HEIGHT: usize = 31;
/// Inputs with a gradient; the gradient is `d_NAME` in the file.
const LEAVES: [&str; 5] = ["means", "log_scales", "rotations", "opacity_logits", "sh"];

/// A tensor of the file, and its shape.
fn read(name: &str) -> (Vec<f64>, Vec<usize>) {
    let file = SafeTensors::deserialize(FILE).expect("a safetensors file");
    let tensor = file.tensor(name).expect("in the file");
    let numbers = match tensor.dtype() {
        Dtype::F32 => tensor
            .data()
            .as_chunks()
            .0
            .iter()
            .map(|&b| f64::from(f32::from_le_bytes(b)))
            .collect(),
        Dtype::F64 => tensor
            .data()
            .as_chunks()
            .0
            .iter()
            .map(|&b| f64::from_le_bytes(b))
            .collect(),
        other => panic!("{name}: {other:?}"),
    };
    (numbers, tensor.shape().to_vec())
}

fn tensor<const D: usize>(name: &str, device: &Device, dtype: DType) -> Tensor<D> {
    let (numbers, shape) = read(name);
    Tensor::from_data(TensorData::new(numbers, shape), (device, dtype))
}

fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    tensor
        .into_data()
        .convert::<f64>()
        .into_vec()
        .expect("floats")
}

fn camera() -> Camera {
    let [r, c, k] = ["world_to_camera", "center", "intrinsics"].map(|name| read(name).0);
    Camera {
        // Rows in the file, columns in glam.
        rotation: DMat3::from_cols_slice(&r).transpose(),
        center: DVec3::from_slice(&c),
        fx: k[0],
        fy: k[1],
        cx: k[2],
        cy: k[3],
        width: WIDTH,
        height: HEIGHT,
    }
}

/// Picture, transmittance, and the gradients of [`LEAVES`] under the file's loss.
fn render(device: &Device, dtype: DType) -> Vec<(String, Vec<f64>)> {
    let device = device.clone().autodiff();
    let input = RasterInput {
        means: tensor("means", &device, dtype).require_grad(),
        log_scales: tensor("log_scales", &device, dtype).require_grad(),
        rotations: tensor("rotations", &device, dtype).require_grad(),
        opacity_logits: tensor("opacity_logits", &device, dtype).require_grad(),
        sh: Some(tensor("sh", &device, dtype).require_grad()),
        active_sh_degree: 3,
        features: None,
        screen: None,
    };
    let out = rasterize(input.clone(), &camera(), &Settings::default(), [0.0; 3]).expect("valid");
    let loss = (out.image.clone() * tensor("loss_image", &device, dtype)).sum()
        + (out.transmittance.clone() * tensor("loss_transmittance", &device, dtype)).sum();
    let grads = loss.backward();
    let gradients = [
        numbers(input.means.grad(&grads).expect("tracked")),
        numbers(input.log_scales.grad(&grads).expect("tracked")),
        numbers(input.rotations.grad(&grads).expect("tracked")),
        numbers(input.opacity_logits.grad(&grads).expect("tracked")),
        numbers(input.sh.expect("given").grad(&grads).expect("tracked")),
    ];
    let pictures = [
        ("image", numbers(out.image)),
        ("transmittance", numbers(out.transmittance)),
    ];
    let named = pictures.into_iter().map(|(name, v)| (name.to_owned(), v));
    named
        .chain(
            LEAVES
                .iter()
                .zip(gradients)
                .map(|(name, v)| (format!("d_{name}"), v)),
        )
        .collect()
}

/// Largest difference of each tensor: of the pictures beside their largest value, of gradients beside their rms.
fn compare(what: &str, got: &[(String, Vec<f64>)]) -> Vec<(String, f64)> {
    let errors = got.iter().map(|(name, got)| {
        let want = read(name).0;
        assert_eq!(got.len(), want.len(), "{name}");
        let scale = if name.starts_with("d_") {
            (want.iter().map(|v| v * v).sum::<f64>() / want.len() as f64).sqrt()
        } else {
            want.iter().fold(0.0, |m: f64, v| m.max(v.abs()))
        };
        assert!(scale > 0.0, "{name}: nothing to compare");
        assert!(got.iter().all(|v| v.is_finite()), "{name}");
        (
            name.clone(),
            got.iter()
                .zip(&want)
                .map(|(g, w)| (g - w).abs() / scale)
                .fold(0.0, f64::max),
        )
    });
    let errors: Vec<(String, f64)> = errors.collect();
    println!("{what}: {errors:?}");
    errors
}

#[test]
fn pictures_and_gradients_in_f64_are_those_of_gsplat() {
    for (name, error) in compare("f64", &render(&crate::support::device(), DType::F64)) {
        assert!(error <= 1e-12, "{name}: {error:e}");
    }
}

#[test]
fn pictures_and_gradients_in_f32_are_those_of_gsplat() {
    #[cfg(feature = "wgpu")]
    let gpu = crate::support::gpu();
    #[cfg(not(feature = "wgpu"))]
    let gpu: Option<Device> = None;
    for (what, device) in [
        ("f32", Some(crate::support::device())),
        ("f32 on the GPU", gpu),
    ] {
        let Some(device) = device else { continue };
        for (name, error) in compare(what, &render(&device, DType::F32)) {
            let bar = if name.starts_with("d_") { 1e-3 } else { 1e-4 };
            assert!(error <= bar, "{what}, {name}: {error:e}");
        }
    }
}

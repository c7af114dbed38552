//! The rasterizer as an operation of burn in a loop of your own: Gaussians learn four photos with burn's Adam.
//!
//!     cargo run --release --example learn_photos

use burn::module::{Module, Param};
use burn::optim::{AdamConfig, GradientsParams};
use burn::tensor::{Tensor, TensorData};
use coseg::data::Split;
use coseg::data::builtin::{BuiltinOptions, scene_with};
use coseg::metrics::psnr;
use coseg::ops::{PhotometricTarget, photometric_loss};
use coseg::raster::{RasterInput, Settings, SplatTensors, rasterize};
use coseg::reconstruction::initialization;
use coseg::splat::Gaussians;
use std::error::Error;
use std::sync::Arc;

/// What is learned of N Gaussians. One learning rate for all: `shifts` are in units of 2 cm.
#[derive(Module, Debug)]
struct Learned {
    shifts: Param<Tensor<2>>,
    log_scales: Param<Tensor<2>>,
    rotations: Param<Tensor<2>>,
    opacity_logits: Param<Tensor<1>>,
    sh: Param<Tensor<3>>,
}

impl Learned {
    fn new(gaussians: &Gaussians, device: &burn::tensor::Device) -> Self {
        let SplatTensors {
            means,
            log_scales,
            rotations,
            opacity_logits,
        } = SplatTensors::new(gaussians, device);
        let shape = [gaussians.len(), gaussians.sh_len(), 3];
        let sh = Tensor::from_data(TensorData::new(gaussians.sh.clone(), shape), device);
        Self {
            shifts: Param::from_tensor(Tensor::from_inner(means.zeros_like())),
            log_scales: Param::from_tensor(Tensor::from_inner(log_scales)),
            rotations: Param::from_tensor(Tensor::from_inner(rotations)),
            opacity_logits: Param::from_tensor(Tensor::from_inner(opacity_logits)),
            sh: Param::from_tensor(sh),
        }
    }

    fn input(&self, means: &Tensor<2>) -> RasterInput {
        RasterInput {
            means: means.clone() + self.shifts.val() * 0.02,
            log_scales: self.log_scales.val(),
            rotations: self.rotations.val(),
            opacity_logits: self.opacity_logits.val(),
            sh: Some(self.sh.val()),
            active_sh_degree: 1,
            features: None, // [N, C] of your own would be blended beside the colour, with gradients too
            screen: None,
        }
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let device = coseg::backend::device::open(None)?.autodiff();
    let options = BuiltinOptions {
        width: 160,
        height: 120,
        train_views: 4,
        test_views: 0,
        ..Default::default()
    };
    let scene = scene_with(&options)?;
    let views: Vec<_> = scene.split(Split::Train).collect();
    let targets = views.iter().map(|view| {
        let target = PhotometricTarget::new(view.image.pixels()?, view.mask.clone());
        Ok(Arc::new(target))
    });
    let targets = targets.collect::<coseg::Result<Vec<_>>>()?;

    let gaussians = initialization::from_points(&scene.points, 1, 5.0)?;
    let means = Tensor::from_inner(SplatTensors::new(&gaussians, &device).means);
    let mut learned = Learned::new(&gaussians, &device);
    let mut adam = AdamConfig::new().with_epsilon(1e-15).init();
    println!("{} Gaussians, {} photos", gaussians.len(), targets.len());
    for step in 0..=200 {
        let i = step % views.len();
        let image = rasterize(
            learned.input(&means),
            &views[i].camera,
            &Settings::default(),
            [0.0; 3],
        )?
        .image;
        if step % 40 == 0 {
            let rendered = image
                .clone()
                .inner()
                .into_data()
                .into_vec::<f32>()
                .map_err(|e| format!("{e:?}"))?;
            let decibels = psnr(&rendered, &views[i].rgb()?).unwrap_or(f64::NAN);
            println!("step {step:3}: PSNR {decibels:.2} dB in {}", views[i].name);
        }
        let gradients = photometric_loss(image, &targets[i], 0.2).backward();
        let gradients = GradientsParams::from_grads(gradients, &learned);
        learned = adam.step(0.01, learned, gradients);
    }
    Ok(())
}

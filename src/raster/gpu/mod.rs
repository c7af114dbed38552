//! The rasterizer's kernels for GPUs, one CubeCL source for every device.
//!
//! They follow the CPU's formulas step by step, in `f32`. The camera centre is split into two floats, and the exponent is
//! `-(u^2 + v^2)` with the determinant as a sum of positive terms: rounding costs digits, never splats. The kernels use no
//! subgroup operation and no float atomic, and sum in a fixed order, so that a device returns the same bits every time. A forward
//! pass reads back once: the number of tile entries and the number of non-finite rows.
//!
//! Memory besides inputs and outputs, in bytes: 64 for each Gaussian (100 in the backward pass), 28 for each tile entry during the
//! sort and 8 afterwards. The backward pass and the adjoint take up to 128 for each tile entry (80 where cubes have 32 KB of shared
//! memory), 1 GiB at most: more entries go through in slabs. Sums of absolute values add 8 for each Gaussian and tile entry.

mod backward;
mod backward_sums;
mod batch;
mod blend;
mod ewa;
mod frozen;
mod inputs;
mod lists;
mod outline;
mod parameters;
mod passes;
mod pixel;
mod pixel_sums;
mod prepare;
mod project;
mod radix_sort;
mod row_sums;
mod scan;
mod sh;
mod vec3;
mod view;

pub(crate) use self::inputs::Inputs;
pub(crate) use self::passes::Forward;
pub(super) use self::passes::forward;
pub(crate) use self::prepare::Prepared;
pub(crate) use self::sh::Harmonics;

use crate::backend::gpu::missing_capability;
use burn::tensor::DType;
use burn_cubecl::tensor::CubeTensor;

/// Sums of absolute screen-space gradients exist for up to this many channels.
pub(super) const ABSOLUTE_CHANNELS: usize = backward::COMMON_BLOCK_CHANNELS;

/// Whether the device of `tensor` can run the kernels.
pub(super) fn covers(tensor: &CubeTensor) -> bool {
    tensor.dtype == DType::F32 && missing_capability(&tensor.client).is_none()
}

#[cfg(test)]
mod fixture {
    //! What the tests of the kernels share.

    use super::inputs::Inputs;
    use super::prepare::{Prepared, read_words};
    use crate::backend::device::gpu_of_tests;
    use crate::backend::gpu::Gpu;
    use crate::raster::Settings;
    use crate::raster::{Projected, Splats};
    use crate::splat::camera::Camera;
    use burn_cubecl::CubeDevice;
    use burn_cubecl::tensor::CubeTensor;
    use glam::{DMat3, DVec3};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// The default device, if this machine has one.
    pub fn gpu() -> Option<Gpu> {
        gpu_of_tests()?;
        Some(Gpu::on(CubeDevice::Wgpu(Default::default())))
    }

    pub fn words(gpu: &Gpu, tensor: &CubeTensor) -> Vec<u32> {
        read_words(gpu, tensor).expect("a working device")
    }

    pub fn floats(gpu: &Gpu, tensor: &CubeTensor) -> Vec<f32> {
        words(gpu, tensor).into_iter().map(f32::from_bits).collect()
    }

    /// A scene in host memory and on the device, up to its tile lists.
    pub struct View {
        pub gpu: Gpu,
        pub host: Projected<f32>,
        pub prepared: Prepared,
    }

    impl View {
        pub fn new(n: usize, scale: f32, size: [usize; 2], settings: &Settings) -> Option<Self> {
            let gpu = gpu()?;
            let mut rng = ChaCha8Rng::seed_from_u64(3);
            let mut draw = |n: usize, low: f32, high: f32| -> Vec<f32> {
                (0..n).map(|_| rng.random_range(low..high)).collect()
            };
            let means: Vec<f32> = draw(3 * n, -2.0, 2.0);
            let log_scales: Vec<f32> = draw(3 * n, -1.0, 1.0)
                .iter()
                .map(|x| x + scale.ln())
                .collect();
            let rotations = draw(4 * n, -1.0, 1.0);
            let logits = draw(n, -3.0, 3.0);
            let camera = Camera {
                rotation: DMat3::IDENTITY,
                center: DVec3::new(0.1, 0.2, -2.5),
                fx: 0.8 * size[0] as f64,
                fy: 0.8 * size[0] as f64,
                cx: 0.5 * size[0] as f64,
                cy: 0.5 * size[1] as f64,
                width: size[0],
                height: size[1],
            };
            let splats = Splats {
                means: &means,
                log_scales: &log_scales,
                rotations: &rotations,
                opacity_logits: &logits,
            };
            let host = Projected::new(&splats, &camera, settings).expect("valid");
            let [means, log_scales, rotations, logits] =
                [&means, &log_scales, &rotations, &logits].map(|v| gpu.upload(v));
            let inputs = Inputs {
                means,
                log_scales,
                rotations,
                logits,
                sh: None,
                features: None,
            };
            let prepared =
                Prepared::new(&inputs, &camera, settings, [0.0; 3]).expect("a working device");
            Some(Self {
                prepared: prepared.expect("finite"),
                gpu,
                host,
            })
        }
    }
}

//! The geometry of Gaussians as tensors.

use super::{RasterInput, RasterOutput, rasterize};
use crate::camera::Camera;
use crate::error::Result;
use crate::gaussians::Gaussians;
use crate::raster::settings::Settings;
use burn::tensor::{Device, Int, Tensor, TensorData};

/// Geometry of N Gaussians on a device, frozen: no gradient goes there.
#[derive(Clone, Debug)]
pub struct SplatTensors {
    /// `[N, 3]`, world units.
    pub means: Tensor<2>,
    /// `[N, 3]`, natural logarithms.
    pub log_scales: Tensor<2>,
    /// `[N, 4]` (w, x, y, z), not normalised.
    pub rotations: Tensor<2>,
    /// `[N]`.
    pub opacity_logits: Tensor<1>,
}

impl SplatTensors {
    /// Numbers of a Gaussian.
    pub const WIDTH: usize = 11;

    /// Those of `gaussians` on `device`, in f32 and without autodiff.
    pub fn new(gaussians: &Gaussians, device: &Device) -> Self {
        let device = device.clone().inner();
        let n = gaussians.len();
        let rows = |values: &[f32], width| Tensor::from_data(TensorData::new(values.to_vec(), [n, width]), &device);
        Self {
            means: rows(gaussians.means.as_flattened(), 3),
            log_scales: rows(gaussians.log_scales.as_flattened(), 3),
            rotations: rows(gaussians.rotations.as_flattened(), 4),
            opacity_logits: Tensor::from_data(TensorData::new(gaussians.opacity_logits.clone(), [n]), &device),
        }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.opacity_logits.dims()[0]
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The Gaussians `rows` alone, in that order.
    ///
    /// # Panics
    /// If a row is not below N.
    #[must_use]
    pub fn select(&self, rows: &[u32]) -> Self {
        let index: Vec<i64> = rows.iter().map(|&row| i64::from(row)).collect();
        let index = Tensor::<1, Int>::from_data(TensorData::new(index, [rows.len()]), &self.means.device());
        Self {
            means: self.means.clone().select(0, index.clone()),
            log_scales: self.log_scales.clone().select(0, index.clone()),
            rotations: self.rotations.clone().select(0, index.clone()),
            opacity_logits: self.opacity_logits.clone().select(0, index),
        }
    }

    /// `values` `[N, C]` blended as seen by `camera`, `S = W s` (Eq. 3), with gradient to them.
    ///
    /// # Errors
    /// As [`rasterize`].
    pub fn blend(&self, values: Tensor<2>, camera: &Camera, settings: &Settings) -> Result<RasterOutput> {
        fn beside<const D: usize>(frozen: &Tensor<D>, values: &Tensor<2>) -> Tensor<D> {
            if values.device().is_autodiff() { Tensor::from_inner(frozen.clone()) } else { frozen.clone() }
        }
        let input = RasterInput {
            means: beside(&self.means, &values),
            log_scales: beside(&self.log_scales, &values),
            rotations: beside(&self.rotations, &values),
            opacity_logits: beside(&self.opacity_logits, &values),
            sh: None,
            active_sh_degree: 0,
            features: Some(values),
            screen: None,
        };
        rasterize(input, camera, settings, [0.0; 3])
    }
}

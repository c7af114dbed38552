//! The geometry of Gaussians as tensors.

use super::{RasterInput, RasterOutput, rasterize};
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::gaussians::Gaussians;
use crate::ops::gather_rows;
use crate::raster::settings::Settings;
use burn::tensor::{DType, Device, Int, Tensor, TensorData};
use std::ops::Range;

/// Bytes of an image of several channels, where they need not lie together.
const BLOCK_BYTES: usize = 64 << 20;
/// Channels that are always blended together: the kernels take as many in one go.
const LEAST_CHANNELS: usize = 12;

/// Ranges of `channels` of which an image for `camera` takes [`BLOCK_BYTES`] or little more.
pub(super) fn channel_blocks(camera: &Camera, channels: usize) -> impl Iterator<Item = Range<usize>> + use<> {
    let plane = (camera.width * camera.height * size_of::<f32>()).max(1);
    let together = (BLOCK_BYTES / plane).max(LEAST_CHANNELS);
    (0..channels).step_by(together).map(move |first| first..(first + together).min(channels))
}

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

    /// Whether shapes and float types agree, the latter with `dtype`.
    pub(super) fn check(&self, dtype: DType) -> Result<()> {
        let n = self.len();
        let Self { means, log_scales, rotations, opacity_logits } = self;
        let shapes = [means.dims(), log_scales.dims(), rotations.dims()];
        let expected = [[n, 3], [n, 3], [n, 4]];
        let types = [means.dtype(), log_scales.dtype(), rotations.dtype(), opacity_logits.dtype()];
        if shapes == expected && types == [dtype; 4] {
            return Ok(());
        }
        let (found, expected) = (format!("{shapes:?}, {types:?}"), format!("{expected:?}, all {dtype:?}"));
        Err(Error::config("frozen Gaussians", found, expected, "pass tensors of one scene and one float type"))
    }

    /// `values` `[N, C]` blended at the pixels `pixels` (row-major) of the view of `camera`, `[P, C]`, with gradient to
    /// them. Where all pixels of all channels would take much memory, channels are blended a block at a time.
    ///
    /// # Errors
    /// As [`rasterize`].
    pub fn blend_at(
        &self,
        values: Tensor<2>,
        camera: &Camera,
        settings: &Settings,
        pixels: &[u32],
    ) -> Result<(Tensor<2>, Tensor<1>)> {
        let (n, all) = (self.len(), camera.width * camera.height);
        let mut transmittance = None;
        let blocks = channel_blocks(camera, values.dims()[1]).map(|block| {
            let channels = block.len();
            let output = self.blend(values.clone().slice([0..n, block]), camera, settings)?;
            transmittance.get_or_insert(output.transmittance);
            Ok(gather_rows(output.image.reshape([all, channels]), pixels))
        });
        let image = Tensor::cat(blocks.collect::<Result<Vec<_>>>()?, 1);
        let transmittance = match transmittance {
            Some(transmittance) => transmittance.detach().reshape([all, 1]),
            None => Tensor::ones([all, 1], &image.device()),
        };
        Ok((image, gather_rows(transmittance, pixels).reshape([pixels.len()])))
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

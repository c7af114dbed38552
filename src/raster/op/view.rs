//! Blending with frozen geometry and its adjoint, as operations on tensors: projected and sorted once a view.

use super::backend::RasterBackend;
use super::reference::{ReferenceView, colours};
use super::splats::SplatTensors;
use super::tensors::{BlendedView, ProjectedView, Rows, ViewCall};
use crate::backend::device::largest_allocation;
use crate::error::{Result, ensure};
use crate::ops::{CustomOp, SparseMatrix, sparse_apply};
use crate::raster::settings::Settings;
use crate::splat::camera::Camera;
use burn::backend::Dispatch;
use burn::tensor::{Device, Tensor};
use std::ops::Range;
use std::sync::{Arc, OnceLock};

/// Bytes of an image of several channels, where they need not lie together, in host memory.
const BLOCK_BYTES: usize = 64 << 20;
/// Bytes of such an image on a device, at most.
const DEVICE_BLOCK_BYTES: usize = 1 << 30;
/// Such an image takes at most one part in this many of the largest allocation of a device.
const DEVICE_BLOCK_SHARE: usize = 4;
/// On a device the channels of a block are a multiple of this.
const DEVICE_STEP: usize = 32;
/// Channels that are always blended together, however large the image: each pass evaluates all pairs anew.
const MIN_CHANNELS: usize = 12;

/// Frozen Gaussians and a camera: projected and sorted once for all that is blended and lifted.
#[derive(Clone, Debug)]
pub struct SplatView {
    splats: SplatTensors,
    call: Arc<ViewCall>,
    /// Made at first use.
    projected: Arc<OnceLock<ProjectedView>>,
}

impl SplatTensors {
    /// These Gaussians as `camera` sees them.
    pub fn seen_by(&self, camera: &Camera, settings: &Settings) -> SplatView {
        SplatView {
            splats: self.clone(),
            call: Arc::new(ViewCall {
                camera: camera.clone(),
                settings: *settings,
            }),
            projected: Arc::default(),
        }
    }
}

impl SplatView {
    /// The same view of the Gaussians `rows` alone, in that order.
    ///
    /// # Panics
    /// If a row is not below N.
    pub(crate) fn of_gaussians(&self, rows: &[u32]) -> Self {
        let call = &self.call;
        let splats = self.splats.select(rows);
        splats.seen_by(&call.camera, &call.settings)
    }

    /// The Gaussians.
    pub fn splats(&self) -> &SplatTensors {
        &self.splats
    }

    /// Where the Gaussians live, without autodiff.
    pub fn device(&self) -> Device {
        self.splats.device()
    }

    /// Where it is seen from.
    pub fn camera(&self) -> &Camera {
        &self.call.camera
    }

    /// Ranges of `channels` to blend together. The image of a range takes about 64 MB; on a GPU, a quarter of its largest
    /// allocation, and no more than 1 GB.
    pub fn channel_blocks(&self, channels: usize) -> impl Iterator<Item = Range<usize>> + use<> {
        let plane = (self.camera().width * self.camera().height * size_of::<f32>()).max(1);
        let together = match largest_allocation(&self.device()) {
            None => (BLOCK_BYTES / plane).max(MIN_CHANNELS),
            Some(most) => match (most / DEVICE_BLOCK_SHARE).min(DEVICE_BLOCK_BYTES) / plane {
                few if few < DEVICE_STEP => few.max(MIN_CHANNELS),
                many => many / DEVICE_STEP * DEVICE_STEP,
            },
        };
        (0..channels)
            .step_by(together)
            .map(move |first| first..(first + together).min(channels))
    }

    /// `S = W s` of `values` `[N, C]`, the image `[H, W, C]` with gradient to them, and the transmittance `[H, W]` (Eq. 3-4).
    ///
    /// # Errors
    /// [`crate::Error::Argument`] for tensors of different sizes or float types; those of `Projected::new`; on a GPU [`crate::Error::Limit`]
    /// for what the device cannot hold, and [`crate::Error::Device`] when it fails.
    pub fn blend(&self, values: Tensor<2>) -> Result<(Tensor<3>, Tensor<2>)> {
        let n = self.splats.len();
        let rows = values.dims()[0];
        ensure!(rows == n, argument "values to blend"; found "{rows} rows"; expected "{n}, one a Gaussian";
            help "pass values of these Gaussians");
        self.splats.check(values.dtype())?;
        if CustomOp::Raster.is_replaced() {
            return Ok(self.reference().blend(values));
        }
        match Dispatch::blend_view(values.into_dispatch(), self.projected()?) {
            BlendedView::Done(image, transmittance) => Ok((
                Tensor::from_dispatch(image),
                Tensor::from_dispatch(transmittance),
            )),
            BlendedView::Failed(error) => Err(error),
        }
    }

    /// [`SplatView::blend`] at the pixels `pixels` (row-major): `[P, C]` and `[P]`. Where all pixels of all channels would take
    /// much memory, channels are blended a block at a time.
    ///
    /// # Errors
    /// As [`SplatView::blend`].
    pub fn blend_at(&self, values: Tensor<2>, pixels: &[u32]) -> Result<(Tensor<2>, Tensor<1>)> {
        let n = values.dims()[0];
        let all = self.camera().width * self.camera().height;
        let chosen = Arc::new(SparseMatrix::selection(pixels.to_vec(), all));
        let mut transmittance = None;
        let blocks = self.channel_blocks(values.dims()[1]).map(|block| {
            let channels = block.len();
            let (image, of_all) = self.blend(values.clone().slice([0..n, block]))?;
            transmittance.get_or_insert(of_all);
            Ok(sparse_apply(image.reshape([all, channels]), chosen.clone()))
        });
        let image = Tensor::cat(blocks.collect::<Result<Vec<_>>>()?, 1);
        let transmittance = match transmittance {
            Some(transmittance) => transmittance.reshape([all, 1]),
            None => Tensor::ones([all, 1], &image.device()),
        };
        Ok((
            image,
            sparse_apply(transmittance, chosen).reshape([pixels.len()]),
        ))
    }

    /// `W^T y`, `[N, C]`, of an image `y`, `[H, W, C]`: the adjoint of [`SplatView::blend`], without autodiff.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] for an image of a different size than the camera has; as [`SplatView::blend`].
    pub fn blend_adjoint(&self, image: Tensor<3>) -> Result<Tensor<2>> {
        let camera = self.camera();
        let [height, width, _] = image.dims();
        ensure!([height, width] == [camera.height, camera.width],
            argument "image to lift"; found "{width}x{height}"; expected "{}x{}", camera.width, camera.height;
            help "pass an image of the camera's size");
        self.splats.check(image.dtype())?;
        if CustomOp::Raster.is_replaced() {
            return Ok(self.reference().blend_adjoint(image.inner()));
        }
        match Dispatch::blend_view_adjoint(image.into_dispatch(), self.projected()?) {
            Rows::Done(sums) => Ok(Tensor::from_dispatch(sums)),
            Rows::Failed(error) => Err(error),
        }
    }

    /// Disc pixels: how many pixel centres lie within the projected radius of each Gaussian.
    ///
    /// # Errors
    /// As [`SplatView::blend`].
    pub fn disc_pixels(&self) -> Result<Vec<u32>> {
        self.splats.check(self.splats.means.dtype())?;
        if CustomOp::Raster.is_replaced() {
            return self.reference().disc_pixels();
        }
        match self.projected()? {
            ProjectedView::F32(projected) => Ok(projected.counts()),
            ProjectedView::F64(projected) => Ok(projected.counts()),
            #[cfg(feature = "cube")]
            ProjectedView::Gpu(prepared) => prepared.disc_pixels(),
        }
    }

    /// The rows `pixels` (row-major) of `W`, entries front to back, rounded to `f32`.
    ///
    /// # Errors
    /// As [`SplatView::blend`]; [`crate::Error::Device`] where [`SplatTensors::have_stored_weights`] is false.
    ///
    /// # Panics
    /// If a pixel is outside the image.
    pub(crate) fn weights(&self, pixels: &[u32]) -> Result<SparseMatrix> {
        if CustomOp::Raster.is_replaced() {
            return Ok(self.reference().weights(pixels));
        }
        match self.projected()? {
            ProjectedView::F32(projected) => Ok(projected.weights(pixels)),
            ProjectedView::F64(projected) => Ok(projected.weights(pixels)),
            #[cfg(feature = "cube")]
            ProjectedView::Gpu(_) => Err(crate::error::Error::Device {
                device: "the GPU of this view".into(),
                reason: "views on a GPU store no blending weights".into(),
                help: "use `blend`".into(),
            }),
        }
    }

    /// Colours `max(0, SH + 0.5)` of all Gaussians, `[N, 3]`, from coefficients `[N, K, 3]` of degree `degree`, without autodiff.
    /// Rows of Gaussians that the view does not show are undefined. A GPU does not check that the coefficients are finite, as
    /// [`Gaussians::check`](crate::splat::Gaussians::check) does.
    ///
    /// # Errors
    /// As [`SplatView::blend`]; on a CPU [`crate::Error::NonFinite`] for the coefficients.
    pub(crate) fn colours(&self, sh: Tensor<3>, degree: usize) -> Result<Tensor<2>> {
        if CustomOp::Raster.is_replaced() {
            return Ok(colours(&self.splats.means, sh, degree, self.camera()).inner());
        }
        let means = self.splats.means.clone().into_dispatch();
        let call = self.call.clone();
        match Dispatch::view_colours(means, sh.into_dispatch(), degree, self.projected()?, call) {
            Rows::Done(colours) => Ok(Tensor::from_dispatch(colours)),
            Rows::Failed(error) => Err(error),
        }
    }

    fn reference(&self) -> ReferenceView {
        let frozen = self.splats.clone().inner();
        ReferenceView::new(&frozen, None, &self.call.camera, &self.call.settings)
    }

    /// Projection and tile lists, made at first use.
    pub(super) fn projected(&self) -> Result<ProjectedView> {
        if let Some(projected) = self.projected.get() {
            return Ok(projected.clone());
        }
        let tensors = self.splats.clone().with_values(None, None, None);
        let projected = Dispatch::project_view(tensors, self.call.clone())?;
        Ok(self.projected.get_or_init(|| projected).clone())
    }
}

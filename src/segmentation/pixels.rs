//! Labelled pixels of a training view, and the frozen blending weights that connect them to the Gaussians.

use crate::backend::device::{read, upload};
use crate::error::Result;
use crate::ops::{SparseMatrix, select, sparse_apply};
use crate::raster::{Settings, SplatTensors, SplatView};
use crate::splat::camera::Camera;
use crate::splat::{Gaussians, rows_where};
use burn::tensor::{Device, Int, Tensor, TensorData};
use std::sync::Arc;

/// The label of pixels that do not count.
pub const NO_CLASS: u16 = u16::MAX;

/// Blending weights of P pixels over the V Gaussians that they show. The weights of a pixel sum to 1, or to its coverage 1 - T
/// where blended values are not divided by that.
#[derive(Clone, Debug)]
pub enum PixelWeights {
    /// Stored as a matrix `[P, V]`.
    Stored(Arc<SparseMatrix>),
    /// Computed anew at each use.
    Rendered {
        /// The V Gaussians in the view.
        view: Box<SplatView>,
        /// Row-major numbers of the P pixels.
        pixels: Arc<Vec<u32>>,
        /// Whether blended values are divided by the coverage.
        over_coverage: bool,
    },
}

impl PixelWeights {
    /// Blends `values` `[V, C]`: `[P, C]`, with gradient to `values`.
    pub(crate) fn blend(&self, values: Tensor<2>) -> Result<Tensor<2>> {
        match self {
            Self::Stored(weights) => Ok(sparse_apply(values, weights.clone())),
            Self::Rendered {
                view,
                pixels,
                over_coverage,
            } => {
                let (image, transmittance) = view.blend_at(values, pixels)?;
                if !over_coverage {
                    return Ok(image);
                }
                let coverage = transmittance.neg() + 1.0;
                Ok(image / coverage.reshape([pixels.len(), 1]))
            }
        }
    }

    /// The weights of the pixels `rows`.
    pub(crate) fn at(&self, rows: &[u32]) -> Self {
        match self {
            Self::Stored(weights) => Self::Stored(Arc::new(weights.select_rows(rows))),
            Self::Rendered {
                view,
                pixels,
                over_coverage,
            } => {
                let pixels = rows.iter().map(|&row| pixels[row as usize]);
                Self::Rendered {
                    view: view.clone(),
                    pixels: Arc::new(pixels.collect()),
                    over_coverage: *over_coverage,
                }
            }
        }
    }
}

/// Gaussians whose views are blended with frozen weights.
#[derive(Clone, Debug)]
pub(crate) struct FrozenGaussians {
    splats: SplatTensors,
    settings: Settings,
    over_coverage: bool,
}

impl FrozenGaussians {
    /// `gaussians`, blended on `device`. Blended values are divided by the coverage 1 - T where `over_coverage` says so.
    pub fn new(
        gaussians: &Gaussians,
        settings: Settings,
        over_coverage: bool,
        device: &Device,
    ) -> Self {
        Self {
            splats: SplatTensors::new(gaussians, device),
            settings,
            over_coverage,
        }
    }

    /// The pixels of `camera` that have one of `labels` and a coverage 1 - T of at least `min_coverage`, and the Gaussians that
    /// they show.
    ///
    /// # Errors
    /// Those of [`SplatView::blend`].
    pub fn labelled_pixels(
        &self,
        camera: &Camera,
        labels: &[u16],
        min_coverage: f32,
    ) -> Result<LabelledView> {
        let view = self.splats.seen_by(camera, &self.settings);
        let device = self.splats.device();
        // One channel of zeros: only the transmittance is used.
        let nothing = Tensor::<2>::zeros([self.splats.len(), 1], &device);
        let transmittance = read("transmittance", view.blend(nothing)?.1)?;
        let mut pixels = rows_where(labels, |label| *label != NO_CLASS);
        pixels.retain(|&pixel| {
            let coverage = 1.0 - transmittance[pixel as usize];
            coverage >= min_coverage && coverage > 0.0
        });
        let mut mask = vec![0.0_f32; camera.width * camera.height];
        pixels.iter().for_each(|&pixel| mask[pixel as usize] = 1.0);
        let mask = upload(mask, [camera.height, camera.width, 1], &device);
        let weights = read("weights", view.blend_adjoint(mask)?)?;
        let labels = pixels.iter().map(|&p| labels[p as usize]).collect();
        Ok(LabelledView {
            visible: Arc::new(rows_where(weights, |weight| weight > 0.0)),
            numbers: Arc::new(pixels),
            labels: Arc::new(labels),
        })
    }

    /// The weights of the pixels `numbers` of `camera` over the Gaussians `visible`, at least all that these pixels show: stored
    /// in host memory, rendered on a GPU.
    ///
    /// # Errors
    /// As [`FrozenGaussians::labelled_pixels`].
    pub fn weights(
        &self,
        camera: &Camera,
        visible: &[u32],
        numbers: Arc<Vec<u32>>,
    ) -> Result<PixelWeights> {
        if numbers.is_empty() {
            let none = SparseMatrix::new(visible.len(), vec![0], Vec::new(), Vec::new());
            return Ok(PixelWeights::Stored(Arc::new(none)));
        }
        if !self.splats.have_stored_weights() {
            return Ok(self.rendered(camera, visible, numbers));
        }
        let weights = self.view_of(camera, visible).weights(&numbers)?;
        Ok(PixelWeights::Stored(Arc::new(if self.over_coverage {
            weights.normalised()
        } else {
            weights
        })))
    }

    /// The same, rendered on any device: the faster way to blend all pixels of a view once.
    pub fn rendered(
        &self,
        camera: &Camera,
        visible: &[u32],
        pixels: Arc<Vec<u32>>,
    ) -> PixelWeights {
        PixelWeights::Rendered {
            view: Box::new(self.view_of(camera, visible)),
            pixels,
            over_coverage: self.over_coverage,
        }
    }

    fn view_of(&self, camera: &Camera, visible: &[u32]) -> SplatView {
        let view = self.splats.seen_by(camera, &self.settings);
        view.of_gaussians(visible)
    }
}

/// The labelled, covered pixels of a view.
#[derive(Clone, Debug)]
pub(crate) struct LabelledView {
    /// Scene index of each Gaussian that the pixels show, ascending.
    pub visible: Arc<Vec<u32>>,
    /// Row-major number of each pixel.
    pub numbers: Arc<Vec<u32>>,
    /// Class index of each pixel.
    pub labels: Arc<Vec<u16>>,
}

/// Labelled pixels of a view over the Gaussians it sees.
#[derive(Clone, Debug)]
pub struct LabelledPixels {
    /// Frozen blending weights, one row for each pixel.
    pub weights: PixelWeights,
    /// Class index of each pixel, or [`NO_CLASS`].
    pub labels: Arc<Vec<u16>>,
    /// Class probabilities to train on instead of `labels`, `[P, C]` without autodiff. All pixels have labels then.
    pub distributions: Option<Tensor<2>>,
}

impl LabelledPixels {
    /// Pixels with one class index each.
    pub fn new(weights: PixelWeights, labels: Vec<u16>) -> Self {
        Self {
            weights,
            labels: Arc::new(labels),
            distributions: None,
        }
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.labels.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.labels.is_empty()
    }

    /// The pixels that have a label.
    #[must_use]
    pub fn labelled(&self) -> Self {
        if !self.labels.contains(&NO_CLASS) {
            return self.clone();
        }
        self.at(&rows_where(&*self.labels, |label| *label != NO_CLASS))
    }

    /// The pixels `rows`.
    #[must_use]
    pub fn at(&self, rows: &[u32]) -> Self {
        let label = |&row: &u32| self.labels[row as usize];
        let distributions = self.distributions.as_ref();
        Self {
            distributions: distributions.map(|shares| select(shares, rows)),
            ..Self::new(self.weights.at(rows), rows.iter().map(label).collect())
        }
    }

    /// Blends `values` `[V, C]` at the pixels: `[P, C]`, with gradient to `values`.
    ///
    /// # Errors
    /// When the device fails.
    pub fn blend(&self, values: Tensor<2>) -> Result<Tensor<2>> {
        self.weights.blend(values)
    }

    /// Blends only the channel of each pixel's label: `[P, 1]` from `values` `[V, C]`. All pixels must be labelled.
    ///
    /// With stored weights this costs one multiplication for each weight, for any number of classes.
    ///
    /// # Errors
    /// When the device fails.
    pub fn blend_own_class(&self, values: Tensor<2>) -> Result<Tensor<2>> {
        let [gaussians, classes] = values.dims();
        let PixelWeights::Stored(weights) = &self.weights else {
            let blended = self.blend(values)?;
            let own = one_hot(&self.labels, &blended);
            return Ok((blended * own).sum_dim(1));
        };
        let own = weights.of_channels(&self.labels, classes);
        let flat = values.reshape([gaussians * classes, 1]);
        Ok(sparse_apply(flat, Arc::new(own)))
    }
}

/// 1 at each pixel's label, else 0: a constant of the shape of `values` `[P, C]`.
pub(crate) fn one_hot(labels: &[u16], values: &Tensor<2>) -> Tensor<2> {
    let shape = values.dims();
    let device = values.device();
    let plain = device.clone().inner();
    let labels: Vec<i32> = labels.iter().map(|&label| i32::from(label)).collect();
    let labels = Tensor::<2, Int>::from_data(TensorData::new(labels, [shape[0], 1]), &plain);
    let numbers = Tensor::<1, Int>::arange(0..shape[1] as i64, &plain).reshape([1, shape[1]]);
    let same = labels.expand(shape).equal(numbers.expand(shape));
    constant(same.float().cast(values.dtype()), &device)
}

/// A tensor without autodiff, beside tensors of `device`.
pub(crate) fn constant<const D: usize>(tensor: Tensor<D>, device: &Device) -> Tensor<D> {
    if device.is_autodiff() && !tensor.device().is_autodiff() {
        Tensor::from_inner(tensor)
    } else {
        tensor
    }
}

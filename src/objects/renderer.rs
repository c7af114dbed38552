//! Views of a labelled scene on any device: colour, coverage and labels of a camera together.

use crate::backend::device::{read, upload};
use crate::config::Config;
use crate::data::LabelMap;
use crate::error::{Result, ensure};
use crate::raster::{GaussianLabels, Settings, SplatTensors, SplatView};
use crate::splat::camera::Camera;
use crate::splat::{Gaussians, rotation};
use burn::tensor::{Device, Tensor};
use glam::{DVec3, Vec3};
use smart_default::SmartDefault;
use std::sync::OnceLock;

/// What a view shows. Rows are row-major, from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Colour `[H, W, 3]`, background included, not clamped.
    pub rgb: Vec<f32>,
    /// What covers the background, 1 - T, `[H, W]`.
    pub alpha: Vec<f32>,
    /// The label with the largest summed alpha' T at each pixel, [`RenderOptions::unlabelled`] where alpha is too low; `None` for a
    /// scene without labels.
    pub labels: Option<LabelMap>,
}

/// How [`Renderer`] renders. By default with black behind, and labels from an alpha of 0.5 on.
#[derive(Clone, Copy, Debug, SmartDefault)]
pub struct RenderOptions {
    /// The rasterizer's.
    pub settings: Settings,
    /// Colour behind the scene, sRGB in 0..1.
    pub background: [f32; 3],
    /// Smallest alpha at which a pixel has a label. At 0 all pixels that any Gaussian shows in have one; above 1 no pixel has.
    #[default(0.5)]
    pub min_coverage: f32,
    /// Id of the pixels without a label: [`Classes::ignore`](crate::data::Classes::ignore) of the scene's table.
    pub unlabelled: u16,
}

impl RenderOptions {
    fn check(&self) -> Result<()> {
        let [r, g, b] = self.background;
        let least = self.min_coverage;
        ensure!([r, g, b, least].iter().all(|value| value.is_finite()),
            argument "render options"; found "background {r}, {g}, {b}, min_coverage {least}";
            expected "finite numbers"; help "pass a colour and a share");
        Ok(())
    }
}

impl From<&Config> for RenderOptions {
    fn from(config: &Config) -> Self {
        Self {
            settings: Settings::from(&config.raster),
            background: config.raster.background,
            min_coverage: config.segmentation.min_coverage as f32,
            ..Self::default()
        }
    }
}

/// A scene that is rendered view after view. It is sent to a GPU once.
///
/// Beside the memory of a [`SplatView`], a GPU holds channels of 32-bit floats: for every pixel three and one for each label, and
/// for every Gaussian one for each label. Where either exceeds a quarter of its largest allocation, or 1 GiB, labels are blended in
/// blocks.
#[derive(Debug)]
pub struct Renderer {
    options: RenderOptions,
    splats: SplatTensors,
    /// `[N, K, 3]`.
    sh: Tensor<3>,
    sh_degree: usize,
    labels: Option<GaussianLabels>,
    /// Made at first use.
    shortest_axes: OnceLock<Tensor<2>>,
}

impl Renderer {
    /// `gaussians` on `device`, and a label for each if there are any; positions in the coordinates of the cameras.
    ///
    /// # Errors
    /// As [`Gaussians::check`]; [`crate::Error::Argument`] for options that are not finite.
    pub fn new(
        gaussians: Gaussians,
        labels: Option<Vec<u16>>,
        options: RenderOptions,
        device: &Device,
    ) -> Result<Self> {
        gaussians.check(labels.as_deref())?;
        options.check()?;
        let splats = SplatTensors::new(&gaussians, device);
        let shape = [gaussians.len(), gaussians.sh_len(), 3];
        Ok(Self {
            options,
            sh_degree: gaussians.sh_degree,
            sh: upload(gaussians.sh, shape, &splats.device()),
            splats,
            labels: labels.map(GaussianLabels::new),
            shortest_axes: OnceLock::new(),
        })
    }

    /// What `camera` sees.
    ///
    /// # Errors
    /// As [`SplatView::blend`].
    pub fn frame(&self, camera: &Camera) -> Result<Frame> {
        // Checks width and height before they become sizes.
        camera.check()?;
        let view = self.view(camera);
        let colours = view.colours(self.sh.clone(), self.sh_degree)?;
        let (mut rgb, transmittance, labels) = match &self.labels {
            Some(labels) => {
                let pixels = view.blend_labels(Some(colours), labels)?;
                (pixels.rgb, pixels.transmittance, Some(pixels.labels))
            }
            None => {
                let (rgb, transmittance) = blended(&view, colours)?;
                (rgb, transmittance, None)
            }
        };
        for (pixel, &t) in rgb.chunks_exact_mut(3).zip(&transmittance) {
            for (value, behind) in pixel.iter_mut().zip(self.options.background) {
                *value += t * behind;
            }
        }
        let alpha: Vec<f32> = transmittance.iter().map(|t| 1.0 - t).collect();
        let (width, height) = (camera.width, camera.height);
        let labels = labels.map(|mut ids| {
            let least = self.options.min_coverage;
            for (id, &alpha) in ids.iter_mut().zip(&alpha) {
                // The rasterizer has no other label than 0 for pixels that nothing covers.
                if alpha < least || alpha == 0.0 && *id == 0 {
                    *id = self.options.unlabelled;
                }
            }
            LabelMap { width, height, ids }
        });
        Ok(Frame {
            width,
            height,
            rgb,
            alpha,
            labels,
        })
    }

    /// Mean depth of what each pixel of `camera` shows, `[H, W]`: the depths of the centres along the viewing direction, blended by
    /// alpha' T and divided by alpha, in world units. 0 where alpha is too low.
    ///
    /// # Errors
    /// As [`SplatView::blend`].
    pub fn depth(&self, camera: &Camera) -> Result<Vec<f32>> {
        camera.check()?;
        let forward = camera.rotation.row(2);
        let axis = forward.to_array().map(|v| v as f32).to_vec();
        let axis = upload(axis, [3, 1], &self.splats.device());
        let depths = self.splats.means.clone().matmul(axis) - forward.dot(camera.center);
        self.mean_of(camera, depths)
    }

    /// Mean of `values`, one for each Gaussian, over what each pixel of `camera` shows, `[H, W]`, blended as depths are. 0 where
    /// alpha is too low.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] for another number of values; as [`SplatView::blend`].
    pub fn mean(&self, camera: &Camera, values: &[f32]) -> Result<Vec<f32>> {
        camera.check()?;
        let count = self.splats.len();
        ensure!(values.len() == count, argument "values"; found "{}", values.len(); expected "{count}, one for each Gaussian";
            help "pass a value for each Gaussian");
        let values = upload(values.to_vec(), [count, 1], &self.splats.device());
        self.mean_of(camera, values)
    }

    /// `values` `[N, 1]`, blended by alpha' T and divided by alpha, `[H, W]`.
    fn mean_of(&self, camera: &Camera, values: Tensor<2>) -> Result<Vec<f32>> {
        let (mut mean, transmittance) = blended(&self.view(camera), values)?;
        for (mean, t) in mean.iter_mut().zip(transmittance) {
            let alpha = 1.0 - t;
            let is_seen = alpha > 0.0 && alpha >= self.options.min_coverage;
            *mean = if is_seen { *mean / alpha } else { 0.0 };
        }
        Ok(mean)
    }

    /// Normals of what each pixel of `camera` shows, `[H, W, 3]`, world directions of length 1: the shortest axes of the Gaussians,
    /// turned towards the camera, blended by alpha' T. 0 where alpha is too low.
    ///
    /// # Errors
    /// As [`SplatView::blend`].
    pub fn normals(&self, camera: &Camera) -> Result<Vec<f32>> {
        camera.check()?;
        let view = self.view(camera);
        let center = camera.center.to_array().map(|v| v as f32).to_vec();
        let center = upload(center, [1, 3], &self.splats.device());
        let axes = self.shortest_axes()?;
        let side = ((center - self.splats.means.clone()) * axes.clone()).sum_dim(1);
        let (mut normals, transmittance) = blended(&view, axes * side.sign())?;
        for (normal, t) in normals.chunks_exact_mut(3).zip(transmittance) {
            let is_seen = 1.0 - t >= self.options.min_coverage;
            let direction = Vec3::from_slice(normal).normalize_or_zero();
            let direction = if is_seen { direction } else { Vec3::ZERO };
            normal.copy_from_slice(&direction.to_array());
        }
        Ok(normals)
    }

    /// The axis along which each Gaussian is shortest, `[N, 3]`, of length 1; either end of it.
    fn shortest_axes(&self) -> Result<Tensor<2>> {
        if let Some(axes) = self.shortest_axes.get() {
            return Ok(axes.clone());
        }
        let rotations = read("rotations", self.splats.rotations.clone())?;
        let log_scales = read("log_scales", self.splats.log_scales.clone())?;
        let axis = |(q, scales): (&[f32; 4], &[f32; 3])| {
            let axis = DVec3::AXES[Vec3::from(*scales).min_position()];
            (rotation(q) * axis).as_vec3().to_array()
        };
        let rows = rotations.as_chunks().0.iter().zip(log_scales.as_chunks().0);
        let axes: Vec<f32> = rows.flat_map(axis).collect();
        let axes = upload(axes, [self.splats.len(), 3], &self.splats.device());
        Ok(self.shortest_axes.get_or_init(|| axes).clone())
    }

    /// The Gaussians as `camera` sees them.
    pub(crate) fn view(&self, camera: &Camera) -> SplatView {
        self.splats.seen_by(camera, &self.options.settings)
    }
}

/// `values` in a view, `[H, W, C]`, and what shows of the background, `[H, W]`, on the host.
fn blended(view: &SplatView, values: Tensor<2>) -> Result<(Vec<f32>, Vec<f32>)> {
    let (image, transmittance) = view.blend(values)?;
    let image = read("a rendered view", image)?;
    Ok((image, read("a transmittance", transmittance)?))
}

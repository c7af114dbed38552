//! Views of a labelled scene on any device: colour, coverage and labels of a camera together.

use super::hard_labels::with_hard_labels;
use crate::backend::device::{read, renders_on};
use crate::data::LabelMap;
use crate::error::{Error, Result};
use crate::raster::{
    GaussianLabels, Largest, ListCount, Projected, RasterInput, Settings, SplatTensors, SplatView,
    Viewpoint, rasterize_with_capacity, tile_capacity,
};
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use burn::tensor::{Device, Tensor, TensorData};

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
    /// The label with the largest summed alpha' T at each pixel, 0 where alpha is too low; `None` for a scene without labels.
    pub labels: Option<LabelMap>,
}

/// How [`Renderer`] renders.
#[derive(Clone, Copy, Debug)]
pub struct RenderOptions {
    /// The rasterizer's.
    pub settings: Settings,
    /// Colour behind the scene, sRGB in 0..1.
    pub background: [f32; 3],
    /// The least alpha at which a pixel has a label: all have one at 0 where a Gaussian weighs anything, none above 1.
    pub min_coverage: f32,
}

impl RenderOptions {
    fn check(&self) -> Result<()> {
        let ([r, g, b], least) = (self.background, self.min_coverage);
        if [r, g, b, least].iter().all(|value| value.is_finite()) {
            return Ok(());
        }
        let found = format!("background {r}, {g}, {b}, min_coverage {least}");
        Err(Error::argument(
            "render options",
            found,
            "finite numbers",
            "pass a colour and a share",
        ))
    }
}

impl Default for RenderOptions {
    /// Default settings, black behind, labels from an alpha of 0.5 on.
    fn default() -> Self {
        Self {
            settings: Settings::default(),
            background: [0.0; 3],
            min_coverage: 0.5,
        }
    }
}

/// A scene that is rendered view after view. It is sent to a GPU once, and each frame is read back once. The first frame, and a
/// frame with more tile entries than all before, wait for the device once more.
///
/// Beside the memory of [`rasterize_with_capacity`], a GPU holds channels of 32-bit floats: for every pixel three and one a label,
/// and for every Gaussian one a label. Where either exceeds a quarter of its largest allocation, or 1 GiB, labels are blended in
/// blocks.
#[derive(Debug)]
pub struct Renderer {
    options: RenderOptions,
    splats: SplatTensors,
    place: Place,
}

#[derive(Debug)]
enum Place {
    Host {
        gaussians: Box<Gaussians>,
        labels: Option<Vec<u16>>,
    },
    Device(Box<OnDevice>),
}

impl Renderer {
    /// `gaussians` on `device`, and a label for each where there are any; positions in the coordinates of the cameras.
    ///
    /// # Errors
    /// As [`Gaussians::check`]; [`Error::Argument`] for options that are not finite.
    pub fn new(
        gaussians: Gaussians,
        labels: Option<Vec<u16>>,
        options: RenderOptions,
        device: &Device,
    ) -> Result<Self> {
        gaussians.check(labels.as_deref())?;
        options.check()?;
        // A GPU without the kernels' requirements would copy every frame to the host.
        let on_host = !renders_on(device) || gaussians.is_empty();
        let splats = SplatTensors::new(&gaussians, device);
        let place = if on_host {
            Place::Host {
                gaussians: Box::new(gaussians),
                labels,
            }
        } else {
            Place::Device(Box::new(OnDevice::new(gaussians, labels, &splats)))
        };
        Ok(Self {
            options,
            splats,
            place,
        })
    }

    /// Renders with `options` from now on.
    ///
    /// # Errors
    /// [`Error::Argument`] for options that are not finite.
    pub fn set_options(&mut self, options: RenderOptions) -> Result<()> {
        options.check()?;
        self.options = options;
        Ok(())
    }

    /// What `camera` sees.
    ///
    /// # Errors
    /// As [`Projected::new`]; on a GPU [`Error::Limit`] for what it cannot hold, and [`Error::Device`] when it fails.
    pub fn frame(&mut self, camera: &Camera) -> Result<Frame> {
        // Checks width and height before they become sizes.
        Viewpoint::new(camera)?;
        match &mut self.place {
            Place::Host { gaussians, labels } => {
                on_host(gaussians, labels.as_deref(), camera, &self.options)
            }
            Place::Device(scene) => scene.frame(camera, &self.options),
        }
    }
}

impl Renderer {
    /// The Gaussians as `camera` sees them.
    pub(crate) fn view(&self, camera: &Camera) -> SplatView {
        self.splats.seen_by(camera, &self.options.settings)
    }
}

fn on_host(
    gaussians: &Gaussians,
    labels: Option<&[u16]>,
    camera: &Camera,
    options: &RenderOptions,
) -> Result<Frame> {
    let projected = Projected::new(&gaussians.splats(), camera, &options.settings)?;
    let colours = projected.colours(gaussians, camera)?;
    let (blended, labels) = match labels {
        Some(labels) => {
            let (blended, map) =
                with_hard_labels::<3>(&projected, &colours, labels, options.min_coverage);
            (blended, Some(map))
        }
        None => (projected.blend(&colours, 3), None),
    };
    let blended = blended.over(options.background);
    let alpha = blended.transmittance.iter().map(|t| 1.0 - t).collect();
    Ok(Frame {
        width: camera.width,
        height: camera.height,
        rgb: blended.image,
        alpha,
        labels,
    })
}

/// A scene whose tensors live on a GPU.
#[derive(Debug)]
struct OnDevice {
    input: RasterInput,
    labels: Option<GaussianLabels>,
    /// The most entries that the tile lists of a view had so far.
    entries: Option<usize>,
}

impl OnDevice {
    fn new(gaussians: Gaussians, labels: Option<Vec<u16>>, splats: &SplatTensors) -> Self {
        let device = splats.device();
        let n = gaussians.len();
        let terms = gaussians.sh_len();
        let input = RasterInput {
            means: splats.means.clone(),
            log_scales: splats.log_scales.clone(),
            rotations: splats.rotations.clone(),
            opacity_logits: splats.opacity_logits.clone(),
            sh: Some(Tensor::from_data(
                TensorData::new(gaussians.sh, [n, terms, 3]),
                &device,
            )),
            active_sh_degree: gaussians.sh_degree,
            features: None,
            screen: None,
        };
        let labels = labels.map(GaussianLabels::new);
        Self {
            input,
            labels,
            entries: None,
        }
    }

    fn frame(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Frame> {
        let room = self.entries.map(tile_capacity);
        if let Some(frame) = self.attempt(camera, options, room)? {
            return Ok(frame);
        }
        // The capacity did not suffice.
        match self.attempt(camera, options, None)? {
            Some(frame) => Ok(frame),
            None => Err(Error::non_finite("scene to render", 0)),
        }
    }

    /// `None` where the capacity `room` did not suffice.
    fn attempt(
        &mut self,
        camera: &Camera,
        options: &RenderOptions,
        room: Option<usize>,
    ) -> Result<Option<Frame>> {
        let (height, width) = (camera.height, camera.width);
        let view = self.view(camera, &options.settings);
        let mut blocks = self
            .labels
            .as_ref()
            .map_or_else(Vec::new, |labels| labels.blocks(&view, 3))
            .into_iter();
        let mut input = self.input.clone();
        if let (Some(labels), Some(block)) = (&self.labels, blocks.next()) {
            input.features = Some(labels.one_hot(block, &view.device()));
        }
        let output =
            rasterize_with_capacity(input, camera, &options.settings, options.background, room)?;
        let pixels = height * width;
        let rgb = output.image.clone().slice([0..height, 0..width, 0..3]);
        let mut parts = vec![
            rgb.reshape([3 * pixels]),
            output.transmittance.reshape([pixels]),
        ];
        if let Some(labels) = &self.labels {
            // Colours below any weight never win; slicing them off would copy all other channels.
            let weights = output.image.slice_fill([0..height, 0..width, 0..3], -1.0);
            let mut largest = Largest::of(weights, -3.0);
            for block in blocks {
                let first = block.start as f64;
                let (image, _) = view.blend(labels.one_hot(block, &view.device()))?;
                largest = largest.or(Largest::of(image, first));
            }
            parts.push(largest.indices());
        }
        let (mut values, lists) = read_together(parts, output.tile_lists)?;
        if let Some(lists) = lists {
            if !lists.is_sound {
                return Ok(None);
            }
            self.entries = self.entries.max(Some(lists.entries));
        }
        let rest = values.split_off(3 * pixels);
        let (transmittance, index) = rest.split_at(pixels);
        let alpha: Vec<f32> = transmittance.iter().map(|t| 1.0 - t).collect();
        let labels = self.labels.as_ref().map(|labels| {
            let id = |(&index, &alpha): (&f32, &f32)| match labels.at(index) {
                Some(id) if alpha >= options.min_coverage => id,
                _ => 0,
            };
            LabelMap {
                width,
                height,
                ids: index.iter().zip(&alpha).map(id).collect(),
            }
        });
        Ok(Some(Frame {
            width,
            height,
            rgb: values,
            alpha,
            labels,
        }))
    }

    fn view(&self, camera: &Camera, settings: &Settings) -> SplatView {
        let RasterInput {
            means,
            log_scales,
            rotations,
            opacity_logits,
            ..
        } = self.input.clone();
        SplatTensors {
            means,
            log_scales,
            rotations,
            opacity_logits,
        }
        .seen_by(camera, settings)
    }
}

/// All `parts` one after the other, and the count of the tile lists, in one copy from the device.
fn read_together(
    mut parts: Vec<Tensor<1>>,
    tile_lists: Tensor<1>,
) -> Result<(Vec<f32>, Option<ListCount>)> {
    let fields = tile_lists.dims()[0];
    parts.push(tile_lists);
    let mut values = read("a rendered view", Tensor::cat(parts, 0))?;
    let lists = ListCount::from_values(&values.split_off(values.len() - fields));
    Ok((values, lists))
}

//! Views of a labelled scene on any device: colour, coverage and labels of a camera together.

use super::hard_labels::with_hard_labels;
use crate::camera::Camera;
use crate::data::LabelMap;
use crate::device::{in_host_memory, largest_allocation, read, shortfall};
use crate::error::{Error, Result};
use crate::gaussians::Gaussians;
use crate::raster::{
    ListCount, Projected, RasterInput, Settings, SplatTensors, SplatView, Viewpoint, rasterize_with_room, room_for,
};
use burn::tensor::{Device, Tensor, TensorData};
use std::ops::Range;

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
        Err(Error::argument("render options", found, "finite numbers", "pass a colour and a share"))
    }
}

impl Default for RenderOptions {
    /// Default settings, black behind, labels from an alpha of 0.5 on.
    fn default() -> Self {
        Self { settings: Settings::default(), background: [0.0; 3], min_coverage: 0.5 }
    }
}

/// A scene that is rendered view after view. A GPU gets it once, and a frame is read back once; the first frame, and one with
/// more tile entries than any before, wait for the device once more.
///
/// Beside what [`rasterize_with_room`] takes, a GPU holds channels of 32-bit floats: three and one a label for every pixel, and one a
/// label for every Gaussian. Where either is more than a quarter of its largest allocation, or 1 GiB, labels go in blocks, which project
/// the scene again each.
#[derive(Debug)]
pub struct Renderer {
    options: RenderOptions,
    place: Place,
}

#[derive(Debug)]
enum Place {
    Host { gaussians: Box<Gaussians>, labels: Option<Vec<u16>> },
    Device(Box<OnDevice>),
}

impl Renderer {
    /// `gaussians` on `device`, and a label for each where there are any; positions in the coordinates of the cameras.
    ///
    /// # Errors
    /// As [`Gaussians::check`]; [`Error::Argument`] for options that are no numbers.
    pub fn new(
        gaussians: Gaussians,
        labels: Option<Vec<u16>>,
        options: RenderOptions,
        device: &Device,
    ) -> Result<Self> {
        gaussians.check(labels.as_deref())?;
        options.check()?;
        // Where there is nothing, nothing is sent; where the host would render all the same, nothing is copied for each frame.
        let on_host = in_host_memory(device) || shortfall(device).is_some() || gaussians.is_empty();
        let place = match on_host {
            true => Place::Host { gaussians: Box::new(gaussians), labels },
            false => Place::Device(Box::new(OnDevice::new(gaussians, labels.as_deref(), device))),
        };
        Ok(Self { options, place })
    }

    /// Renders with `options` from now on.
    ///
    /// # Errors
    /// [`Error::Argument`] for options that are no numbers.
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
        // Before any size is made of its width and height.
        Viewpoint::new(camera)?;
        match &mut self.place {
            Place::Host { gaussians, labels } => on_host(gaussians, labels.as_deref(), camera, &self.options),
            Place::Device(scene) => scene.frame(camera, &self.options),
        }
    }
}

fn on_host(gaussians: &Gaussians, labels: Option<&[u16]>, camera: &Camera, options: &RenderOptions) -> Result<Frame> {
    let projected = Projected::new(&gaussians.splats(), camera, &options.settings)?;
    let colours = projected.colours(gaussians, camera)?;
    let (blended, labels) = match labels {
        Some(labels) => {
            let (blended, map) = with_hard_labels::<3>(&projected, &colours, labels, options.min_coverage);
            (blended, Some(map))
        }
        None => (projected.blend(&colours, 3), None),
    };
    let blended = blended.over(options.background);
    let alpha = blended.transmittance.iter().map(|t| 1.0 - t).collect();
    Ok(Frame { width: camera.width, height: camera.height, rgb: blended.image, alpha, labels })
}

/// A scene whose tensors live on a GPU.
#[derive(Debug)]
struct OnDevice {
    input: RasterInput,
    labels: Option<DeviceLabels>,
    /// The most entries that the tile lists of a view had so far.
    entries: Option<usize>,
}

#[derive(Debug)]
struct DeviceLabels {
    /// Those that occur, ascending.
    ids: Vec<u16>,
    /// Index among them of each Gaussian's, `[N, 1]`.
    of_gaussians: Tensor<2>,
    /// Labels that were blended beside the colour last, and 1 where a Gaussian has one, `[N, len]`.
    beside_colour: (Range<usize>, Tensor<2>),
}

/// Bytes of one channel a label for all Gaussians, and labels that are blended together all the same.
const BLOCK_BYTES: usize = 1 << 30;
const FEWEST: usize = 8;

/// The largest weight of a label at each pixel and the index of that label, both `[H, W, 1]`.
type Largest = (Tensor<3>, Tensor<3>);

impl OnDevice {
    fn new(gaussians: Gaussians, labels: Option<&[u16]>, device: &Device) -> Self {
        let device = device.clone().inner();
        let (n, terms) = (gaussians.len(), gaussians.sh_len());
        let SplatTensors { means, log_scales, rotations, opacity_logits } = SplatTensors::new(&gaussians, &device);
        let input = RasterInput {
            means,
            log_scales,
            rotations,
            opacity_logits,
            sh: Some(Tensor::from_data(TensorData::new(gaussians.sh, [n, terms, 3]), &device)),
            active_sh_degree: gaussians.sh_degree,
            features: None,
            screen: None,
        };
        let labels = labels.map(|labels| DeviceLabels::new(labels, &device));
        Self { input, labels, entries: None }
    }

    fn frame(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Frame> {
        let room = self.entries.map(room_for);
        if let Some(frame) = self.attempt(camera, options, room)? {
            return Ok(frame);
        }
        // The view has more entries than there was room for.
        match self.attempt(camera, options, None)? {
            Some(frame) => Ok(frame),
            None => Err(Error::non_finite("scene to render", 0)),
        }
    }

    /// `None` where `room` did not suffice.
    fn attempt(&mut self, camera: &Camera, options: &RenderOptions, room: Option<usize>) -> Result<Option<Frame>> {
        let (height, width) = (camera.height, camera.width);
        let view = self.view(camera, &options.settings);
        let mut blocks = self.labels.as_ref().map_or_else(Vec::new, |labels| labels.blocks(&view)).into_iter();
        let mut input = self.input.clone();
        if let (Some(labels), Some(block)) = (&mut self.labels, blocks.next()) {
            input.features = Some(labels.beside_colour(block));
        }
        let (output, summary) = rasterize_with_room(input, camera, &options.settings, options.background, room)?;
        let pixels = height * width;
        let rgb = output.image.clone().slice([0..height, 0..width, 0..3]);
        let mut parts = vec![rgb.reshape([3 * pixels]), output.transmittance.reshape([pixels])];
        if let Some(labels) = &self.labels {
            // The colour competes with less than any weight: to cut it off would copy all the others.
            let weights = output.image.slice_fill([0..height, 0..width, 0..3], -1.0);
            let mut largest = largest_of(weights, -3.0);
            for block in blocks {
                let first = block.start as f64;
                let (image, _) = view.blend(labels.one_hot(block))?;
                largest = larger_of(largest, largest_of(image, first));
            }
            parts.push(largest.1.mask_fill(largest.0.lower_equal_elem(0.0), -1.0).reshape([pixels]));
        }
        let (mut values, lists) = read_together(parts, summary.as_tensor())?;
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
            // -1 is cut off to no label.
            let id = |(&index, &alpha): (&f32, &f32)| match labels.ids.get(index as usize) {
                Some(&id) if index >= 0.0 && alpha >= options.min_coverage => id,
                _ => 0,
            };
            LabelMap { width, height, ids: index.iter().zip(&alpha).map(id).collect() }
        });
        Ok(Some(Frame { width, height, rgb: values, alpha, labels }))
    }

    fn view(&self, camera: &Camera, settings: &Settings) -> SplatView {
        let RasterInput { means, log_scales, rotations, opacity_logits, .. } = self.input.clone();
        SplatTensors { means, log_scales, rotations, opacity_logits }.seen_by(camera, settings)
    }
}

impl DeviceLabels {
    fn new(labels: &[u16], device: &Device) -> Self {
        let mut ids = labels.to_vec();
        ids.sort_unstable();
        ids.dedup();
        let index = |label| ids.partition_point(|id| id < label) as f32;
        let of_gaussians: Vec<f32> = labels.iter().map(index).collect();
        let of_gaussians = Tensor::from_data(TensorData::new(of_gaussians, [labels.len(), 1]), device);
        let beside_colour = (0..0, Tensor::zeros([1, 1], device));
        Self { ids, of_gaussians, beside_colour }
    }

    /// Ranges of labels: those that `view` blends beside the colour, and further ones in passes of their own. Neither an image of
    /// them nor a channel a Gaussian is more than a block may have.
    fn blocks(&self, view: &SplatView) -> Vec<Range<usize>> {
        let labels = self.ids.len();
        let of_image = view.channel_blocks(3 + labels).next().map_or(labels, |block| block.len() - 3);
        let [n, _] = self.of_gaussians.dims();
        let most =
            largest_allocation(&self.of_gaussians.device()).map_or(BLOCK_BYTES, |most| (most / 4).min(BLOCK_BYTES));
        let of_gaussians = (most / (n * size_of::<f32>())).max(FEWEST);
        let together = of_image.min(of_gaussians);
        (0..labels).step_by(together).map(|first| first..(first + together).min(labels)).collect()
    }

    /// [`DeviceLabels::one_hot`], kept for the next view.
    fn beside_colour(&mut self, block: Range<usize>) -> Tensor<2> {
        if self.beside_colour.0 != block {
            self.beside_colour = (block.clone(), self.one_hot(block));
        }
        self.beside_colour.1.clone()
    }

    /// 1 where a Gaussian has a label of `block`, `[N, len]`.
    fn one_hot(&self, block: Range<usize>) -> Tensor<2> {
        let (n, channels) = (self.of_gaussians.dims()[0], block.len());
        let block: Vec<f32> = block.map(|index| index as f32).collect();
        let block = Tensor::<2>::from_data(TensorData::new(block, [1, channels]), &self.of_gaussians.device());
        self.of_gaussians.clone().expand([n, channels]).equal(block.expand([n, channels])).float()
    }
}

/// The largest channel of `weights`, `[H, W, C]`, the first of which is label `first`; ties to the lower one.
fn largest_of(weights: Tensor<3>, first: f64) -> Largest {
    let (weight, index) = weights.max_dim_with_indices(2);
    (weight, index.float() + first)
}

/// The larger of both at each pixel, the former where they are equal.
fn larger_of(a: Largest, b: Largest) -> Largest {
    let better = b.0.clone().greater(a.0.clone());
    (a.0.mask_where(better.clone(), b.0), a.1.mask_where(better, b.1))
}

/// All of `parts` one after the other, and what is known of the tile lists, by one copy from the device.
fn read_together(mut parts: Vec<Tensor<1>>, summary: Option<Tensor<1>>) -> Result<(Vec<f32>, Option<ListCount>)> {
    let fields = summary.as_ref().map_or(0, |summary| summary.dims()[0]);
    parts.extend(summary);
    let mut values = read("a rendered view", Tensor::cat(parts, 0))?;
    let lists = ListCount::from_values(&values.split_off(values.len() - fields));
    Ok((values, lists))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{BackendName, device_of_tests};

    #[test]
    fn equal_labels_go_to_the_lower_one_within_and_between_blocks() {
        for device in BackendName::compiled().iter().filter_map(|&name| device_of_tests(name)) {
            let block = |values: [f32; 4], first| largest_of(Tensor::from_data([[values]], &device), first);
            let index = |largest: Largest| largest.1.into_data().into_vec::<f32>().expect("floats")[0];
            assert_eq!(index(block([0.1, 0.4, 0.4, 0.3], 8.0)), 9.0, "{device:?}");
            let between = |a, b| index(larger_of(block(a, 0.0), block(b, 4.0)));
            assert_eq!(between([0.0, 0.0, 0.5, 0.0], [0.5, 0.5, 0.0, 0.0]), 2.0, "{device:?}");
            assert_eq!(between([0.0, 0.0, 0.5, 0.0], [0.0, 0.6, 0.6, 0.0]), 5.0, "{device:?}");
        }
    }
}

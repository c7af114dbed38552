//! The sums of the unprojection on a GPU: maps are read bilinearly as two small dense products, and lifted by the
//! rasterizer's adjoint.

use super::Sums;
use crate::camera::Camera;
use crate::config::Resolution;
use crate::device::read;
use crate::error::Result;
use crate::features::{Axis, FeatureMap};
use crate::raster::{Lifted, Settings, SplatTensors};
use burn::tensor::{Device, Tensor, TensorData};

/// [`Sums`] that stay on a device until they are read.
pub(super) struct DeviceSums {
    splats: SplatTensors,
    scales: Vec<Scale>,
}

struct Scale {
    channels: usize,
    /// `[N, channels]`, `[N]` and `[N]`: none before the first view.
    sums: Option<[Tensor<2>; 2]>,
    /// `[N]`. Summed on the host: f32 counts no further than 2^24.
    counts: Vec<u64>,
    pixels: u64,
}

impl DeviceSums {
    /// Of no views yet.
    pub fn new(splats: SplatTensors, channels: &[usize]) -> Self {
        let n = splats.len();
        let scale = |&channels| Scale { channels, sums: None, counts: vec![0; n], pixels: 0 };
        Self { scales: channels.iter().map(scale).collect(), splats }
    }

    /// As [`Sums::add`].
    pub fn add(
        &mut self,
        camera: &Camera,
        maps: &[FeatureMap],
        resolution: Resolution,
        settings: &Settings,
    ) -> Result<()> {
        let channels: Vec<usize> = self.scales.iter().map(|scale| scale.channels).collect();
        super::check(self.splats.len(), &channels, self.splats.len(), maps)?;
        let device = self.splats.means.device();
        // At image resolution all scales share the camera: its weights and counts.
        let mut shared: Option<(Tensor<2>, Vec<u64>)> = None;
        for (scale, map) in self.scales.iter_mut().zip(maps) {
            let (camera, image) = match resolution {
                Resolution::Image => (camera.clone(), enlarged(map, camera, &device)),
                Resolution::Feature => (map.lattice().camera(camera), upload(map, &device)),
            };
            let lift = |image| self.splats.adjoint(image, &camera, settings);
            let (weights, counts) = match (resolution, &shared) {
                (Resolution::Image, Some(shared)) => shared.clone(),
                _ => {
                    let Lifted { sums, counts } = lift(Tensor::ones([camera.height, camera.width, 1], &device))?;
                    let counts = read("counts", counts)?.into_iter().map(|count| count as u64).collect();
                    shared.insert((sums, counts)).clone()
                }
            };
            let lifted = lift(image)?.sums;
            scale.sums = Some(match scale.sums.take() {
                Some([buffer, sum]) => [buffer + lifted, sum + weights],
                None => [lifted, weights],
            });
            scale.counts.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
            scale.pixels += (camera.width * camera.height) as u64;
        }
        Ok(())
    }

    /// The sums, read back.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not give them back.
    pub fn into_sums(self) -> Result<Sums<f32>> {
        let n = self.splats.len();
        let mut out = Sums::default();
        for Scale { channels, sums, counts, pixels } in self.scales {
            let [buffer, weights] = match sums {
                Some([buffer, weights]) => [read("unprojected features", buffer)?, read("weights", weights)?],
                None => [vec![0.0; n * channels], vec![0.0; n]],
            };
            out.buffers.push(buffer);
            out.channels.push(channels);
            out.weights.push(weights);
            out.counts.push(counts);
            out.pixels.push(pixels);
        }
        Ok(out)
    }
}

/// `[height, width, channels]`.
fn upload(map: &FeatureMap, device: &Device) -> Tensor<3> {
    Tensor::from_data(TensorData::new(map.data.clone(), [map.height, map.width, map.channels]), device)
}

/// `U F`: the map at every pixel of `camera`, `[H, W, channels]`.
fn enlarged(map: &FeatureMap, camera: &Camera, device: &Device) -> Tensor<3> {
    let lattice = map.lattice();
    let image = upload(map, device);
    if lattice.is_of_pixels(camera.width, camera.height) {
        return image;
    }
    let (height, width, channels) = (map.height, map.width, map.channels);
    let rows = bilinear(lattice.rows(camera.height), height, camera.height, device);
    let columns = bilinear(lattice.columns(camera.width), width, camera.width, device);
    let tall = rows.matmul(image.reshape([height, width * channels])).reshape([camera.height, width, channels]);
    columns.unsqueeze::<3>().matmul(tall)
}

/// Weights of `cells` cells at the centres of `pixels` pixels, `[pixels, cells]`.
fn bilinear(axis: Axis, cells: usize, pixels: usize, device: &Device) -> Tensor<2> {
    let mut weights = vec![0.0_f32; pixels * cells];
    for (pixel, row) in weights.chunks_exact_mut(cells.max(1)).enumerate() {
        let (before, after, share) = axis.taps(pixel as f64 + 0.5);
        row[before] += 1.0 - share;
        row[after] += share;
    }
    Tensor::from_data(TensorData::new(weights, [pixels, cells]), device)
}

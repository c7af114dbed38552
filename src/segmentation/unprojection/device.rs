//! The sums of the unprojection on a GPU: maps are read bilinearly as a sparse product, and lifted by the rasterizer's adjoint.

use super::Sums;
use crate::camera::Camera;
use crate::config::Resolution;
use crate::device::read;
use crate::error::Result;
use crate::features::{FeatureMap, Lattice};
use crate::ops::{SparseMatrix, sparse_apply};
use crate::raster::{Lifted, Settings, SplatTensors, SplatView};
use burn::tensor::{Device, Tensor, TensorData};
use std::sync::Arc;

/// [`Sums`] that stay on a device until they are read.
pub(super) struct DeviceSums {
    splats: SplatTensors,
    scales: Vec<Scale>,
    /// `U` of the lattices and image sizes met so far: views of one camera have one a scale.
    reads: Vec<(Lattice, [usize; 2], Arc<SparseMatrix>)>,
}

struct Scale {
    channels: usize,
    /// `[N, channels]` and `[N, 1]`: none before the first view.
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
        Self { scales: channels.iter().map(scale).collect(), splats, reads: Vec::new() }
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
        // At image resolution all scales share the camera: its lists, weights and counts.
        let mut shared: Option<(SplatView, Tensor<2>, Vec<u64>)> = None;
        for (number, map) in maps.iter().enumerate() {
            let seen = match (resolution, shared.take()) {
                (Resolution::Image, Some(seen)) => seen,
                (Resolution::Image, None) => self.look(camera, settings)?,
                (Resolution::Feature, _) => self.look(&map.lattice().camera(camera), settings)?,
            };
            let (view, weights, counts) = shared.insert(seen);
            let reading = match resolution {
                Resolution::Image => self.reading(map.lattice(), camera),
                Resolution::Feature => None,
            };
            let lifted = lifted(view, map, reading, &self.splats.means.device())?;
            let scale = &mut self.scales[number];
            scale.sums = Some(match scale.sums.take() {
                Some([buffer, sum]) => [buffer + lifted, sum + weights.clone()],
                None => [lifted, weights.clone()],
            });
            scale.counts.iter_mut().zip(counts).for_each(|(sum, count)| *sum += *count);
            scale.pixels += (view.camera().width * view.camera().height) as u64;
        }
        Ok(())
    }

    /// The view of `camera`, its weights `W^T 1` `[N, 1]` and its counts.
    fn look(&self, camera: &Camera, settings: &Settings) -> Result<(SplatView, Tensor<2>, Vec<u64>)> {
        let view = self.splats.seen_by(camera, settings);
        let ones = Tensor::ones([camera.height, camera.width, 1], &self.splats.means.device());
        let Lifted { sums, counts } = view.adjoint(ones)?;
        let counts = read("counts", counts)?.into_iter().map(|count| count as u64).collect();
        Ok((view, sums, counts))
    }

    /// `U`, unless the cells are the pixels.
    fn reading(&mut self, lattice: Lattice, camera: &Camera) -> Option<Arc<SparseMatrix>> {
        let size = [camera.width, camera.height];
        if lattice.is_of_pixels(size[0], size[1]) {
            return None;
        }
        if let Some((.., reading)) = self.reads.iter().find(|(of, at, _)| (*of, *at) == (lattice, size)) {
            return Some(reading.clone());
        }
        let reading = Arc::new(bilinear(&lattice, size));
        self.reads.push((lattice, size, reading.clone()));
        Some(reading)
    }

    /// Reads a value of every sum back.
    pub fn wait(&self) -> Result<()> {
        for [buffer, _] in self.scales.iter().filter_map(|scale| scale.sums.as_ref()) {
            read("a value of the sums", buffer.clone().slice([0..1, 0..1]))?;
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

/// `W^T U F`, `[N, channels]`: a block of channels at a time, so that no image holds them all.
fn lifted(
    view: &SplatView,
    map: &FeatureMap,
    reading: Option<Arc<SparseMatrix>>,
    device: &Device,
) -> Result<Tensor<2>> {
    let Camera { width, height, .. } = *view.camera();
    let cells = map.width * map.height;
    let cells = Tensor::<2>::from_data(TensorData::new(map.data.clone(), [cells, map.channels]), device);
    let blocks = view.channel_blocks(map.channels).map(|block| {
        let channels = block.len();
        let part = cells.clone().slice([0..cells.dims()[0], block]);
        let image = match &reading {
            Some(reading) => sparse_apply(part, reading.clone()),
            None => part,
        };
        Ok(view.adjoint(image.reshape([height, width, channels]))?.sums)
    });
    Ok(Tensor::cat(blocks.collect::<Result<Vec<_>>>()?, 1))
}

/// The bilinear read of every pixel of an image, `[W H, cells]`.
fn bilinear(lattice: &Lattice, [width, height]: [usize; 2]) -> SparseMatrix {
    let (columns, rows) = (lattice.columns(width), lattice.rows(height));
    let (mut indices, mut values) = (Vec::with_capacity(4 * width * height), Vec::with_capacity(4 * width * height));
    for y in 0..height {
        let (above, below, down) = rows.taps(y as f64 + 0.5);
        for x in 0..width {
            let (left, right, across) = columns.taps(x as f64 + 0.5);
            for (row, weight) in [(above, 1.0 - down), (below, down)] {
                indices.extend([left, right].map(|column| (row * lattice.width + column) as u32));
                values.extend([weight * (1.0 - across), weight * across]);
            }
        }
    }
    let offsets = (0..=(width * height) as u32).map(|pixel| 4 * pixel).collect();
    SparseMatrix::new(lattice.width * lattice.height, offsets, indices, values)
}

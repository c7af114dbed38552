//! Lifting in tensors: maps are read bilinearly as a sparse product, and lifted by the adjoint of blending.

use super::Sums;
use crate::backend::device::{read, upload};
use crate::config::Resolution;
use crate::data::mask::Mask;
use crate::error::Result;
use crate::features::{FeatureMap, Lattice};
use crate::ops::{SparseMatrix, sparse_apply};
use crate::raster::{Projected, Settings, SplatTensors, SplatView, Splats};
use crate::splat::camera::Camera;
use burn::tensor::{Device, Tensor};
use std::sync::Arc;

/// [`Sums`] as tensors.
pub(super) struct TensorSums {
    splats: SplatTensors,
    scales: Vec<Scale>,
    /// `U` of each lattice and image size so far. Views of one camera share one for each scale.
    bilinear_reads: Vec<(Lattice, [usize; 2], Arc<SparseMatrix>)>,
}

struct Scale {
    channels: usize,
    /// `[N, channels]` and `[N, 1]`: none before the first view.
    sums: Option<[Tensor<2>; 2]>,
    /// `[N]`. Summed on the host: f32 counts no further than 2^24.
    counts: Vec<u64>,
    pixels: u64,
}

impl TensorSums {
    /// No views yet.
    pub fn new(splats: SplatTensors, channels: &[usize]) -> Self {
        let n = splats.len();
        let scale = |&channels| Scale {
            channels,
            sums: None,
            counts: vec![0; n],
            pixels: 0,
        };
        Self {
            scales: channels.iter().map(scale).collect(),
            splats,
            bilinear_reads: Vec::new(),
        }
    }

    /// As [`Sums::add`]; `splats` are the same Gaussians on the host.
    pub fn add(
        &mut self,
        splats: &Splats<'_, f32>,
        camera: &Camera,
        maps: &[FeatureMap],
        mask: Option<&Mask>,
        resolution: Resolution,
        settings: &Settings,
    ) -> Result<()> {
        let channels: Vec<usize> = self.scales.iter().map(|scale| scale.channels).collect();
        super::check_maps(self.splats.len(), &channels, self.splats.len(), maps)?;
        mask.map_or(Ok(()), |mask| {
            mask.expect_size("a view", camera.width, camera.height)
        })?;
        // At image resolution all scales share the camera: its lists, weights and counts.
        let mut shared: Option<ProjectedPixels> = None;
        for (number, map) in maps.iter().enumerate() {
            let projected = match (resolution, shared.take()) {
                (Resolution::Image, Some(projected)) => projected,
                (Resolution::Image, None) => self.project(splats, camera, mask, settings)?,
                (Resolution::Feature, _) => {
                    let cells = map.lattice().camera(camera);
                    let mask = mask.map(|mask| super::mask_of_cells(mask, camera, &cells));
                    self.project(splats, &cells, mask.as_ref(), settings)?
                }
            };
            let projected = shared.insert(projected);
            let reading = match resolution {
                Resolution::Image => self.reading(map.lattice(), camera),
                Resolution::Feature => None,
            };
            let lifted = lifted(projected, map, reading, &self.splats.means.device())?;
            let weights = projected.weights.clone();
            let scale = &mut self.scales[number];
            scale.sums = Some(match scale.sums.take() {
                Some([buffer, sum]) => [buffer + lifted, sum + weights],
                None => [lifted, weights],
            });
            for (sum, count) in scale.counts.iter_mut().zip(&projected.counts) {
                *sum += count;
            }
            scale.pixels += projected.pixels;
        }
        Ok(())
    }

    /// The view of `camera`, of the pixels that `mask` uses.
    pub fn project(
        &self,
        splats: &Splats<'_, f32>,
        camera: &Camera,
        mask: Option<&Mask>,
        settings: &Settings,
    ) -> Result<ProjectedPixels> {
        let view = self.splats.seen_by(camera, settings);
        let pixels = camera.height * camera.width;
        let device = self.splats.means.device();
        let used = mask.map(|mask| {
            let value = |pixel| f32::from(u8::from(mask.uses(pixel)));
            upload((0..pixels).map(value).collect(), [pixels, 1], &device)
        });
        let all = used.clone();
        let all = all.unwrap_or_else(|| Tensor::ones([pixels, 1], &device));
        let weights = view.blend_adjoint(all.reshape([camera.height, camera.width, 1]))?;
        // The GPU counts all pixels. With a mask the CPU counts, and projects the view once more.
        let counts = match mask {
            Some(_) => Projected::new(splats, camera, settings)?.used_counts(mask),
            None => view.disc_pixels()?,
        };
        Ok(ProjectedPixels {
            view,
            used,
            weights,
            counts: counts.into_iter().map(u64::from).collect(),
            pixels: mask.map_or(pixels, Mask::kept) as u64,
        })
    }

    /// `U`, unless the cells are the pixels.
    fn reading(&mut self, lattice: Lattice, camera: &Camera) -> Option<Arc<SparseMatrix>> {
        let size = [camera.width, camera.height];
        if lattice.is_of_pixels(size[0], size[1]) {
            return None;
        }
        let mut known = self.bilinear_reads.iter();
        if let Some((.., reading)) = known.find(|(of, at, _)| (*of, *at) == (lattice, size)) {
            return Some(reading.clone());
        }
        let reading = Arc::new(bilinear(&lattice, size));
        self.bilinear_reads.push((lattice, size, reading.clone()));
        Some(reading)
    }

    /// The sums, read back.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not give them back.
    pub fn into_sums(self) -> Result<Sums<f32>> {
        let n = self.splats.len();
        let mut out = Sums::default();
        for scale in self.scales {
            let [buffer, weights] = match scale.sums {
                Some([buffer, weights]) => [
                    read("unprojected features", buffer)?,
                    read("weights", weights)?,
                ],
                None => [vec![0.0; n * scale.channels], vec![0.0; n]],
            };
            out.buffers.push(buffer);
            out.channels.push(scale.channels);
            out.weights.push(weights);
            out.counts.push(scale.counts);
            out.pixels.push(scale.pixels);
        }
        Ok(out)
    }
}

/// A view whose maps are lifted, and its pixels that count.
pub(super) struct ProjectedPixels {
    view: SplatView,
    /// 1 for pixels that the mask uses, else 0, `[W H, 1]`; `None` without a mask.
    used: Option<Tensor<2>>,
    /// `W^T 1` over the used pixels, `[N, 1]`.
    weights: Tensor<2>,
    /// Disc pixels of each Gaussian among the used ones, and the number of used pixels.
    pub counts: Vec<u64>,
    pub pixels: u64,
}

/// `W^T U F`, `[N, channels]`: a block of channels at a time, so that no image holds them all.
fn lifted(
    ProjectedPixels { view, used, .. }: &ProjectedPixels,
    map: &FeatureMap,
    reading: Option<Arc<SparseMatrix>>,
    device: &Device,
) -> Result<Tensor<2>> {
    let Camera { width, height, .. } = *view.camera();
    let cells = upload(map.data.clone(), [map.cells(), map.channels], device);
    let blocks = view.channel_blocks(map.channels).map(|block| {
        let channels = block.len();
        let part = cells.clone().slice([0..cells.dims()[0], block]);
        let image = match &reading {
            Some(reading) => sparse_apply(part, reading.clone()),
            None => part,
        };
        let image = match used {
            Some(used) => image * used.clone(),
            None => image,
        };
        view.blend_adjoint(image.reshape([height, width, channels]))
    });
    Ok(Tensor::cat(blocks.collect::<Result<Vec<_>>>()?, 1))
}

/// The bilinear read of every pixel of an image, `[W H, cells]`.
fn bilinear(lattice: &Lattice, [width, height]: [usize; 2]) -> SparseMatrix {
    let (columns, rows) = (lattice.columns(width), lattice.rows(height));
    let mut indices = Vec::with_capacity(4 * width * height);
    let mut values = Vec::with_capacity(4 * width * height);
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
    let offsets = (0..=(width * height) as u32)
        .map(|pixel| 4 * pixel)
        .collect();
    SparseMatrix::new(lattice.width * lattice.height, offsets, indices, values)
}

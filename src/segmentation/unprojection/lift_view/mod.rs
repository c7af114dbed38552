//! The operation `lift_view`: one view's part of Eq. 5, `W^T F` or `(W U)^T F`, added to the sums of the views before.
//!
//! The CPU's kernel first sums the weights of each Gaussian per feature cell (`cell_weights`), then gathers each cell's features
//! once (`cpu`). Elsewhere the map is read bilinearly as a sparse product, and lifted by the adjoint of blending
//! (`tensors`). That is also the reference.

mod cell_weights;
mod cpu;
mod tensors;

use crate::backend::Real;
use crate::backend::device::in_host_memory;
use crate::config::Resolution;
use crate::data::mask::Mask;
use crate::error::{Result, ensure};
use crate::features::{FeatureMap, Lattice};
use crate::ops::CustomOp;
use crate::raster::{Projected, Settings, SplatTensors, Splats};
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use burn::tensor::Device;
use tensors::TensorSums;

/// Sums over the views added so far, per Gaussian and scale.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sums<E> {
    /// `sum_v (W U)^T F_v` per scale, `[N, channels]`.
    pub buffers: Vec<Vec<E>>,
    /// Channels per scale.
    pub channels: Vec<usize>,
    /// `sum_v W^T 1` per scale, `[N]`: at `image` resolution the same at every scale.
    pub weights: Vec<Vec<E>>,
    /// Algorithm 1's counter per scale, `[N]`: unmasked pixels (at `feature` resolution: cells) whose centre lies within the
    /// radius. Masked ones do not add to the buffers either.
    pub counts: Vec<Vec<u64>>,
    /// Unmasked pixels (cells) of all views per scale; without masks `sum_v H_v W_v`.
    pub pixels: Vec<u64>,
}

impl<E: Real> Sums<E> {
    /// No views yet, for `n` Gaussians and one entry of `channels` per scale.
    pub fn new(n: usize, channels: &[usize]) -> Self {
        Self {
            buffers: channels.iter().map(|c| vec![E::zero(); n * c]).collect(),
            channels: channels.to_vec(),
            weights: vec![vec![E::zero(); n]; channels.len()],
            counts: vec![vec![0; n]; channels.len()],
            pixels: vec![0; channels.len()],
        }
    }

    /// Adds a view with one map per scale. `mask` has the camera's size; only pixels that it uses count. At `feature` resolution,
    /// only cells count whose centre is a used pixel.
    ///
    /// Results do not depend on the number of threads. Memory beside the sums holds the view's (Gaussian, cell) weights, and
    /// nothing per pixel and channel.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] when maps, mask or Gaussians do not match what this was made for; [`crate::Error::NonFinite`] for maps with
    /// such values; what [`crate::raster::Projected::new`] returns.
    pub fn add(
        &mut self,
        splats: &Splats<'_, E>,
        camera: &Camera,
        maps: &[FeatureMap],
        mask: Option<&Mask>,
        resolution: Resolution,
        settings: &Settings,
    ) -> Result<()> {
        let n = self.counts.first().map_or(splats.len(), Vec::len);
        check_maps(n, &self.channels, splats.len(), maps)?;
        mask.map_or(Ok(()), |mask| {
            mask.expect_size("a view", camera.width, camera.height)
        })?;
        // Scales on one grid share the projection and the scalar weights.
        let mut grids: Vec<(Lattice, Vec<usize>)> = Vec::new();
        for (scale, map) in maps.iter().enumerate() {
            let lattice = map.lattice();
            match grids.iter_mut().find(|(of, _)| *of == lattice) {
                Some((_, scales)) => scales.push(scale),
                None => grids.push((lattice, vec![scale])),
            }
        }
        match resolution {
            Resolution::Image => cpu::lift_view(self, splats, camera, maps, mask, &grids, settings),
            Resolution::Feature => grids.into_iter().try_for_each(|(mut lattice, scales)| {
                let cells = lattice.camera(camera);
                let mask = mask.map(|mask| mask_of_cells(mask, camera, &cells));
                // Cells are the pixels of the scaled camera.
                lattice.steps = None;
                let grids = [(lattice, scales)];
                cpu::lift_view(self, splats, &cells, maps, mask.as_ref(), &grids, settings)
            }),
        }
    }
}

/// `mask`, of the pixels of `camera`, at the centres of the pixels of `cells`, the same camera at another size.
fn mask_of_cells(mask: &Mask, camera: &Camera, cells: &Camera) -> Mask {
    let axes = |c: &Camera| [(c.cx, c.fx, c.width), (c.cy, c.fy, c.height)];
    let (from, to) = (axes(cells), axes(camera));
    let pixel = |axis: usize, cell: usize| {
        let ((center, focal, _), (pixel_center, pixel_focal, pixels)) = (from[axis], to[axis]);
        let position = (cell as f64 + 0.5 - center) * pixel_focal / focal + pixel_center;
        (position.max(0.0) as usize).min(pixels.saturating_sub(1))
    };
    Mask::new(cells.width, cells.height, |i| {
        let [x, y] = [pixel(0, i % cells.width), pixel(1, i / cells.width)];
        mask.uses(y * camera.width + x)
    })
}

/// Checks that `maps` of `gaussians` Gaussians fit sums over `n` Gaussians and maps of `channels`.
fn check_maps(n: usize, channels: &[usize], gaussians: usize, maps: &[FeatureMap]) -> Result<()> {
    let found: Vec<usize> = maps.iter().map(|m| m.channels).collect();
    ensure!(found == channels, argument "feature maps"; found "channels {found:?}";
        expected "{channels:?}, one map a scale"; help "reduce all views alike");
    ensure!(gaussians == n, argument "unprojection"; found "{gaussians} Gaussians"; expected "{n}";
        help "use new sums for another scene");
    for (scale, map) in maps.iter().enumerate() {
        map.check(&format!("feature map of scale {}", scale + 1))?;
        ensure!(map.cells() != 0, argument "feature map"; found "no cells"; expected "one or more";
            help "leave the view out");
    }
    Ok(())
}

/// Sums over views in the making, on the device that holds the Gaussians.
pub struct LiftedViews<'a> {
    gaussians: &'a Gaussians,
    kernel: Kernel,
}

enum Kernel {
    Cpu(Sums<f32>),
    Tensors(Box<TensorSums>),
}

impl<'a> LiftedViews<'a> {
    /// No views yet, one entry of `channels` per scale.
    pub fn new(gaussians: &'a Gaussians, channels: &[usize], device: &Device) -> Self {
        let by_cpu = in_host_memory(device) && !CustomOp::Raster.is_replaced();
        let kernel = if by_cpu || gaussians.is_empty() {
            Kernel::Cpu(Sums::new(gaussians.len(), channels))
        } else {
            let splats = SplatTensors::new(gaussians, device);
            Kernel::Tensors(Box::new(TensorSums::new(splats, channels)))
        };
        Self { gaussians, kernel }
    }

    /// Adds a view with one map per scale, of the pixels that `mask` uses; see [`Sums::add`].
    ///
    /// # Errors
    /// As [`Sums::add`]; on a GPU as [`crate::raster::SplatView::blend_adjoint`].
    pub fn add(
        &mut self,
        camera: &Camera,
        maps: &[FeatureMap],
        mask: Option<&Mask>,
        resolution: Resolution,
        settings: &Settings,
    ) -> Result<()> {
        let splats = self.gaussians.splats();
        match &mut self.kernel {
            Kernel::Cpu(sums) => sums.add(&splats, camera, maps, mask, resolution, settings),
            Kernel::Tensors(sums) => sums.add(&splats, camera, maps, mask, resolution, settings),
        }
    }

    /// Algorithm 1's counter in the view of `camera`, `[N]`, of the pixels that `mask` uses, and the number of these pixels. The
    /// kernels are those that lift features, so that a pixel on the rim of a disc counts alike.
    ///
    /// # Errors
    /// As [`Projected::new`]; [`crate::Error::Device`] when the device fails.
    pub fn disc_pixels(
        &self,
        camera: &Camera,
        mask: Option<&Mask>,
        settings: &Settings,
    ) -> Result<(Vec<u64>, u64)> {
        let splats = self.gaussians.splats();
        match &self.kernel {
            Kernel::Cpu(_) => {
                let counts = Projected::new(&splats, camera, settings)?.used_counts(mask);
                let pixels = mask.map_or(camera.width * camera.height, Mask::kept);
                Ok((counts.into_iter().map(u64::from).collect(), pixels as u64))
            }
            Kernel::Tensors(sums) => {
                let projected = sums.project(&splats, camera, mask, settings)?;
                Ok((projected.counts, projected.pixels))
            }
        }
    }

    /// The sums, on the host.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not return them.
    pub fn finish(self) -> Result<Sums<f32>> {
        match self.kernel {
            Kernel::Cpu(sums) => Ok(sums),
            Kernel::Tensors(sums) => sums.into_sums(),
        }
    }
}

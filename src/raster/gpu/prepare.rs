//! Projection and tile lists of a view.

use super::inputs::Inputs;
use super::lists::{self, Order, TileEntries};
use super::project::{self, ProjectedScene};
use super::{scan, view};
use crate::backend::gpu::{Gpu, add_non_finite};
use crate::error::{Error, Result, ensure};
use crate::raster::cpu::geometry::Viewpoint;
use crate::raster::settings::Settings;
use crate::splat::camera::Camera;
use burn_cubecl::cubecl::prelude::*;
use burn_cubecl::tensor::CubeTensor;

/// A view's projection and tile lists.
pub(crate) struct Prepared {
    pub(super) view: CubeTensor,
    pub(super) projected: ProjectedScene,
    pub(super) order: Order,
    pub(super) entries: TileEntries,
    pub(super) size: [usize; 2],
}

/// [`Error::Limit`] when `count` of `what`, of `bytes` each, exceed the largest allocation of the device or 32 bits.
pub(super) fn check_size(gpu: &Gpu, what: &str, count: usize, bytes: usize) -> Result<()> {
    let limit = (gpu.largest() / bytes.max(1)).min(scan::CEILING as usize - 1);
    ensure!(count <= limit, limit "{what} on this device"; found "{count}"; expected "{limit}";
        help "render a smaller image or fewer channels, remove very large Gaussians, or use a CPU backend");
    Ok(())
}

impl Prepared {
    /// Projects and sorts `inputs`; `None` when an input holds a NaN or an infinity.
    ///
    /// # Errors
    /// As [`super::forward`].
    pub fn new(
        inputs: &Inputs,
        camera: &Camera,
        settings: &Settings,
        background: [f64; 3],
    ) -> Result<Option<Self>> {
        settings.check()?;
        let viewpoint = Viewpoint::new(camera)?;
        // The background is part of colours alone.
        let behind = if inputs.sh.is_some() {
            background
        } else {
            [0.0; 3]
        };
        let gpu = &Gpu::of(&inputs.means);
        let size = viewpoint.size;
        let len = inputs.len();
        check_size(gpu, "Gaussians", len, project::SPLAT * size_of::<f32>())?;
        let view = gpu.upload(&view::constants(&viewpoint, settings, behind));
        // Non-finite rows, and entries of the tile lists.
        let report = gpu.upload(&[0_u32, 0]);
        for tensor in inputs.coefficients_and_features() {
            add_non_finite(gpu, tensor, &report);
        }
        let projected = project::project(gpu, inputs, &view, &report);
        let order = lists::depth_order(gpu, &projected, len, size, &report);
        let report = read_words(gpu, &report)?;
        if report[0] > 0 {
            return Ok(None);
        }
        let count = report[1] as usize;
        let what = "entries of the tile lists of one view";
        check_size(gpu, what, count, size_of::<u32>())?;
        let entries = lists::tile_entries(gpu, &projected, &order, count, size);
        Ok(Some(Self {
            view,
            projected,
            order,
            entries,
            size,
        }))
    }
}

pub(super) fn read_words(gpu: &Gpu, tensor: &CubeTensor) -> Result<Vec<u32>> {
    match gpu.client.read_one(tensor.handle.clone()) {
        Ok(bytes) => Ok(u32::from_bytes(&bytes).to_vec()),
        Err(error) => Err(Error::Device {
            device: gpu.client.name().into(),
            reason: format!("reading from the device failed: {error:?}"),
            help: "check whether the device has memory left, or choose a CPU backend".into(),
        }),
    }
}

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

/// Camera, settings and background.
#[derive(Clone, Copy)]
pub(crate) struct Scenery<'a> {
    pub camera: &'a Camera,
    pub settings: &'a Settings,
    pub background: [f64; 3],
}

/// A view's projection and tile lists.
pub(super) struct Prepared {
    pub view: CubeTensor,
    pub projected: ProjectedScene,
    pub order: Order,
    pub entries: TileEntries,
    pub size: [usize; 2],
}

/// [`Error::Limit`] when `count` of `what`, of `bytes` each, exceed the largest allocation of the device or 32 bits.
pub(super) fn check_size(gpu: &Gpu, what: &str, count: usize, bytes: usize) -> Result<()> {
    let limit = (gpu.largest() / bytes.max(1)).min(scan::CEILING as usize - 1);
    ensure!(count <= limit, limit "{what} on this device"; found "{count}"; expected "{limit}";
        help "render a smaller image or fewer channels, remove very large Gaussians, or use a CPU backend");
    Ok(())
}

/// Projects and sorts `inputs`; `None` when an input holds a NaN or an infinity.
pub(super) fn prepare(
    gpu: &Gpu,
    inputs: &Inputs,
    scenery: Scenery<'_>,
) -> Result<Option<Prepared>> {
    let Scenery {
        camera,
        settings,
        background,
    } = scenery;
    settings.check()?;
    let viewpoint = Viewpoint::new(camera)?;
    // The background is part of colours alone.
    let behind = if inputs.sh.is_some() {
        background
    } else {
        [0.0; 3]
    };
    let size = viewpoint.size;
    let len = inputs.len();
    check_size(gpu, "Gaussians", len, project::SPLAT * size_of::<f32>())?;
    let view = gpu.upload(&view::constants(&viewpoint, settings, behind));
    // Non-finite rows, and entries of the tile lists.
    let report = gpu.upload(&[0_u32, 0]);
    for tensor in inputs.sh.iter().map(|(sh, _)| sh).chain(&inputs.features) {
        add_non_finite(gpu, tensor, tensor.meta.num_elements(), &report);
    }
    let projected = project::project(gpu, inputs, &view, &report);
    let order = lists::depth_order(gpu, &projected, len, size, &report);
    let [non_finite, count] = read_report(gpu, &report)?;
    if non_finite > 0 {
        return Ok(None);
    }
    let what = "entries of the tile lists of one view";
    check_size(gpu, what, count as usize, size_of::<u32>())?;
    let count = count as usize;
    let entries = lists::tile_entries(gpu, &projected, &order, count, size);
    Ok(Some(Prepared {
        view,
        projected,
        order,
        entries,
        size,
    }))
}

/// Non-finite rows, and entries.
fn read_report(gpu: &Gpu, report: &CubeTensor) -> Result<[u32; 2]> {
    let words = read_words(gpu, report)?;
    match words[..] {
        [non_finite, entries, ..] => Ok([non_finite, entries]),
        _ => Err(device_error(gpu, "a readback was too short".into())),
    }
}

fn device_error(gpu: &Gpu, reason: String) -> Error {
    Error::Device {
        device: gpu.client.name().into(),
        reason,
        help: "check whether the device has memory left, or choose a CPU backend".into(),
    }
}

pub(super) fn read_words(gpu: &Gpu, tensor: &CubeTensor) -> Result<Vec<u32>> {
    match gpu.client.read_one(tensor.handle.clone()) {
        Ok(bytes) => Ok(u32::from_bytes(&bytes).to_vec()),
        Err(error) => Err(device_error(
            gpu,
            format!("reading from the device failed: {error:?}"),
        )),
    }
}

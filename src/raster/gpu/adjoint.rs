//! `W^T y` without a forward pass, and the counter of Algorithm 1.

use super::backward::{self, Tiles};
use super::project::SPLAT;
use super::{Inputs, Scenery, check_size, prepare};
use crate::error::Result;
use crate::gpu::{Gpu, arg};
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

/// Pixels whose centres lie within `low..=high`, of `limit`.
#[cube]
fn covered(low: f32, high: f32, limit: f32) -> f32 {
    let first = min(max((low - 0.5f32).ceil(), 0.0f32), limit);
    let end = min((high - 0.5f32).floor() + 1.0f32, limit);
    max(end - first, 0.0f32)
}

/// Pixels within the radius of each Gaussian.
#[cube(launch)]
fn count_pixels(splats: &[f32], radii: &[u32], counts: &mut [f32], gaussians: u32, width: f32, height: f32) {
    let i = ABSOLUTE_POS;
    if i >= gaussians as usize {
        terminate!();
    }
    let mut count = 0.0f32;
    if radii[i] > 0u32 {
        let radius = f32::cast_from(radii[i]);
        let x = splats[SPLAT * i];
        let y = splats[SPLAT * i + 1];
        let mut row = min(max((y - radius - 0.5f32).ceil(), 0.0f32), height);
        let rows = covered(y - radius, y + radius, height);
        let end = row + rows;
        while row < end {
            let dy = row + 0.5f32 - y;
            let half = max(radius * radius - dy * dy, 0.0f32).sqrt();
            count += covered(x - half, x + half, width);
            row += 1.0f32;
        }
    }
    counts[i] = count;
}

/// `W^T y` `[N, channels]` and the counts `[N]`; `y` is `[H, W, channels]`, contiguous. `None` when some input holds a NaN or
/// an infinity.
///
/// # Errors
/// As [`super::forward`].
pub(in crate::raster) fn adjoint(
    inputs: &Inputs,
    scenery: Scenery<'_>,
    y: &CubeTensor,
    channels: usize,
) -> Result<Option<(CubeTensor, CubeTensor)>> {
    let gpu = Gpu::of(&inputs.means);
    check_size(&gpu, "Gaussians times channels", inputs.len().saturating_mul(channels), size_of::<f32>())?;
    let Some(prepared) = prepare(&gpu, inputs, scenery)? else { return Ok(None) };
    let (projected, size) = (&prepared.projected, prepared.size);
    let tiles = Tiles { order: &prepared.order, entries: &prepared.entries, size };
    let sums =
        backward::adjoint(&gpu, &projected.splats, tiles, y, channels, &prepared.view, backward::row_bytes(&gpu));
    let counts = gpu.floats([inputs.len()]);
    count_pixels::launch(
        &gpu.client,
        gpu.cubes_for(inputs.len()),
        gpu.dim(),
        arg(&projected.splats),
        arg(&projected.radii),
        arg(&counts),
        inputs.len() as u32,
        size[0] as f32,
        size[1] as f32,
    );
    Ok(Some((sums, counts)))
}

//! The backward pass over the tiles, launched block of channels by block and slab of entries by slab, and the sums over each
//! Gaussian's tiles.

use super::backward::{tiles_backward, widest};
use super::batch::{ABSOLUTE_MOMENTS, MOMENTS};
use super::blend::blocks;
use super::lists::tile_counts;
use super::prepare::Prepared;
use super::row_sums::sum_rows;
use crate::backend::gpu::{Gpu, launch};
use burn_cubecl::tensor::CubeTensor;

/// What was rendered and its gradient.
pub(super) struct PixelGradients<'a> {
    /// `[H, W, C]`, background included.
    pub image: &'a CubeTensor,
    pub d_image: &'a CubeTensor,
    /// `[H, W]`.
    pub transmittance: &'a CubeTensor,
    pub d_transmittance: Option<&'a CubeTensor>,
    /// Whether to add sums of absolute values, for at most [`super::backward::COMMON_BLOCK_CHANNELS`] channels.
    pub absolute: bool,
}

/// Bytes that the rows of one pass may take. More entries go through in several passes.
pub(super) fn row_bytes(gpu: &Gpu) -> usize {
    gpu.largest().min(1 << 30)
}

/// Sums over all pixels, a row for every Gaussian of the scene; zero for culled ones.
pub(super) struct PixelSums {
    /// `[N, 6]`, or `[N, 8]` with sums of absolute values; of any length where none are wanted.
    pub moments: CubeTensor,
    /// Gradients of the values, `[N, C]`.
    pub values: CubeTensor,
}

/// `W^T y` alone, `[N, channels]`: `y` is `[H, W, channels]`.
pub(super) fn adjoint(
    gpu: &Gpu,
    prepared: &Prepared,
    y: &CubeTensor,
    row_bytes: usize,
) -> CubeTensor {
    // Read by the moments alone.
    let absent = gpu.floats([1]);
    let pixels = PixelGradients {
        image: &absent,
        d_image: y,
        transmittance: &absent,
        d_transmittance: None,
        absolute: false,
    };
    pixel_sums(gpu, prepared, None, &pixels, row_bytes).values
}

/// Runs the backward pass over the tiles; without `values` (`[N, C]`) it sums no moments. Rows take at most `row_bytes`.
pub(super) fn pixel_sums(
    gpu: &Gpu,
    prepared: &Prepared,
    values: Option<&CubeTensor>,
    pixels: &PixelGradients<'_>,
    row_bytes: usize,
) -> PixelSums {
    let order = &prepared.order;
    let entries = &prepared.entries;
    let [w, h] = prepared.size;
    let tile_count: usize = tile_counts(prepared.size).iter().product();
    let channels = pixels.d_image.meta.num_elements() / (w * h);
    let moments = match values {
        None => 0,
        Some(_) if pixels.absolute => ABSOLUTE_MOMENTS,
        Some(_) => MOMENTS,
    };
    let out = PixelSums {
        moments: gpu.floats([order.len, moments]),
        values: gpu.floats([order.len, channels]),
    };
    for (first_channel, block) in blocks(channels, widest(gpu, moments)) {
        let columns = moments + block;
        let most = (row_bytes / (columns * size_of::<f32>())).clamp(1, entries.len.max(1));
        let rows = gpu.floats([most, columns]);
        // One pass even without entries, to write the zeros.
        for first_entry in (0..entries.len.max(1)).step_by(most) {
            let end_entry = (first_entry + most).min(entries.len);
            launch!(gpu, tiles_backward, gpu.cubes(tile_count);
                &entries.ranges, &entries.gaussians, &entries.entries, &prepared.projected.splats,
                values.unwrap_or(pixels.d_image), &prepared.view, pixels.image, pixels.d_image,
                pixels.transmittance, pixels.d_transmittance.unwrap_or(pixels.transmittance), &rows;
                w as u32, h as u32, tile_count as u32, channels as u32, first_channel as u32,
                first_entry as u32, end_entry as u32, block, moments,
                first_channel == 0 && pixels.d_transmittance.is_some());
            // The first slab of each part overwrites its sums.
            launch!(gpu, sum_rows, gpu.cubes_for(order.len * columns);
                &order.ids, &order.offsets, &entries.ends, &rows, &out.moments, &out.values;
                order.len as u32, channels as u32, first_channel as u32, first_entry as u32,
                end_entry as u32, block, moments, first_channel > 0 || first_entry > 0, first_entry > 0);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Settings;
    use crate::raster::gpu::blend::blend;
    use crate::raster::gpu::fixture::{View, floats};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn entries_in_slabs_give_the_same_sums() {
        let Some(view) = View::new(400, 0.1, [50, 41], &Settings::default()) else {
            return;
        };
        let gpu = &view.gpu;
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut draw = |n: usize| -> CubeTensor {
            let values: Vec<f32> = (0..n).map(|_| rng.random_range(-1.0..1.0)).collect();
            gpu.upload(&values)
        };
        let pixels = 50 * 41;
        let values = draw(400 * 12);
        let (image, transmittance) = blend(gpu, &view.prepared, &values, 12);
        let d_image = draw(pixels * 12);
        let d_transmittance = draw(pixels);
        let gradients = PixelGradients {
            image: &image,
            d_image: &d_image,
            transmittance: &transmittance,
            d_transmittance: Some(&d_transmittance),
            absolute: false,
        };
        let sums = |row_bytes: usize| {
            let out = pixel_sums(gpu, &view.prepared, Some(&values), &gradients, row_bytes);
            [out.moments, out.values].map(|t| floats(gpu, &t))
        };
        let whole = sums(usize::MAX);
        let slabs = sums(view.prepared.entries.len * 56 / 3);
        let lift = |row_bytes: usize| {
            let sums = adjoint(gpu, &view.prepared, &d_image, row_bytes);
            floats(gpu, &sums)
        };
        let lifted = [lift(usize::MAX), lift(view.prepared.entries.len * 48 / 3)];
        let pairs = whole
            .iter()
            .zip(&slabs)
            .chain([(&lifted[0], &lifted[1]), (&whole[1], &lifted[0])]);
        for (whole, slabs) in pairs {
            let largest = whole.iter().fold(0.0_f32, |a, v| a.max(v.abs()));
            assert!(largest > 0.0);
            assert!(
                whole
                    .iter()
                    .zip(slabs)
                    .all(|(a, b)| (a - b).abs() <= 1e-5 * largest)
            );
        }
    }
}

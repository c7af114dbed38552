//! Photos on a device: f32 values with moments from the host, or bytes, whose moments a kernel makes before each comparison.

use super::tile_window::{PLANE, ROWS, SIDE, cubes, own_place, place, windowed};
use crate::backend::gpu::{Gpu, UNITS, arg};
use crate::data::mask::Mask;
use crate::ops::photo::CHANNELS;
use crate::ops::{Compared, Photo};
use burn::tensor::DType;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

/// 1 / 255 in two parts. The first has 16 bits, so that a byte times it is exact, and the sum of both products is the byte / 255
/// as the host rounds it.
const BYTE_HIGH: f32 = f32::from_bits(0x3b80_8000);
const BYTE_LOW: f32 = (1.0 / 255.0 - BYTE_HIGH as f64) as f32;

/// Value number `at` of a photo: bytes in words, or the bits of f32 values.
#[cube]
pub(super) fn value_at(photo: &[u32], at: usize, #[comptime] packed: bool) -> f32 {
    let mut value = 0.0f32;
    if comptime![packed] {
        let byte = f32::cast_from(photo[at / 4] >> (at as u32 % 4 * 8) & 255u32);
        value = byte * comptime![BYTE_HIGH] + byte * comptime![BYTE_LOW];
    }
    if comptime![!packed] {
        value = f32::reinterpret(photo[at]);
    }
    value
}

/// Windowed mean and variance of a photo of bytes, `[H, W, CHANNELS]`.
#[cube(launch)]
fn moments_of(
    photo: &[u32],
    mean: &mut [f32],
    variance: &mut [f32],
    width: u32,
    height: u32,
    cubes: u32,
) {
    if CUBE_POS >= cubes as usize {
        terminate!();
    }
    let tile = CUBE_POS / CHANNELS;
    let channel = CUBE_POS % CHANNELS;
    let mut planes = Shared::<[f32]>::new_slice(2 * PLANE);
    let mut rows = Shared::<[f32]>::new_slice(2 * ROWS);
    let mut k = UNIT_POS as usize;
    while k < PLANE {
        let at = place(tile, k % SIDE, k / SIDE, width, height);
        let mut y = 0.0f32;
        if at.inside {
            y = value_at(photo, at.pixel * CHANNELS + channel, true);
        }
        planes[k] = y;
        planes[k + PLANE] = y * y;
        k += UNITS as usize;
    }
    sync_cube();
    let moments = windowed(&planes, &mut rows, false);
    let own = own_place(tile, width, height);
    if own.inside {
        let at = own.pixel * CHANNELS + channel;
        mean[at] = moments.first;
        variance[at] = moments.second - moments.first * moments.first;
    }
}

/// `values` (`[pixels, CHANNELS]`) of the pixels whose bit is set, and zeros for the others.
#[cube(launch)]
fn used_of(values: &[f32], bits: &[u32], out: &mut [f32], count: u32) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let pixel = i / CHANNELS;
    let mut value = values[i];
    if (bits[pixel / 32] >> (pixel as u32 % 32) & 1u32) == 0u32 {
        value = 0.0f32;
    }
    out[i] = value;
}

/// The pixels of an image that a mask uses; the others are black.
pub(super) fn used(gpu: &Gpu, image: &CubeTensor, bits: &CubeTensor) -> CubeTensor {
    let values = image.meta.num_elements();
    let out = gpu.floats(image.meta.shape().clone());
    used_of::launch(
        &gpu.client,
        gpu.cubes_for(values),
        gpu.dim(),
        arg(image),
        arg(bits),
        arg(&out),
        values as u32,
    );
    out
}

/// The bytes of a photo in words, and the bits of its mask.
#[derive(Clone)]
pub(crate) struct DeviceBytes {
    words: CubeTensor,
    mask: Option<CubeTensor>,
}

/// A photo with its windowed moments.
#[derive(Clone)]
pub(crate) struct DevicePhoto {
    /// 32-bit values, or bytes in words.
    pub(super) rgb: CubeTensor,
    pub(super) packed: bool,
    pub(super) mean: CubeTensor,
    pub(super) variance: CubeTensor,
    /// Bits of the pixels that are used, where some are left out.
    pub(super) mask: Option<CubeTensor>,
}

impl DevicePhoto {
    fn upload(gpu: &Gpu, photo: &Photo) -> Self {
        let upload = |values| gpu.upload::<f32>(values, DType::F32);
        let [rgb, mean, variance] =
            [&photo.rgb, &photo.mean, &photo.variance].map(|values| upload(values));
        Self {
            rgb,
            packed: false,
            mean,
            variance,
            mask: bits(gpu, photo.mask.as_ref()),
        }
    }

    /// Of a photo's bytes.
    fn of_bytes(
        gpu: &Gpu,
        DeviceBytes { words, mask }: DeviceBytes,
        (height, width): (usize, usize),
    ) -> Self {
        let [mean, variance] = [0; 2].map(|_| gpu.floats([height, width, CHANNELS]));
        let cubes = cubes(height, width);
        moments_of::launch(
            &gpu.client,
            gpu.cubes(cubes),
            gpu.dim(),
            arg(&words),
            arg(&mean),
            arg(&variance),
            width as u32,
            height as u32,
            cubes as u32,
        );
        Self {
            rgb: words,
            packed: true,
            mean,
            variance,
            mask,
        }
    }

    /// `photo` on the device, uploaded when it is first seen there.
    pub(super) fn of(gpu: &Gpu, photo: &Compared) -> Self {
        match photo {
            Compared::Prepared(photo) => photo.resident.on(gpu, || Self::upload(gpu, photo)),
            Compared::Packed(photo) => {
                let bytes = photo.resident.on(gpu, || DeviceBytes {
                    words: gpu.upload(&photo.words(), DType::U32),
                    mask: bits(gpu, photo.mask.as_ref()),
                });
                Self::of_bytes(gpu, bytes, photo.size())
            }
        }
    }
}

fn bits(gpu: &Gpu, mask: Option<&Mask>) -> Option<CubeTensor> {
    Some(gpu.upload(mask?.words(), DType::U32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_become_the_values_that_the_host_has() {
        assert_eq!(BYTE_HIGH.to_bits() & 0xff, 0, "16 bits of mantissa");
        for byte in 0..=255 {
            let (byte, want) = (byte as f32, byte as f32 / 255.0);
            assert_eq!(byte * BYTE_HIGH + byte * BYTE_LOW, want);
            assert_eq!(
                byte.mul_add(BYTE_LOW, byte * BYTE_HIGH),
                want,
                "of devices that fuse"
            );
        }
    }
}

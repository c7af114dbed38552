//! Attendance by itself: what Algorithm 1 counts, without features.

use super::Sums;
use super::device::DeviceSums;
use crate::backend::device::in_host_memory;
use crate::config::UnprojectionConfig;
use crate::data::View;
use crate::data::mask::Mask;
use crate::error::Result;
use crate::raster::{Projected, Settings, SplatTensors};
use crate::splat::Gaussians;
use burn::tensor::Device;

/// Which of `gaussians` attendance pruning keeps, `[N]`: those that [`super::unproject`] of any features of `views` at `image`
/// resolution keeps. At `feature` resolution the counted cells are those of the maps, which this does not know.
///
/// # Errors
/// As [`Projected::new`]; [`crate::Error::Config`] for a mask of another size than its view; [`crate::Error::Device`] where a
/// device does not give its counts back.
pub fn attended<'a>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    config: &UnprojectionConfig,
    settings: &Settings,
    device: &Device,
) -> Result<Vec<bool>> {
    if gaussians.is_empty() || config.attendance == 0.0 {
        return Ok(vec![true; gaussians.len()]);
    }
    let splats = gaussians.splats();
    // By the kernels that lift features there: a pixel on the rim of a radius goes the same way.
    let device = (!in_host_memory(device))
        .then(|| DeviceSums::new(SplatTensors::new(gaussians, device), &[]));
    let (mut sums, mut all) = (vec![0; gaussians.len()], 0);
    for View {
        name, camera, mask, ..
    } in views
    {
        let mask = mask.as_ref();
        mask.map_or(Ok(()), |mask| {
            mask.expect_size(&format!("view {name}"), camera.width, camera.height)
        })?;
        let (counts, pixels) = match &device {
            Some(device) => device.counts(&splats, camera, mask, settings)?,
            None => {
                let counts = Projected::new(&splats, camera, settings)?.used_counts(mask);
                let pixels = mask.map_or(camera.width * camera.height, Mask::kept);
                (counts.into_iter().map(u64::from).collect(), pixels as u64)
            }
        };
        sums.iter_mut()
            .zip(counts)
            .for_each(|(sum, count)| *sum += count);
        all += pixels;
    }
    Ok(Sums::<f32> {
        counts: vec![sums],
        pixels: vec![all],
        ..Sums::default()
    }
    .attended(config))
}

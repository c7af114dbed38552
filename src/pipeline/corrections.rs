//! Labels that a person corrected in a finished run: stage two takes them as true when it is trained again.

use super::reconstruct::RunFiles;
use crate::config::Config;
use crate::data::{Scene, Split};
use crate::error::Result;
use crate::files::atomic;
use crate::objects::Corrections;
use crate::progress::{Progress, Viewing};
use crate::raster::{Settings, SplatTensors};
use crate::splat::Gaussians;
use burn::tensor::Device;
use std::path::Path;

/// Gives the training views of `scene` the labels of `corrections`, which belong to it and to `gaussians`, and the scene their class
/// table.
///
/// # Errors
/// As [`Corrections::correct`]; [`crate::Error::Stopped`].
pub(super) fn apply(
    corrections: &Corrections,
    scene: &mut Scene,
    gaussians: &Gaussians,
    config: &Config,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<()> {
    scene.classes = corrections.classes().clone();
    let maps = corrections.maps(config.segmentation.min_coverage as f32);
    let splats = SplatTensors::new(gaussians, device);
    let settings = Settings::from(&config.raster);
    let count = scene.split(Split::Train).count();
    let mut viewing = Viewing::begin(progress, "corrections", count);
    let views = scene.views.iter_mut();
    for view in views.filter(|view| view.split == Split::Train) {
        corrections.correct(view, &maps, &splats, &settings)?;
        viewing.advance(1)?;
    }
    viewing.end();
    Ok(())
}

/// Stores `corrections` in the run folder `out`, in which stage two then begins anew. If `corrections` are empty, stored ones are
/// removed. Storing the same ones again changes nothing.
///
/// # Errors
/// [`crate::Error::Io`].
pub fn store_corrections(corrections: &Corrections, out: &Path) -> Result<()> {
    let files = RunFiles::new(out);
    let file = files.corrections();
    if Corrections::read(&file)?.as_ref() == Some(corrections) {
        return Ok(());
    }
    if corrections.count() == 0 {
        atomic::remove(&file)?;
    } else {
        corrections.write(&file)?;
    }
    files.forget_stage_two()
}

/// The corrections that the run folder `out` has.
///
/// # Errors
/// As [`Corrections::read`].
pub fn stored_corrections(out: &Path) -> Result<Option<Corrections>> {
    Corrections::read(&RunFiles::new(out).corrections())
}

//! Labels that a person corrected in a finished run: stage two takes them as true when it is trained again.

use super::reconstruct::RunFiles;
use crate::config::Config;
use crate::data::{Scene, Split};
use crate::error::{Result, ensure, invalid};
use crate::objects::Corrections;
use crate::progress::{Progress, Viewing};
use crate::raster::{Settings, SplatTensors};
use crate::splat::Gaussians;
use burn::tensor::Device;
use std::path::Path;

/// Puts `corrections` of `gaussians`, read from `file`, into the raw labels of the training views of `scene` and into its class table.
/// False where `progress` stopped it.
///
/// # Errors
/// [`crate::Error::Input`] for corrections of other Gaussians or classes, and for those of one class where nothing else is labelled;
/// as [`Corrections::correct`].
pub(super) fn apply(
    corrections: &Corrections,
    file: &Path,
    scene: &mut Scene,
    gaussians: &Gaussians,
    config: &Config,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<bool> {
    corrections.check(gaussians, file)?;
    let classes = corrections.classes();
    let missing = scene.classes.entries.iter();
    let mut missing = missing.filter(|class| classes.index(class.id).is_none());
    if let Some(class) = missing.next() {
        return Err(
            invalid!(file, "classes"; found "no class {} ({})", class.id, class.name;
            expected "all {} classes of the scene", scene.classes.len();
            help "resume with the data and settings of the run"),
        );
    }
    let used = corrections.used();
    ensure!(used.len() > 1 || scene.labelled().next().is_some(), file, "labels";
        found "one thing alone, {}", used.first().map_or("nothing", |class| class.name.as_str());
        expected "two or more, where photos have no labels";
        help "label something else too, such as what is around it: otherwise all becomes that thing");
    scene.classes = classes.clone();
    let maps = corrections.maps(config.segmentation.min_coverage as f32);
    let splats = SplatTensors::new(gaussians, device);
    let settings = Settings::from(&config.raster);
    let count = scene.split(Split::Train).count();
    let mut viewing = Viewing::begin(progress, "corrections", count);
    let views = scene.views.iter_mut();
    for view in views.filter(|view| view.split == Split::Train) {
        corrections.correct(view, &maps, &splats, &settings)?;
        if viewing.advance(1).is_break() {
            return Ok(false);
        }
    }
    viewing.end();
    Ok(true)
}

/// Stores `corrections` in the run folder `out`, in which stage two then begins anew.
///
/// # Errors
/// [`crate::Error::Io`].
pub fn store_corrections(corrections: &Corrections, out: &Path) -> Result<()> {
    let files = RunFiles::new(out);
    corrections.write(&files.corrections())?;
    files.forget_stage_two()
}

/// The corrections that the run folder `out` has.
///
/// # Errors
/// As [`Corrections::read`].
pub fn stored_corrections(out: &Path) -> Result<Option<Corrections>> {
    Corrections::read(&RunFiles::new(out).corrections())
}

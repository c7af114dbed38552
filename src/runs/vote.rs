//! Labels for Gaussians by a vote of the raw labels of a scene folder, without training.

use super::scene_path;
use crate::config::{Association, Config};
use crate::data::{self, LoadOptions, Scene};
use crate::error::{Result, ensure};
use crate::objects::{Identities, Votes};
use crate::pipeline::{SegmentationInputs, compare_with_photos, label_evidence};
use crate::splat::Gaussians;
use crate::splat::formats;
use crate::splat::ply::PlyScene;
use burn::tensor::Device;
use std::path::Path;

/// The scene folder `dir` and the Gaussians that `scene` names, see [`scene_path`]; both relative to the origin of the Gaussians.
/// Warns if they do not show the photos.
///
/// # Errors
/// As [`data::load`], [`scene_path`] and [`formats::read`].
pub fn load_both(
    dir: &Path,
    scene: &Path,
    config: &Config,
    device: &Device,
) -> Result<(Scene, PlyScene)> {
    let path = scene_path(scene)?;
    let scene = data::load(dir, &LoadOptions::from(config))?;
    let ply = formats::read(&path)?;
    let scene = scene.with_origin(ply.origin);
    compare_with_photos(&path, &ply.gaussians, &scene, config, device)?;
    Ok((scene, ply))
}

/// Refuses settings under which the labels of a scene are not the same classes in every view.
///
/// # Errors
/// [`crate::Error::Config`] for `data.association`.
pub fn check_vote(config: &Config) -> Result<()> {
    ensure!(config.data.association == Association::None,
        setting "data.association"; found "\"gaussians\"";
        expected "\"none\": the votes are for classes that are the same in every view";
        help "use `coseg associate`, which makes objects of segments and votes for these");
    Ok(())
}

/// The vote of the raw labels of the training views of `scene` for each of `gaussians`, `[N, classes]`; `pooled` over patches of
/// one surface, corrected for classes named too often.
///
/// # Errors
/// [`crate::Error::Input`] where no training view has raw labels; those of rendering.
pub fn vote(
    scene: &Scene,
    gaussians: &Gaussians,
    pooled: bool,
    config: &Config,
    device: &Device,
) -> Result<Identities> {
    let dir = config.data.dir.as_deref().unwrap_or(Path::new("built-in"));
    ensure!(scene.labelled().next().is_some(), dir, "raw_label_path"; found "nothing"; expected "raw labels of training views";
        help "add raw_label_path to the frames of a transforms.json, or name a folder with --set data.raw_labels=FOLDER");
    let inputs = SegmentationInputs::new(scene, gaussians, config, device);
    let quarters = label_evidence::quarters(&inputs)?;
    if !pooled {
        return Ok(Votes::of_all(quarters.each_ref()).identities());
    }
    Ok(label_evidence::pooled(&inputs, &quarters)?.identities)
}

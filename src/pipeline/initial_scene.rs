//! The initial scene of a run: Gaussians of another run or another trainer.

use super::pictures::Pictures;
use crate::config::Config;
use crate::data::{Scene, Split};
use crate::error::{Result, bail, ensure};
use crate::files::atomic;
use crate::splat::{self, Gaussians, formats};
use burn::tensor::Device;
use std::path::Path;

/// Training photos that the Gaussians are compared with.
const COMPARED_PHOTOS: usize = 8;
/// PSNR in dB below which Gaussians do not show the photos. Those of the built-in room have 31 in place. Moved by a tenth of its
/// size, turned by ten degrees, mirrored, halved in size or with other axes, they have 7 to 14.
const MIN_PSNR: f64 = 15.0;

/// The Gaussians of the file `path`, relative to the origin of `scene`. Warns where they do not show its photos. The run will
/// write `scene_file`.
///
/// # Errors
/// Those of [`formats::read`]; [`crate::Error::Input`] for a file without Gaussians; [`crate::Error::Argument`] for a scene without
/// training views; [`crate::Error::Config`] for a file that would be written over, and for more Gaussians than
/// `building.max_gaussians` has, where they are trained: trained ones cannot be thinned as points can.
pub(crate) fn load_initial_scene(
    path: &Path,
    scene: &Scene,
    config: &Config,
    scene_file: &Path,
    device: &Device,
) -> Result<Gaussians> {
    ensure!(!atomic::same_file(path, scene_file), setting "building.gaussians"; found "{}", path.display();
        expected "a file other than the run's own scene.ply, which is written over";
        help "let the run write into another folder");
    scene.expect_training_views()?;
    let ply = formats::read(path)?;
    let mut gaussians = ply.gaussians;
    ensure!(!gaussians.is_empty(), path, "element vertex"; found "no Gaussian"; expected "one or more";
        help "name a scene that is not empty");
    if config.building.iterations > 0
        && let Some(most) = config.building.max_gaussians.limit()
        && gaussians.len() > most
    {
        bail!(setting "building.max_gaussians"; found "{most}";
            expected "{} or more, as building.gaussians has, or \"unlimited\"", gaussians.len();
            help "raise it");
    }
    splat::shift(&mut gaussians.means, ply.origin - scene.origin);
    compare_with_photos(path, &gaussians, scene, config, device)?;
    Ok(gaussians)
}

/// Warns where the Gaussians of `path`, relative to the origin of `scene`, do not show its training photos.
///
/// # Errors
/// As [`super::score_images`].
pub fn compare_with_photos(
    path: &Path,
    gaussians: &Gaussians,
    scene: &Scene,
    config: &Config,
    device: &Device,
) -> Result<()> {
    let views: Vec<_> = scene.split(Split::Train).collect();
    let every = views.len().div_ceil(COMPARED_PHOTOS).max(1);
    let scores =
        Pictures::new(gaussians, config, device)?.score(views.into_iter().step_by(every))?;
    if let Some(psnr) = scores.psnr.filter(|psnr| *psnr < MIN_PSNR) {
        tracing::warn!(
            "the Gaussians of {} show the training photos at {psnr:.1} dB: they look misplaced. They have to show this scene, \
             in the units and axes of its cameras. nerfstudio changes these: the setting data.dataparser_transforms names the \
             dataparser_transforms.json of its run",
            path.display()
        );
    }
    Ok(())
}

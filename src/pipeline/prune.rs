//! Pruning of a finished scene by what its Gaussians add to the training photos.

use crate::config::Config;
use crate::data::{Scene, Split, View};
use crate::error::Result;
use crate::random::{Purpose, stream};
pub use crate::reconstruction::pruning::Pruning;
use crate::reconstruction::pruning::{PrunedScene, evenly};
use crate::splat::Gaussians;
use burn::tensor::Device;

/// Training views that judge the result, at most. The Gaussians are measured in all of them.
const JUDGES: usize = 16;

/// How many Gaussians stay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Keep {
    /// This share of them, above 0, at most 1.
    Share(f64),
    /// As few as lower the mean PSNR of training views by no more than this, dB, to a 256th.
    Within(f64),
}

/// Leaves out the Gaussians of least effect on the pictures of the training views of `scene`, which has the origin of `gaussians`.
///
/// # Errors
/// [`crate::Error::Argument`] for a scene without training views; those of [`crate::data::Photo::pixels`]; and
/// [`crate::Error::Device`] when the device does not return the pictures.
pub fn prune(
    gaussians: &Gaussians,
    scene: &Scene,
    keep: Keep,
    config: &Config,
    device: &Device,
) -> Result<Pruning> {
    scene.expect_training_views()?;
    let views: Vec<&View> = scene.split(Split::Train).collect();
    let pruned = PrunedScene::new(gaussians, &config.raster, device);
    let mut rng = stream(config.seed, Purpose::Pruning, 0);
    let judges = evenly(&views, JUDGES);
    let costs = pruned.costs(&views, &mut rng)?;
    match keep {
        Keep::Share(share) => {
            let count = (share * costs.len() as f64).round().max(1.0) as usize;
            pruned.keep(&costs, &judges, count)
        }
        Keep::Within(loss) => pruned.prune(&costs, &judges, loss),
    }
}

//! Pruning of a finished scene by what its Gaussians add to the training photos.

use crate::config::Config;
use crate::data::{Scene, Split, View};
use crate::error::Result;
use crate::random::{Purpose, stream};
use crate::reconstruction::pruning::{PrunedScene, ascending, cheapest_first};
use crate::splat::Gaussians;
use burn::tensor::Device;

/// Number of training views whose PSNR judges the result, at most. Gaussians are measured in all training views.
const JUDGES: usize = 16;
/// A round leaves out at most one in this many Gaussians. Then all are measured again: each of two similar Gaussians adds little
/// until the other is gone.
const ROUND: usize = 10;
/// A round that leaves out fewer than one in this many Gaussians is the last.
const LAST_ROUND: usize = 100;

/// How many Gaussians stay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Keep {
    /// This share of them, above 0, at most 1.
    Share(f64),
    /// The fewest, within about a hundredth, that lower the mean PSNR of training views by no more than this, dB.
    Within(f64),
}

/// The Gaussians that stay.
#[derive(Clone, Debug, PartialEq)]
pub struct Pruning {
    /// Rows that stay, in their order.
    pub kept: Vec<u32>,
    /// Mean PSNR of some training views with all Gaussians, dB.
    pub before: f64,
    /// The same with those that stay.
    pub after: f64,
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
    let every = views.len().div_ceil(JUDGES);
    let judges: Vec<&View> = views.iter().copied().step_by(every).collect();
    let mut rng = stream(config.seed, Purpose::Pruning, 0);
    let mut rows: Vec<u32> = (0..gaussians.len() as u32).collect();
    let before = PrunedScene::new(gaussians, &config.raster, device).psnr(&judges, &[])?;
    loop {
        let left = PrunedScene::new(&gaussians.select(&rows), &config.raster, device);
        let most = rows.len().div_ceil(ROUND);
        let kept = match keep {
            Keep::Share(share) => {
                let target = (share * gaussians.len() as f64).round().max(1.0) as usize;
                let surplus = rows.len().saturating_sub(target).min(most);
                if surplus == 0 {
                    break;
                }
                ascending(&cheapest_first(&left.costs(&views, &mut rng)?)[surplus..])
            }
            Keep::Within(loss) => {
                let costs = left.costs(&views, &mut rng)?;
                left.prune(&costs, &judges, before - loss, most)?
            }
        };
        let left_out = rows.len() - kept.len();
        let is_last = matches!(keep, Keep::Within(_)) && left_out * LAST_ROUND < rows.len();
        rows = kept.into_iter().map(|i| rows[i as usize]).collect();
        if is_last {
            break;
        }
    }
    let left = PrunedScene::new(&gaussians.select(&rows), &config.raster, device);
    Ok(Pruning {
        after: left.psnr(&judges, &[])?,
        before,
        kept: rows,
    })
}

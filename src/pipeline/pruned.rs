//! Attendance pruning between the stages (Algorithm 1, line 8), whichever rows follow.

use super::pictures::score_images;
use super::run::Outcome;
use super::segmentation_inputs::Seen;
use crate::config::{Config, Resolution};
use crate::data::{Scene, Split};
use crate::error::Result;
use crate::metrics::ImageScores;
use crate::progress::{Event, Progress};
use crate::raster::Settings;
use crate::segmentation::unprojection::attended;
use crate::splat::Gaussians;
use burn::tensor::Device;
use std::time::Instant;

/// Attendance pruning that removes more than this share is warned of; trained scenes lose a thousandth.
const MANY_PRUNED: f64 = 0.05;

/// What attendance pruning (Algorithm 1, line 8) removed and what it cost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pruned {
    /// Gaussians before.
    pub before: usize,
    /// Gaussians after.
    pub after: usize,
    /// Mean held-out scores before.
    pub scores_before: ImageScores,
    /// Mean held-out scores after.
    pub scores_after: ImageScores,
}

/// The Gaussians that were seen often enough. The same ones whichever rows a run trains: a row goes on only over the Gaussians
/// that it began with, and rows are compared over the same ones.
pub(crate) enum Attendance {
    /// With image features lifted onto them.
    Lifted(Seen),
    /// Counted only: rows of the Gaussians that are kept, ascending, and the seconds that it took.
    Counted(Vec<u32>, f64),
}

impl Attendance {
    /// Of `gaussians` in the training views of `scene`. Features are extracted only where something reads them. None where
    /// `progress` said stop before they were.
    ///
    /// # Errors
    /// Those of [`Seen::new`] and of [`attended`].
    pub fn of(
        scene: &Scene,
        gaussians: &Gaussians,
        config: &Config,
        settings: &Settings,
        device: &Device,
        progress: &mut dyn Progress,
    ) -> Result<Option<Self>> {
        if reads_features(config) {
            return Ok(
                Seen::new(scene, gaussians, config, settings, device, progress)?.map(Self::Lifted),
            );
        }
        let clock = Instant::now();
        progress.event(&Event::Started {
            stage: "attendance",
            done: 0,
            iterations: 1,
        });
        let keep = attended(
            gaussians,
            scene.split(Split::Train),
            &config.unprojection,
            settings,
            device,
        )?;
        progress.event(&Event::Finished);
        let kept = (0..)
            .zip(keep)
            .filter_map(|(row, keep)| keep.then_some(row))
            .collect();
        Ok(Some(Self::Counted(kept, clock.elapsed().as_secs_f64())))
    }

    /// Leaves in `outcome` what is kept, and notes what that cost. Returns the features, where there are any.
    ///
    /// # Errors
    /// Those of [`score_images`].
    pub fn apply(self, outcome: &mut Outcome, device: &Device) -> Result<Option<Seen>> {
        let kept = match &self {
            Self::Lifted(seen) => &seen.kept,
            Self::Counted(kept, _) => kept,
        };
        let (before, scores_before) = (outcome.gaussians.len(), outcome.test);
        let removed = before - kept.len();
        if removed > 0 {
            outcome.gaussians = outcome.gaussians.select(kept);
            outcome.test =
                score_images(&outcome.gaussians, &outcome.scene, &outcome.config, device)?;
        }
        if removed as f64 > MANY_PRUNED * before as f64 {
            tracing::warn!(
                "attendance pruning removed {removed} of {before} Gaussians, because few pixels see them; a smaller \
                 unprojection.attendance than {} keeps more",
                outcome.config.unprojection.attendance
            );
        }
        let (after, scores_after) = (outcome.gaussians.len(), outcome.test);
        outcome.pruned = Some(Pruned {
            before,
            after,
            scores_before,
            scores_after,
        });
        Ok(match self {
            Self::Lifted(seen) => {
                [outcome.seconds.features, outcome.seconds.unprojection] = seen.seconds;
                outcome.features = seen.name.clone();
                Some(seen)
            }
            Self::Counted(_, seconds) => {
                outcome.seconds.unprojection = seconds;
                None
            }
        })
    }
}

/// Whether image features are read: by the decoder, and where pruning counts the cells of
/// their maps.
fn reads_features(config: &Config) -> bool {
    let cells = config.unprojection.resolution == Resolution::Feature
        && config.unprojection.attendance > 0.0;
    let decoded = config
        .segmentation
        .rows()
        .iter()
        .any(|row| row.trains_decoder());
    decoded || cells
}

//! Lifting of a run: attendance pruning (Algorithm 1, line 12), and image features onto the Gaussians that remain (Eq. 5).

use super::pictures::score_images;
use crate::config::Config;
use crate::data::{Scene, Split};
use crate::error::Result;
use crate::features::{FeatureColors, FeatureReduction};
use crate::metrics::ImageScores;
use crate::progress::{Progress, Viewing, go_on};
use crate::ranks;
use crate::raster::Settings;
use crate::segmentation::unprojection::{attended, unproject};
use crate::splat::{Gaussians, rows_where};
use burn::tensor::Device;
use std::time::Instant;

/// A larger share of pruned Gaussians gives a warning; trained scenes lose a thousandth.
const MAX_PRUNED_SHARE: f64 = 0.05;

/// Image features lifted onto Gaussians.
pub struct LiftedFeatures {
    /// Features of the Gaussians per scale, `[N, D]`.
    pub lifted: Vec<Vec<f32>>,
    /// D.
    pub dimensions: usize,
    /// Where the features came from.
    pub name: String,
    /// What the features depend on besides photos and Gaussians, see [`FeatureReduction::content`].
    pub content: String,
    /// Seconds of extraction, and of reduction and unprojection.
    pub seconds: [f64; 2],
}

impl LiftedFeatures {
    /// Extracts and unprojects features of the training views, a few views at a time.
    ///
    /// # Errors
    /// Those of the extractor and of the unprojection; [`crate::Error::Stopped`].
    pub fn of_views(
        scene: &Scene,
        gaussians: &Gaussians,
        config: &Config,
        device: &Device,
        progress: &mut dyn Progress,
    ) -> Result<Self> {
        let clock = Instant::now();
        let views = ranks::share(scene.split(Split::Train)).count();
        let mut viewing = Viewing::begin(progress, "features", views);
        let features = &config.features;
        let seed = config.seed;
        let advance = &mut || viewing.advance(1);
        let mut reduction = FeatureReduction::fit(scene, features, seed, device, advance)?;
        viewing.end();
        go_on(progress)?;
        let extraction = clock.elapsed().as_secs_f64();
        let clock = Instant::now();
        let name = reduction.name.clone();
        let content = reduction.content.clone();
        let mut viewing = Viewing::begin(progress, "unprojection", views);
        let lifted = unproject(
            gaussians,
            ranks::share(scene.split(Split::Train)),
            reduction.training_views(),
            config.unprojection.normalisation,
            &Settings::from(&config.raster),
            device,
            &mut || viewing.advance(1),
        )?;
        viewing.end();
        Ok(Self {
            lifted,
            dimensions: features.dimensions,
            name,
            content,
            seconds: [extraction, clock.elapsed().as_secs_f64()],
        })
    }

    /// Colours of the Gaussians by their features.
    ///
    /// # Errors
    /// As [`FeatureColors::of`].
    pub(super) fn colors(&self) -> Result<FeatureColors> {
        FeatureColors::of(&self.lifted, self.dimensions)
    }

    /// Features of the Gaussians `rows` at `scale`, counted from 0: `[rows, D]`.
    pub(super) fn rows(&self, scale: usize, rows: &[u32]) -> Vec<f32> {
        let width = self.dimensions;
        let mut values = Vec::with_capacity(rows.len() * width);
        for &row in rows {
            values.extend_from_slice(&self.lifted[scale][row as usize * width..][..width]);
        }
        values
    }
}

/// What attendance pruning (Algorithm 1, line 12) removed and what it cost.
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

/// Gaussians after attendance pruning, with their features.
pub(crate) struct Lifted {
    /// The Gaussians that enough pixels show.
    pub gaussians: Gaussians,
    /// Their features; absent where no variant reads them.
    pub features: Option<LiftedFeatures>,
    /// What pruning removed.
    pub pruned: Pruned,
    /// Seconds of extraction and of unprojection.
    pub seconds: [f64; 2],
}

/// Prunes those of `gaussians` that too few pixels show, and lifts image features of the training views onto the others, where a variant
/// reads them. Pruning is the same whichever variants follow, so that they compare over the same Gaussians. `test` are the held-out
/// scores of `gaussians`.
///
/// # Errors
/// Those of [`LiftedFeatures::of_views`], of [`attended`] and of [`score_images`]; [`crate::Error::Stopped`].
pub(crate) fn lift(
    gaussians: &Gaussians,
    scene: &Scene,
    test: ImageScores,
    config: &Config,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<Lifted> {
    let clock = Instant::now();
    let kept = kept(scene, gaussians, config, device, progress)?;
    let mut seconds = [0.0, clock.elapsed().as_secs_f64()];
    go_on(progress)?;
    let (before, after) = (gaussians.len(), kept.len());
    let removed = before - after;
    let (gaussians, scores_after) = if removed > 0 {
        let gaussians = gaussians.select(&kept);
        let scores = score_images(&gaussians, scene, config, device)?;
        (gaussians, scores)
    } else {
        (gaussians.clone(), test)
    };
    if removed as f64 > MAX_PRUNED_SHARE * before as f64 {
        tracing::warn!(
            "attendance pruning removed {removed} of {before} Gaussians, because few pixels see them; a smaller \
             unprojection.attendance than {} keeps more",
            config.unprojection.attendance
        );
    }
    let features = if reads_features(config) {
        let features = LiftedFeatures::of_views(scene, &gaussians, config, device, progress)?;
        let [extraction, unprojection] = features.seconds;
        seconds = [extraction, seconds[1] + unprojection];
        Some(features)
    } else {
        None
    };
    go_on(progress)?;
    Ok(Lifted {
        gaussians,
        features,
        pruned: Pruned {
            before,
            after,
            scores_before: test,
            scores_after,
        },
        seconds,
    })
}

/// Indices of the Gaussians that enough pixels show, ascending.
fn kept(
    scene: &Scene,
    gaussians: &Gaussians,
    config: &Config,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<Vec<u32>> {
    if config.unprojection.attendance == 0.0 {
        return Ok((0..gaussians.len() as u32).collect());
    }
    let settings = &Settings::from(&config.raster);
    let views = || ranks::share(scene.split(Split::Train));
    let mut viewing = Viewing::begin(progress, "attendance", views().count());
    let keep = attended(
        gaussians,
        views(),
        &config.unprojection,
        settings,
        device,
        &mut || viewing.advance(1),
    )?;
    viewing.end();
    Ok(rows_where(keep, |keep| keep))
}

/// Whether any variant reads image features.
pub(super) fn reads_features(config: &Config) -> bool {
    let mut variants = config.segmentation.rows().iter();
    variants.any(|variant| variant.reads_image_features())
}

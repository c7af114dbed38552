//! Lifting of a run: image features onto Gaussians (Eq. 5), and attendance pruning (Algorithm 1, line 12).

use super::pictures::score_images;
use crate::config::{Config, Resolution};
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

/// Image features lifted onto the Gaussians that enough pixels show.
pub struct LiftedFeatures {
    /// Indices of the Gaussians that attendance pruning keeps, ascending.
    pub kept: Vec<u32>,
    /// Lifted features of the kept Gaussians per scale, `[N, D]`.
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
            &config.unprojection,
            &Settings::from(&config.raster),
            device,
            &mut || viewing.advance(1),
        )?;
        viewing.end();
        let kept = rows_where(&lifted.keep, |keep| *keep);
        let dimensions = features.dimensions;
        let mut scales = lifted.sums.buffers;
        scales
            .iter_mut()
            .for_each(|rows| keep_rows(rows, &kept, dimensions));
        Ok(Self {
            lifted: scales,
            kept,
            dimensions,
            name,
            content,
            seconds: [extraction, clock.elapsed().as_secs_f64()],
        })
    }

    /// Features at `scale`, counted from 0, of all `gaussians` that were lifted onto, `[gaussians, D]`; zeros where they are not kept.
    pub fn of_all(&self, scale: usize, gaussians: usize) -> Vec<f32> {
        let width = self.dimensions;
        let mut all = vec![0.0; gaussians * width];
        let kept = self.lifted[scale].chunks_exact(width);
        for (&row, values) in self.kept.iter().zip(kept) {
            all[row as usize * width..][..width].copy_from_slice(values);
        }
        all
    }

    /// Colours of the kept Gaussians by their features.
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

/// Keeps the rows `kept` (ascending) of `values`, `[N, width]`, in place: the features of a large scene take a gigabyte.
fn keep_rows(values: &mut Vec<f32>, kept: &[u32], width: usize) {
    for (to, &from) in kept.iter().enumerate() {
        let from = from as usize * width;
        values.copy_within(from..from + width, to * width);
    }
    values.truncate(kept.len() * width);
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

/// Lifts image features of the training views onto `gaussians`, and prunes those that too few pixels show. Pruning is the same
/// whichever variants follow, so that they compare over the same Gaussians. Features are extracted only where they are read.
/// `test` are the held-out scores of `gaussians`.
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
    let (features, counted, seconds) = if reads_features(config) {
        let features = LiftedFeatures::of_views(scene, gaussians, config, device, progress)?;
        let seconds = features.seconds;
        (Some(features), Vec::new(), seconds)
    } else {
        let clock = Instant::now();
        let counted = count(scene, gaussians, config, device, progress)?;
        (None, counted, [0.0, clock.elapsed().as_secs_f64()])
    };
    go_on(progress)?;
    let kept = features.as_ref().map_or(&counted, |lifted| &lifted.kept);
    let (before, after) = (gaussians.len(), kept.len());
    let removed = before - after;
    let (gaussians, scores_after) = if removed > 0 {
        let gaussians = gaussians.select(kept);
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

/// Indices of the Gaussians that enough pixels show, counted without features.
fn count(
    scene: &Scene,
    gaussians: &Gaussians,
    config: &Config,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<Vec<u32>> {
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

/// Whether image features are read: by the decoder, and where pruning counts the cells of their maps.
pub(super) fn reads_features(config: &Config) -> bool {
    let cells = config.unprojection.resolution == Resolution::Feature
        && config.unprojection.attendance > 0.0;
    let mut variants = config.segmentation.rows().iter();
    cells || variants.any(|variant| variant.reads_image_features())
}

#[cfg(test)]
mod tests {
    use super::{LiftedFeatures, keep_rows};

    #[test]
    fn rows_that_were_not_kept_are_zero() {
        let mut lifted = LiftedFeatures {
            kept: vec![1, 3],
            lifted: vec![Vec::new(); 4],
            dimensions: 2,
            name: String::new(),
            content: String::new(),
            seconds: [0.0; 2],
        };
        lifted.lifted[2] = vec![1.0, 2.0, 3.0, 4.0];
        let all = lifted.of_all(2, 5);
        assert_eq!(all, [0.0, 0.0, 1.0, 2.0, 0.0, 0.0, 3.0, 4.0, 0.0, 0.0]);
    }

    #[test]
    fn kept_rows_stay_in_order() {
        let all: Vec<f32> = (0..12).map(|v| v as f32).collect();
        for (kept, want) in [
            (vec![0, 1, 2, 3], all.clone()),
            (vec![1, 3], vec![3.0, 4.0, 5.0, 9.0, 10.0, 11.0]),
            (vec![], vec![]),
        ] {
            let mut rows = all.clone();
            keep_rows(&mut rows, &kept, 3);
            assert_eq!(rows, want, "{kept:?}");
        }
    }
}

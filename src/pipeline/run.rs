//! The main job: a scene in, a segmented Gaussian scene out, with everything that a report needs.

use super::associate::{Associated, AssociationCounts, associate};
use super::corrections;
use super::lift::{Pruned, lift};
use super::load::load_scene;
use super::pictures::score_images;
use super::reconstruct::{Reconstruction, RunFiles, reconstruct};
use super::requirements::{
    check_networks, check_ranks, check_scores, has_raw_labels, has_segments, least_count,
    score_tables, warn_of_no_labels,
};
use super::resolve::resolved;
use super::segmentation_inputs::SegmentationInputs;
use super::variant_outcome::VariantOutcome;
use super::variants::train_variants;
use crate::config::{Association, Config, Variant};
use crate::data::{Classes, Scene};
use crate::error::Result;
use crate::features::FeatureColors;
use crate::memory;
use crate::metrics::ImageScores;
use crate::objects::{Corrections, Identities, Semantics, color_all_apart};
use crate::progress::{CurvePoint, Progress, Review, go_on};
use crate::ranks::{self, Traffic};
use crate::splat::Gaussians;
use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::Instant;

/// A stage one of this many steps should have learned the photos.
const LONG: usize = 1_000;
/// Held-out photos with less, in dB, are hardly recognisable.
const FAILED_PSNR: f64 = 10.0;

/// Seconds spent in each part of the job; evaluations count in their stage. Training in earlier parts of a resumed run counts.
/// Steps that it repeats (loading, association, features, unprojection) count once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    /// Stage one.
    pub building: f64,
    /// 2D feature extraction.
    pub features: f64,
    /// Attendance of the Gaussians; reducing features and lifting them.
    pub unprojection: f64,
    /// Stage two, the point encoder included.
    pub segmentation: f64,
    /// Everything from loading to the last score.
    pub total: f64,
}

/// The results of a run.
#[derive(Default)]
pub struct Outcome {
    /// The scene as loaded; after association its classes and raw labels are objects.
    pub scene: Scene,
    /// The trained Gaussians in spatial order, after attendance pruning.
    pub gaussians: Gaussians,
    /// Curve of stage one.
    pub building: Vec<CurvePoint>,
    /// Reviews of the number of Gaussians in stage one.
    pub reviews: Vec<Review>,
    /// Mean held-out scores of the final Gaussians.
    pub test: ImageScores,
    /// Attendance pruning, where stage two was reached.
    pub pruned: Option<Pruned>,
    /// Association, where settings ask for it and training views have raw labels.
    pub association: Option<AssociationCounts>,
    /// What the classes of objects are scored against, where association found objects with classes.
    pub semantics: Option<Semantics>,
    /// Labels that a person corrected, where the run folder has some.
    pub corrections: Option<Corrections>,
    /// Variants of the label table, in the order of the settings; empty without labels.
    pub rows: Vec<VariantOutcome>,
    /// Where the 2D features came from; empty when none were needed.
    pub features: String,
    /// Colours of the Gaussians by lifted image features; absent where nothing read them.
    pub feature_colors: Option<FeatureColors>,
    /// Where the point encoder came from; empty when none was needed.
    pub spatial: String,
    /// Where the time went.
    pub seconds: Seconds,
    /// What several ranks put into sums and gathered values.
    pub traffic: Option<Traffic>,
    /// The settings as they ran, with the chosen variants where none were named.
    pub config: Config,
}

impl Outcome {
    /// After stage one.
    fn new(scene: Scene, config: &Config, reconstruction: Reconstruction) -> Self {
        Self {
            scene,
            gaussians: reconstruction.gaussians,
            building: reconstruction.curve,
            reviews: reconstruction.reviews,
            seconds: Seconds {
                building: reconstruction.seconds,
                total: reconstruction.earlier,
                ..Seconds::default()
            },
            config: config.clone(),
            ..Self::default()
        }
    }

    /// The variant whose identities the scene stores: `ours` where it was trained, else the last with identities.
    pub fn stored(&self) -> Option<(&VariantOutcome, &Identities)> {
        let rows = || self.rows.iter().filter(|row| row.identities.is_some());
        let ours = rows().find(|row| row.variant == Variant::Ours);
        let row = ours.or_else(|| rows().next_back())?;
        Some((row, row.identities.as_ref()?))
    }

    /// Size of the learned parts in bytes: (name, bytes).
    pub fn learnable_bytes(&self) -> Vec<(String, u64)> {
        let g = &self.gaussians;
        let floats = g.len() * (3 + 3 + 4 + 1 + 3 * g.sh_len());
        let mut parts = vec![("gaussians".to_owned(), 4 * floats as u64)];
        for row in &self.rows {
            if row.learnable_bytes > 0 {
                parts.push((row.name().to_owned(), row.learnable_bytes as u64));
            }
        }
        parts
    }
}

/// Runs the pipeline on the scene that `config` names: reconstruct, associate, lift, and for each variant encode, decode and score.
/// Checkpoints lie in `out/checkpoint`; a run that finds its own there resumes.
///
/// # Errors
/// Those of loading, of both stages, and of writing; [`crate::Error::Stopped`]. Files written before stay.
pub fn run(
    config: &Config,
    out: &Path,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<Outcome> {
    let start = Instant::now();
    let scene = load_scene(config)?;
    let loading = start.elapsed().as_secs_f64();
    let scores_fields = false;
    let mut outcome = run_on(scene, config, scores_fields, out, device, progress)?;
    outcome.seconds.total += loading;
    Ok(outcome)
}

/// As [`run`], on a scene that was loaded before. `scores_fields`: also scores image features rendered from the Gaussians on
/// held-out views, see [`FieldScores`](super::FieldScores).
///
/// # Errors
/// Those of both stages, and of writing; [`crate::Error::Stopped`]. Files written before stay.
pub fn run_on(
    mut scene: Scene,
    config: &Config,
    scores_fields: bool,
    out: &Path,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<Outcome> {
    let start = Instant::now();
    let files = RunFiles::new(out);
    let corrections = Corrections::read(&files.corrections())?;
    ranks::expect_same("the corrections", corrections.is_some().to_string())?;
    let config = &resolved(config, &scene, corrections.is_some());
    if config.data.association == Association::None {
        scene.drop_unused_classes(&Classes::default());
    }
    if !config.segmentation.rows().is_empty() {
        if has_raw_labels(&scene) || has_segments(&scene, config) || corrections.is_some() {
            check_networks(config, &scene, device)?;
        } else {
            warn_of_no_labels(&scene);
        }
    }
    check_scores(least_count(&scene, config), &scene, config)?;
    check_ranks(&scene, config)?;
    progress.scene(&scene);
    let reconstruction = reconstruct(&scene, config, &files, device, progress)?;
    let building_bytes = ranks::sent();
    let building_step_bytes = building_bytes.checked_div(reconstruction.steps as u64);
    let mut outcome = Outcome::new(scene, config, reconstruction);
    outcome.corrections = corrections;
    outcome.test = score_images(&outcome.gaussians, &outcome.scene, config, device)?;
    outcome.warn_of_failure();
    outcome.associate(progress)?;
    outcome.segment(scores_fields, &files, device, progress)?;
    outcome.traffic = (ranks::count() > 1).then(|| Traffic {
        ranks: ranks::count(),
        building_bytes,
        building_step_bytes: building_step_bytes.unwrap_or(0),
        segmentation_bytes: ranks::sent() - building_bytes,
    });
    outcome.seconds.total += start.elapsed().as_secs_f64();
    Ok(outcome)
}

impl Outcome {
    /// Warns if a long stage one did not learn the photos.
    fn warn_of_failure(&self) {
        let is_long = self.config.building.iterations >= LONG;
        if let Some(psnr) = self.test.psnr.filter(|psnr| is_long && *psnr < FAILED_PSNR) {
            tracing::warn!(
                "held-out photos have only {psnr:.1} dB after stage one: the poses may be wrong, or in other units or axes than the initial \
                 points. Try `coseg data check`"
            );
        }
    }

    /// Makes segments of single views objects, where settings ask for it.
    fn associate(&mut self, progress: &mut dyn Progress) -> Result<()> {
        if !has_segments(&self.scene, &self.config) {
            return Ok(());
        }
        go_on(progress)?;
        let Associated { counts, semantics } =
            associate(&self.gaussians, &mut self.scene, &self.config, progress)?;
        self.association = Some(counts);
        self.semantics = semantics;
        progress.scene(&self.scene);
        Ok(())
    }

    /// Puts the corrections of the run folder into the scene.
    fn correct(
        &mut self,
        files: &RunFiles,
        device: &Device,
        progress: &mut dyn Progress,
    ) -> Result<()> {
        let Some(corrections) = &self.corrections else {
            return Ok(());
        };
        let scene = &mut self.scene;
        let gaussians = &self.gaussians;
        corrections.check(gaussians, &scene.classes, &files.corrections())?;
        let config = &self.config;
        corrections::apply(corrections, scene, gaussians, config, device, progress)?;
        progress.scene(&self.scene);
        Ok(())
    }

    /// Stage two: lifts features, trains the variants and scores them.
    fn segment(
        &mut self,
        scores_fields: bool,
        files: &RunFiles,
        device: &Device,
        progress: &mut dyn Progress,
    ) -> Result<()> {
        let config = &self.config;
        let is_labelled = has_raw_labels(&self.scene) || self.corrections.is_some();
        if !is_labelled || config.segmentation.rows().is_empty() {
            return Ok(());
        }
        go_on(progress)?;
        let classes = self.corrections.as_ref().map(Corrections::classes);
        let classes = classes.unwrap_or(&self.scene.classes).len();
        memory::check_scores(self.gaussians.len(), classes, score_tables(config))?;
        let scene = &self.scene;
        let lifted = lift(&self.gaussians, scene, self.test, config, device, progress)?;
        self.gaussians = lifted.gaussians;
        progress.gaussians(&self.gaussians, None);
        self.test = lifted.pruned.scores_after;
        self.pruned = Some(lifted.pruned);
        [self.seconds.features, self.seconds.unprojection] = lifted.seconds;
        if let Some(features) = &lifted.features {
            self.features.clone_from(&features.name);
        }
        self.correct(files, device, progress)?;
        let config = &self.config;
        let clock = Instant::now();
        let inputs = SegmentationInputs {
            lifted: lifted.features,
            semantics: self.semantics.as_ref(),
            corrections: self.corrections.as_ref(),
            scores_fields,
            ..SegmentationInputs::new(&self.scene, &self.gaussians, config, device)
        };
        let trained = train_variants(&inputs, &files.checkpoints, progress)?;
        if let Some(lifted) = &inputs.lifted {
            self.feature_colors = Some(lifted.colors()?);
        }
        self.rows = trained.rows;
        self.spatial = trained.spatial;
        let earlier: f64 = self.rows.iter().map(|row| row.earlier_seconds).sum();
        self.seconds.segmentation = clock.elapsed().as_secs_f64() + earlier;
        self.seconds.total += earlier;
        self.color_objects()?;
        progress.scene(&self.scene);
        Ok(())
    }

    /// Gives objects that lie side by side colours that differ. With corrections, the colours that a person chose stay.
    fn color_objects(&mut self) -> Result<()> {
        if self.association.is_none() || self.corrections.is_some() {
            return Ok(());
        }
        let ids = self
            .stored()
            .map(|(_, identities)| identities.ids(&self.scene.classes));
        if let Some(ids) = ids {
            color_all_apart(&self.gaussians, &ids, &mut self.scene.classes)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::evaluate::HeldOutScores;
    use super::*;

    #[test]
    fn objects_side_by_side_get_colours_that_differ() {
        let classes = Classes::from_names(0, [(1, "object 1"), (256, "object 256")]);
        assert_eq!(classes.color(1), classes.color(256), "the palette repeats");
        let gaussians = Gaussians {
            means: (0..18).map(|i| [i as f32, 0.0, 0.0]).collect(),
            ..Gaussians::default()
        };
        let scores = (0..18).flat_map(|i| if i < 9 { [1.0, 0.0] } else { [0.0, 1.0] });
        let identities = Identities {
            scores: scores.collect(),
            classes: 2,
        };
        let row = VariantOutcome {
            identities: Some(identities),
            ..VariantOutcome::new(Variant::Vote, HeldOutScores::default())
        };
        let mut outcome = Outcome {
            corrections: Some(Corrections::none(&gaussians, &classes)),
            association: Some(AssociationCounts::default()),
            rows: vec![row],
            gaussians,
            ..Outcome::default()
        };
        outcome.scene.classes = classes.clone();
        outcome.color_objects().unwrap();
        assert_eq!(
            outcome.scene.classes, classes,
            "a person may have chosen them"
        );
        outcome.corrections = None;
        outcome.color_objects().unwrap();
        let [one, other] = [1, 256].map(|id| outcome.scene.classes.color(id));
        assert_eq!(one, classes.color(1));
        assert_ne!(one, other);
    }
}

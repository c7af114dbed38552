//! The main job: a scene in, a segmented Gaussian scene out, with everything that a report needs.

use super::associate::{Associated, AssociationCounts, associate};
use super::corrections;
use super::encode::Inputs;
use super::evaluate::score_images;
use super::lift::{Pruned, lift};
use super::reconstruct::{Reconstruction, RunFiles, reconstruct};
use super::requirements::{
    check_networks, check_scores, has_raw_labels, least_count, score_tables,
};
use super::resolve::resolved;
use super::variant_outcome::VariantOutcome;
use super::variants::train_variants;
use crate::config::{Association, Config, Variant};
use crate::data::{self, LoadOptions, Scene, builtin};
use crate::error::Result;
use crate::features::FeatureColors;
use crate::memory;
use crate::metrics::ImageScores;
use crate::objects::{Corrections, Identities, Semantics};
use crate::progress::{CurvePoint, Progress, Review};
use crate::splat::Gaussians;
use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::Instant;

/// Seconds spent in each part of the job; evaluations count in their stage. Training in earlier parts of a resumed run counts.
/// Steps that it repeats (loading, association, features, unprojection) count once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    /// Stage one.
    pub building: f64,
    /// 2D feature extraction.
    pub features: f64,
    /// Reducing features and lifting them onto Gaussians.
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
    /// The settings as they ran, with the chosen variants where none were named.
    pub config: Config,
    /// Whether `progress` stopped the run. Later results are empty then, the variant in training has no identities, and
    /// half-built Gaussians have no scores. [`run`] resumes it.
    pub stopped: bool,
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
        let with = |row: &VariantOutcome| row.identities.is_some();
        let row = self
            .rows
            .iter()
            .find(|r| r.variant == Variant::Ours && with(r));
        let row = row.or_else(|| self.rows.iter().rfind(|r| with(r)))?;
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

/// The scene that `config.data` names: a folder, or the built-in scene.
///
/// # Errors
/// Those of the loader, each naming file and field.
pub fn load_scene(config: &Config) -> Result<Scene> {
    load(config, &LoadOptions::from(config))
}

fn load(config: &Config, options: &LoadOptions) -> Result<Scene> {
    match &config.data.dir {
        None => Ok(builtin::scene(builtin::EVALUATED_SEED)),
        Some(dir) => data::load(dir, options),
    }
}

/// Runs the pipeline on the scene that `config` names, until `progress` stops it: reconstruct, associate, lift, and for each
/// variant encode, decode and score. Checkpoints lie in `out/checkpoint`; a run that finds its own there resumes.
///
/// # Errors
/// Those of loading, of both stages, and of writing. Files written before stay.
pub fn run(
    config: &Config,
    out: &Path,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<Outcome> {
    let start = Instant::now();
    let scene = load(config, &LoadOptions::from(config))?;
    let loading = start.elapsed().as_secs_f64();
    let mut outcome = run_on(scene, config, Scored::Labels, out, device, progress)?;
    outcome.seconds.total += loading;
    Ok(outcome)
}

/// What is scored on held-out views, besides photos.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scored {
    /// Label maps.
    Labels,
    /// Label maps, and image features rendered from the Gaussians, see [`FieldScores`](super::FieldScores).
    LabelsAndFeatures,
}

/// As [`run`], on a scene that was loaded before. Scores what `scored` says.
///
/// # Errors
/// Those of both stages, and of writing. Files written before stay.
pub fn run_on(
    scene: Scene,
    config: &Config,
    scored: Scored,
    out: &Path,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<Outcome> {
    let start = Instant::now();
    let files = RunFiles::new(out);
    let corrections = Corrections::read(&files.corrections())?;
    let config = &resolved(config, &scene, corrections.is_some());
    if !config.segmentation.rows().is_empty() {
        if has_raw_labels(&scene) || has_segments(&scene, config) || corrections.is_some() {
            check_networks(config, &scene, device)?;
        } else {
            tracing::warn!(
                "no training view has raw labels: only the Gaussians are built. raw_label_path in transforms.json or \
                 data.raw_labels names them; set segmentation.rows = [] if there are none"
            );
        }
    }
    check_scores(least_count(&scene, config), &scene, config)?;
    progress.scene(&scene);
    let reconstruction = reconstruct(&scene, config, &files, device, progress)?;
    let complete = reconstruction.complete;
    let mut outcome = Outcome::new(scene, config, reconstruction);
    outcome.corrections = corrections;
    // A run that is stopped ends without delay.
    let finished = complete && {
        outcome.test = score_images(&outcome.gaussians, &outcome.scene, config, device)?;
        outcome.associate(progress)? && outcome.segment(scored, &files, device, progress)?
    };
    outcome.stopped = !finished;
    outcome.seconds.total += start.elapsed().as_secs_f64();
    Ok(outcome)
}

impl Outcome {
    /// Makes segments of single views objects, where settings ask for it. False where `progress` stopped it.
    fn associate(&mut self, progress: &mut dyn Progress) -> Result<bool> {
        if !has_segments(&self.scene, &self.config) {
            return Ok(true);
        }
        if progress.stop() {
            return Ok(false);
        }
        let found = associate(&self.gaussians, &mut self.scene, &self.config, progress)?;
        let Some(Associated { counts, semantics }) = found else {
            return Ok(false);
        };
        self.association = Some(counts);
        self.semantics = semantics;
        progress.scene(&self.scene);
        Ok(true)
    }

    /// Puts the corrections of the run folder into the scene. False where `progress` stopped it.
    fn correct(
        &mut self,
        files: &RunFiles,
        device: &Device,
        progress: &mut dyn Progress,
    ) -> Result<bool> {
        let Some(corrections) = &self.corrections else {
            return Ok(true);
        };
        let (scene, gaussians) = (&mut self.scene, &self.gaussians);
        corrections.check(gaussians, &scene.classes, &files.corrections())?;
        let done = corrections::apply(
            corrections,
            scene,
            gaussians,
            &self.config,
            device,
            progress,
        )?;
        if done {
            progress.scene(&self.scene);
        }
        Ok(done)
    }

    /// Stage two: lifts features, trains the variants and scores them. False where `progress` stopped it.
    fn segment(
        &mut self,
        scored: Scored,
        files: &RunFiles,
        device: &Device,
        progress: &mut dyn Progress,
    ) -> Result<bool> {
        let config = &self.config;
        let is_labelled = has_raw_labels(&self.scene) || self.corrections.is_some();
        if !is_labelled || config.segmentation.rows().is_empty() {
            return Ok(true);
        }
        if progress.stop() {
            return Ok(false);
        }
        let classes = self.corrections.as_ref().map(Corrections::classes);
        let classes = classes.unwrap_or(&self.scene.classes).len();
        memory::check_scores(self.gaussians.len(), classes, score_tables(config))?;
        let lifted = lift(
            &self.gaussians,
            &self.scene,
            self.test,
            config,
            device,
            progress,
        )?;
        let Some(lifted) = lifted else {
            return Ok(false);
        };
        self.gaussians = lifted.gaussians;
        progress.gaussians(&self.gaussians, None);
        self.test = lifted.pruned.scores_after;
        self.pruned = Some(lifted.pruned);
        [self.seconds.features, self.seconds.unprojection] = lifted.seconds;
        if let Some(features) = &lifted.features {
            self.features.clone_from(&features.name);
        }
        if !self.correct(files, device, progress)? {
            return Ok(false);
        }
        let config = &self.config;
        let clock = Instant::now();
        let inputs = Inputs {
            lifted: lifted.features,
            semantics: self.semantics.as_ref(),
            corrections: self.corrections.as_ref(),
            scores_fields: scored == Scored::LabelsAndFeatures,
            ..Inputs::new(&self.scene, &self.gaussians, config, device)
        };
        let trained = train_variants(&inputs, &files.checkpoints, progress)?;
        if let Some(lifted) = &inputs.lifted
            && !trained.stopped
        {
            self.feature_colors = Some(lifted.colors()?);
        }
        self.rows = trained.rows;
        self.spatial = trained.spatial;
        let earlier: f64 = self.rows.iter().map(|row| row.earlier_seconds).sum();
        self.seconds.segmentation = clock.elapsed().as_secs_f64() + earlier;
        self.seconds.total += earlier;
        Ok(!trained.stopped)
    }
}

/// Whether there are segments of single views that the settings make objects of.
fn has_segments(scene: &Scene, config: &Config) -> bool {
    config.data.association != Association::None && scene.labelled().next().is_some()
}

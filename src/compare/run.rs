//! Runs the missing cells of a plan, one after the other.

use super::cells::{read_cell, write_cell};
use super::plan::{LabelKind, Plan, Row, SceneFolder};
use super::stage_one::SharedGaussians;
use super::{Cell, CellId, Figures};
use crate::config::Config;
use crate::data::{self, Classes, Scene, Split, View};
use crate::error::{Result, bail, ensure};
use crate::files::lock::Lock;
use crate::files::own;
use crate::metrics::ClassIou;
use crate::pipeline::{self, Scored, VariantOutcome, load_scene};
use crate::progress::Progress;
use crate::provenance::Provenance;
use crate::random::{Purpose, stream};
use burn::tensor::Device;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// How a plan is run.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Folder of the comparison.
    pub out: PathBuf,
    /// The command line, for the files that it writes.
    pub command: String,
    /// Commit of the program.
    pub commit: String,
    /// Backend and processor threads, in words.
    pub device: String,
    /// Finished cells of other commits are kept.
    pub keep_cells: bool,
    /// Only cells are run whose name `scene/labels/row/seed` has this in it.
    pub only: String,
    /// 3DGS PLY files to take as stage one, by the names of their scenes.
    pub gaussians: BTreeMap<String, PathBuf>,
}

/// Listens to a comparison.
pub trait Watch: Progress {
    /// Something is about to be trained.
    fn begins(&mut self, what: &str);

    /// A cell is finished and written.
    fn finished(&mut self, cell: &Cell);
}

/// What a comparison has.
pub struct Finished {
    /// All finished cells of the plan by their names, those of earlier commands too.
    pub cells: Vec<Cell>,
    /// Whether `watch` stopped it. The same command continues.
    pub stopped: bool,
}

/// Runs the cells of `plan` that are missing and wanted. Finished ones have to be of the plan's settings and data and of the same
/// commit.
///
/// # Errors
/// [`crate::Error::Input`] for a finished cell of something else; [`crate::Error::Argument`] for unusable options; those of
/// [`pipeline::run`].
pub fn run(
    plan: &Plan,
    options: &Options,
    device: &Device,
    watch: &mut dyn Watch,
) -> Result<Finished> {
    check_options(plan, options)?;
    let _lock = Lock::new(&options.out)?;
    let mut comparison = Comparison {
        plan,
        options,
        device,
        cells: Vec::new(),
    };
    // First, so that a table is refused before hours of training.
    for scene in &plan.scenes {
        if !comparison.read_finished(scene, watch)? {
            return Ok(comparison.end(true));
        }
    }
    for scene in &plan.scenes {
        if !comparison.train_missing(scene, watch)? {
            return Ok(comparison.end(true));
        }
    }
    Ok(comparison.end(false))
}

fn check_options(plan: &Plan, options: &Options) -> Result<()> {
    for scene in &plan.scenes {
        if let Some(dir) = &scene.dir {
            let read = plan.load_options(scene, &plan.labels[0])?;
            data::check_outputs("--out", &[&options.out], Some((dir, &read)))?;
        }
    }
    let names: Vec<&str> = plan.scenes.iter().map(|scene| &*scene.name).collect();
    let unknown = options
        .gaussians
        .keys()
        .find(|name| !names.contains(&&***name));
    if let Some(unknown) = unknown {
        bail!(argument "--gaussians"; found "{unknown}"; expected "a scene of the plan: {}", names.join(", ");
            help "name one of these");
    }
    ensure!(plan.cells().iter().any(|id| options.wants(id)),
        argument "--only"; found "{}", options.only; expected "a part of the name of a cell";
        help "a name is scene/labels/row/seed");
    Ok(())
}

impl Options {
    fn wants(&self, id: &CellId) -> bool {
        id.to_string().contains(&self.only)
    }
}

/// Cells of one scene that share labels and seed.
struct Part<'p> {
    labels: &'p LabelKind,
    seed: u64,
    rows: Vec<&'p Row>,
}

/// A cell with all that it follows from.
struct Job<'p> {
    id: CellId,
    row: &'p Row,
    config: Config,
    provenance: Provenance,
}

/// A plan while it is run.
struct Comparison<'a> {
    plan: &'a Plan,
    options: &'a Options,
    device: &'a Device,
    cells: Vec<Cell>,
}

impl<'a> Comparison<'a> {
    /// Checks the finished cells of `scene`, and keeps them. False where it was stopped.
    fn read_finished(&mut self, scene: &SceneFolder, watch: &mut dyn Watch) -> Result<bool> {
        let out = &self.options.out;
        let parts = self.parts(scene, |id| id.file(out).exists());
        if parts.is_empty() {
            return Ok(true);
        }
        let Some(gaussians) = self.gaussians(scene, watch)? else {
            return Ok(false);
        };
        let commit = (!self.options.keep_cells).then_some(&*self.options.commit);
        for part in &parts {
            let loaded = self.load(scene, part)?;
            for job in self.jobs(scene, part, &loaded, &gaussians)? {
                let cell = read_cell(out, &job.id, &job.provenance, commit)?;
                self.cells.extend(cell);
            }
        }
        Ok(true)
    }

    /// Trains the missing cells of `scene` that are wanted. False where it was stopped.
    fn train_missing(&mut self, scene: &SceneFolder, watch: &mut dyn Watch) -> Result<bool> {
        let options = self.options;
        let parts = self.parts(scene, |id| {
            options.wants(id) && !id.file(&options.out).exists()
        });
        if parts.is_empty() {
            return Ok(true);
        }
        let Some(gaussians) = self.gaussians(scene, watch)? else {
            return Ok(false);
        };
        for part in &parts {
            let loaded = self.load(scene, part)?;
            for jobs in grouped(self.jobs(scene, part, &loaded, &gaussians)?) {
                if watch.stop() || !self.train(&jobs, &loaded, watch)? {
                    return Ok(false);
                }
            }
        }
        Ok(true)
    }

    /// The cells of `scene` that `chosen` accepts.
    fn parts(&self, scene: &SceneFolder, chosen: impl Fn(&CellId) -> bool) -> Vec<Part<'a>> {
        let mut parts = Vec::new();
        for labels in &self.plan.labels {
            for seed in 0..self.plan.seeds {
                let rows = self.plan.rows.iter();
                let rows: Vec<&Row> = rows
                    .filter(|row| chosen(&CellId::new(scene, labels, row, seed)))
                    .collect();
                if !rows.is_empty() {
                    parts.push(Part { labels, seed, rows });
                }
            }
        }
        parts
    }

    fn gaussians(
        &self,
        scene: &SceneFolder,
        watch: &mut dyn Watch,
    ) -> Result<Option<SharedGaussians>> {
        SharedGaussians::of(scene, self.plan, self.options, self.device, watch)
    }

    /// The scene of `part`, with raw labels of as many training photos as its labels keep.
    fn load(&self, scene: &SceneFolder, part: &Part<'_>) -> Result<Scene> {
        let mut scene = load_scene(&self.plan.reading(scene, part.labels)?)?;
        let Some(kept) = part.labels.labelled_photos else {
            return Ok(scene);
        };
        let is_labelled = |view: &&mut View| view.split == Split::Train && view.raw.is_some();
        let labelled: Vec<&mut View> = scene.views.iter_mut().filter(is_labelled).collect();
        let count = labelled.len();
        if kept > count {
            let path = &self.plan.path;
            bail!(path, "labels {:?}, labelled_photos", part.labels.name; found "{kept}";
                expected "at most {count}, the training photos of {} with raw labels", scene.name;
                help "give fewer, or name another data.raw_labels");
        }
        let mut random = stream(part.seed, Purpose::LabelledPhotos, 0);
        let drawn = rand::seq::index::sample(&mut random, count, kept).into_vec();
        for (index, view) in labelled.into_iter().enumerate() {
            if !drawn.contains(&index) {
                view.raw = None;
                view.scores = None;
            }
        }
        Ok(scene)
    }

    /// The cells of `part` on the scene that was `loaded` for it.
    fn jobs(
        &self,
        scene: &SceneFolder,
        part: &Part<'a>,
        loaded: &Scene,
        gaussians: &SharedGaussians,
    ) -> Result<Vec<Job<'a>>> {
        let labels = part.labels;
        let seed = part.seed;
        let job = |row: &&'a Row| {
            let file = gaussians.file.clone();
            let config = self.plan.stage_two(scene, labels, row, seed, file)?;
            let decodes = row.variant.trains_decoder();
            Ok(Job {
                id: CellId::new(scene, labels, row, seed),
                row,
                provenance: Provenance::scores(&config, loaded, &gaussians.gaussians, decodes)?,
                config,
            })
        };
        part.rows.iter().map(job).collect()
    }

    /// Trains cells of equal settings in one run, and writes each. False where it was stopped.
    fn train(&mut self, jobs: &[Job<'a>], scene: &Scene, watch: &mut dyn Watch) -> Result<bool> {
        let Some(first) = jobs.first() else {
            return Ok(true);
        };
        let names: Vec<&str> = jobs.iter().map(|job| &*job.row.name).collect();
        let id = &first.id;
        watch.begins(&format!(
            "{}/{}/seed {}: {}",
            id.scene,
            id.labels,
            id.seed,
            names.join(", ")
        ));
        let mut config = first.config.clone();
        config.segmentation.rows = Some(jobs.iter().map(|job| job.row.variant).collect());
        let folder = self.options.out.join("runs").join(&id.scene);
        let folder = folder.join(&id.labels);
        let folder = folder.join(format!("{} {}", first.row.name, id.seed));
        let outcome = pipeline::run_on(
            scene.clone(),
            &config,
            Scored::LabelsAndFeatures,
            &folder,
            self.device,
            watch,
        )?;
        if outcome.stopped {
            return Ok(false);
        }
        for job in jobs {
            let row = outcome
                .rows
                .iter()
                .find(|row| row.variant == job.row.variant);
            let Some(row) = row else {
                bail!(&self.plan.path, "labels {:?}", id.labels; found "{} without raw labels", id.scene;
                    expected "training photos with raw labels"; help "name them by data.raw_labels or data.transforms");
            };
            let cell = Cell {
                id: job.id.clone(),
                variant: job.row.variant,
                commit: self.options.commit.clone(),
                command: self.options.command.clone(),
                device: self.options.device.clone(),
                figures: Figures::of(row, &outcome, self.device)?,
                class_iou: named_classes(row, &outcome.scene.classes),
            };
            write_cell(&self.options.out, cell.clone(), job.provenance.clone())?;
            watch.finished(&cell);
            self.cells.push(cell);
        }
        // Its checkpoints are as large as the scene, and have served.
        own::remove_folder(&folder)?;
        Ok(true)
    }

    fn end(mut self, stopped: bool) -> Finished {
        self.cells.sort_by(|a, b| a.id.cmp(&b.id));
        Finished {
            cells: self.cells,
            stopped,
        }
    }
}

/// The IoU of each class in the truth.
fn named_classes(row: &VariantOutcome, classes: &Classes) -> Vec<ClassIou> {
    let named = |&(id, iou): &(u16, f64)| ClassIou {
        id,
        name: classes.name(id).to_owned(),
        iou,
    };
    row.scores.labels.per_class.iter().map(named).collect()
}

/// Jobs in groups that a run can train together: of equal settings, each variant once.
fn grouped(jobs: Vec<Job<'_>>) -> Vec<Vec<Job<'_>>> {
    let mut groups: Vec<Vec<Job<'_>>> = Vec::new();
    for job in jobs {
        let fits = |group: &&mut Vec<Job<'_>>| {
            group[0].config == job.config
                && group
                    .iter()
                    .all(|other| other.row.variant != job.row.variant)
        };
        match groups.iter_mut().find(fits) {
            Some(group) => group.push(job),
            None => groups.push(vec![job]),
        }
    }
    groups
}

//! Runs the missing cells of a plan, one after the other.

use super::cells::{read_cell, write_cell};
use super::plan::{LabelKind, Plan, SceneFolder, TableRow};
use super::stage_one::SharedGaussians;
use super::{Cell, CellId, Figures};
use crate::config::Config;
use crate::data::{self, LoadOptions, Scene, Split, View};
use crate::error::{Error, Result, bail, ensure};
use crate::files::lock::Lock;
use crate::files::own;
use crate::pipeline::{self, load_scene};
use crate::progress::{Event, Progress, go_on};
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
    /// Only cells whose name `scene/labels/row/seed` contains this are run.
    pub only: String,
    /// 3DGS PLY files to take as stage one, by the names of their scenes.
    pub gaussians: BTreeMap<String, PathBuf>,
}

/// What a comparison has.
pub struct Finished {
    /// All finished cells of the plan by their names, those of earlier commands too.
    pub cells: Vec<Cell>,
    /// Whether `progress` stopped it. The same command continues.
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
    progress: &mut dyn Progress,
) -> Result<Finished> {
    check_options(plan, options)?;
    let _lock = Lock::new(&options.out)?;
    let mut comparison = Comparison {
        plan,
        options,
        device,
        progress,
        cells: Vec::new(),
    };
    let is_finished = |id: &CellId| id.file(&options.out).exists();
    let is_missing = |id: &CellId| options.wants(id) && !is_finished(id);
    // Finished ones first, so that a table is refused before hours of training.
    let read = comparison.visit(is_finished, Comparison::read);
    let done = read.and_then(|()| comparison.visit(is_missing, Comparison::train));
    let stopped = match done {
        Err(Error::Stopped) => true,
        done => done.map(|()| false)?,
    };
    let mut cells = comparison.cells;
    cells.sort_by(|a, b| a.id.cmp(&b.id));
    Ok(Finished { cells, stopped })
}

fn check_options(plan: &Plan, options: &Options) -> Result<()> {
    for scene in &plan.scenes {
        if let Some(dir) = &scene.dir {
            let read = LoadOptions::from(&plan.reading(scene, &plan.labels[0])?);
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

/// A cell with all that it follows from.
struct Job<'p> {
    id: CellId,
    row: &'p TableRow,
    config: Config,
    provenance: Provenance,
}

/// A plan while it is run.
struct Comparison<'a> {
    plan: &'a Plan,
    options: &'a Options,
    device: &'a Device,
    progress: &'a mut dyn Progress,
    cells: Vec<Cell>,
}

impl<'a> Comparison<'a> {
    /// Calls `work` for each scene, labels and seed, with the cells that `chosen` accepts and the scene that they are trained on.
    fn visit(
        &mut self,
        chosen: impl Fn(&CellId) -> bool,
        work: impl Fn(&mut Self, Vec<Job<'a>>, &Scene) -> Result<()>,
    ) -> Result<()> {
        let plan = self.plan;
        for scene in &plan.scenes {
            let mut shared = None;
            let of_labels = |labels| (0..plan.seeds).map(move |seed| (labels, seed));
            for (labels, seed) in plan.labels.iter().flat_map(of_labels) {
                let is_chosen = |row: &&TableRow| chosen(&CellId::new(scene, labels, row, seed));
                let rows: Vec<&TableRow> = plan.rows.iter().filter(is_chosen).collect();
                if rows.is_empty() {
                    continue;
                }
                let options = self.options;
                let device = self.device;
                let made = match shared.take() {
                    Some(made) => made,
                    None => SharedGaussians::of(scene, plan, options, device, self.progress)?,
                };
                let gaussians = &*shared.insert(made);
                let loaded = self.load(scene, labels, seed)?;
                let job =
                    |row: &'a TableRow| self.job((scene, labels, row, seed), &loaded, gaussians);
                let jobs = rows.into_iter().map(job).collect::<Result<_>>()?;
                work(self, jobs, &loaded)?;
            }
        }
        Ok(())
    }

    /// The scene under a kind of labels, with raw labels of as many training photos as these keep.
    fn load(&self, scene: &SceneFolder, labels: &LabelKind, seed: u64) -> Result<Scene> {
        let mut scene = load_scene(&self.plan.reading(scene, labels)?)?;
        let Some(kept) = labels.labelled_photos else {
            return Ok(scene);
        };
        let is_labelled = |view: &&mut View| view.split == Split::Train && view.raw.is_some();
        let labelled: Vec<&mut View> = scene.views.iter_mut().filter(is_labelled).collect();
        let count = labelled.len();
        ensure!(kept <= count, &self.plan.path, "labels {:?}, labelled_photos", labels.name; found "{kept}";
            expected "at most {count}, the training photos of {} with raw labels", scene.name;
            help "give fewer, or name another data.raw_labels");
        let mut random = stream(seed, Purpose::LabelledPhotos, 0);
        let drawn = rand::seq::index::sample(&mut random, count, kept).into_vec();
        for (index, view) in labelled.into_iter().enumerate() {
            if !drawn.contains(&index) {
                view.raw = None;
                view.scores = None;
            }
        }
        Ok(scene)
    }

    /// A cell on the scene that was `loaded` for it.
    fn job(
        &self,
        (scene, labels, row, seed): (&SceneFolder, &LabelKind, &'a TableRow, u64),
        loaded: &Scene,
        gaussians: &SharedGaussians,
    ) -> Result<Job<'a>> {
        let file = gaussians.file.clone();
        let config = self.plan.stage_two(scene, labels, row, seed, file)?;
        let decodes = row.variant.trains_decoder();
        Ok(Job {
            id: CellId::new(scene, labels, row, seed),
            row,
            provenance: Provenance::scores(&config, loaded, &gaussians.gaussians, decodes)?,
            config,
        })
    }

    /// Keeps finished cells that are of the plan.
    fn read(&mut self, jobs: Vec<Job<'a>>, _: &Scene) -> Result<()> {
        let options = self.options;
        let commit = (!options.keep_cells).then_some(&*options.commit);
        for job in jobs {
            let cell = read_cell(&options.out, &job.id, &job.provenance, commit)?;
            self.cells.push(cell);
        }
        Ok(())
    }

    /// Trains cells.
    fn train(&mut self, jobs: Vec<Job<'a>>, scene: &Scene) -> Result<()> {
        for group in grouped(jobs) {
            go_on(self.progress)?;
            self.train_group(&group, scene)?;
        }
        Ok(())
    }

    /// Trains cells of equal settings in one run, and writes each.
    fn train_group(&mut self, jobs: &[Job<'a>], scene: &Scene) -> Result<()> {
        let first = &jobs[0];
        let names: Vec<&str> = jobs.iter().map(|job| &*job.row.name).collect();
        let id = &first.id;
        self.progress.event(&Event::Begun(format!(
            "{}/{}/seed {}: {}",
            id.scene,
            id.labels,
            id.seed,
            names.join(", ")
        )));
        let mut config = first.config.clone();
        config.segmentation.rows = Some(jobs.iter().map(|job| job.row.variant).collect());
        let folder = self.options.out.join("runs").join(&id.scene);
        let folder = folder.join(&id.labels);
        let folder = folder.join(format!("{} {}", first.row.name, id.seed));
        let scores_fields = true;
        let outcome = pipeline::run_on(
            scene.clone(),
            &config,
            scores_fields,
            &folder,
            self.device,
            self.progress,
        )?;
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
                class_iou: row.scores.labels.named(&outcome.scene.classes),
            };
            write_cell(&self.options.out, cell.clone(), job.provenance.clone())?;
            self.progress.event(&Event::Stored {
                cell: cell.id.to_string(),
                miou: cell.figures.pixels.miou,
            });
            self.cells.push(cell);
        }
        // The checkpoints are as large as the scene and are no longer needed.
        own::remove_folder(&folder)
    }
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

//! The files of a run folder.

use super::scene_file::{
    CAMERAS, CLASSES, COMMANDS, CONFIG, FEATURE_COLORS, METRICS, SCENE, VIEWER, classes_beside,
    unfinished_run,
};
use crate::config::Config;
use crate::data::Classes;
use crate::data::blocks::BLOCK;
use crate::error::{Error, Result, ensure};
use crate::files::lock::Lock;
use crate::files::{self, atomic, own, shell_word};
use crate::objects::Identities;
use crate::report::{Command, Metrics};
use std::path::{Path, PathBuf};

/// The scores of each Gaussian for each class.
pub const IDENTITIES: &str = "identities.safetensors";
/// The figures on a page.
pub const REPORT: &str = "report.html";
/// The folder of held-out views.
pub const RENDERS: &str = "renders";
/// The files of a run folder, except those in its folders.
const FILES: [&str; 11] = [
    BLOCK,
    CAMERAS,
    CLASSES,
    COMMANDS,
    CONFIG,
    FEATURE_COLORS,
    IDENTITIES,
    METRICS,
    REPORT,
    SCENE,
    VIEWER,
];
/// The folders of a run folder.
const FOLDERS: [&str; 2] = [CHECKPOINTS, RENDERS];
/// The state that a run continues from.
const CHECKPOINTS: &str = "checkpoint";

/// A run folder.
#[derive(Clone, Debug)]
pub struct RunFolder(PathBuf);

impl RunFolder {
    /// An existing run.
    ///
    /// # Errors
    /// [`Error::Missing`] where `dir` is not there; [`Error::Input`] when it holds no `config.toml`.
    pub fn existing(dir: &Path) -> Result<Self> {
        let run = Self(dir.to_owned());
        let help = "give the folder that `coseg train` wrote";
        if !dir.exists() {
            return Err(Error::missing("folder", dir, help));
        }
        ensure!(run.is_used(), dir, "{CONFIG}"; found "no such file"; expected "a run folder"; help "{help}");
        Ok(run)
    }

    /// The folder of a new run: `dir`, or `runs/NAME`, numbered when that is taken.
    ///
    /// # Errors
    /// [`Error::Input`] when `dir` already holds a run.
    pub fn new(dir: Option<&Path>, name: &str) -> Result<Self> {
        let Some(dir) = dir else {
            let base = Path::new("runs");
            let numbered = (2..).map(|i| base.join(format!("{name}-{i}")));
            let mut all = std::iter::once(base.join(name)).chain(numbered).map(Self);
            let free = all.find(|run| !run.is_used());
            return Ok(free.unwrap_or_else(|| Self(base.join(name))));
        };
        let run = Self(dir.to_owned());
        ensure!(!run.is_used(), dir, "{CONFIG}"; found "a run"; expected "no run there yet";
            help "continue it (--resume {}) or choose another folder", shell_word(dir));
        Ok(run)
    }

    /// Locks the folder for this process. With `resume`, the files of the run may be overwritten. Without it, files that this
    /// program did not write are refused.
    ///
    /// # Errors
    /// [`Error::Input`] naming the process that has the folder; [`Error::Argument`] naming a file that is in the way.
    pub fn claim(&self, resume: bool) -> Result<Lock> {
        if resume {
            own::allow(&self.0);
            FOLDERS.iter().for_each(|name| own::allow(self.file(name)));
        } else {
            FILES
                .iter()
                .try_for_each(|name| own::check(self.file(name)))?;
            FOLDERS
                .iter()
                .try_for_each(|name| own::check_folder(self.file(name)))?;
        }
        Lock::new(&self.0)
    }

    fn is_used(&self) -> bool {
        self.file(CONFIG).exists()
    }

    /// Starts or resumes the run with `command` and the settings `config`. A new run gets both files at once, so that it can
    /// be resumed however it ends. A resumed run keeps its earlier settings file until it succeeds: it may still refuse these.
    ///
    /// # Errors
    /// [`Error::Io`] naming the file; [`Error::Argument`] for settings that TOML cannot hold.
    pub fn start(&self, config: &Config, command: Command) -> Result<StartedRun> {
        // A file that cannot be read is ignored.
        let earlier = files::json(&self.file(COMMANDS), "the commands of a run");
        let mut commands: Vec<Command> = earlier.unwrap_or_default();
        commands.push(command);
        let started = StartedRun {
            run: self.clone(),
            is_new: !self.is_used(),
            commands,
        };
        if started.is_new {
            let written = self.write_start(config);
            let written = written.and_then(|()| started.write_commands());
            written.inspect_err(|_| started.remove_new())?;
        }
        Ok(started)
    }

    /// Writes the settings, and the block of a larger scene that they name: that scene may be split again.
    fn write_start(&self, config: &Config) -> Result<()> {
        let block = config.data.dir.as_ref().map(|dir| dir.join(BLOCK));
        if let Some(block) = block.filter(|file| file.is_file()) {
            atomic::write_bytes(self.file(BLOCK), &files::read(&block)?)?;
        }
        atomic::write_bytes(self.file(CONFIG), config.to_toml()?.as_bytes())
    }

    /// Peak memory of the earlier part of the run, if any.
    pub fn peak_memory_before(&self) -> Option<u64> {
        let metrics = files::json::<Metrics>(&self.file(METRICS), "the figures of a run");
        metrics.ok()?.peak_memory_bytes
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// The file `name` of the folder.
    pub fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// Settings as run, with overrides.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn config(&self, sets: &[String]) -> Result<Config> {
        Config::load(Some(&self.file(CONFIG)), sets)
    }

    /// The same for the scene folder `data`, where one is given.
    ///
    /// # Errors
    /// As [`Config::load`]; [`Error::Missing`] where the run's own scene folder is not there any more.
    pub fn config_for(&self, data: Option<&Path>, sets: &[String]) -> Result<Config> {
        let mut config = self.config(sets)?;
        match (data, &config.data.dir) {
            (Some(data), _) => config.data.dir = Some(data.to_owned()),
            (None, Some(dir)) if !dir.exists() => {
                return Err(Error::missing(
                    "folder",
                    dir,
                    "add --data DIR if the scene has moved",
                ));
            }
            (None, _) => {}
        }
        Ok(config)
    }

    /// The command that continues the run, if it was stopped before its end.
    pub fn unfinished(&self) -> Option<String> {
        unfinished_run(&self.0)
    }

    /// The class table; empty for runs without labels.
    ///
    /// # Errors
    /// As [`Classes::read`].
    pub fn classes(&self) -> Result<Classes> {
        classes_beside(&self.file(SCENE), None)
    }
}

/// A run that was started or resumed.
#[derive(Debug)]
pub struct StartedRun {
    run: RunFolder,
    /// Whether the folder is new.
    is_new: bool,
    /// The command lines of the run, this one the last.
    pub commands: Vec<Command>,
}

impl StartedRun {
    /// Writes the command lines.
    ///
    /// # Errors
    /// [`Error::Io`] naming the file.
    pub fn write_commands(&self) -> Result<()> {
        atomic::write_json(self.run.file(COMMANDS), &self.commands)
    }

    /// Removes the files of a new run after an error, unless training has started: the input was wrong.
    pub fn remove_new(&self) {
        let checkpoints = self.run.file(CHECKPOINTS);
        let has_checkpoint =
            !files::names(&checkpoints, |name, _| !name.starts_with('.')).is_empty();
        if !self.is_new || has_checkpoint {
            return;
        }
        // The first error is the one to report; files that cannot be removed do no harm.
        for name in [CONFIG, COMMANDS, BLOCK] {
            let _ = atomic::remove(self.run.file(name));
        }
        own::remove_empty(&checkpoints);
        own::remove_empty(&self.run.0);
    }
}

/// The identities beside the scene `scene` of `gaussians` Gaussians and `classes` classes, if any.
///
/// # Errors
/// As [`Identities::read`]; [`Error::Input`] for other numbers of Gaussians or classes.
pub fn identities_beside(
    scene: &Path,
    gaussians: usize,
    classes: usize,
) -> Result<Option<Identities>> {
    let path = scene.with_file_name(IDENTITIES);
    if !path.is_file() {
        return Ok(None);
    }
    let identities = Identities::read(&path)?;
    let rows = identities.scores.len() / identities.classes.max(1);
    ensure!(rows == gaussians, &path, "scores"; found "{rows} rows";
        expected "{gaussians}, as in scene.ply"; help "the two files are of different runs; train again");
    ensure!(identities.classes == classes, &path, "scores"; found "{} columns", identities.classes;
        expected "{classes}, as classes.json has classes"; help "the two files are of different runs; train again");
    Ok(Some(identities))
}

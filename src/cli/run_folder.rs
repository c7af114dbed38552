//! What lies where in a run folder.

use super::scene_file::CONFIG;
use coseg::config::Config;
use coseg::data::{Classes, atomic};
use coseg::error::{Error, Result};
use coseg::report::{Command, Metrics};
use std::path::{Path, PathBuf};

/// A run folder.
#[derive(Clone, Debug)]
pub struct RunFolder(PathBuf);

impl RunFolder {
    /// An existing run.
    ///
    /// # Errors
    /// [`Error::Input`] when `dir` holds no `config.toml`.
    pub fn existing(dir: &Path) -> Result<Self> {
        let run = Self(dir.to_owned());
        if !run.config_path().is_file() {
            let help = "give the folder that `coseg train` wrote";
            return Err(Error::input(
                dir,
                "config.toml",
                "no such file",
                "a run folder",
                help,
            ));
        }
        Ok(run)
    }

    /// A place for a new run: `dir`, or `runs/NAME` with a number behind it when that is taken.
    ///
    /// # Errors
    /// [`Error::Input`] when `dir` already holds a run.
    pub fn new(dir: Option<&Path>, name: &str) -> Result<Self> {
        let Some(dir) = dir else {
            let base = Path::new("runs");
            let numbered = (2..).map(|i| base.join(format!("{name}-{i}")));
            let free = std::iter::once(base.join(name))
                .chain(numbered)
                .map(Self)
                .find(|run| !run.is_used());
            return Ok(free.unwrap_or_else(|| Self(base.join(name))));
        };
        let run = Self(dir.to_owned());
        if run.is_used() {
            let help = format!(
                "go on with it (--resume {}) or choose another folder",
                dir.display()
            );
            return Err(Error::input(
                dir,
                "config.toml",
                "a run",
                "no run there yet",
                help,
            ));
        }
        Ok(run)
    }

    fn is_used(&self) -> bool {
        self.config_path().exists()
    }

    /// Notes that `command` begins the run, or goes on with it, with the settings `config`. A new run has both at once, so that
    /// it can be gone on with however it ends. One that was there may yet refuse these settings: it keeps its own until it is
    /// done.
    ///
    /// # Errors
    /// [`Error::Io`] naming the file; [`Error::Argument`] for settings that TOML cannot hold.
    pub fn begin(&self, config: &Config, command: Command) -> Result<Begun> {
        // A run of before this file was kept has none; one that cannot be read says nothing.
        let earlier = std::fs::read(self.commands_path()).ok();
        let earlier = earlier.and_then(|text| serde_json::from_slice::<Vec<Command>>(&text).ok());
        let commands: Vec<Command> = earlier.into_iter().flatten().chain([command]).collect();
        let begun = Begun {
            run: self.clone(),
            anew: !self.is_used(),
            commands,
        };
        if begun.anew {
            let config = config.to_toml()?;
            let written = atomic::write_bytes(self.config_path(), config.as_bytes())
                .and_then(|()| begun.keep());
            written.inspect_err(|_| begun.undo())?;
        }
        Ok(begun)
    }

    /// Largest memory of the part of the run that ended last, where one did.
    pub fn peak_memory_before(&self) -> Option<u64> {
        let text = std::fs::read(self.0.join("metrics.json")).ok()?;
        serde_json::from_slice::<Metrics>(&text)
            .ok()?
            .peak_memory_bytes
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Settings as run.
    pub fn config_path(&self) -> PathBuf {
        self.0.join(CONFIG)
    }

    /// The command lines that the run is of.
    fn commands_path(&self) -> PathBuf {
        self.0.join("commands.json")
    }

    /// The scene.
    pub fn scene_path(&self) -> PathBuf {
        self.0.join("scene.ply")
    }

    /// The views' cameras.
    pub fn cameras_path(&self) -> PathBuf {
        self.0.join("cameras.json")
    }

    /// Scores of each Gaussian for each class.
    pub fn identities_path(&self) -> PathBuf {
        self.0.join("identities.safetensors")
    }

    /// The page.
    pub fn report_path(&self) -> PathBuf {
        self.0.join("report.html")
    }

    /// The scene as a page.
    pub fn viewer_path(&self) -> PathBuf {
        self.0.join("viewer.html")
    }

    /// Settings as run, with overrides. A run of before there was `data.max_side` had its photos at their full size, and one of
    /// before there were masks used them whole; the built-in scene has neither.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn config(&self, sets: &[String]) -> Result<Config> {
        let path = self.config_path();
        let text = std::fs::read_to_string(&path).unwrap_or_default();
        let says = |key: &str| {
            text.lines().any(|line| {
                line.split('=')
                    .next()
                    .is_some_and(|name| name.trim() == key)
            })
        };
        let then = [
            ("max_side", "data.max_side=0"),
            ("masks", "data.masks=none"),
        ];
        let then = then
            .into_iter()
            .filter(|(key, _)| says("dir") && !says(key))
            .map(|(_, set)| set.to_owned());
        Config::load(
            Some(&path),
            &then.chain(sets.iter().cloned()).collect::<Vec<_>>(),
        )
    }

    /// The class table; empty for runs without labels.
    ///
    /// # Errors
    /// As [`Classes::read`].
    pub fn classes(&self) -> Result<Classes> {
        let path = self.0.join("classes.json");
        if path.is_file() {
            Classes::read(&path)
        } else {
            Ok(Classes::default())
        }
    }
}

/// A run that has begun, or goes on.
#[derive(Debug)]
pub struct Begun {
    run: RunFolder,
    /// Whether there was none before.
    anew: bool,
    /// The command lines that the run is of, this one the last.
    pub commands: Vec<Command>,
}

impl Begun {
    /// Writes the command lines, once the run has gone on.
    ///
    /// # Errors
    /// [`Error::Io`] naming the file.
    pub fn keep(&self) -> Result<()> {
        let path = self.run.commands_path();
        let text = serde_json::to_string_pretty(&self.commands)
            .map_err(|e| Error::io(&path, "encode", e.into()))?;
        atomic::write_bytes(&path, text.as_bytes())
    }

    /// Frees the folder of a new run for another try after an error, where training has not begun: input was at fault.
    pub fn undo(&self) {
        let checkpoints = self.run.0.join("checkpoint");
        let started = std::fs::read_dir(&checkpoints).is_ok_and(|mut files| files.next().is_some());
        if !self.anew || started {
            return;
        }
        // The error that led here is told; what cannot be removed does no harm.
        for path in [self.run.config_path(), self.run.commands_path()] {
            let _ = atomic::remove(path);
        }
        let _ = std::fs::remove_dir(&checkpoints);
        let _ = std::fs::remove_dir(&self.run.0);
    }
}

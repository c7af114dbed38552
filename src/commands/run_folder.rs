//! What lies where in a run folder.

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
            let mend = "give the folder that `coseg train` wrote";
            return Err(Error::input(dir, "config.toml", "no such file", "a run folder", mend));
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
            let free = std::iter::once(base.join(name)).chain(numbered).map(Self).find(|run| !run.is_used());
            return Ok(free.unwrap_or_else(|| Self(base.join(name))));
        };
        let run = Self(dir.to_owned());
        if run.is_used() {
            let mend = format!("go on with it (--resume {}) or choose another folder", dir.display());
            return Err(Error::input(dir, "config.toml", "a run", "no run there yet", mend));
        }
        Ok(run)
    }

    fn is_used(&self) -> bool {
        self.config_path().exists()
    }

    /// Writes `config.toml`; returns what stood there, which is something in a run that is gone on with.
    ///
    /// # Errors
    /// [`Error::Io`] naming the file; [`Error::Config`] for settings that TOML cannot hold.
    pub fn replace_config(&self, config: &Config) -> Result<Option<Vec<u8>>> {
        let before = std::fs::read(self.config_path()).ok();
        atomic::write_bytes(self.config_path(), config.to_toml()?.as_bytes())?;
        Ok(before)
    }

    /// Notes that `command` begins the run or goes on with it; returns all commands of the run, it the last.
    ///
    /// # Errors
    /// [`Error::Io`] naming the file.
    pub fn begin(&self, command: Command) -> Result<Vec<Command>> {
        let path = self.commands_path();
        // A run of before this file was kept has none; one that cannot be read says nothing.
        let before = std::fs::read(&path).ok().and_then(|text| serde_json::from_slice(&text).ok());
        let commands: Vec<Command> = before.into_iter().flat_map(|all: Vec<Command>| all).chain([command]).collect();
        let text = serde_json::to_string_pretty(&commands).map_err(|e| Error::io(&path, "encode", e.into()))?;
        atomic::write_bytes(&path, text.as_bytes())?;
        Ok(commands)
    }

    /// Largest memory of the part of the run that ended last, where one did.
    pub fn peak_memory_before(&self) -> Option<u64> {
        let text = std::fs::read(self.0.join("metrics.json")).ok()?;
        serde_json::from_slice::<Metrics>(&text).ok()?.peak_memory_bytes
    }

    /// Puts back what [`RunFolder::replace_config`] returned: the run did not go on with other settings.
    pub fn restore_config(&self, before: &[u8]) {
        // The error that led here is told; this file only says less of it.
        let _ = atomic::write_bytes(self.config_path(), before);
    }

    /// Takes `config.toml` and the noted commands away, and the folder when that empties it, if training has not begun: input was at fault, and
    /// the folder is free for another try.
    pub fn forget_unless_started(&self) {
        if !self.0.join("checkpoint").exists() {
            // What cannot be removed does no harm.
            let _ = std::fs::remove_file(self.config_path());
            let _ = std::fs::remove_file(self.commands_path());
            let _ = std::fs::remove_dir(&self.0);
        }
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Settings as run.
    pub fn config_path(&self) -> PathBuf {
        self.0.join("config.toml")
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

    /// Settings as run, with overrides.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn config(&self, sets: &[String]) -> Result<Config> {
        Config::load(Some(&self.config_path()), sets)
    }

    /// The class table; empty for runs without labels.
    ///
    /// # Errors
    /// As [`Classes::read`].
    pub fn classes(&self) -> Result<Classes> {
        let path = self.0.join("classes.json");
        if path.is_file() { Classes::read(&path) } else { Ok(Classes::default()) }
    }
}

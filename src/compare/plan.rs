//! The plan of a table: scenes, kinds of labels, rows and seeds, read from a TOML file.

use super::CellId;
use crate::config::{BuildingConfig, Config, Variant};
use crate::error::{Error, Result, bail, ensure, invalid};
use crate::files;
use serde::Deserialize;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use toml::Table;

/// Cells of a plan, at most.
const MAX_CELLS: u64 = 10_000;
/// Bytes of a name, which is part of file names, at most.
const MAX_BYTES: usize = 60;

/// The scene of this name is the built-in room.
const BUILTIN: &str = "builtin";

/// Settings that a plan decides by its other parts, and where.
const OWN_KEYS: [(&str, &str); 4] = [
    ("seed", "`seeds` counts them"),
    ("data.dir", "`scenes` names the folders"),
    ("building.gaussians", "`--gaussians SCENE=FILE` names them"),
    ("segmentation.rows", "`rows` lists them"),
];

/// A table, as its file states it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// The file.
    #[serde(skip)]
    pub path: PathBuf,
    /// Heading of the table.
    pub title: String,
    /// The scenes, in order.
    pub scenes: Vec<SceneFolder>,
    /// Stage two is trained under the seeds 0, 1, ... below this. Stage one has seed 0.
    pub seeds: u64,
    /// Kinds of labels; each has a table of its own.
    pub labels: Vec<LabelKind>,
    /// Lines of each table.
    pub rows: Vec<TableRow>,
    /// Markdown with figures of papers, shown below the tables; may be empty.
    #[serde(default)]
    pub published: String,
    #[serde(default)]
    settings: Table,
}

/// A scene of a plan.
#[derive(Clone, Debug, Deserialize)]
#[serde(from = "String")]
pub struct SceneFolder {
    /// Name of the folder; `builtin` for the built-in room.
    pub name: String,
    /// The folder; absent for the built-in room.
    pub dir: Option<PathBuf>,
}

impl From<String> for SceneFolder {
    fn from(path: String) -> Self {
        Self {
            name: files::file_name(Path::new(&path)).unwrap_or_default(),
            dir: (path != BUILTIN).then(|| path.into()),
        }
    }
}

/// A kind of labels: where they come from.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LabelKind {
    /// Its name.
    pub name: String,
    /// Training photos that keep their raw labels, drawn by the seed; absent: all.
    pub labelled_photos: Option<usize>,
    #[serde(default)]
    settings: Table,
}

/// A line of the table.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TableRow {
    /// Its name.
    pub name: String,
    /// What is trained.
    pub variant: Variant,
    #[serde(default)]
    settings: Table,
}

impl Plan {
    /// Reads and checks the plan at `path`. Its scenes are folders within `root`, or else within the folder of the file. `builtin`
    /// is the built-in room.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Input`] naming the field of the file; [`Error::Missing`] for a scene that is not there;
    /// [`Error::Limit`] for too many cells.
    pub fn read(path: &Path, root: Option<&Path>) -> Result<Self> {
        let text = files::text(path)?;
        let form = "a plan: title, scenes, seeds, published, [settings], [[labels]] with name, labelled_photos and settings, \
                    [[rows]] with name, variant and settings";
        let mut plan: Self = files::toml(&text, path, form)?;
        plan.path = path.to_owned();
        plan.title = plan.title.trim().to_owned();
        plan.published = plan.published.trim().to_owned();
        let root = root.or(path.parent()).unwrap_or(Path::new("."));
        for dir in plan.scenes.iter_mut().flat_map(|scene| &mut scene.dir) {
            *dir = root.join(&dir);
        }
        plan.check_names()?;
        plan.check_size()?;
        plan.check_settings()?;
        Ok(plan)
    }

    /// The names of all cells: by scene, labels, seed and row.
    pub fn cells(&self) -> Vec<CellId> {
        let mut cells = Vec::new();
        for scene in &self.scenes {
            for labels in &self.labels {
                for seed in 0..self.seeds {
                    let rows = self.rows.iter();
                    cells.extend(rows.map(|row| CellId::new(scene, labels, row, seed)));
                }
            }
        }
        cells
    }

    /// Settings of a run on `scene`: those of the plan, and those of `tables`.
    fn settings(&self, scene: &SceneFolder, tables: &[&Table]) -> Result<Config> {
        let mut config = Config::of_tables(&[&[&self.settings], tables].concat())?;
        config.data.dir = scene.dir.clone();
        Ok(config)
    }

    /// Settings of stage one of a scene.
    ///
    /// # Errors
    /// [`Error::Config`].
    pub(super) fn stage_one(&self, scene: &SceneFolder) -> Result<Config> {
        let mut config = self.settings(scene, &[])?;
        config.segmentation.rows = Some(Vec::new());
        Ok(config)
    }

    /// Settings under which the scene of a kind of labels is read.
    ///
    /// # Errors
    /// [`Error::Config`].
    pub(super) fn reading(&self, scene: &SceneFolder, labels: &LabelKind) -> Result<Config> {
        self.settings(scene, &[&labels.settings])
    }

    /// Settings of a cell, without its variant: stage two on Gaussians that are taken as they are.
    ///
    /// # Errors
    /// [`Error::Config`].
    pub(super) fn stage_two(
        &self,
        scene: &SceneFolder,
        labels: &LabelKind,
        row: &TableRow,
        seed: u64,
        gaussians: PathBuf,
    ) -> Result<Config> {
        let mut config = self.settings(scene, &[&labels.settings, &row.settings])?;
        config.seed = seed;
        config.building = BuildingConfig::taking(gaussians);
        Ok(config)
    }

    fn check_names(&self) -> Result<()> {
        ensure!(!self.title.is_empty() && !self.title.contains(char::is_control),
            &self.path, "title"; found "{:?}", self.title; expected "a line of text"; help "name what the table shows");
        self.check_list("scenes", self.scenes.iter().map(|scene| &*scene.name))?;
        self.check_list("labels", self.labels.iter().map(|kind| &*kind.name))?;
        self.check_list("rows", self.rows.iter().map(|row| &*row.name))?;
        for scene in &self.scenes {
            if let Some(dir) = scene.dir.as_ref().filter(|dir| !dir.is_dir()) {
                let help = format!(
                    "{} names it in `scenes`, relative to --data-root or else to the plan",
                    self.path.display()
                );
                return Err(Error::missing("folder", dir, help));
            }
        }
        Ok(())
    }

    /// Checks the names of a list: one or more, each usable as a file name, none twice.
    fn check_list<'a>(&self, field: &str, names: impl Iterator<Item = &'a str>) -> Result<()> {
        let path = &self.path;
        let mut seen = BTreeSet::new();
        for (i, name) in names.enumerate() {
            let field = format!("{field}, number {}", i + 1);
            let forbidden = |c: char| c.is_control() || "/\\|<>\":*?`".contains(c);
            let is_plain = !name.trim().is_empty()
                && name.trim() == name
                && name.len() <= MAX_BYTES
                && !name.starts_with('.')
                && !name.contains(forbidden);
            ensure!(is_plain, path, "{field}"; found "{name:?}";
                expected "a name of at most {MAX_BYTES} bytes that can be part of a file name and of a table";
                help "leave out / \\ | < > \" : * ? ` and a dot at the front");
            ensure!(seen.insert(name),
                path, "{field}"; found "{name:?} twice"; expected "each name once"; help "rename one of the two");
        }
        ensure!(!seen.is_empty(), path, "{field}"; found "none"; expected "one or more"; help "list them");
        Ok(())
    }

    fn check_size(&self) -> Result<()> {
        let path = &self.path;
        ensure!(self.seeds > 0, path, "seeds"; found "0"; expected "1 or more"; help "3 show a spread");
        for kind in &self.labels {
            ensure!(kind.labelled_photos != Some(0), path, "labels {:?}, labelled_photos", kind.name; found "0";
                expected "1 or more"; help "leave it out to keep all");
        }
        let lists = [self.scenes.len(), self.labels.len(), self.rows.len()];
        let cells = lists
            .iter()
            .try_fold(self.seeds, |all, &n| all.checked_mul(n as u64));
        let found = cells.map_or("more than 2^64".into(), |cells| cells.to_string());
        ensure!(cells.is_some_and(|cells| cells <= MAX_CELLS), limit "cells of {}", path.display(); found "{found}";
            expected "{MAX_CELLS}"; help "give fewer seeds, scenes, labels or rows");
        Ok(())
    }

    /// Checks that no table sets keys that other parts of the plan decide, and that each row has valid settings.
    fn check_settings(&self) -> Result<()> {
        self.check_table("settings", &self.settings, &[])?;
        let scene = &self.scenes[0];
        self.stage_one(scene)
            .map_err(|error| self.in_file(error, "settings"))?;
        for labels in &self.labels {
            let location = format!("labels {:?}", labels.name);
            self.check_table(&location, &labels.settings, &["building"])?;
            self.reading(scene, labels)
                .map_err(|error| self.in_file(error, &location))?;
            for row in &self.rows {
                let location = format!("rows {:?}", row.name);
                self.check_table(&location, &row.settings, &["building", "data"])?;
                self.stage_two(scene, labels, row, 0, PathBuf::new())
                    .map_err(|error| self.in_file(error, &location))?;
            }
        }
        Ok(())
    }

    /// `shared` are sections that only the plan's own settings may have.
    fn check_table(&self, location: &str, table: &Table, shared: &[&str]) -> Result<()> {
        let has = |key: &str| {
            let mut parts = key.split('.');
            let first = parts.next().and_then(|section| table.get(section));
            parts.fold(first, |value, name| value?.get(name)).is_some()
        };
        if let Some((key, help)) = OWN_KEYS.iter().find(|(key, _)| has(key)) {
            bail!(&self.path, "{location}, {key}"; found "a value"; expected "no such setting in a plan"; help "{help}");
        }
        if let Some(section) = shared.iter().find(|section| has(section)) {
            bail!(&self.path, "{location}, {section}"; found "a setting of its own";
                expected "the same {section} for all rows, so that they compare over the same Gaussians and labels";
                help "put it into [settings] or, of data, into the settings of [[labels]]");
        }
        Ok(())
    }

    /// A fault of settings as one of the file.
    fn in_file(&self, error: Error, location: &str) -> Error {
        match error {
            Error::Config {
                key,
                found,
                expected,
                help,
            } => {
                invalid!(&self.path, "{location}, {key}"; found "{found}"; expected "{expected}"; help "{help}")
            }
            other => other,
        }
    }
}

//! The plan of a table: scenes, kinds of labels, rows and seeds, read from a TOML file.

use super::CellId;
use crate::config::{BuildingConfig, Config, Variant};
use crate::data::LoadOptions;
use crate::error::{Error, Result, invalid};
use crate::files;
use serde::Deserialize;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use toml::Table;

/// Most cells of a plan.
const MOST_CELLS: u64 = 10_000;
/// Most bytes of a name, which is part of file names.
const MOST_BYTES: usize = 60;

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
#[derive(Clone, Debug)]
pub struct Plan {
    /// The file.
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
    pub rows: Vec<Row>,
    settings: Table,
}

/// A scene of a plan.
#[derive(Clone, Debug)]
pub struct SceneFolder {
    /// Name of the folder, or [`BUILTIN`].
    pub name: String,
    /// The folder; absent for the built-in room.
    pub dir: Option<PathBuf>,
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
pub struct Row {
    /// Its name.
    pub name: String,
    /// What is trained.
    pub variant: Variant,
    #[serde(default)]
    settings: Table,
}

/// The file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PlanFile {
    title: String,
    scenes: Vec<String>,
    seeds: u64,
    #[serde(default)]
    settings: Table,
    labels: Vec<LabelKind>,
    rows: Vec<Row>,
}

impl Plan {
    /// Reads and checks the plan at `path`. Its scenes are folders within `root`, or else within the folder of the
    /// file; `builtin` is the built-in room.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Input`] naming the field of the file; [`Error::Missing`] for a scene that is not there;
    /// [`Error::Limit`] for too many cells.
    pub fn read(path: &Path, root: Option<&Path>) -> Result<Self> {
        let text = files::text(path)?;
        let form = "a plan: title, scenes, seeds, [settings], [[labels]] with name, labelled_photos and settings, \
                    [[rows]] with name, variant and settings";
        let file: PlanFile = files::toml(&text, path, form)?;
        let root = root.or(path.parent()).unwrap_or(Path::new("."));
        let scene = |given: &String| SceneFolder {
            name: folder_name(given),
            dir: (given != BUILTIN).then(|| root.join(given)),
        };
        let plan = Self {
            path: path.to_owned(),
            title: file.title.trim().to_owned(),
            scenes: file.scenes.iter().map(scene).collect(),
            seeds: file.seeds,
            labels: file.labels,
            rows: file.rows,
            settings: file.settings,
        };
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

    /// Settings of stage one of a scene.
    ///
    /// # Errors
    /// [`Error::Config`].
    pub(super) fn stage_one(&self, scene: &SceneFolder) -> Result<Config> {
        let mut config = Config::of_tables(&[&self.settings])?;
        config.data.dir = scene.dir.clone();
        config.segmentation.rows = Some(Vec::new());
        Ok(config)
    }

    /// Settings under which the scene of a kind of labels is read.
    ///
    /// # Errors
    /// [`Error::Config`].
    pub(super) fn reading(&self, scene: &SceneFolder, labels: &LabelKind) -> Result<Config> {
        let mut config = Config::of_tables(&[&self.settings, &labels.settings])?;
        config.data.dir = scene.dir.clone();
        Ok(config)
    }

    /// Settings of a cell, without its variant: stage two on Gaussians that are taken as they are.
    ///
    /// # Errors
    /// [`Error::Config`].
    pub(super) fn stage_two(
        &self,
        scene: &SceneFolder,
        labels: &LabelKind,
        row: &Row,
        seed: u64,
        gaussians: PathBuf,
    ) -> Result<Config> {
        let mut config = Config::of_tables(&[&self.settings, &labels.settings, &row.settings])?;
        config.data.dir = scene.dir.clone();
        config.seed = seed;
        config.building = BuildingConfig::taking(gaussians);
        Ok(config)
    }

    /// How the scene of a kind of labels is read, to know its files.
    pub(super) fn load_options(
        &self,
        scene: &SceneFolder,
        labels: &LabelKind,
    ) -> Result<LoadOptions> {
        self.reading(scene, labels)
            .map(|config| LoadOptions::from(&config))
    }

    fn refused(&self, field: &str, found: &str, expected: &str, help: &str) -> Error {
        Error::input(&self.path, field, found, expected, help)
    }

    fn check_names(&self) -> Result<()> {
        if self.title.is_empty() || self.title.contains(char::is_control) {
            let found = format!("{:?}", self.title);
            return Err(self.refused(
                "title",
                &found,
                "a line of text",
                "name what the table shows",
            ));
        }
        let scenes: Vec<&str> = self.scenes.iter().map(|scene| &*scene.name).collect();
        let labels: Vec<&str> = self.labels.iter().map(|kind| &*kind.name).collect();
        let rows: Vec<&str> = self.rows.iter().map(|row| &*row.name).collect();
        for (field, names) in [("scenes", scenes), ("labels", labels), ("rows", rows)] {
            self.check_list(field, &names)?;
        }
        for scene in &self.scenes {
            if let Some(dir) = scene.dir.as_ref().filter(|dir| !dir.is_dir()) {
                return Err(Error::Missing {
                    what: "folder",
                    path: dir.clone(),
                    help: format!(
                        "{} names it in `scenes`, relative to --data-root or else to the plan",
                        self.path.display()
                    ),
                });
            }
        }
        Ok(())
    }

    /// Checks the names of a list: one or more, each usable as a file name, none twice.
    fn check_list(&self, field: &str, names: &[&str]) -> Result<()> {
        if names.is_empty() {
            return Err(self.refused(field, "none", "one or more", "list them"));
        }
        let mut seen = BTreeSet::new();
        for (i, name) in names.iter().enumerate() {
            let field = format!("{field}, number {}", i + 1);
            let forbidden = |c: char| c.is_control() || "/\\|<>\":*?`".contains(c);
            let is_plain = !name.trim().is_empty()
                && name.trim() == *name
                && name.len() <= MOST_BYTES
                && !name.starts_with('.')
                && !name.contains(forbidden);
            if !is_plain {
                let expected = format!(
                    "a name of at most {MOST_BYTES} bytes that can be part of a file name and of a table"
                );
                let help = "leave out / \\ | < > \" : * ? ` and a dot at the front";
                return Err(self.refused(&field, &format!("{name:?}"), &expected, help));
            }
            if !seen.insert(*name) {
                let found = format!("{name:?} twice");
                return Err(self.refused(
                    &field,
                    &found,
                    "each name once",
                    "rename one of the two",
                ));
            }
        }
        Ok(())
    }

    fn check_size(&self) -> Result<()> {
        if self.seeds == 0 {
            return Err(self.refused("seeds", "0", "1 or more", "3 show a spread"));
        }
        if let Some(kind) = self
            .labels
            .iter()
            .find(|kind| kind.labelled_photos == Some(0))
        {
            let field = format!("labels {:?}, labelled_photos", kind.name);
            return Err(self.refused(&field, "0", "1 or more", "leave it out to keep all"));
        }
        let lists = [self.scenes.len(), self.labels.len(), self.rows.len()];
        let cells = lists
            .iter()
            .try_fold(self.seeds, |all, &n| all.checked_mul(n as u64));
        match cells {
            Some(cells) if cells <= MOST_CELLS => Ok(()),
            _ => Err(Error::Limit {
                what: format!("cells of {}", self.path.display()),
                found: cells.map_or("more than 2^64".into(), |cells| cells.to_string()),
                limit: MOST_CELLS.to_string(),
                help: "give fewer seeds, scenes, labels or rows".into(),
            }),
        }
    }

    /// Checks that no table sets what other parts of the plan decide, and that each row has valid settings.
    fn check_settings(&self) -> Result<()> {
        self.check_table("settings", &self.settings, &[])?;
        let scene = &self.scenes[0];
        self.stage_one(scene)
            .map_err(|error| self.in_file(error, "settings"))?;
        for labels in &self.labels {
            let place = format!("labels {:?}", labels.name);
            self.check_table(&place, &labels.settings, &["building"])?;
            self.reading(scene, labels)
                .map_err(|error| self.in_file(error, &place))?;
            for row in &self.rows {
                let place = format!("rows {:?}", row.name);
                self.check_table(&place, &row.settings, &["building", "data"])?;
                self.stage_two(scene, labels, row, 0, PathBuf::new())
                    .map_err(|error| self.in_file(error, &place))?;
            }
        }
        Ok(())
    }

    /// `shared` are sections that only the plan's own settings may have.
    fn check_table(&self, place: &str, table: &Table, shared: &[&str]) -> Result<()> {
        let given = |key: &str| {
            let mut parts = key.split('.');
            let first = parts.next().and_then(|section| table.get(section));
            parts.fold(first, |value, name| value?.get(name)).is_some()
        };
        if let Some((key, help)) = OWN_KEYS.iter().find(|(key, _)| given(key)) {
            let field = format!("{place}, {key}");
            return Err(self.refused(&field, "a value", "no such setting in a plan", help));
        }
        if let Some(section) = shared.iter().find(|section| given(section)) {
            return Err(
                invalid!(&self.path, "{place}, {section}"; found "a setting of its own";
                expected "the same {section} for all rows, so that they compare over equal Gaussians and labels";
                help "put it into [settings] or, of data, into the settings of [[labels]]"),
            );
        }
        Ok(())
    }

    /// A fault of settings as one of the file.
    fn in_file(&self, error: Error, place: &str) -> Error {
        match error {
            Error::Config {
                key,
                found,
                expected,
                help,
            } => self.refused(&format!("{place}, {key}"), &found, &expected, &help),
            other => other,
        }
    }
}

/// The last part of a path.
fn folder_name(path: &str) -> String {
    let name = Path::new(path).file_name();
    name.map_or(String::new(), |name| name.to_string_lossy().into_owned())
}

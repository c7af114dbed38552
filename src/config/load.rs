//! From files and `--set` overrides to a checked [`Config`], and back to TOML.

use super::assignment::{Assignment, assigned, assignments, fault, parse_set};
use super::{Config, Preset};
use crate::error::{Error, Result, invalid};
use crate::files;
use std::path::{Path, PathBuf};
use toml::Table;

impl Config {
    /// Reads the settings of a run: the preset first, then `file`, then each `section.key=value` of `sets`.
    ///
    /// The values of `sets` are TOML. Text needs no quotes, lists may be written `a,b,c`, and an empty value removes an
    /// optional path. Relative paths start from the working folder.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read; [`Error::Input`] for a fault in the file (syntax, unknown key, wrong
    /// type, value out of range), naming line and key; [`Error::Config`] for the same in `sets`, and
    /// [`Error::Argument`] for one of these that is not a `section.key=value`.
    pub fn load(file: Option<&Path>, sets: &[String]) -> Result<Self> {
        Self::load_over(file, sets, |preset, _| Self::preset(preset))
    }

    /// The same for the scene folder `data`, or else for the one that the settings name. Without either the run trains the
    /// built-in scene and starts from [`Config::builtin_preset`].
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn load_for(data: Option<&Path>, file: Option<&Path>, sets: &[String]) -> Result<Self> {
        let mut config = Self::load_over(file, sets, |preset, values| {
            if data.is_some() || names_folder(values) {
                Self::preset(preset)
            } else {
                Self::builtin_preset(preset)
            }
        })?;
        config.data.dir = data.map(Path::to_owned).or(config.data.dir);
        Ok(config)
    }

    /// The values of `file` and `sets` over what `base` makes of their preset.
    fn load_over(
        file: Option<&Path>,
        sets: &[String],
        base: impl FnOnce(Preset, &[Assignment<'_>]) -> Self,
    ) -> Result<Self> {
        let text = file.map_or(Ok(String::new()), files::text)?;
        let mut values = file.map_or(Ok(Vec::new()), |path| assignments(path, &text))?;
        for set in sets {
            values.push(parse_set(set)?);
        }
        base(chosen_preset(&values)?, &values).with(&values)
    }

    /// The settings of a run of a scene folder: the preset first, then the values of each of `tables`.
    ///
    /// # Errors
    /// [`Error::Config`] for an unknown key, a wrong type or a value out of range.
    pub(crate) fn of_tables(tables: &[&Table]) -> Result<Self> {
        let tables = tables.iter().map(|table| (*table).clone());
        let values: Vec<_> = tables.flat_map(|table| assigned(table, None)).collect();
        Self::preset(chosen_preset(&values)?).with(&values)
    }

    /// The settings that a run whose settings file is at `path` rendered with: its section `[raster]` and its
    /// `segmentation.min_coverage`, over its preset. The defaults where the file has no such section, as in files of other
    /// programs. Other sections are ignored, so that unknown keys there do no harm.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn rendering_of(path: &Path) -> Result<Self> {
        let text = files::text(path)?;
        let mut values = assignments(path, &text)?;
        let is_raster = |key: &str| key.starts_with("raster.");
        if !values.iter().any(|one| is_raster(&one.key)) {
            return Ok(Self::default());
        }
        values.retain(|one| {
            is_raster(&one.key) || ["preset", "segmentation.min_coverage"].contains(&&*one.key)
        });
        Self::preset(chosen_preset(&values)?).with(&values)
    }

    /// `data.dataparser_transforms` of the settings file at `path`. Other settings are ignored, so that unknown keys there do no harm.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn dataparser_transforms_of(path: &Path) -> Result<Option<PathBuf>> {
        let text = files::text(path)?;
        let mut values = assignments(path, &text)?;
        values.retain(|one| one.key == "data.dataparser_transforms");
        Ok(Self::default().with(&values)?.data.dataparser_transforms)
    }

    /// This config with each value of `values`, checked.
    fn with(mut self, values: &[Assignment<'_>]) -> Result<Self> {
        // One at a time, so that an error belongs to one key.
        for one in values {
            self = one.apply(&self)?;
        }
        self.validate().map_err(|error| in_file(error, values))?;
        Ok(self)
    }

    /// This config with paths that do not depend on the working folder.
    ///
    /// # Errors
    /// [`Error::Io`] when the working folder is gone.
    pub fn with_absolute_paths(mut self) -> Result<Self> {
        for path in self.paths() {
            *path = files::absolute(path)?;
        }
        // It may be the name of a shipped contract.
        if let Some(contract) = &mut self.features.contract
            && Path::new(contract).is_file()
        {
            *contract = files::absolute(Path::new(contract))?.display().to_string();
        }
        Ok(self)
    }

    /// This config as TOML; [`Config::load`] of it gives the same config.
    ///
    /// # Errors
    /// [`Error::Argument`] when a value has no TOML form (a seed beyond 2^63 - 1).
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self).map_err(|e| {
            invalid!(argument "settings"; found "{e}"; expected "settings that TOML can hold";
                help "check seed and paths")
        })
    }
}

/// Whether a scene folder is named. The last value counts; an empty one removes the folder.
fn names_folder(values: &[Assignment<'_>]) -> bool {
    let last = values.iter().rfind(|one| one.key == "data.dir");
    last.is_some_and(|one| one.readings[0].as_str() != Some(""))
}

/// The preset that applies: the last one given.
fn chosen_preset(values: &[Assignment<'_>]) -> Result<Preset> {
    match values.iter().rfind(|one| one.key == "preset") {
        Some(last) => Ok(last.apply(&Config::default())?.preset),
        None => Ok(Preset::Default),
    }
}

/// A range error as the file's fault, when the value came from the file.
fn in_file(error: Error, values: &[Assignment<'_>]) -> Error {
    match error {
        Error::Config {
            key,
            found,
            expected,
            help,
        } => {
            let file = values.iter().rfind(|one| one.key == key);
            fault(file.and_then(|one| one.file), &key, found, expected, help)
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::assignment::{flatten, table_of};
    use crate::config::{FeatureSource, LabelLoss, Prior, SpatialSource, Variant};
    use std::path::PathBuf;
    use toml::{Table, Value};

    /// Every key with a value: the union of configs that have all optional keys and all payloads.
    fn template() -> Table {
        let path = || PathBuf::from("path");
        let mut full = Config::default();
        full.building.gaussians = Some(path());
        full.building.gradient_threshold = Some(2e-4);
        full.building.batch = Some(2);
        full.segmentation.batch = Some(2);
        full.pooling.exponent = Some(0.5);
        full.segmentation.prior = Some(Prior::Votes);
        full.segmentation.loss = Some(LabelLoss::GCE);
        full.segmentation.pixel_share = Some(0.5);
        full.segmentation.fine_tune = Some(true);
        full.segmentation.rows = Some(Variant::COMPARED.to_vec());
        full.data.dir = Some(path());
        full.features.weights = Some(path());
        full.features.contract = Some("name".to_owned());
        full.features.cache_dir = Some(path());
        let mut other = full.clone();
        other.features.source = FeatureSource::Import(path());
        other.spatial.source = SpatialSource::Pretrained(path());
        other.segmentation.loss = Some(LabelLoss::Js { pi_rl: 0.9 });
        let mut union = Table::new();
        for config in [full, other] {
            merge(&mut union, table_of(&config));
        }
        union
    }

    /// Adds the keys of `more`; a payload replaces the name of a variant without one.
    fn merge(union: &mut Table, more: Table) {
        for (name, value) in more {
            match (union.get_mut(&name), value) {
                (Some(Value::Table(known)), Value::Table(more)) => merge(known, more),
                (Some(Value::Table(_)), _) => {}
                (_, value) => _ = union.insert(name, value),
            }
        }
    }

    /// Keys for labels of a network, for labels by hand, and for several processes. The bound holds for all others.
    const BEYOND_THE_METHOD: [&str; 8] = [
        "data.labels_by",
        "pooling.distance",
        "pooling.superpoints",
        "pooling.confusion",
        "pooling.exponent",
        "segmentation.fine_tune",
        "building.batch",
        "segmentation.batch",
    ];

    #[test]
    fn the_method_has_at_most_sixty_keys() {
        let mut keys = Vec::new();
        flatten(template(), "", &mut keys);
        let all = keys.len();
        keys.retain(|(key, _)| !BEYOND_THE_METHOD.contains(&key.as_str()));
        assert_eq!(keys.len() + BEYOND_THE_METHOD.len(), all, "a key is gone");
        assert!(
            (50..=60).contains(&keys.len()),
            "{} keys: {keys:#?}",
            keys.len()
        );
    }
}

//! From files and `--set` overrides to a checked [`Config`], and back to TOML.

use super::{Config, Preset};
use crate::error::{Error, Result};
use crate::files;
use std::path::Path;
use toml::{Table, Value};

/// A value that a file or `--set` gives to a key.
struct Assignment<'a> {
    /// Dotted.
    key: String,
    /// What the value may mean: the first that the key can hold counts.
    readings: Vec<Value>,
    /// The file and its text; `None` for `--set`.
    file: Option<(&'a Path, &'a str)>,
}

impl Config {
    /// Reads the settings of a run: the preset first, then `file`, then each `section.key=value` of `sets`.
    ///
    /// The values of `sets` are TOML. Text needs no quotes, lists may be written `a,b,c`, and an empty value removes an
    /// optional path. Relative paths start from the working folder.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read; [`Error::Input`] for a fault in the file (syntax, unknown key, wrong
    /// type, value out of range), naming line and key; [`Error::Config`] for the same in `sets`, and
    /// [`Error::Argument`] for one of these that is no `section.key=value`.
    pub fn load(file: Option<&Path>, sets: &[String]) -> Result<Self> {
        Self::load_over(file, sets, |preset, _| Self::preset(preset))
    }

    /// The same for the scene folder `data`, or else for the one that the settings name. Without either the run trains the
    /// built-in scene and starts from [`Config::builtin_preset`].
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn load_for(data: Option<&Path>, file: Option<&Path>, sets: &[String]) -> Result<Self> {
        let mut config = Self::load_over(file, sets, |preset, given| {
            if data.is_some() || names_folder(given) {
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
        let mut given = file.map_or(Ok(Vec::new()), |path| assignments(path, &text))?;
        for set in sets {
            given.push(parse_set(set)?);
        }
        base(chosen_preset(&given)?, &given).with(&given)
    }

    /// The settings of a run of a scene folder: the preset first, then the values of each of `tables`.
    ///
    /// # Errors
    /// [`Error::Config`] for an unknown key, a wrong type or a value out of range.
    pub(crate) fn of_tables(tables: &[&Table]) -> Result<Self> {
        let mut values = Vec::new();
        for table in tables {
            flatten((*table).clone(), "", &mut values);
        }
        let assignment = |(key, value)| Assignment {
            key,
            readings: vec![value],
            file: None,
        };
        let given: Vec<_> = values.into_iter().map(assignment).collect();
        Self::preset(chosen_preset(&given)?).with(&given)
    }

    /// The settings that a run whose settings file is at `path` rendered with: its section `[raster]` and its
    /// `segmentation.min_coverage`, over its preset. The defaults where the file has no such section, as files of other
    /// programs. Other sections are ignored, so that unknown keys there do no harm.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn rendering_of(path: &Path) -> Result<Self> {
        let text = files::text(path)?;
        let mut given = assignments(path, &text)?;
        let is_raster = |key: &str| key.starts_with("raster.");
        if !given.iter().any(|one| is_raster(&one.key)) {
            return Ok(Self::default());
        }
        given.retain(|one| {
            is_raster(&one.key) || ["preset", "segmentation.min_coverage"].contains(&&*one.key)
        });
        Self::preset(chosen_preset(&given)?).with(&given)
    }

    /// This config with each value of `given`, checked.
    fn with(mut self, given: &[Assignment<'_>]) -> Result<Self> {
        // One at a time, so that an error belongs to one key.
        for one in given {
            self = one.apply(&self)?;
        }
        self.validate().map_err(|error| in_file(error, given))?;
        Ok(self)
    }

    /// This config with paths that do not depend on the working folder.
    ///
    /// # Errors
    /// [`Error::Io`] when the working folder is gone.
    pub fn with_absolute_paths(mut self) -> Result<Self> {
        for path in self.paths() {
            *path = std::path::absolute(&*path).map_err(|e| Error::io(&*path, "find", e))?;
        }
        Ok(self)
    }

    /// This config as TOML; [`Config::load`] of it gives the same config.
    ///
    /// # Errors
    /// [`Error::Argument`] when a value has no TOML form (a seed beyond 2^63 - 1).
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self).map_err(|e| {
            let expected = "settings that TOML can hold";
            Error::argument("settings", e.to_string(), expected, "check seed and paths")
        })
    }
}

/// The values of a file.
fn assignments<'a>(path: &'a Path, text: &'a str) -> Result<Vec<Assignment<'a>>> {
    let table = text
        .parse::<Table>()
        .map_err(|e| syntax_error(path, text, &e))?;
    let mut values = Vec::new();
    flatten(table, "", &mut values);
    let assignment = |(key, value)| Assignment {
        key,
        readings: vec![value],
        file: Some((path, text)),
    };
    Ok(values.into_iter().map(assignment).collect())
}

/// The values of a table by their dotted keys.
fn flatten(table: Table, prefix: &str, out: &mut Vec<(String, Value)>) {
    for (name, value) in table {
        let key = format!("{prefix}{name}");
        match value {
            Value::Table(inner) if !inner.is_empty() => flatten(inner, &format!("{key}."), out),
            value => out.push((key, value)),
        }
    }
}

fn parse_set<'a>(set: &str) -> Result<Assignment<'a>> {
    let Some((key, text)) = set.split_once('=') else {
        let help = "for instance --set building.iterations=3000";
        return Err(Error::argument("--set", set, "section.key=value", help));
    };
    let text = text.trim();
    let items = text.trim_matches(['[', ']']).split(',');
    let items = items.filter(|item| !item.trim().is_empty()).map(value_of);
    Ok(Assignment {
        key: key.trim().to_owned(),
        readings: vec![value_of(text), text.into(), Value::Array(items.collect())],
        file: None,
    })
}

/// The value of a TOML text, or else the text itself.
fn value_of(text: &str) -> Value {
    let table = format!("v = {text}").parse::<Table>();
    let value = table.ok().and_then(|mut table| table.remove("v"));
    value.unwrap_or_else(|| text.trim().into())
}

/// Whether a scene folder is named. The last value counts; an empty one removes the folder.
fn names_folder(given: &[Assignment<'_>]) -> bool {
    let last = given.iter().rfind(|one| one.key == "data.dir");
    last.is_some_and(|one| one.readings[0].as_str() != Some(""))
}

/// The preset that applies: the last one given.
fn chosen_preset(given: &[Assignment<'_>]) -> Result<Preset> {
    match given.iter().rfind(|one| one.key == "preset") {
        Some(last) => Ok(last.apply(&Config::default())?.preset),
        None => Ok(Preset::Default),
    }
}

/// `config` as a table. Every config that was read has such a form.
fn table_of(config: &Config) -> Table {
    Table::try_from(config).unwrap_or_default()
}

impl Assignment<'_> {
    /// `config` with this value.
    fn apply(&self, config: &Config) -> Result<Config> {
        let keys: Vec<&str> = self.key.split('.').collect();
        let mut refusal = String::new();
        for value in &self.readings {
            let wants_list = ["expected a sequence", "expected an array"]
                .iter()
                .any(|list| refusal.contains(list));
            // A list can fill a section too, which nobody means.
            if value.is_array() && !refusal.is_empty() && !wants_list {
                continue;
            }
            // A variant with a payload takes the place of another one. Only the types tell which table holds variants.
            for emptied in (1..keys.len().max(2)).rev() {
                let mut table = table_of(config);
                insert(&mut table, &keys, emptied, value);
                match table.try_into::<Config>() {
                    Ok(config) => return Ok(config),
                    Err(error) => refusal = error.message().to_owned(),
                }
            }
        }
        Err(self.refused(&refusal))
    }

    /// The error for a value of which serde says `message`.
    fn refused(&self, message: &str) -> Error {
        let mut quoted = message.split('`').skip(1).step_by(2);
        if message.contains("unknown field") {
            let unknown = quoted.next().unwrap_or_default();
            return self.unknown_key(unknown, quoted);
        }
        let expected = message.rsplit_once("expected ").map_or(message, |m| m.1);
        let expected = match expected {
            "usize" | "u64" | "u32" => "a whole number of 0 or more".to_owned(),
            "f64" | "f32" => "a number".to_owned(),
            "a boolean" => "true or false".to_owned(),
            "a sequence" => "a list of names".to_owned(),
            "newtype variant" => {
                let name = self.readings[0].as_str().unwrap_or("NAME");
                format!("its value, as {}.{name} = ...", self.key)
            }
            section if section.starts_with("struct ") && self.file.is_none() => {
                "a key within it".to_owned()
            }
            section if section.starts_with("struct ") => "a section".to_owned(),
            other => match other.strip_prefix("an array of length ") {
                Some(length) => format!("a list of {length} numbers"),
                None => other.replace('`', "\""),
            },
        };
        let found = match &self.readings[0] {
            Value::Table(_) => "a section".to_owned(),
            other => other.to_string(),
        };
        let help = "write it as expected, or leave the key out";
        fault(self.file, &self.key, found, expected, help.into())
    }

    /// The error for a part of the key that its section does not have; `known` are those that it has.
    fn unknown_key<'k>(&self, unknown: &str, known: impl Iterator<Item = &'k str>) -> Error {
        let parts = self.key.split('.');
        let section: String = parts
            .take_while(|part| *part != unknown)
            .map(|part| format!("{part}."))
            .collect();
        let key = format!("{section}{unknown}");
        let mut values = Vec::new();
        flatten(table_of(&Config::default()), "", &mut values);
        let elsewhere = values.into_iter().map(|(key, _)| key);
        let beside = known.map(|name| format!("{section}{name}"));
        let last = |key: &str| key.rsplit('.').next().unwrap_or_default().to_owned();
        // The whole key may be misspelt, or only its last part be right and the section be missing or wrong.
        let score = |k: &String| {
            strsim::jaro_winkler(k, &key).max(strsim::jaro_winkler(&last(k), unknown) - 0.05)
        };
        let nearest = beside
            .chain(elsewhere)
            .max_by(|a, b| score(a).total_cmp(&score(b)));
        let help = nearest.map_or("remove it".into(), |k| format!("did you mean {k}?"));
        fault(
            self.file,
            &key,
            "an unknown key".into(),
            "a known key".into(),
            help,
        )
    }
}

/// Puts `value` at the path `keys` of `table`. The table at depth `emptied` of the path loses its other entries.
fn insert(table: &mut Table, keys: &[&str], emptied: usize, value: &Value) {
    let [parents @ .., name] = keys else {
        return;
    };
    let mut section = table;
    for (depth, parent) in parents.iter().enumerate() {
        let inner = section
            .entry(*parent)
            .or_insert_with(|| Table::new().into());
        if depth == emptied || !inner.is_table() {
            *inner = Table::new().into();
        }
        let Value::Table(inner) = inner else {
            return;
        };
        section = inner;
    }
    // A section without keys changes nothing, and a variant that is chosen already keeps its payload.
    let keeps = |present: &Table| match value {
        Value::String(variant) => present.contains_key(variant),
        Value::Table(table) => table.is_empty(),
        _ => false,
    };
    let present = section.get(*name).and_then(Value::as_table);
    if !present.is_some_and(keeps) {
        section.insert((*name).to_owned(), value.clone());
    }
}

/// A fault of a file, by its line, or of `--set`.
fn fault(
    file: Option<(&Path, &str)>,
    key: &str,
    found: String,
    expected: String,
    help: String,
) -> Error {
    match file {
        Some((path, text)) => Error::input(path, located(text, key), found, expected, help),
        None => Error::config(key, found, expected, help),
    }
}

/// `line 12, building.iterations`, or the key alone when the line is not to be found.
fn located(text: &str, key: &str) -> String {
    match line_of(text, key) {
        Some(line) => format!("line {line}, {key}"),
        None => key.to_owned(),
    }
}

/// Line on which a dotted key is given, from 1.
fn line_of(text: &str, key: &str) -> Option<usize> {
    let document = toml::de::DeTable::parse(text).ok()?;
    let mut table = document.get_ref();
    let mut name = key;
    loop {
        let (first, rest) = name
            .split_once('.')
            .map_or((name, None), |(first, rest)| (first, Some(rest)));
        let (found, value) = table.iter().find(|(k, _)| k.get_ref() == first)?;
        match rest {
            None => return Some(line_at(text, found.span().start)),
            Some(rest) => (table, name) = (value.get_ref().as_table()?, rest),
        }
    }
}

fn line_at(text: &str, offset: usize) -> usize {
    text.bytes().take(offset).filter(|&b| b == b'\n').count() + 1
}

fn syntax_error(path: &Path, text: &str, error: &toml::de::Error) -> Error {
    let line = error.span().map_or(1, |span| line_at(text, span.start));
    let found = text
        .lines()
        .nth(line - 1)
        .unwrap_or_default()
        .trim()
        .to_owned();
    Error::input(
        path,
        format!("line {line}"),
        format!("`{found}`"),
        "TOML",
        error.message().replace('\n', ", "),
    )
}

/// A range error as the file's fault, when the value came from the file.
fn in_file(error: Error, given: &[Assignment<'_>]) -> Error {
    match error {
        Error::Config {
            key,
            found,
            expected,
            help,
        } => {
            let file = given.iter().rfind(|one| one.key == key);
            fault(file.and_then(|one| one.file), &key, found, expected, help)
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{
        AdcConfig, FeatureSource, LabelLoss, McmcConfig, SpatialSource, Strategy, Variant,
    };
    use std::path::PathBuf;

    /// Every key with a value: the union of configs that have all optional keys and all payloads.
    fn template() -> Table {
        let path = || PathBuf::from("path");
        let mut full = Config::default();
        full.building.gaussians = Some(path());
        full.building.strategy = Strategy::Adc(AdcConfig {
            threshold: Some(2e-4),
            ..AdcConfig::default()
        });
        full.segmentation.rows = Some(Variant::COMPARED.to_vec());
        full.data.dir = Some(path());
        full.features.weights = Some(path());
        full.features.cache_dir = Some(path());
        let mut other = full.clone();
        other.building.strategy = Strategy::Mcmc(McmcConfig::default());
        other.features.source = FeatureSource::Import(path());
        other.spatial.source = SpatialSource::Pretrained(path());
        other.segmentation.loss = LabelLoss::Js { pi_rl: 0.9 };
        let mut third = full.clone();
        third.segmentation.loss = LabelLoss::Gjs { pi_rl: 0.9 };
        let mut union = Table::new();
        for config in [full, other, third] {
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

    #[test]
    fn there_are_at_most_sixty_keys() {
        let mut keys = Vec::new();
        flatten(template(), "", &mut keys);
        assert!(
            (50..=60).contains(&keys.len()),
            "{} keys: {keys:#?}",
            keys.len()
        );
    }
}

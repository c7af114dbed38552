//! From files and `--set` overrides to a checked [`Config`], and back to TOML.

use super::{
    AdcConfig, Config, FeatureSource, LabelLoss, McmcConfig, Preset, SpatialSource, Strategy,
    Variant,
};
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Where a value was given; an error names it.
#[derive(Clone, Copy)]
enum Origin<'a> {
    /// A config file, with its text for line numbers.
    File(&'a Path, &'a str),
    /// `--set`.
    Set,
}

/// A value of a file or of `--set`.
struct Given<'a> {
    key: String,
    value: Value,
    origin: Origin<'a>,
}

impl Config {
    /// Reads the settings of a run: the preset first, then `file`, then each `section.key=value` of `sets`.
    ///
    /// The values of `sets` are TOML; text needs no quotes, lists of names may be written `a,b,c`, and an empty value
    /// takes an optional path away. Relative paths are meant from the working folder.
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
        base: impl FnOnce(Preset, &[Given<'_>]) -> Self,
    ) -> Result<Self> {
        let template = template()?;
        let text = match file {
            Some(path) => std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?,
            None => String::new(),
        };
        let mut given = Vec::new();
        if let Some(path) = file {
            let table = text
                .parse::<Table>()
                .map_err(|e| syntax_error(path, &text, &e))?;
            flatten(table, "", &template, Origin::File(path, &text), &mut given)?;
        }
        for set in sets {
            given.push(parse_set(set, &template)?);
        }
        from_given(&given, base(chosen_preset(&given)?, &given))
    }

    /// How a run whose settings file is at `path` rendered: its section `[raster]` and its `segmentation.min_coverage`, over
    /// its preset. The defaults where the file has no such section, as files of other programs. Other sections are ignored,
    /// so that unknown keys there do no harm.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn rendering_of(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
        let mut table = text
            .parse::<Table>()
            .map_err(|e| syntax_error(path, &text, &e))?;
        if !table.get("raster").is_some_and(Value::is_table) {
            return Ok(Self::default());
        }
        if let Some(section) = table.get_mut("segmentation").and_then(Value::as_table_mut) {
            section.retain(|key, _| key == "min_coverage");
        }
        table.retain(|key, value| {
            matches!(key, "preset" | "raster") || key == "segmentation" && value.is_table()
        });
        let mut given = Vec::new();
        flatten(
            table,
            "",
            &template()?,
            Origin::File(path, &text),
            &mut given,
        )?;
        from_given(&given, Self::preset(chosen_preset(&given)?))
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
        toml::to_string(self).map_err(|e| unrepresentable(&e))
    }
}

/// Whether a scene folder is named. The last value counts; an empty one removes the folder.
fn names_folder(given: &[Given<'_>]) -> bool {
    given
        .iter()
        .rfind(|g| g.key == "data.dir")
        .is_some_and(|g| g.value.as_str() != Some(""))
}

/// `config` with each value of `given`, checked.
fn from_given(given: &[Given<'_>], mut config: Config) -> Result<Config> {
    for one in given {
        config = apply(&config, one)?;
    }
    config.validate().map_err(|error| in_file(error, given))?;
    Ok(config)
}

fn unrepresentable(error: &toml::ser::Error) -> Error {
    Error::argument(
        "settings",
        error.to_string(),
        "settings that TOML can hold",
        "check seed and paths",
    )
}

/// Every key with a value of its type: the union of configs that have all optional keys and all payloads.
fn template() -> Result<Table> {
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
    third.features.source = FeatureSource::Segmenter("tensor".to_owned());
    third.segmentation.loss = LabelLoss::Gjs { pi_rl: 0.9 };
    let mut union = Table::new();
    for config in [full, other, third] {
        let table = Table::try_from(&config).map_err(|e| unrepresentable(&e))?;
        merge(&mut union, table);
    }
    Ok(union)
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

/// The template's value at a dotted key.
fn lookup<'t>(template: &'t Table, key: &str) -> Option<&'t Value> {
    let mut parts = key.split('.');
    let first = template.get(parts.next()?)?;
    parts.try_fold(first, |value, part| value.as_table()?.get(part))
}

/// All dotted keys that hold values.
fn leaf_keys(table: &Table, prefix: &str) -> Vec<String> {
    let mut keys = Vec::new();
    for (name, value) in table {
        match value {
            Value::Table(inner) => keys.extend(leaf_keys(inner, &format!("{prefix}{name}."))),
            _ => keys.push(format!("{prefix}{name}")),
        }
    }
    keys
}

/// The table's values in dotted form; unknown keys are errors.
fn flatten<'a>(
    table: Table,
    prefix: &str,
    template: &Table,
    origin: Origin<'a>,
    out: &mut Vec<Given<'a>>,
) -> Result<()> {
    for (name, value) in table {
        let key = format!("{prefix}{name}");
        match (lookup(template, &key), value) {
            (None, _) => return Err(unknown_key(&key, template, origin)),
            (Some(Value::Table(_)), Value::Table(inner)) if !inner.is_empty() => {
                flatten(inner, &format!("{key}."), template, origin, out)?;
            }
            (Some(_), value) => out.push(Given { key, value, origin }),
        }
    }
    Ok(())
}

fn parse_set<'a>(set: &str, template: &Table) -> Result<Given<'a>> {
    let Some((key, text)) = set.split_once('=') else {
        return Err(Error::argument(
            "--set",
            set,
            "section.key=value",
            "for instance --set building.iterations=3000",
        ));
    };
    let (key, text) = (key.trim().to_owned(), text.trim());
    let Some(expected) = lookup(template, &key) else {
        return Err(unknown_key(&key, template, Origin::Set));
    };
    let parsed = format!("v = {text}")
        .parse::<Table>()
        .ok()
        .and_then(|mut t| t.remove("v"));
    let value = match (expected, parsed) {
        (Value::String(_), Some(Value::String(text))) => Value::String(text),
        (Value::String(_), _) => Value::String(text.to_owned()),
        (Value::Array(_), None) => {
            let list = text.trim_start_matches('[').trim_end_matches(']');
            Value::Array(
                list.split(',')
                    .filter(|s| !s.trim().is_empty())
                    .map(scalar)
                    .collect(),
            )
        }
        (_, Some(value)) => value,
        (_, None) => Value::String(text.to_owned()),
    };
    Ok(Given {
        key,
        value,
        origin: Origin::Set,
    })
}

/// A list item of `--set key=a,b,c`: a number where it reads as one, else text.
fn scalar(text: &str) -> Value {
    let text = text.trim();
    text.parse()
        .map(Value::Integer)
        .or_else(|_| text.parse().map(Value::Float))
        .unwrap_or_else(|_| text.into())
}

/// The preset that applies: the last one given.
fn chosen_preset(given: &[Given<'_>]) -> Result<Preset> {
    let Some(last) = given.iter().rfind(|g| g.key == "preset") else {
        return Ok(Preset::Default);
    };
    last.value
        .clone()
        .try_into()
        .map_err(|e: toml::de::Error| wrong_value(last, e.message()))
}

/// `config` with one value replaced. One at a time, so that an error belongs to one key.
fn apply(config: &Config, given: &Given<'_>) -> Result<Config> {
    let keys: Vec<&str> = given.key.split('.').collect();
    let mut first_error = String::new();
    // A key of another variant of an enum takes the place of its siblings. Which level holds the enum only the types tell.
    for alone in (1..=keys.len()).rev() {
        let mut table = Table::try_from(config).map_err(|e| unrepresentable(&e))?;
        put(&mut table, &keys, alone, given);
        match table.try_into() {
            Ok(config) => return Ok(config),
            Err(error) if first_error.is_empty() => first_error = error.message().to_owned(),
            Err(_) => {}
        }
    }
    Err(wrong_value(given, &first_error))
}

/// Puts a value at the path `keys` below `section`; the siblings of what lies `alone` levels below go.
fn put(section: &mut Table, keys: &[&str], alone: usize, given: &Given<'_>) {
    let [name, below @ ..] = keys else {
        return;
    };
    if alone == 0 {
        section.retain(|key, _| key == *name);
    }
    if !below.is_empty() {
        let inner = section.entry(*name).or_insert_with(|| Table::new().into());
        if let Value::String(_) = inner {
            *inner = Table::new().into();
        }
        if let Value::Table(inner) = inner {
            put(inner, below, alone.wrapping_sub(1), given);
        }
        return;
    }
    let present = section.get(*name).and_then(Value::as_table);
    let keeps = |present: &Table| match &given.value {
        Value::String(variant) => present.contains_key(variant),
        Value::Table(table) => table.is_empty(),
        _ => false,
    };
    // A variant that is chosen already keeps its payload.
    if present.is_some_and(keeps) {
        return;
    }
    if given.value.as_str() == Some("") && is_optional(&given.key) {
        section.remove(*name);
    } else {
        section.insert((*name).to_owned(), given.value.clone());
    }
}

/// Whether a key may be absent from a written config.
fn is_optional(key: &str) -> bool {
    Table::try_from(Config::default()).is_ok_and(|table| lookup(&table, key).is_none())
}

fn wrong_value(given: &Given<'_>, message: &str) -> Error {
    let expected = match template().ok().as_ref().and_then(|t| lookup(t, &given.key)) {
        // An enumeration: serde lists what there is.
        _ if message.starts_with("unknown variant") => message
            .split_once("expected ")
            .map_or(message, |(_, list)| list)
            .replace('`', "\""),
        Some(Value::Table(_)) if message.contains("unit variant") => {
            format!(
                "its value, as {}.{} = ...",
                given.key,
                given.value.as_str().unwrap_or("NAME")
            )
        }
        Some(Value::Table(_)) => match given.origin {
            Origin::File(..) => "a section".to_owned(),
            Origin::Set => "a key within it".to_owned(),
        },
        Some(Value::Boolean(_)) => "true or false".to_owned(),
        Some(Value::Integer(_)) => "a whole number of 0 or more".to_owned(),
        Some(Value::Float(_)) => "a number".to_owned(),
        Some(Value::String(_)) => "text".to_owned(),
        Some(Value::Array(items)) => match items.first() {
            Some(Value::String(_)) => "a list of names".to_owned(),
            _ => format!("a list of {} numbers", items.len()),
        },
        _ => message.to_owned(),
    };
    fault(
        given.origin,
        &given.key,
        describe(&given.value),
        expected,
        "write it as expected, or leave the key out".into(),
    )
}

fn describe(value: &Value) -> String {
    match value {
        Value::Table(_) => "a section".to_owned(),
        other => other.to_string(),
    }
}

fn fault(origin: Origin<'_>, key: &str, found: String, expected: String, help: String) -> Error {
    match origin {
        Origin::File(path, text) => Error::input(path, located(text, key), found, expected, help),
        Origin::Set => Error::config(key, found, expected, help),
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

fn unknown_key(key: &str, template: &Table, origin: Origin<'_>) -> Error {
    let mut keys = leaf_keys(template, "");
    keys.extend(
        template
            .iter()
            .filter(|(_, v)| v.is_table())
            .map(|(k, _)| k.clone()),
    );
    let last = |k: &str| k.rsplit('.').next().unwrap_or_default().to_owned();
    // The whole key may be misspelt, or only its last part be right and the section be missing or wrong.
    let score = |k: &String| {
        strsim::jaro_winkler(k, key).max(strsim::jaro_winkler(&last(k), &last(key)) - 0.05)
    };
    let nearest = keys.iter().max_by(|a, b| score(a).total_cmp(&score(b)));
    let help = nearest.map_or_else(|| "remove it".to_owned(), |k| format!("did you mean {k}?"));
    fault(
        origin,
        key,
        "an unknown key".into(),
        "a known key".into(),
        help,
    )
}

/// A range error as the file's fault, when the value came from the file.
fn in_file(error: Error, given: &[Given<'_>]) -> Error {
    match error {
        Error::Config {
            key,
            found,
            expected,
            help,
        } => {
            let origin = given
                .iter()
                .rfind(|g| g.key == key)
                .map_or(Origin::Set, |g| g.origin);
            fault(origin, &key, found, expected, help)
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_at_most_sixty_keys() {
        let keys = leaf_keys(&template().expect("plain data"), "");
        assert!(keys.len() <= 60, "{} keys: {keys:#?}", keys.len());
    }
}

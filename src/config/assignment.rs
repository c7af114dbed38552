//! The values that a settings file or `--set` gives to keys, and errors that name file, line and key.

use super::Config;
use crate::error::{Error, Result, bail, invalid};
use crate::files::line_at;
use std::fmt::Display;
use std::path::Path;
use toml::{Table, Value};

/// Names that are less alike are not misspellings of each other.
const ALIKE: f64 = 0.8;

/// A value that a file or `--set` gives to a key.
pub(super) struct Assignment<'a> {
    /// Dotted.
    pub key: String,
    /// What the value may mean. The first one that the key can hold counts.
    pub readings: Vec<Value>,
    /// The file and its text; `None` for `--set`.
    pub file: Option<(&'a Path, &'a str)>,
}

/// The values of a file.
pub(super) fn assignments<'a>(path: &'a Path, text: &'a str) -> Result<Vec<Assignment<'a>>> {
    let table = text
        .parse::<Table>()
        .map_err(|e| syntax_error(path, text, &e))?;
    Ok(assigned(table, Some((path, text))))
}

/// The values of a table, of a file if it is given.
pub(super) fn assigned<'a>(table: Table, file: Option<(&'a Path, &'a str)>) -> Vec<Assignment<'a>> {
    let mut values = Vec::new();
    flatten(table, "", &mut values);
    let assignment = |(key, value)| Assignment {
        key,
        readings: vec![value],
        file,
    };
    values.into_iter().map(assignment).collect()
}

/// The values of a table by their dotted keys.
pub(super) fn flatten(table: Table, prefix: &str, out: &mut Vec<(String, Value)>) {
    for (name, value) in table {
        let key = format!("{prefix}{name}");
        match value {
            Value::Table(inner) if !inner.is_empty() => flatten(inner, &format!("{key}."), out),
            value => out.push((key, value)),
        }
    }
}

pub(super) fn parse_set<'a>(set: &str) -> Result<Assignment<'a>> {
    let Some((key, text)) = set.split_once('=') else {
        bail!(argument "--set"; found "{set}"; expected "section.key=value";
            help "for instance --set building.iterations=3000");
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

/// `config` as a table. Every config that was read can be written as one.
pub(super) fn table_of(config: &Config) -> Table {
    Table::try_from(config).unwrap_or_default()
}

impl Assignment<'_> {
    /// `config` with this value.
    pub fn apply(&self, config: &Config) -> Result<Config> {
        let keys: Vec<&str> = self.key.split('.').collect();
        let mut refusal = String::new();
        for value in &self.readings {
            let wants_list = ["expected a sequence", "expected an array"]
                .iter()
                .any(|list| refusal.contains(list));
            // A list can fill a section too, which nobody intends.
            if value.is_array() && !refusal.is_empty() && !wants_list {
                continue;
            }
            // A variant with a payload replaces another one. Only the types tell which table holds variants.
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

    /// The error for a value that serde refuses with `message`.
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
        if message.starts_with("unknown variant") {
            let unknown = quoted.next().unwrap_or_default();
            return self.unknown_variant(unknown, quoted, &expected);
        }
        let help = "write it as expected, or leave the key out";
        fault(self.file, &self.key, found, expected, help)
    }

    /// The error for a name that is none of `known`; `expected` lists these. It may be one of several in a list.
    fn unknown_variant<'k>(
        &self,
        unknown: &str,
        known: impl Iterator<Item = &'k str>,
        expected: &str,
    ) -> Error {
        let score = |name: &str| strsim::jaro_winkler(name, unknown);
        let nearest = known.max_by(|a, b| score(a).total_cmp(&score(b)));
        let help = match nearest.filter(|name| score(name) > ALIKE) {
            Some(name) => format!("did you mean {name}?"),
            None => "write it as expected, or leave the key out".to_owned(),
        };
        fault(self.file, &self.key, format!("{unknown:?}"), expected, help)
    }

    /// The error for a part of the key that its section does not have. `known` lists the keys of the section.
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
        // The whole key may be misspelt, or its last part may be right and its section missing or wrong.
        let score = |k: &String| {
            strsim::jaro_winkler(k, &key).max(strsim::jaro_winkler(&last(k), unknown) - 0.05)
        };
        let nearest = beside
            .chain(elsewhere)
            .max_by(|a, b| score(a).total_cmp(&score(b)));
        let nearest = nearest.filter(|key| score(key) > ALIKE);
        let help = nearest.map_or_else(
            || "docs/settings.md lists the keys".into(),
            |key| format!("did you mean {key}?"),
        );
        fault(self.file, &key, "an unknown key", "a known key", help)
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
pub(super) fn fault(
    file: Option<(&Path, &str)>,
    key: &str,
    found: impl Display,
    expected: impl Display,
    help: impl Display,
) -> Error {
    match file {
        Some((path, text)) => {
            let line = line_of(text, key).map(|line| format!("line {line}, "));
            invalid!(path, "{}{key}", line.unwrap_or_default(); found "{found}";
                expected "{expected}"; help "{help}")
        }
        None => invalid!(setting "{key}"; found "{found}"; expected "{expected}"; help "{help}"),
    }
}

/// Line on which a dotted key is given, from 1.
fn line_of(text: &str, key: &str) -> Option<usize> {
    let document = toml::de::DeTable::parse(text).ok()?;
    let names: Vec<&str> = key.split('.').collect();
    let (name, sections) = names.split_last()?;
    let mut table = document.get_ref();
    for section in sections {
        table = table.get(*section)?.get_ref().as_table()?;
    }
    let (found, _) = table.get_key_value(*name)?;
    Some(line_at(text, found.span().start))
}

fn syntax_error(path: &Path, text: &str, error: &toml::de::Error) -> Error {
    let line = error.span().map_or(1, |span| line_at(text, span.start));
    let found = text.lines().nth(line - 1).unwrap_or_default();
    invalid!(path, "line {line}"; found "`{}`", found.trim(); expected "TOML";
        help "{}", error.message().replace('\n', ", "))
}

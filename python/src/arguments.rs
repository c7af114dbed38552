//! Arguments as the command line writes them.

use crate::raised;
use coseg::backend::device::BackendName;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyString, PyTuple};
use std::path::PathBuf;

/// `KEY=VALUE` for each of `settings`, as `--set` takes them.
pub fn sets(settings: Option<&Bound<'_, PyDict>>) -> PyResult<Vec<String>> {
    let Some(settings) = settings else {
        return Ok(Vec::new());
    };
    let mut sets = Vec::new();
    for (key, value) in settings {
        let key: String = key.extract()?;
        let value = match value.cast::<PyString>() {
            Ok(text) => text.to_string(),
            Err(_) => toml(&key, &value)?,
        };
        sets.push(format!("{key}={value}"));
    }
    Ok(sets)
}

/// A basic string of TOML.
fn quoted(text: &str) -> String {
    let escaped = |c: char| match c {
        '"' | '\\' => format!("\\{c}"),
        c if c.is_control() => format!("\\u{:04X}", u32::from(c)),
        c => c.to_string(),
    };
    format!("\"{}\"", text.chars().map(escaped).collect::<String>())
}

/// A value as TOML.
fn toml(key: &str, value: &Bound<'_, PyAny>) -> PyResult<String> {
    if let Ok(value) = value.cast::<PyBool>() {
        return Ok(value.is_true().to_string());
    }
    if value.is_instance_of::<PyInt>() || value.is_instance_of::<PyFloat>() {
        return Ok(value.str()?.to_string());
    }
    if let Ok(text) = value.cast::<PyString>() {
        return Ok(quoted(&text.to_string()));
    }
    if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
        let items = value.try_iter()?.map(|item| toml(key, &item?));
        let items = items.collect::<PyResult<Vec<String>>>()?;
        return Ok(format!("[{}]", items.join(", ")));
    }
    // Files and folders.
    if let Ok(path) = value.extract::<PathBuf>() {
        return Ok(path.display().to_string());
    }
    let kind = value.get_type().name()?;
    let expected = "expected a string, a number, a bool, a path, or a list of these";
    Err(PyTypeError::new_err(format!(
        "set {key}: found {kind}, {expected}"
    )))
}

/// The backend of this name.
pub fn backend(name: Option<&str>) -> PyResult<Option<BackendName>> {
    name.map(str::parse).transpose().map_err(raised)
}

//! A scene folder, and the faults found in it.

use crate::config::Layout;
use crate::data::LoadOptions;
use crate::error::{Error, Result};
use crate::files::file_name;
use std::path::Path;

/// A scene folder, and how it is read.
#[derive(Clone, Copy)]
pub(crate) struct Folder<'a> {
    pub dir: &'a Path,
    pub options: &'a LoadOptions,
    /// Never `auto`.
    pub layout: Layout,
}

/// Faults collected while the rest of a folder is checked.
#[derive(Default)]
pub(crate) struct Problems(Vec<Error>);

impl Problems {
    pub fn push(&mut self, error: Error) {
        self.0.push(error);
    }

    /// The value, if there is one. An error is recorded.
    pub fn ok<T>(&mut self, result: Result<T>) -> Option<T> {
        result.map_err(|error| self.push(error)).ok()
    }

    /// What `list` gives; a fault that it has collected is an error.
    ///
    /// # Errors
    /// Its error, or the first fault.
    pub fn first_of<T>(list: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        let mut problems = Self::default();
        let found = list(&mut problems)?;
        problems.0.into_iter().next().map_or(Ok(found), Err)
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub fn messages(&self) -> impl Iterator<Item = String> {
        self.0.iter().map(ToString::to_string)
    }

    pub fn all(self) -> Vec<Error> {
        self.0
    }
}

/// The name of the scene in the folder `dir`: that of the folder.
pub fn scene_name(dir: &Path) -> String {
    let full = dir.canonicalize().unwrap_or_else(|_| dir.to_owned());
    file_name(&full).unwrap_or_else(|| "scene".into())
}

//! Edits of a labelled scene. [`Editing`] is a scene under changes, by options of `coseg edit` or by a file of [`Edits`]: what a person
//! did in the viewer, in order, each an [`Operation`]. `docs/edits.md` describes the format. [`Corrections`] are the labels of such a
//! file that a run is trained on.

mod corrections;
mod editing;
mod operation;

pub use self::corrections::Corrections;
pub(crate) use self::editing::farthest;
pub use self::editing::{Edited, Editing};
pub use self::operation::{NewObject, Operation, Turn, is_name};

use crate::error::{Error, Result, ensure, invalid};
use crate::files;
use glam::DVec3;
use serde::Deserialize;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// The version of the format.
pub const VERSION: u32 = 1;

/// A file of edits.
#[derive(Clone, Debug, PartialEq)]
pub struct Edits {
    /// The file, for errors.
    path: PathBuf,
    /// SHA-256 of the scene file that the edits belong to, 64 hexadecimal digits.
    pub scene: String,
    /// What was done, in order.
    pub operations: Vec<Operation>,
}

/// The form of the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EditsFile {
    #[serde(rename = "version")]
    _version: u32,
    scene: String,
    operations: Vec<Value>,
}

impl Edits {
    /// Reads a file of edits. Whether they fit a scene shows when they are applied.
    ///
    /// # Errors
    /// [`crate::Error::Io`]; [`crate::Error::Input`] naming line or field: malformed JSON, another version, an operation that does not exist or
    /// lacks a part.
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(path, &files::text(path)?)
    }

    /// Edits of a `text`, which is or will be that of the file at `path`.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self> {
        const FORM: &str = "{\"version\": 1, \"scene\": \"SHA-256\", \"operations\": [..]}";
        const HELP: &str = "save the edits again in the viewer";
        let content: Value =
            serde_json::from_str(text).map_err(|e| files::json_error(path, &e, FORM))?;
        let version = content.get("version").unwrap_or(&Value::Null);
        ensure!(*version == VERSION, path, "version"; found "{}", shown(version); expected "{VERSION}";
            help "use a file that this version of coseg wrote: open the scene in a page by `coseg view`, and save there");
        let malformed = |field: &str, e: &serde_json::Error, expected: &str| invalid!(path, "{field}"; found "{e}"; expected "{expected}"; help "{HELP}");
        let file: EditsFile =
            serde_json::from_value(content).map_err(|e| malformed("edits", &e, FORM))?;
        let read = |(i, value): (usize, Value)| {
            let expected = "an operation of docs/edits.md";
            serde_json::from_value(value)
                .map_err(|e| malformed(&format!("operations[{i}]"), &e, expected))
        };
        let operations = file.operations.into_iter().enumerate().map(read);
        Ok(Self {
            path: path.to_owned(),
            scene: file.scene,
            operations: operations.collect::<Result<_>>()?,
        })
    }

    /// Applies the edits in order to the scene whose file has the SHA-256 `scene`. `origin` is what was subtracted from its
    /// positions.
    ///
    /// # Errors
    /// [`crate::Error::Input`] naming the field: the edits belong to another scene, or name a Gaussian, a label or a place that it does not
    /// have. `editing` is unusable then.
    pub fn apply(&self, editing: &mut Editing, scene: &str, origin: DVec3) -> Result<()> {
        ensure!(self.scene == scene, &self.path, "scene"; found "{}", shown(&Value::from(self.scene.as_str()));
            expected "the SHA-256 of the scene file, {scene}";
            help "name the scene whose page these edits were saved from; where it has changed since, edit it in a new page by `coseg view`");
        for (i, operation) in self.operations.iter().enumerate() {
            operation
                .apply(editing, origin)
                .map_err(|error| match error {
                    Error::Argument {
                        name,
                        found,
                        expected,
                        help,
                    } => Error::Input {
                        path: self.path.clone(),
                        field: format!("operations[{i}].{name}"),
                        found,
                        expected,
                        help,
                    },
                    other => other,
                })?;
        }
        Ok(())
    }
}

/// A value in an error: its beginning, where it is long.
fn shown(value: &Value) -> String {
    const MOST: usize = 80;
    let text = match value {
        Value::Null => return "nothing".into(),
        value => value.to_string(),
    };
    match text.char_indices().nth(MOST) {
        Some((end, _)) => format!("{}..", &text[..end]),
        None => text,
    }
}

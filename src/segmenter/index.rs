//! `label.json` in a folder of labels: which files `coseg label` wrote there, and what from.

use crate::data::Classes;
use crate::data::labels::raw::INDEX_FILE as FILE;
use crate::error::{Result, bail};
use crate::files::{self, atomic, own};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// What a folder of labels holds.
#[derive(Debug)]
pub(super) struct Index {
    folder: PathBuf,
    content: Content,
}

/// The file.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Content {
    /// The network, its contract and the user's classes by name, for people.
    made_from: BTreeMap<String, String>,
    /// SHA-256 of each file that was written, by its path within the folder.
    files: BTreeMap<String, String>,
    /// The photos that are labelled, by view.
    photos: BTreeMap<String, Entry>,
}

/// A labelled photo.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    /// SHA-256 of all that its labels follow from.
    key: String,
    /// SHA-256 of what ids mean; empty where an older program wrote the file.
    #[serde(default)]
    classes: String,
    /// Ids in its label map.
    ids: BTreeSet<u16>,
}

impl Index {
    /// The index of `folder`; empty if there is none.
    ///
    /// # Errors
    /// [`crate::Error::Io`]; [`crate::Error::Input`] for an index that does not parse, and for a folder that holds other files.
    pub fn open(folder: &Path) -> Result<Self> {
        let path = folder.join(FILE);
        let content = if path.is_file() {
            // A copy of the folder lacks the list of files that this program wrote. The index says as much.
            own::allow(folder);
            own::allow(folder.join("scores"));
            files::json(&path, "the index of a folder that `coseg label` wrote")?
        } else {
            if let Some(other) = files::names(folder, |name, _| !name.starts_with('.')).first() {
                bail!(folder, "{FILE}"; found "no such file, but {other}";
                    expected "a new or empty folder, or one that `coseg label` wrote"; help "name a new folder");
            }
            Content::default()
        };
        Ok(Self {
            folder: folder.to_owned(),
            content,
        })
    }

    /// Notes what the labels are made from.
    pub fn made_from(&mut self, parts: &[(&str, String)]) {
        let owned = |(name, text): &(&str, String)| ((*name).to_owned(), text.clone());
        self.content.made_from = parts.iter().map(owned).collect();
    }

    /// Refuses labels of other photos than `views` whose ids do not mean `classes`, a digest.
    ///
    /// # Errors
    /// [`crate::Error::Input`] naming one of these photos.
    pub fn check_classes<'a>(
        &self,
        classes: &str,
        views: impl Iterator<Item = &'a str>,
    ) -> Result<()> {
        let views: BTreeSet<&str> = views.collect();
        let mut photos = self.content.photos.iter();
        let other =
            photos.find(|(view, entry)| !views.contains(view.as_str()) && entry.classes != classes);
        if let Some((view, _)) = other {
            bail!(self.folder.join(FILE), "photos"; found "labels of {view}, which is not among the photos to label, in other classes";
                expected "labels in one set of classes"; help "name a new folder, or label all photos");
        }
        Ok(())
    }

    /// Whether the labels of a photo are there and follow from what has the digest `key`.
    pub fn is_current(&self, view: &str, key: &str, names: &[String]) -> bool {
        let entry = self.content.photos.get(view);
        entry.is_some_and(|entry| entry.key == key)
            && names.iter().all(|name| self.is_ours(name).unwrap_or(false))
    }

    /// Whether the file is there as it was written; `None` where it is not there.
    fn is_ours(&self, name: &str) -> Option<bool> {
        let bytes = files::read(&self.folder.join(name)).ok()?;
        Some(self.content.files.get(name) == Some(&digest(&bytes)))
    }

    /// Refuses to overwrite a file that was not written by this command, or was changed since.
    pub fn check_own(&self, name: &str) -> Result<()> {
        if self.is_ours(name).unwrap_or(true) {
            return Ok(());
        }
        let found = if self.content.files.contains_key(name) {
            "a file that was changed since it was written"
        } else {
            "somebody else's file"
        };
        bail!(self.folder.join(name), "content"; found "{found}"; expected "a file as `coseg label` wrote it";
            help "move it away, or name another folder");
    }

    /// Writes files with `bytes`, after an index that names them: a run that is cut off knows its own files.
    ///
    /// # Errors
    /// [`crate::Error::Io`]; as [`Index::check_own`].
    pub fn write(&mut self, files: &[(String, Vec<u8>)]) -> Result<()> {
        let mut changed = Vec::new();
        for file @ (name, bytes) in files {
            self.check_own(name)?;
            let new = digest(bytes);
            let is_written =
                self.content.files.get(name) == Some(&new) && self.folder.join(name).is_file();
            if is_written {
                continue;
            }
            self.content.files.insert(name.clone(), new);
            atomic::remove(self.folder.join(name))?;
            changed.push(file);
        }
        atomic::write_json(self.folder.join(FILE), &self.content)?;
        changed
            .into_iter()
            .try_for_each(|(name, bytes)| atomic::write_bytes(self.folder.join(name), bytes))
    }

    /// Writes the labels of a photo and notes them, with the digests of all that they follow from and of what ids mean.
    ///
    /// # Errors
    /// As [`Index::write`].
    pub fn add(
        &mut self,
        view: &str,
        [key, classes]: [String; 2],
        ids: BTreeSet<u16>,
        files: &[(String, Vec<u8>)],
    ) -> Result<()> {
        self.remove_table()?;
        let entry = Entry { key, classes, ids };
        self.content.photos.insert(view.to_owned(), entry);
        self.write(files)
    }

    /// Removes the class table, which is not of all labels again before the last photo is labelled: a folder without one is unfinished.
    fn remove_table(&self) -> Result<()> {
        self.check_own(Classes::FILE)?;
        atomic::remove(self.folder.join(Classes::FILE))
    }

    /// The ids that occur in the label maps.
    pub fn ids(&self) -> BTreeSet<u16> {
        let entries = self.content.photos.values();
        entries
            .flat_map(|entry| entry.ids.iter().copied())
            .collect()
    }
}

/// SHA-256 in hexadecimal digits.
pub(super) fn digest(bytes: &[u8]) -> String {
    format!("{:x}", Sha256::digest(bytes))
}

//! Manifests: what is known of a published scene that cannot be shipped, so that two people mean the same data by its
//! name.

use crate::config::{Layout, ScannetClasses};
use crate::data::LoadOptions;
use crate::error::{Error, Result};
use serde::Deserialize;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// A file of `data_manifests/`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Name of the scene.
    pub name: String,
    /// Page of the dataset, where it can be had and on which terms.
    pub source: String,
    /// Licence as that page states it.
    pub licence: String,
    /// Folder of the scene within the dataset as it is unpacked.
    pub folder: String,
    /// How that folder is laid out.
    pub layout: Layout,
    /// Which frames are held out, in words.
    pub split: String,
    /// Class table: `replica`, `nyu40` or `scannet20`; absent for scenes without labels.
    pub classes: Option<String>,
    /// Id of unlabelled pixels.
    pub ignore: u16,
    /// How ids in the label maps become class ids; absent: they are class ids.
    pub label_map: Option<LabelMapping>,
    /// Files that must be there.
    #[serde(default)]
    pub files: Vec<ExpectedFile>,
}

/// How ids in label maps become class ids, many to one.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(untagged)]
pub enum LabelMapping {
    /// By two columns of a tab-separated table that comes with the dataset.
    Table {
        /// Name of the table.
        table: String,
        /// Column of the ids in the label maps.
        from: String,
        /// Column of the class ids.
        to: String,
    },
    /// Id by id.
    Ids(BTreeMap<String, u16>),
}

/// A file, or files with a number in their names, that a scene must have.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExpectedFile {
    /// Path within the folder; `{}` stands for the numbers from 0 on, `{:06}` for the same with six digits.
    pub path: String,
    /// How many numbered files; absent for a single one.
    pub count: Option<usize>,
    /// Bytes, where known.
    pub size: Option<u64>,
    /// SHA-256 in hexadecimal, where known.
    pub sha256: Option<String>,
}

impl Manifest {
    /// Reads a manifest.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Input`] naming line and fault: no TOML, unknown or missing keys, a class table that
    /// there is not.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
        let manifest: Self = toml::from_str(&text).map_err(|e: toml::de::Error| {
            let start = e.span().map_or(0, |span| span.start);
            let line = text.bytes().take(start).filter(|&b| b == b'\n').count() + 1;
            let message = e.message().replace('\n', ", ");
            Error::input(
                path,
                format!("line {line}"),
                message,
                "a manifest as in data_manifests/",
                "correct the file there",
            )
        })?;
        if let Some(name) = manifest
            .classes
            .as_deref()
            .filter(|name| !["replica", "nyu40", "scannet20"].contains(name))
        {
            let expected = "replica, nyu40 or scannet20";
            return Err(Error::input(
                path,
                "classes",
                format!("{name:?}"),
                expected,
                "name a table, or leave it out",
            ));
        }
        Ok(manifest)
    }

    /// `options` with the layout and class table of the manifest.
    pub fn options(&self, options: &LoadOptions) -> LoadOptions {
        let mut options = LoadOptions {
            layout: self.layout,
            ..options.clone()
        };
        match self.classes.as_deref() {
            Some("scannet20") => options.scannet_classes = ScannetClasses::Scannet20,
            Some("nyu40") => options.scannet_classes = ScannetClasses::Nyu40,
            _ => {}
        }
        options
    }

    /// What of the expected files is missing or differs in folder `dir`; at most one fault for each entry.
    pub fn check(&self, dir: &Path) -> Vec<Error> {
        self.files
            .iter()
            .filter_map(|file| file.check(dir).err())
            .collect()
    }
}

impl ExpectedFile {
    /// The paths that are meant, in `dir`.
    fn paths(&self, dir: &Path) -> Vec<PathBuf> {
        let Some(count) = self.count else {
            return vec![dir.join(&self.path)];
        };
        let named = |i: usize| {
            self.path
                .replace("{:06}", &format!("{i:06}"))
                .replace("{}", &i.to_string())
        };
        (0..count).map(|i| dir.join(named(i))).collect()
    }

    fn check(&self, dir: &Path) -> Result<()> {
        let again = "unpack the dataset again";
        let paths = self.paths(dir);
        let missing: Vec<&PathBuf> = paths.iter().filter(|path| !path.is_file()).collect();
        if let [first, rest @ ..] = &missing[..] {
            let found = match rest.len() {
                0 => "no such file".to_owned(),
                more => format!("no such file, as {more} more of {}", paths.len()),
            };
            return Err(Error::input(
                first,
                &self.path,
                found,
                "a file that the manifest lists",
                again,
            ));
        }
        let Some(path) = paths.first().filter(|_| self.count.is_none()) else {
            return Ok(());
        };
        let length = std::fs::metadata(path)
            .map_err(|e| Error::io(path, "measure", e))?
            .len();
        if let Some(size) = self.size.filter(|size| *size != length) {
            return Err(Error::input(
                path,
                "size",
                format!("{length} bytes"),
                format!("{size} bytes"),
                again,
            ));
        }
        let Some(expected) = &self.sha256 else {
            return Ok(());
        };
        let found = sha256(path)?;
        if found.eq_ignore_ascii_case(expected) {
            return Ok(());
        }
        Err(Error::input(path, "sha256", found, expected, again))
    }
}

fn sha256(path: &Path) -> Result<String> {
    let mut file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
    let (mut hash, mut block) = (Sha256::new(), vec![0; 1 << 16]);
    loop {
        match file
            .read(&mut block)
            .map_err(|e| Error::io(path, "read", e))?
        {
            0 => return Ok(format!("{:x}", hash.finalize())),
            n => hash.update(&block[..n]),
        }
    }
}

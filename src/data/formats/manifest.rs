//! Manifests: the layout and files of a published scene that cannot be shipped, so that its name means the same data to
//! everybody.

use crate::config::{Layout, ScannetClasses};
use crate::data::LoadOptions;
use crate::error::{Error, Result, invalid};
use crate::files;
use serde::Deserialize;
use sha2::{Digest, Sha256};
use std::fs::File;
use std::path::{Path, PathBuf};

/// A file of `data_manifests/`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Page where the dataset can be had, and on which terms.
    pub source: String,
    /// How the folder of the scene is laid out.
    pub layout: Layout,
    /// Class table; absent for scenes without labels.
    pub classes: Option<ClassTable>,
    /// Files that must be there.
    #[serde(default)]
    pub files: Vec<ExpectedFile>,
}

/// A class table of a dataset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ClassTable {
    /// The 101 classes of Replica.
    Replica,
    /// The 40 classes of NYU Depth v2.
    Nyu40,
    /// The 20 of them that ScanNet's benchmark counts.
    Scannet20,
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
        files::toml(
            &files::text(path)?,
            path,
            "a manifest as in data_manifests/",
        )
    }

    /// `options` with the layout and class table of the manifest.
    pub fn options(&self, options: &LoadOptions) -> LoadOptions {
        let mut options = LoadOptions {
            layout: self.layout,
            ..options.clone()
        };
        match self.classes {
            Some(ClassTable::Scannet20) => options.scannet_classes = ScannetClasses::Scannet20,
            Some(ClassTable::Nyu40) => options.scannet_classes = ScannetClasses::Nyu40,
            Some(ClassTable::Replica) | None => {}
        }
        options
    }

    /// What is wrong with the expected files in folder `dir`; at most one fault for each entry.
    pub fn check(&self, dir: &Path) -> Vec<Error> {
        self.files
            .iter()
            .filter_map(|file| file.check(dir, &self.source).err())
            .collect()
    }
}

impl ExpectedFile {
    /// All paths of the entry, in `dir`.
    fn paths(&self, dir: &Path) -> Vec<PathBuf> {
        let numbered = |i: usize| {
            let path = self.path.replace("{:06}", &format!("{i:06}"));
            dir.join(path.replace("{}", &i.to_string()))
        };
        match self.count {
            Some(count) => (0..count).map(numbered).collect(),
            None => vec![dir.join(&self.path)],
        }
    }

    fn check(&self, dir: &Path, source: &str) -> Result<()> {
        let again = format!("unpack the dataset again ({source})");
        let paths = self.paths(dir);
        let missing: Vec<&PathBuf> = paths.iter().filter(|path| !path.is_file()).collect();
        if let [first, rest @ ..] = &missing[..] {
            let more = match rest.len() {
                0 => String::new(),
                more => format!(", and {more} more of {} are missing", paths.len()),
            };
            return Err(invalid!(first, "{}", self.path; found "no such file{more}";
                expected "a file that the manifest lists"; help "{again}"));
        }
        let Some(path) = paths.first().filter(|_| self.count.is_none()) else {
            return Ok(());
        };
        let length = std::fs::metadata(path)
            .map_err(|e| Error::io(path, "measure", e))?
            .len();
        if let Some(size) = self.size.filter(|size| *size != length) {
            return Err(
                invalid!(path, "size"; found "{length} bytes"; expected "{size} bytes"; help "{again}"),
            );
        }
        let Some(expected) = &self.sha256 else {
            return Ok(());
        };
        let mut hash = Sha256::new();
        File::open(path)
            .and_then(|mut file| std::io::copy(&mut file, &mut hash))
            .map_err(|e| Error::io(path, "read", e))?;
        let found = format!("{:x}", hash.finalize());
        if found.eq_ignore_ascii_case(expected) {
            return Ok(());
        }
        Err(invalid!(path, "sha256"; found "{found}"; expected "{expected}"; help "{again}"))
    }
}

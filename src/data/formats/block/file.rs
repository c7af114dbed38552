//! The file of a block, and the scene folder that it stands for.

use super::{AGAIN, Grid, Region, block_name};
use crate::config::{DataConfig, Layout};
use crate::data::LoadOptions;
use crate::error::{Error, Result, ensure};
use crate::files::{self, atomic};
use serde::{Deserialize, Serialize};
use std::io::ErrorKind;
use std::path::{Component, Path, PathBuf};

/// The name of the file in the folder of a block.
pub const BLOCK: &str = "block.json";
/// The version of the file.
const VERSION: u32 = 1;
const EXPECTED: &str = "a block that `coseg split` wrote";

/// A block of a scene. Its region follows from the grid and its position there, so that blocks of one grid cover space once.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Block {
    version: u32,
    /// The scene folder, absolute or relative to that of the block.
    pub scene: PathBuf,
    /// How the scene folder was read.
    pub reading: Reading,
    /// All blocks.
    pub grid: Grid,
    /// Column and row of this block.
    pub index: [usize; 2],
    /// Names of its training frames.
    pub train: Vec<String>,
    /// Names of its held-out frames.
    pub test: Vec<String>,
}

/// What decides on the frames of a scene folder and on their splits.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reading {
    /// As [`LoadOptions::layout`], never `auto`.
    pub layout: Layout,
    /// As [`LoadOptions::transforms`].
    pub transforms: String,
    /// As [`LoadOptions::images`].
    pub images: String,
    /// As [`LoadOptions::stride`].
    pub stride: usize,
    /// As [`LoadOptions::max_frames`].
    pub max_frames: usize,
}

impl Reading {
    pub(crate) fn of(options: &LoadOptions, layout: Layout) -> Self {
        Self {
            layout,
            transforms: options.transforms.clone(),
            images: options.images.clone(),
            stride: options.stride,
            max_frames: options.max_frames,
        }
    }

    /// Makes `config` read the whole scene in folder `dir` as it was split. Names of files stay if they are not the usual ones.
    pub fn apply(&self, dir: PathBuf, config: &mut DataConfig) {
        let usual = LoadOptions::default();
        config.dir = Some(dir);
        config.layout = self.layout;
        config.transforms = named(&config.transforms, &usual.transforms, &self.transforms);
        config.images = named(&config.images, &usual.images, &self.images);
        config.stride = self.stride;
        config.max_frames = self.max_frames;
    }

    /// How the whole scene is listed to find the frames of a block. `options` may name other files, for instance other labels; its
    /// limits on frames are applied to the block later.
    fn options(&self, options: &LoadOptions) -> LoadOptions {
        let usual = LoadOptions::default();
        LoadOptions {
            layout: self.layout,
            transforms: named(&options.transforms, &usual.transforms, &self.transforms),
            images: named(&options.images, &usual.images, &self.images),
            stride: self.stride,
            max_frames: self.max_frames,
            ..options.clone()
        }
    }
}

/// `name`, or `own` where it is the usual one.
fn named(name: &str, usual: &str, own: &str) -> String {
    if name == usual { own } else { name }.to_owned()
}

impl Block {
    /// The block `index` of `grid`, without frames.
    pub(crate) fn new(scene: PathBuf, reading: Reading, grid: Grid, index: [usize; 2]) -> Self {
        Self {
            version: VERSION,
            scene,
            reading,
            grid,
            index,
            train: Vec::new(),
            test: Vec::new(),
        }
    }

    /// Its name, see [`block_name`].
    pub fn name(&self) -> String {
        block_name(self.index)
    }

    /// What it is trained on.
    pub fn region(&self) -> Region {
        self.grid.extended(self.index)
    }

    /// The block in the folder `dir`; `None` where the folder has no such file.
    ///
    /// # Errors
    /// As [`Block::read`].
    pub fn in_folder(dir: &Path) -> Result<Option<Self>> {
        let file = dir.join(BLOCK);
        let is_there = match file.try_exists() {
            // `dir` is a file.
            Err(error) if error.kind() == ErrorKind::NotADirectory => false,
            is_there => is_there.map_err(|e| Error::io(&file, "look at", e))?,
        };
        is_there.then(|| Self::read(&file)).transpose()
    }

    /// Reads the file of a block.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Input`] for another version, and for fields that are missing, unknown or contradict each other.
    pub fn read(file: &Path) -> Result<Self> {
        #[derive(Deserialize)]
        struct Versioned {
            version: u32,
        }
        let Versioned { version } = files::json(file, EXPECTED)?;
        ensure!(version == VERSION, file, "version"; found "{version}"; expected "{VERSION}"; help "{AGAIN} with this program");
        let block: Self = files::json(file, EXPECTED)?;
        block.grid.check(file)?;
        let [column, row] = block.index;
        let [columns, rows] = block.grid.counts;
        ensure!(column < columns && row < rows, file, "index"; found "{column}, {row}";
            expected "a column below {columns} and a row below {rows}"; help "{AGAIN}");
        Ok(block)
    }

    /// Writes the file into the folder `dir`, with a relative path to the scene where both are below one folder.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Argument`] for a file that the running command did not write.
    pub fn write(&self, dir: &Path) -> Result<()> {
        std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, "create", e))?;
        let scene = relative(&self.scene, dir).unwrap_or_else(|| self.scene.clone());
        let block = Self {
            scene,
            ..self.clone()
        };
        atomic::write_json(dir.join(BLOCK), &block)
    }

    /// The folder of the whole scene that this block, which lies in the folder `dir`, belongs to.
    ///
    /// # Errors
    /// [`Error::Missing`] if there is none; [`Error::Input`] for one that is a block itself.
    pub fn scene_folder(&self, dir: &Path) -> Result<PathBuf> {
        let scene = dir.join(&self.scene);
        let file = dir.join(BLOCK);
        if !scene.is_dir() {
            let help = format!("{} names it: put it there, or {AGAIN}", file.display());
            return Err(Error::missing("folder", scene, help));
        }
        ensure!(!scene.join(BLOCK).exists(), file, "scene"; found "{}, a block itself", self.scene.display();
            expected "the folder of a whole scene"; help "{AGAIN}");
        Ok(scene.canonicalize().unwrap_or(scene))
    }

    /// How the whole scene is read, and its folder.
    pub(crate) fn whole(
        &self,
        dir: &Path,
        options: &LoadOptions,
    ) -> Result<(PathBuf, LoadOptions)> {
        Ok((self.scene_folder(dir)?, self.reading.options(options)))
    }
}

/// `to` as seen from the folder `from`, where both are below one folder that is not the root.
fn relative(to: &Path, from: &Path) -> Option<PathBuf> {
    let [to, from] = [to.canonicalize().ok()?, from.canonicalize().ok()?];
    let same = to.components().zip(from.components());
    let shared = same.take_while(|(a, b)| a == b).count();
    let named = to
        .components()
        .take(shared)
        .filter(|part| matches!(part, Component::Normal(_)));
    if named.count() == 0 {
        return None;
    }
    let up = from.components().skip(shared).map(|_| Component::ParentDir);
    Some(up.chain(to.components().skip(shared)).collect())
}

//! Photos in a form that all programs read alike: of one size and without an EXIF orientation.

use crate::data::photos::image_file::{ImageFile, proportional};
use crate::data::photos::{HEIC_HELP, is_heic, is_photo, is_video};
use crate::error::{Error, Result, bail, ensure, in_order};
use crate::files::{folder, names};
use image::metadata::Orientation;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// The photos in `dir`, sorted by name.
///
/// # Errors
/// [`Error::Input`] for fewer than two, and for two whose names differ in their extension alone; [`Error::Io`]. Warnings
/// count HEIC files and videos.
pub(super) fn list(dir: &Path) -> Result<Vec<PathBuf>> {
    std::fs::read_dir(dir).map_err(|e| Error::io(dir, "list", e))?;
    let visible = |name: &str| !name.starts_with('.');
    let photos = names(dir, |name, path| visible(name) && is_photo(path));
    let heic = names(dir, |name, path| visible(name) && is_heic(path)).len();
    if photos.len() < 2 && heic > 0 {
        bail!(dir, "photos"; found "{heic} HEIC files"; expected "PNG or JPEG"; help "{HEIC_HELP}");
    }
    ensure!(photos.len() > 1, dir, "photos"; found "{} PNG or JPEG files", photos.len(); expected "two or more";
        help "give the folder that holds the photos itself, or a video");
    let mut stems = HashMap::new();
    for name in &photos {
        if let Some(other) = stems.insert(Path::new(name).file_stem(), name) {
            bail!(dir, "photos"; found "{other} and {name}"; expected "names that differ before the extension";
                help "move one of the two to another folder");
        }
    }
    if heic > 0 {
        tracing::warn!(
            "{}: {heic} HEIC files are left out; {HEIC_HELP}",
            dir.display()
        );
    }
    let videos = names(dir, |name, path| visible(name) && is_video(path));
    if let [first, ..] = &videos[..] {
        tracing::warn!(
            "{}: {} videos are left out, such as {first}; `coseg from-photos VIDEO` makes a scene folder from one",
            dir.display(),
            videos.len()
        );
    }
    Ok(photos.iter().map(|name| dir.join(name)).collect())
}

/// Photos that get one size when they are turned by their EXIF orientation, or have one as they are stored.
pub(super) struct Photos {
    pub all: Vec<Photo>,
    /// They are turned.
    turns: bool,
}

/// What the header of a photo says.
pub(super) struct Photo {
    pub path: PathBuf,
    /// As it is stored.
    pub size: (usize, usize),
    /// EXIF orientation, unless it is upright.
    exif: Option<Orientation>,
}

impl Photo {
    /// Whether its EXIF orientation turns or mirrors it while its proportions stay the same.
    pub fn turns_without_trace(&self) -> bool {
        self.exif.is_some() && proportional(self.size, turned(self.size, self.exif))
    }
}

/// A size after a turn.
pub(super) fn turned((width, height): (usize, usize), turn: Option<Orientation>) -> (usize, usize) {
    // From 5 on the sides are swapped.
    match turn.map(Orientation::to_exif) {
        Some(5..) => (height, width),
        _ => (width, height),
    }
}

impl Photos {
    /// Reads the headers of the photos at `paths`.
    ///
    /// # Errors
    /// [`Error::Input`] where they differ in size, or one cannot be read; [`Error::Io`].
    pub fn look(paths: Vec<PathBuf>) -> Result<Self> {
        let all = in_order(paths.into_par_iter().map(|path| {
            let file = ImageFile::open(&path)?;
            let exif = file.exif_orientation().and_then(Orientation::from_exif);
            let size = file.size;
            Ok(Photo { path, size, exif })
        }))?;
        let is_one = |size: fn(&Photo) -> (usize, usize)| {
            all.iter().all(|photo| size(photo) == size(&all[0]))
        };
        let turns = is_one(|photo| turned(photo.size, photo.exif));
        if turns || is_one(|photo| photo.size) {
            return Ok(Self { all, turns });
        }
        let mut counts = BTreeMap::new();
        for photo in &all {
            *counts.entry(photo.size).or_insert(0) += 1;
        }
        let counts = counts.iter().map(|((w, h), n)| format!("{n} of {w}x{h}"));
        let counts = counts.collect::<Vec<_>>().join(", ");
        bail!(folder(&all[0].path), "photos"; found "{counts} pixels"; expected "photos of one size, by one lens at one zoom";
            help "move the others to another folder");
    }

    /// The EXIF orientation by which the copy of `photo` is turned.
    pub fn turn(&self, photo: &Photo) -> Option<Orientation> {
        photo.exif.filter(|_| self.turns)
    }

    /// The file of `photo` without EXIF orientation. A file that has none is returned unchanged.
    ///
    /// # Errors
    /// [`Error::Input`] for a photo that cannot be read; [`Error::Io`].
    pub fn upright(&self, photo: &Photo) -> Result<Vec<u8>> {
        ImageFile::open(&photo.path)?.without_orientation(self.turns)
    }
}

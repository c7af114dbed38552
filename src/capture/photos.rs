//! Photos as all programs read them alike: of one size and without an EXIF orientation.

use super::masks::Masks;
use crate::data::Limits;
use crate::data::photos::image_file::ImageFile;
use crate::data::photos::{HEIC_HELP, is_heic, is_photo, is_video};
use crate::error::{Error, Result, bail, ensure, in_order};
use crate::files::{atomic, file_name, names};
use crate::progress::{Progress, Viewing};
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};
use std::ops::ControlFlow;
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
            "{}: {} videos are left out, such as {first}; `coseg from-photos VIDEO` makes a scene folder of one",
            dir.display(),
            videos.len()
        );
    }
    Ok(photos.iter().map(|name| dir.join(name)).collect())
}

/// Writes the photos into the folder `out`, without EXIF orientation: turned by it where that gives all of them one size, else
/// with their pixels as they are stored. Photos without orientation are copied. Each one's mask goes into the folder that comes with
/// `masks`.
///
/// # Errors
/// [`Error::Input`] where the photos differ in size, or one or its mask cannot be read; [`Error::Io`].
pub(super) fn copy(
    photos: &[PathBuf],
    masks: Option<(&Masks, &Path)>,
    out: &Path,
    progress: &mut dyn Progress,
) -> Result<ControlFlow<()>> {
    let limits = Limits::default();
    let headers = in_order(photos.par_iter().map(|path| {
        let file = ImageFile::open(path, &limits)?;
        Ok((file.size, file.exif_orientation()))
    }))?;
    let turns = turns(&photos[0], &headers)?;
    let mut viewing = Viewing::begin(progress, "photos", photos.len());
    for some in photos.chunks(rayon::current_num_threads()) {
        in_order(some.par_iter().map(|path| {
            let photo = ImageFile::open(path, &limits)?;
            if let Some((masks, folder)) = masks {
                let orientation = photo.exif_orientation().filter(|_| turns);
                masks.write(&photo, orientation, folder)?;
            }
            let photo = photo.without_orientation(turns)?;
            let name = file_name(path).unwrap_or_default();
            atomic::write_bytes(out.join(name), &photo)
        }))?;
        if viewing.advance(some.len()).is_break() {
            return Ok(ControlFlow::Break(()));
        }
    }
    viewing.end();
    Ok(ControlFlow::Continue(()))
}

/// Whether the photos get one size when they are turned by their EXIF orientation, and not as they are stored only.
fn turns(first: &Path, headers: &[((usize, usize), Option<u8>)]) -> Result<bool> {
    // From 5 on the sides are swapped.
    let upright = |&((w, h), exif): &((usize, usize), Option<u8>)| match exif {
        Some(5..) => (h, w),
        _ => (w, h),
    };
    let is_one = |sizes: &[(usize, usize)]| sizes.iter().all(|size| *size == sizes[0]);
    let turned: Vec<_> = headers.iter().map(upright).collect();
    if is_one(&turned) {
        return Ok(true);
    }
    let stored: Vec<_> = headers.iter().map(|(size, _)| *size).collect();
    if is_one(&stored) {
        return Ok(false);
    }
    let mut counts = BTreeMap::new();
    for size in stored {
        *counts.entry(size).or_insert(0) += 1;
    }
    let counts = counts.iter().map(|((w, h), n)| format!("{n} of {w}x{h}"));
    let counts = counts.collect::<Vec<_>>().join(", ");
    let dir = first.parent().unwrap_or(first);
    bail!(dir, "photos"; found "{counts} pixels"; expected "photos of one size, by one lens at one zoom";
        help "move the others to another folder");
}

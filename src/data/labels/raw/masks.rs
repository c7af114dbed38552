//! A folder of binary masks for each photo, as Segment Anything's `amg.py` writes them: `0.png`, `1.png`, and so on, and
//! perhaps `metadata.csv`.

use crate::data::LabelMap;
use crate::data::photos::image_file::ImageFile;
use crate::error::{Error, Result, bail, ensure, invalid};
use crate::files::{self, Numbered, check_limit, check_pixels, extension, names, numbered};
use std::collections::BTreeSet;
use std::path::Path;

const TABLE: &str = "metadata.csv";
const DAMAGED_HELP: &str = "copy the folder of masks again, or write it again";

/// Reads the masks of a photo as one map. A pixel belongs to the smallest mask that covers it; among equal masks, to the lowest
/// number. It is 0 where there is no mask. The k-th mask by number has id k, from 1 on. A table without rows says that nothing was
/// found: no pixel belongs to a mask.
///
/// `path` is the folder, or that name with an extension; `photo` the size of a map without masks.
pub(super) fn read(
    path: &Path,
    photo: (usize, usize),
    check_size: &dyn Fn(&ImageFile) -> Result<()>,
) -> Result<LabelMap> {
    let folder = if path.is_dir() {
        path.to_owned()
    } else {
        path.with_extension("")
    };
    if !folder.is_dir() {
        let help = "put the photo's masks there, or drop the frame";
        return Err(Error::missing("folder", folder, help));
    }
    let is_number = |name: &str| {
        name.split_once('.')
            .is_some_and(|(stem, _)| !stem.starts_with('+') && stem.parse::<usize>().is_ok())
    };
    let is_other = |name: &str, path: &Path| extension(path) == "png" && !is_number(name);
    if let Some(other) = names(&folder, is_other).first() {
        bail!(&folder, "masks"; found "{other:?}"; expected "whole numbers for names";
            help "rename or remove the file");
    }
    let files = numbered(&folder, "", &["png"])?;
    let has_table = check_table(&folder, &files)?;
    let size = match files.values().next() {
        Some(first) => ImageFile::open(first)?.size,
        None if has_table => photo,
        None => {
            bail!(&folder, "masks"; found "no PNG files";
                expected "0.png, 1.png and so on, or a {TABLE} without rows where nothing was found"; help "{DAMAGED_HELP}");
        }
    };
    let (width, height) = size;
    check_pixels(&folder, width, height)?;
    let help = "keep the masks with the best scores";
    check_limit(&folder, "masks", files.len() as u64, u16::MAX.into(), help)?;
    let mut ids = vec![0; width * height];
    let mut areas = vec![u32::MAX; width * height];
    for (path, id) in files.values().zip(1..) {
        let file = ImageFile::open(path)?;
        check_size(&file)?;
        let help = "all masks of a photo have its size: make them again, or scale them";
        file.expect_size(size, "the first mask of the photo", help)?;
        let mask = covered(path, &file)?;
        let area = mask.iter().filter(|covered| **covered).count() as u32;
        for (i, _) in mask.iter().enumerate().filter(|(_, covered)| **covered) {
            if area < areas[i] {
                ids[i] = id;
                areas[i] = area;
            }
        }
    }
    Ok(LabelMap { width, height, ids })
}

/// The pixels of a mask: those that are not black.
pub(super) fn covered(path: &Path, file: &ImageFile) -> Result<Vec<bool>> {
    if let Some((_, 0)) = file.png_color() {
        let values = file.decode()?.into_luma16().into_raw();
        return Ok(values.into_iter().map(|value| value > 0).collect());
    }
    let found = file
        .png_color()
        .map_or("JPEG", |_| "a PNG with colours, a palette or alpha");
    bail!(path, "pixel format"; found "{found}"; expected "a grey PNG, black where the mask is not";
        help "write the mask as grey PNG");
}

/// Checks `metadata.csv`, where it is there, against the files: its first column numbers the masks. Whether it is there.
fn check_table(folder: &Path, files: &Numbered) -> Result<bool> {
    let path = folder.join(TABLE);
    if !path.is_file() {
        return Ok(false);
    }
    let mut listed = BTreeSet::new();
    let text = files::text(&path)?;
    let rows = text
        .lines()
        .zip(1..)
        .skip(1)
        .filter(|(row, _)| !row.trim().is_empty());
    for (row, line) in rows {
        let cell = row.split(',').next().unwrap_or_default().trim();
        let number: usize = cell.parse().map_err(|_| {
            invalid!(&path, "line {line}, id"; found "{cell:?}"; expected "the number of a mask"; help "{DAMAGED_HELP}")
        })?;
        ensure!(files.contains_key(&number), &path, "line {line}, id"; found "{number}, which has no file";
            expected "a file {number}.png beside it"; help "{DAMAGED_HELP}");
        listed.insert(number);
    }
    if let Some(number) = files.keys().find(|number| !listed.contains(number)) {
        bail!(&path, "rows"; found "{} rows, none for {number}.png", listed.len();
            expected "one for each mask"; help "{DAMAGED_HELP}");
    }
    Ok(true)
}

//! A folder of binary masks for each photo, as Segment Anything's `amg.py` writes them: `0.png`, `1.png`, and so on, and
//! perhaps `metadata.csv`.

use crate::data::photos::image_file::ImageFile;
use crate::data::{LabelMap, Limits};
use crate::error::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

const TABLE: &str = "metadata.csv";
const AGAIN: &str = "copy the folder of masks again, or write it again";

/// Reads the masks of a photo as one map: a pixel belongs to the smallest mask that covers it, of equal ones to the one
/// with the lower number, and to none (0) where no mask is. The k-th mask by number has id k, from 1 on. Where the table
/// says that nothing was found, no pixel of the `photo`'s is of a mask.
///
/// `path` is the folder, or that name with an extension; `photo` the size of a map without masks.
pub(crate) fn read(
    path: &Path,
    photo: (usize, usize),
    limits: &Limits,
    check_size: &dyn Fn(&ImageFile) -> Result<()>,
) -> Result<LabelMap> {
    let folder = if path.is_dir() {
        path.to_owned()
    } else {
        path.with_extension("")
    };
    if !folder.is_dir() {
        let help = "put the photo's masks there, or take the frame away".into();
        return Err(Error::Missing {
            what: "folder",
            path: folder,
            help,
        });
    }
    let files = numbered(&folder)?;
    let has_table = check_table(&folder, &files)?;
    let Some(first) = files.values().next() else {
        let (width, height) = photo;
        if has_table {
            let pixels = (width as u64).saturating_mul(height as u64);
            Limits::check(
                format!("{}: pixels", folder.display()),
                pixels,
                limits.image_pixels,
                "scale the photos down",
            )?;
            return Ok(LabelMap {
                width,
                height,
                ids: vec![0; width * height],
            });
        }
        let expected =
            format!("0.png, 1.png and so on, or a {TABLE} without rows where nothing was found");
        return Err(Error::input(
            &folder,
            "masks",
            "no PNG files",
            expected,
            AGAIN,
        ));
    };
    let what = format!("{}: masks", folder.display());
    Limits::check(
        what,
        files.len() as u64,
        u64::from(u16::MAX),
        "keep the masks with the best scores",
    )?;
    let (width, height) = ImageFile::open(first, limits)?.size;
    let mut ids = vec![0; width * height];
    let mut areas = vec![u32::MAX; width * height];
    for (path, id) in files.values().zip(1..) {
        let file = ImageFile::open(path, limits)?;
        check_size(&file)?;
        file.expect_size(width, height, "the first mask of the photo")?;
        let mask = covered(path, &file)?;
        let area = mask.iter().filter(|covered| **covered).count() as u32;
        let pixels = ids
            .iter_mut()
            .zip(&mut areas)
            .zip(mask)
            .filter(|(_, covered)| *covered);
        for ((to, smallest), _) in pixels {
            if area < *smallest {
                (*to, *smallest) = (id, area);
            }
        }
    }
    Ok(LabelMap { width, height, ids })
}

/// The pixels of a mask: those that are not black.
fn covered(path: &Path, file: &ImageFile) -> Result<Vec<bool>> {
    match file.png_color() {
        Some((_, 0)) => Ok(file
            .decode()?
            .into_luma16()
            .into_raw()
            .into_iter()
            .map(|v| v > 0)
            .collect()),
        found => {
            let found = if found.is_some() {
                "a PNG with colours, a palette or alpha"
            } else {
                "JPEG"
            };
            let expected = "a grey PNG, black where the mask is not";
            Err(Error::input(
                path,
                "pixel format",
                found,
                expected,
                "write the mask as grey PNG",
            ))
        }
    }
}

/// Masks by number.
fn numbered(folder: &Path) -> Result<BTreeMap<u64, PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list", e))?;
    let mut files: BTreeMap<u64, PathBuf> = BTreeMap::new();
    for entry in entries {
        let path = entry.map_err(|e| Error::io(folder, "list", e))?.path();
        if path
            .extension()
            .is_none_or(|e| !e.eq_ignore_ascii_case("png"))
        {
            continue;
        }
        let stem = path
            .file_stem()
            .and_then(|stem| stem.to_str())
            .unwrap_or_default();
        let Ok(number) = stem.parse::<u64>() else {
            let found = format!("{:?}", path.file_name().unwrap_or_default());
            return Err(Error::input(
                folder,
                "masks",
                found,
                "whole numbers for names",
                "rename or remove the file",
            ));
        };
        if let Some(other) = files.insert(number, path.clone()) {
            let found = format!("{} and {}", other.display(), path.display());
            let field = format!("mask {number}");
            return Err(Error::input(
                folder,
                field,
                found,
                "one file a number",
                "take one of the two away",
            ));
        }
    }
    Ok(files)
}

/// Holds `metadata.csv`, where it is there, against the files: its first column numbers the masks. Whether it is there.
fn check_table(folder: &Path, files: &BTreeMap<u64, PathBuf>) -> Result<bool> {
    let path = folder.join(TABLE);
    if !path.is_file() {
        return Ok(false);
    }
    let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, "read", e))?;
    let mut listed = BTreeSet::new();
    for (i, line) in text
        .lines()
        .enumerate()
        .skip(1)
        .filter(|(_, line)| !line.trim().is_empty())
    {
        let cell = line.split(',').next().unwrap_or_default().trim();
        let field = format!("line {}, id", i + 1);
        let Ok(number) = cell.parse::<u64>() else {
            return Err(Error::input(
                &path,
                field,
                format!("{cell:?}"),
                "the number of a mask",
                AGAIN,
            ));
        };
        if !files.contains_key(&number) {
            let expected = format!("a file {number}.png beside it");
            return Err(Error::input(
                &path,
                field,
                format!("{number}, which has no file"),
                expected,
                AGAIN,
            ));
        }
        listed.insert(number);
    }
    match files.keys().find(|number| !listed.contains(number)) {
        Some(number) => {
            let found = format!("{} rows, none for {number}.png", listed.len());
            Err(Error::input(
                &path,
                "rows",
                found,
                "one for each mask",
                AGAIN,
            ))
        }
        None => Ok(true),
    }
}

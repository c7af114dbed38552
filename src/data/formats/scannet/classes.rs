//! ScanNet's label ids and the classes they are mapped to.

use crate::config::ScannetClasses;
use crate::data::formats::listing::UNMAPPED;
use crate::data::{Classes, LoadOptions};
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// The 40 classes of NYU Depth v2, in the order of their ids, from 1.
const NYU40: [&str; 40] = [
    "wall",
    "floor",
    "cabinet",
    "bed",
    "chair",
    "sofa",
    "table",
    "door",
    "window",
    "bookshelf",
    "picture",
    "counter",
    "blinds",
    "desk",
    "shelves",
    "curtain",
    "dresser",
    "pillow",
    "mirror",
    "floor mat",
    "clothes",
    "ceiling",
    "books",
    "refrigerator",
    "television",
    "paper",
    "towel",
    "shower curtain",
    "box",
    "whiteboard",
    "person",
    "night stand",
    "toilet",
    "sink",
    "lamp",
    "bathtub",
    "bag",
    "otherstructure",
    "otherfurniture",
    "otherprop",
];
/// Those that ScanNet's benchmark counts.
const SCANNET20: [u16; 20] = [
    1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 24, 28, 33, 34, 36, 39,
];
/// Name of the table that comes with the dataset.
const TABLE: &str = "scannetv2-labels.combined.tsv";
const COLUMNS: [&str; 2] = ["id", "nyu40id"];

fn counted(set: ScannetClasses, id: u16) -> bool {
    set == ScannetClasses::Nyu40 || SCANNET20.contains(&id)
}

/// The classes of a set, with NYU40's ids; 0 is unlabelled.
pub(crate) fn classes(set: ScannetClasses) -> Classes {
    let named = (1_u16..).zip(NYU40);
    Classes::from_names(0, named.filter(|(id, _)| counted(set, *id)))
}

/// ScanNet's table.
pub(crate) struct Table {
    /// NYU40 id of each label id, 0 for those that the set does not count, [`UNMAPPED`] for those that the table lacks.
    pub ids: Vec<u32>,
}

/// Reads the table that the options name, or that lies in `dir` or one of the three folders above it.
pub(crate) fn table(dir: &Path, options: &LoadOptions) -> Result<Table> {
    let full = dir.canonicalize().unwrap_or_else(|_| dir.to_owned());
    let near = full.ancestors().take(4).map(|folder| folder.join(TABLE));
    let path: Option<PathBuf> = match &options.scannet_labels {
        Some(path) => Some(path.clone()),
        None => near.into_iter().find(|path| path.is_file()),
    };
    let Some(path) = path else {
        let expected = format!(
            "{TABLE} there or in one of the three folders above: the labels' ids mean nothing without it"
        );
        let help = "copy it from the dataset to the folder of the scene";
        return Err(Error::input(dir, TABLE, "no such file", expected, help));
    };
    let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, "read", e))?;
    parse(&text, &path, options.scannet_classes)
}

fn parse(text: &str, path: &Path, set: ScannetClasses) -> Result<Table> {
    let error = |line: usize, found: String, expected: &str| {
        Error::input(
            path,
            format!("line {line}"),
            found,
            expected,
            "copy the table from the dataset again",
        )
    };
    let header: Vec<&str> = text
        .lines()
        .next()
        .unwrap_or_default()
        .split('\t')
        .map(str::trim)
        .collect();
    let mut places = [0; 2];
    for (place, column) in places.iter_mut().zip(COLUMNS) {
        let missing = || {
            error(
                1,
                format!("columns {header:?}"),
                &format!("a column {column}, separated by tabs"),
            )
        };
        *place = header
            .iter()
            .position(|name| *name == column)
            .ok_or_else(missing)?;
    }
    let mut ids = vec![UNMAPPED; 1 << 16];
    ids[0] = 0;
    for (i, row) in text
        .lines()
        .enumerate()
        .skip(1)
        .filter(|(_, row)| !row.trim().is_empty())
    {
        let cells: Vec<&str> = row.split('\t').map(str::trim).collect();
        let mut values = [0_u16; 2];
        for ((value, place), column) in values.iter_mut().zip(places).zip(COLUMNS) {
            let cell = cells.get(place).copied().unwrap_or_default();
            let wrong = |_| {
                error(
                    i + 1,
                    format!("{cell:?} in column {column}"),
                    "a whole number from 0 to 65535",
                )
            };
            *value = cell.parse().map_err(wrong)?;
        }
        let [id, class] = values;
        if usize::from(class) > NYU40.len() {
            return Err(error(i + 1, format!("nyu40id {class}"), "0 to 40"));
        }
        ids[usize::from(id)] = if counted(set, class) {
            u32::from(class)
        } else {
            0
        };
    }
    Ok(Table { ids })
}

//! Raw labels as segmenters write them: which of the formats a folder has, and what its maps say.

mod ade20k;
mod ade20k_table;
mod coco;
mod masks;

use crate::config::{Association, RawFormat};
use crate::data::formats::frame::Frame;
use crate::data::photos::image_file::ImageFile;
use crate::data::{Classes, LabelMap, Limits, LoadOptions, Segment};
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// What mends unknown ids that are no classes.
const IF_SEGMENTS: &str = "; where ids mean something in their view alone (instance masks), \
                           add --set data.association=gaussians, or use `coseg associate`";

/// The raw labels of a scene folder, as far as they are known before a map is decoded.
pub(crate) struct RawLabels {
    source: Source,
    /// Ids are segments of their view, not classes.
    segments: bool,
}

enum Source {
    Grey,
    Coco(coco::Panoptic),
    Ade20k(ade20k::Palette),
    Masks,
}

/// A decoded map, of the size of its file.
#[derive(Debug)]
pub(crate) struct RawMap {
    pub map: LabelMap,
    /// What is known of its segments; empty where ids are classes, and where nothing is known.
    pub segments: Vec<Segment>,
}

/// Class ids of a segmenter's own classes in the class table of the scene, or the segmenter's table itself.
struct Vocabulary {
    /// The table of the scene.
    classes: Classes,
    /// Class id of each of the segmenter's classes, in its order.
    ids: Vec<Option<u16>>,
    /// What was left out.
    notice: Option<String>,
}

impl Vocabulary {
    /// The segmenter's classes `names` (`own` is the id that each has in a table of its own) in the table `classes`,
    /// matched by name; without a table theirs is taken.
    ///
    /// # Errors
    /// No name is in the table.
    fn new(file: &Path, classes: &Classes, names: &[(u16, &str)]) -> Result<Self> {
        if classes.is_empty() {
            let classes = Classes::from_names(0, names.iter().copied());
            return Ok(Self {
                classes,
                ids: names.iter().map(|(id, _)| Some(*id)).collect(),
                notice: None,
            });
        }
        let plain = |name: &str| name.trim().to_lowercase().replace(['-', '_'], " ");
        let known: Vec<(String, u16)> = classes
            .entries
            .iter()
            .map(|c| (plain(&c.name), c.id))
            .collect();
        let find = |name: &str| {
            known
                .iter()
                .find(|(k, _)| *k == plain(name))
                .map(|(_, id)| *id)
        };
        let ids: Vec<Option<u16>> = names.iter().map(|(_, name)| find(name)).collect();
        let found = ids.iter().flatten().count();
        if found == 0 {
            let listed: Vec<_> = names.iter().take(5).map(|(_, name)| *name).collect();
            let expected = format!(
                "names of the class table, such as {}",
                classes.entries[0].name
            );
            let help = "rename the classes of classes.json, or take it away where there are no true labels";
            return Err(Error::input(
                file,
                "categories",
                format!("{} ..", listed.join(", ")),
                expected,
                help,
            ));
        }
        let notice = (found < names.len()).then(|| {
            format!(
                "{found} of the {} classes of {} are in the class table by name; pixels of the others are unlabelled",
                names.len(),
                file.display()
            )
        });
        Ok(Self {
            classes: classes.clone(),
            ids,
            notice,
        })
    }
}

/// Whether the frames' labels need a class table from elsewhere: all but raw labels that bring their own or have none. What is
/// told then is what mends its absence beside a table.
pub(crate) fn need_table(
    dir: &Path,
    options: &LoadOptions,
    frames: &[Frame],
) -> Option<&'static str> {
    let any = |of: fn(&Frame) -> bool| frames.iter().any(of);
    let grey = || detect(dir, options, frames).is_ok_and(|format| format == RawFormat::Grey);
    if any(|frame| frame.truth.is_some()) {
        return Some("");
    }
    let raw =
        any(|frame| frame.raw.is_some()) && options.association == Association::None && grey();
    raw.then_some(IF_SEGMENTS)
}

/// The format that the options name, or that the first map has.
fn detect(dir: &Path, options: &LoadOptions, frames: &[Frame]) -> Result<RawFormat> {
    if options.raw_format != RawFormat::Auto {
        return Ok(options.raw_format);
    }
    let there = |path: &&PathBuf| path.exists();
    let Some(first) = frames
        .iter()
        .filter_map(|frame| frame.raw.as_ref())
        .find(there)
    else {
        return Ok(RawFormat::Grey);
    };
    if first.is_dir() {
        return Ok(RawFormat::Masks);
    }
    // A file that cannot be read is told of where it is read.
    let Ok(file) = ImageFile::open(first, &options.limits) else {
        return Ok(RawFormat::Grey);
    };
    Ok(match file.png_color() {
        Some((_, 2 | 6)) if coco::find(&folder(dir, options, first)).is_some() => {
            RawFormat::CocoPanoptic
        }
        Some((_, 2 | 3 | 6)) if ade20k::matches(&file) => RawFormat::Ade20k,
        _ => RawFormat::Grey,
    })
}

/// The folder of raw labels that `map` is in.
fn folder(dir: &Path, options: &LoadOptions, map: &Path) -> PathBuf {
    let usual = dir.join(options.raw_labels.as_deref().unwrap_or("labels_raw"));
    match map.starts_with(&usual) {
        true => usual,
        false => map.parent().map_or(usual, Path::to_owned),
    }
}

impl RawLabels {
    /// Of a folder without any, or whose format is not known.
    pub fn grey() -> Self {
        Self {
            source: Source::Grey,
            segments: false,
        }
    }

    /// Settles the format for `frames`. Where `classes` is empty, the segmenter's own class table takes its place, and
    /// the answer has `true` with it.
    ///
    /// # Errors
    /// As for [`crate::data::load`]; [`Error::Config`] for masks without association.
    pub fn settle(
        dir: &Path,
        options: &LoadOptions,
        frames: &[Frame],
        classes: &mut Classes,
        notices: &mut Vec<String>,
    ) -> Result<(Self, bool)> {
        let Some(first) = frames.iter().find_map(|frame| frame.raw.as_ref()) else {
            return Ok((Self::grey(), false));
        };
        let segments = options.association != Association::None;
        let source = match detect(dir, options, frames)? {
            RawFormat::Auto | RawFormat::Grey => Source::Grey,
            RawFormat::CocoPanoptic => {
                Source::Coco(coco::Panoptic::read(&folder(dir, options, first), classes)?)
            }
            RawFormat::Ade20k => Source::Ade20k(ade20k::Palette::new(first, classes)?),
            RawFormat::Masks if !segments => {
                let expected = "\"gaussians\", as raw labels are folders of masks, whose ids differ from view to view";
                let help = "add --set data.association=gaussians (`coseg train`, `coseg data`), or use `coseg associate`";
                return Err(Error::config(
                    "data.association",
                    "\"none\"",
                    expected,
                    help,
                ));
            }
            RawFormat::Masks => Source::Masks,
        };
        let vocabulary = match &source {
            Source::Coco(panoptic) => Some(panoptic.vocabulary()),
            Source::Ade20k(palette) => Some(palette.vocabulary()),
            Source::Grey | Source::Masks => None,
        };
        let own = vocabulary.is_some() && classes.is_empty();
        if let Some(vocabulary) = vocabulary {
            *classes = vocabulary.classes.clone();
            notices.extend(vocabulary.notice.clone());
        }
        Ok((Self { source, segments }, own))
    }

    /// Whether ids are segments of their view.
    pub fn are_segments(&self) -> bool {
        self.segments
    }

    /// Reads the map at `path` of a photo of the size `photo`; `check_size` refuses files of the wrong size. `known` is the
    /// lookup of `classes`.
    pub fn read(
        &self,
        path: &Path,
        photo: (usize, usize),
        classes: &Classes,
        known: &[u16],
        limits: &Limits,
        check_size: &dyn Fn(&ImageFile) -> Result<()>,
    ) -> Result<RawMap> {
        if let Source::Masks = self.source {
            let map = masks::read(path, photo, limits, check_size)?;
            return Ok(RawMap {
                map,
                segments: Vec::new(),
            });
        }
        crate::data::formats::listing::expect_file(path)?;
        let file = ImageFile::open(path, limits)?;
        check_size(&file)?;
        match &self.source {
            Source::Coco(panoptic) => {
                let read = panoptic.decode(path, &file)?;
                Ok(if self.segments {
                    read
                } else {
                    RawMap {
                        map: by_class(&read, classes),
                        segments: Vec::new(),
                    }
                })
            }
            Source::Ade20k(palette) => {
                let map = palette.decode(path, &file)?;
                let segments = if self.segments {
                    palette.stuff()
                } else {
                    Vec::new()
                };
                Ok(RawMap { map, segments })
            }
            Source::Grey | Source::Masks => {
                let mut map = LabelMap::decode(path, &file)?;
                if !self.segments {
                    map.settle_ids(path, classes, known, IF_SEGMENTS)?;
                }
                Ok(RawMap {
                    map,
                    segments: Vec::new(),
                })
            }
        }
    }
}

/// A map of segments as a map of their classes.
fn by_class(read: &RawMap, classes: &Classes) -> LabelMap {
    let mut table = vec![classes.ignore; 1 << 16];
    for segment in &read.segments {
        table[usize::from(segment.id)] = segment.class.unwrap_or(classes.ignore);
    }
    LabelMap {
        ids: read
            .map
            .ids
            .iter()
            .map(|&id| table[usize::from(id)])
            .collect(),
        ..read.map
    }
}

//! Raw labels as segmenters write them: which of the formats a folder has, and what its maps say.

mod ade20k;
pub(crate) mod coco_instances;
mod coco_panoptic;
mod drawing;
pub(crate) mod labelme;
mod masks;
mod own_classes;

use self::drawing::Drawing;
use super::label_map::expect_file;
use crate::config::{Association, RawFormat};
use crate::data::labels::scores::ScoreIds;
use crate::data::photos::image_file::ImageFile;
use crate::data::{Classes, LabelMap, Limits, LoadOptions, Segment};
use crate::error::{Result, bail};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Help for unknown ids that may be no classes.
const SEGMENTS_HELP: &str = "; where ids mean something in their view alone (instance masks), \
    add --set data.association=gaussians, or use `coseg associate`";

/// The format of the raw labels of a scene folder.
pub(crate) struct RawLabels {
    source: Source,
    /// Ids are segments of their view, not classes.
    segments: bool,
    /// The ids of scores beside the maps; `None` where maps of this kind have no scores.
    scores: Option<Arc<ScoreIds>>,
}

enum Source {
    Grey,
    /// Grey maps of ids of the class table beside them.
    Named(own_classes::OwnClasses),
    Coco(coco_panoptic::Panoptic),
    /// With the class id of each class of ADE20K.
    Ade20k(Vec<Option<u16>>),
    Masks,
    /// Shapes, by the names of the frames.
    Drawn(HashMap<String, Drawing>),
}

/// Where the raw labels of a photo are.
#[derive(Clone, Copy)]
pub(crate) struct RawFile<'a> {
    /// Name of the frame.
    pub name: &'a str,
    pub photo: &'a Path,
    /// A map, a folder of masks, or a file of shapes.
    pub path: &'a Path,
    /// It is a file of LabelMe.
    pub is_labelme: bool,
}

/// A decoded map, of the size of its file.
#[derive(Debug)]
pub(crate) struct RawMap {
    pub map: LabelMap,
    /// What is known of its segments; empty where ids are classes, and where nothing is known.
    pub segments: Vec<Segment>,
}

/// How a segmenter's own classes become those of the scene.
#[derive(Clone)]
pub(crate) struct Vocabulary {
    /// The class table of the scene.
    pub classes: Classes,
    /// Class id of each of the segmenter's classes, in its order.
    ids: Vec<Option<u16>>,
    /// What is left out.
    pub notice: Option<String>,
}

impl Vocabulary {
    /// Matches the segmenter's classes `names` to the table `classes` by name. An empty table is replaced by the segmenter's, with
    /// the ids that come with the names.
    ///
    /// # Errors
    /// No name is in the table.
    fn new(file: &Path, classes: &Classes, names: &[(u16, &str)]) -> Result<Self> {
        if classes.is_empty() {
            return Ok(Self {
                classes: Classes::from_names(0, names.iter().copied()),
                ids: names.iter().map(|(id, _)| Some(*id)).collect(),
                notice: None,
            });
        }
        let ids: Vec<Option<u16>> = names.iter().map(|(_, name)| classes.id_of(name)).collect();
        let found = ids.iter().flatten().count();
        let all = names.len();
        if found == 0 {
            let listed: Vec<_> = names.iter().take(5).map(|(_, name)| *name).collect();
            bail!(file, "categories"; found "{} ..", listed.join(", ");
                expected "names of the class table, such as {}", classes.entries[0].name;
                help "rename the classes of classes.json, or remove it where there are no true labels");
        }
        let others = names.iter().zip(&ids).filter(|(_, id)| id.is_none());
        let others: Vec<&str> = others.map(|((_, name), _)| *name).collect();
        let notice = format!(
            "{found} of the {all} classes of {} are in the class table by name; pixels of the others are unlabelled: {}",
            file.display(),
            crate::data::first_names(&others)
        );
        Ok(Self {
            classes: classes.clone(),
            ids,
            notice: (found < all).then_some(notice),
        })
    }
}

/// Whether the raw labels `files` need a class table: all but those that bring their own or have none. Returns the text to
/// add to the help if the table is missing.
pub(crate) fn needs_classes(
    dir: &Path,
    options: &LoadOptions,
    files: &[RawFile],
) -> Option<&'static str> {
    let is_named = own_classes::table(dir, &folder(dir, options, files.first()?.path)).is_some();
    let is_grey = options.association == Association::None
        && format_of(dir, options, files) == RawFormat::Grey;
    (is_grey && !is_named).then_some(SEGMENTS_HELP)
}

/// The format that the options name, or that of the first map.
fn format_of(dir: &Path, options: &LoadOptions, files: &[RawFile]) -> RawFormat {
    let Some(first) = files.iter().find(|file| file.path.exists()) else {
        return if options.raw_format == RawFormat::Auto {
            RawFormat::Grey
        } else {
            options.raw_format
        };
    };
    if options.raw_format != RawFormat::Auto {
        return options.raw_format;
    }
    if first.is_labelme {
        return RawFormat::Labelme;
    }
    let first = first.path;
    if first.is_dir() {
        return RawFormat::Masks;
    }
    if coco_instances::find(dir, options).as_deref() == Some(first) {
        return RawFormat::CocoInstances;
    }
    // A file that cannot be read is reported where it is read.
    let Ok(file) = ImageFile::open(first, &options.limits) else {
        return RawFormat::Grey;
    };
    match file.png_color() {
        Some((_, 2 | 6)) if coco_panoptic::find(&folder(dir, options, first)).is_some() => {
            RawFormat::CocoPanoptic
        }
        Some((_, 2 | 3 | 6)) if ade20k::matches(&file) => RawFormat::Ade20k,
        _ => RawFormat::Grey,
    }
}

/// The folder of raw labels that `map` is in.
fn folder(dir: &Path, options: &LoadOptions, map: &Path) -> PathBuf {
    let usual = dir.join(options.raw_labels.as_deref().unwrap_or("labels_raw"));
    match map.parent() {
        Some(parent) if !map.starts_with(&usual) => parent.to_owned(),
        _ => usual,
    }
}

impl RawLabels {
    /// Grey maps of class ids; also where there are no raw labels.
    pub fn grey() -> Self {
        Self {
            source: Source::Grey,
            segments: false,
            scores: None,
        }
    }

    /// The format of the raw labels `files` of a scene with the table `classes`, and the segmenter's vocabulary where the format
    /// has one.
    ///
    /// # Errors
    /// As for [`crate::data::load`]; [`crate::Error::Config`] for masks without association.
    pub fn detect(
        dir: &Path,
        options: &LoadOptions,
        files: &[RawFile],
        classes: &Classes,
    ) -> Result<(Self, Option<Vocabulary>)> {
        let Some(first) = files.first().map(|file| file.path) else {
            return Ok((Self::grey(), None));
        };
        let segments = options.association != Association::None;
        let mut vocabulary = None;
        let source = match format_of(dir, options, files) {
            RawFormat::Auto | RawFormat::Grey if segments => Source::Grey,
            RawFormat::Auto | RawFormat::Grey => {
                let table = own_classes::table(dir, &folder(dir, options, first));
                match table
                    .map(|file| own_classes::OwnClasses::read(&file, classes))
                    .transpose()?
                {
                    Some((own, known)) => {
                        vocabulary = Some(known);
                        Source::Named(own)
                    }
                    None => Source::Grey,
                }
            }
            RawFormat::CocoPanoptic => {
                let panoptic =
                    coco_panoptic::Panoptic::read(&folder(dir, options, first), classes)?;
                vocabulary = Some(panoptic.vocabulary.clone());
                Source::Coco(panoptic)
            }
            RawFormat::Ade20k => {
                let own = vocabulary.insert(ade20k::vocabulary(first, classes)?);
                Source::Ade20k(own.ids.clone())
            }
            RawFormat::Labelme => {
                let (drawings, known) = labelme::read(files, classes)?;
                vocabulary = Some(known);
                Source::Drawn(drawings)
            }
            RawFormat::CocoInstances => {
                let read = coco_instances::read(first, files, classes, &options.limits);
                let (drawings, known) = read?;
                vocabulary = Some(known);
                Source::Drawn(drawings)
            }
            RawFormat::Masks if segments => Source::Masks,
            RawFormat::Masks => bail!(setting "data.association"; found "\"none\"";
                expected "\"gaussians\", as raw labels are folders of masks, whose ids differ from view to view";
                help "add --set data.association=gaussians (`coseg train`, `coseg data`), or use `coseg associate`"),
        };
        let known = vocabulary.as_ref().map_or(classes, |own| &own.classes);
        let scores = match &source {
            _ if segments => None,
            Source::Grey => Some(
                known
                    .entries
                    .iter()
                    .map(|class| (class.id, class.id))
                    .collect(),
            ),
            Source::Named(own) => Some(own.ids.clone()),
            Source::Coco(_) | Source::Ade20k(_) | Source::Masks | Source::Drawn(_) => None,
        };
        Ok((
            Self {
                source,
                segments,
                scores: scores.map(Arc::new),
            },
            vocabulary,
        ))
    }

    /// Whether ids are segments of their view.
    pub fn are_segments(&self) -> bool {
        self.segments
    }

    /// Whether labels are shapes that somebody drew.
    pub fn are_drawn(&self) -> bool {
        self.drawings().is_some()
    }

    /// Whether somebody drew labels on the photo of this name.
    pub fn has_drawing(&self, name: &str) -> bool {
        self.drawings()
            .is_some_and(|drawings| drawings.contains_key(name))
    }

    /// The shapes by the names of the frames.
    fn drawings(&self) -> Option<&HashMap<String, Drawing>> {
        match &self.source {
            Source::Drawn(drawings) => Some(drawings),
            _ => None,
        }
    }

    /// The ids of scores that may lie beside the maps.
    pub fn score_ids(&self) -> Option<Arc<ScoreIds>> {
        self.scores.clone()
    }

    /// Reads the map at `path` of a photo of the size `photo` and the name `name`; `check_size` refuses files of the wrong size.
    /// With the class table comes its lookup.
    pub fn read(
        &self,
        (name, path): (&str, &Path),
        photo: (usize, usize),
        (classes, known): (&Classes, &[u16]),
        limits: &Limits,
        check_size: &dyn Fn(&ImageFile) -> Result<()>,
    ) -> Result<RawMap> {
        let without_segments = |map| RawMap {
            map,
            segments: Vec::new(),
        };
        if let Source::Masks = self.source {
            return masks::read(path, photo, limits, check_size).map(without_segments);
        }
        let with_classes = |raw: RawMap| {
            if self.segments {
                raw
            } else {
                without_segments(by_class(&raw, classes))
            }
        };
        expect_file(path)?;
        if let Some(drawing) = self.drawings().and_then(|drawings| drawings.get(name)) {
            return drawing.paint(photo).map(with_classes);
        }
        let file = ImageFile::open(path, limits)?;
        check_size(&file)?;
        match &self.source {
            Source::Coco(panoptic) => panoptic.decode(path, &file).map(with_classes),
            Source::Ade20k(ids) => {
                let map = ade20k::decode(path, &file, ids, classes.ignore)?;
                let segments = if self.segments {
                    ade20k::stuff(ids)
                } else {
                    Vec::new()
                };
                Ok(RawMap { map, segments })
            }
            Source::Named(own) => {
                let mut map = LabelMap::decode(path, &file)?;
                own.translate(path, &mut map, classes.ignore)?;
                Ok(without_segments(map))
            }
            Source::Grey | Source::Masks | Source::Drawn(_) => {
                let mut map = LabelMap::decode(path, &file)?;
                if !self.segments {
                    map.check_ids(path, classes, known, SEGMENTS_HELP)?;
                }
                Ok(without_segments(map))
            }
        }
    }
}

/// A map of segments as a map of their classes.
fn by_class(raw: &RawMap, classes: &Classes) -> LabelMap {
    let mut class_ids = vec![classes.ignore; 1 << 16];
    for segment in &raw.segments {
        class_ids[usize::from(segment.id)] = segment.class.unwrap_or(classes.ignore);
    }
    let mut map = raw.map.clone();
    map.ids
        .iter_mut()
        .for_each(|id| *id = class_ids[usize::from(*id)]);
    map
}

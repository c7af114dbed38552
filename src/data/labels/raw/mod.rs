//! Raw labels as segmenters write them: which of the formats a folder has, and what its maps say.

mod ade20k;
mod coco_instances;
mod coco_panoptic;
mod cvat;
mod drawing;
pub(crate) mod labelme;
mod masks;
mod own_classes;
mod runs;
mod shape_file;
mod shape_labels;
mod vocabulary;

use self::drawing::Drawing;
pub(crate) use self::shape_file::{INDEX_FILE, OTHER_FILES, ShapeFile};
use self::vocabulary::{Unmatched, Vocabulary};
use super::label_map::expect_file;
use crate::config::{Association, RawFormat};
use crate::data::labels::scores::ScoreIds;
use crate::data::photos::image_file::ImageFile;
use crate::data::{Classes, LabelMap, LoadOptions, Segment};
use crate::error::{Result, bail};
use crate::files;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Help for classes that the scene lacks: of labels that `coseg label` wrote, and of others.
const MAP_CLASSES: &str =
    "map them to classes of the scene with --classes FILE.toml (`coseg label`)";
const ADD_CLASSES: &str = "correct the names, or add them to classes.json";

/// Help for unknown ids that may be no classes.
const SEGMENTS_HELP: &str = "; where ids mean something in their view alone (instance masks), \
    add --set data.association=gaussians, or use `coseg associate`";

/// The format of the raw labels of a scene folder.
#[derive(Default)]
pub(crate) struct RawLabels {
    source: Source,
    /// Ids are segments of their view, not classes.
    pub are_segments: bool,
    /// The ids of scores that may lie beside the maps; `None` where maps of this kind have no scores.
    pub score_ids: Option<Arc<ScoreIds>>,
    /// Classes that the scene lacks.
    unmatched: Option<Arc<Unmatched>>,
}

#[derive(Default)]
enum Source {
    /// Grey maps of class ids; also if there are no raw labels.
    #[default]
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

/// Whether the raw labels `files` require a class table: all but those that bring their own or have none. Returns the text to
/// add to the help if the table is missing.
pub(crate) fn requires_classes(
    dir: &Path,
    options: &LoadOptions,
    files: &[RawFile],
) -> Option<&'static str> {
    let maps = folder(dir, options, files.first()?.path);
    // Where labelling was stopped, that is what is reported.
    let is_named =
        own_classes::table(dir, &maps).is_some() || own_classes::unfinished_index(&maps).is_some();
    let is_grey = options.association == Association::None
        && format_of(dir, options, files) == RawFormat::Grey;
    (is_grey && !is_named).then_some(SEGMENTS_HELP)
}

/// The format that the options name, or that of the first map.
fn format_of(dir: &Path, options: &LoadOptions, files: &[RawFile]) -> RawFormat {
    let first = files.iter().find(|file| file.path.exists());
    match (options.raw_format, first) {
        (RawFormat::Auto, None) => RawFormat::Grey,
        (RawFormat::Auto, Some(first)) => format_of_file(dir, options, first),
        (format, _) => format,
    }
}

fn format_of_file(dir: &Path, options: &LoadOptions, file: &RawFile) -> RawFormat {
    let path = file.path;
    if file.is_labelme {
        return RawFormat::Labelme;
    }
    if path.is_dir() {
        return RawFormat::Masks;
    }
    if let Some(file) = ShapeFile::find(dir, options).filter(|file| file.path == path) {
        return file.format;
    }
    // A file that cannot be read is reported where it is read.
    let Ok(image) = ImageFile::open(path) else {
        return RawFormat::Grey;
    };
    match image.png_color() {
        Some((_, 2 | 6)) if coco_panoptic::find(&folder(dir, options, path)).is_some() => {
            RawFormat::CocoPanoptic
        }
        Some((_, 2 | 3 | 6)) if ade20k::matches(&image) => RawFormat::Ade20k,
        _ => RawFormat::Grey,
    }
}

/// The usual folder of raw labels.
pub(crate) const LABELS_RAW: &str = "labels_raw";

/// The folder of raw labels that `map` is in.
fn folder(dir: &Path, options: &LoadOptions, map: &Path) -> PathBuf {
    let usual = dir.join(options.raw_labels.as_deref().unwrap_or(LABELS_RAW));
    if map.starts_with(&usual) {
        usual
    } else {
        files::folder(map).to_owned()
    }
}

impl RawLabels {
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
            return Ok((Self::default(), None));
        };
        let are_segments = options.association != Association::None;
        let folder = || folder(dir, options, first);
        let drawn = |(drawings, vocabulary)| (Source::Drawn(drawings), Some(vocabulary));
        let (source, vocabulary) = match format_of(dir, options, files) {
            RawFormat::Auto | RawFormat::Grey if are_segments => (Source::Grey, None),
            RawFormat::Auto | RawFormat::Grey => {
                own_classes::expect_finished(&folder())?;
                match own_classes::table(dir, &folder()) {
                    Some(file) => {
                        let (own, vocabulary) = own_classes::OwnClasses::read(&file, classes)?;
                        (Source::Named(own), Some(vocabulary))
                    }
                    None => (Source::Grey, None),
                }
            }
            RawFormat::CocoPanoptic => {
                let (panoptic, vocabulary) = coco_panoptic::Panoptic::read(&folder(), classes)?;
                (Source::Coco(panoptic), Some(vocabulary))
            }
            RawFormat::Ade20k => {
                let vocabulary = ade20k::vocabulary(first, classes)?;
                (Source::Ade20k(vocabulary.ids.clone()), Some(vocabulary))
            }
            RawFormat::Labelme => drawn(labelme::read(files, classes)?),
            RawFormat::CocoInstances => drawn(coco_instances::read(first, files, classes)?),
            RawFormat::Cvat => drawn(cvat::read(first, files, classes)?),
            RawFormat::Masks if are_segments => (Source::Masks, None),
            RawFormat::Masks => bail!(setting "data.association"; found "\"none\"";
                expected "\"gaussians\", as raw labels are folders of masks, whose ids differ from view to view";
                help "add --set data.association=gaussians (`coseg train`, `coseg data`), or use `coseg associate`"),
        };
        let ids = classes.entries.iter().map(|class| class.id);
        let score_ids = match &source {
            Source::Grey => Some(ScoreIds::new(classes.ignore, ids.map(|id| (id, Some(id))))),
            Source::Named(own) => Some(own.score_ids()),
            _ => None,
        };
        let raw = Self {
            source,
            are_segments,
            score_ids: score_ids.filter(|_| !are_segments).map(Arc::new),
            unmatched: vocabulary.as_ref().and_then(|v| v.unmatched.clone()),
        };
        Ok((raw, vocabulary))
    }

    /// The shapes by the names of the frames, where labels are shapes that somebody drew.
    pub fn drawings(&self) -> Option<&HashMap<String, Drawing>> {
        match &self.source {
            Source::Drawn(drawings) => Some(drawings),
            _ => None,
        }
    }

    /// A notice on the classes that the scene lacks, with their shares of the maps that were read.
    pub fn unmatched_classes(&self) -> Option<String> {
        let help = match &self.source {
            Source::Named(own) if own.is_by_label => MAP_CLASSES,
            _ => ADD_CLASSES,
        };
        self.unmatched.as_ref().map(|classes| classes.notice(help))
    }

    /// Reads `raw`, whose photo has the size `photo`; `check_size` refuses files of the wrong size.
    pub fn read(
        &self,
        raw: RawFile,
        photo: (usize, usize),
        classes: &Classes,
        check_size: &dyn Fn(&ImageFile) -> Result<()>,
    ) -> Result<RawMap> {
        let path = raw.path;
        if let Source::Masks = self.source {
            return masks::read(path, photo, check_size).map(RawMap::from);
        }
        expect_file(path, raw.photo)?;
        let in_classes = |raw| self.in_classes(raw, classes);
        let drawings = self.drawings();
        if let Some(drawing) = drawings.and_then(|drawings| drawings.get(raw.name)) {
            return drawing.paint(photo).map(in_classes);
        }
        let file = ImageFile::open(path)?;
        check_size(&file)?;
        match &self.source {
            Source::Coco(panoptic) => panoptic.decode(path, &file).map(in_classes),
            Source::Ade20k(ids) => {
                let unmatched = self.unmatched.as_deref();
                ade20k::decode(path, &file, ids, classes.ignore, unmatched).map(in_classes)
            }
            Source::Named(own) => own.decode(path, &file, classes.ignore).map(RawMap::from),
            Source::Grey | Source::Masks | Source::Drawn(_) => {
                let mut map = LabelMap::decode(path, &file)?;
                if !self.are_segments {
                    map.check_ids(path, classes, SEGMENTS_HELP)?;
                }
                Ok(map.into())
            }
        }
    }

    /// A map of segments as a map of their classes, unless ids are segments.
    fn in_classes(&self, raw: RawMap, classes: &Classes) -> RawMap {
        if self.are_segments {
            return raw;
        }
        let mut class_ids = vec![classes.ignore; 1 << 16];
        for segment in &raw.segments {
            class_ids[usize::from(segment.id)] = segment.class.unwrap_or(classes.ignore);
        }
        let mut map = raw.map;
        let ids = map.ids.iter_mut();
        ids.for_each(|id| *id = class_ids[usize::from(*id)]);
        map.into()
    }
}

impl From<LabelMap> for RawMap {
    /// A map of whose segments nothing is known.
    fn from(map: LabelMap) -> Self {
        let segments = Vec::new();
        Self { map, segments }
    }
}

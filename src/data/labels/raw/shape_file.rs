//! One file with the shapes of all photos: where it is, and which photos its pictures are.

use super::drawing::{self, Drawing};
use super::{RawFile, Vocabulary};
use crate::config::RawFormat;
use crate::data::{Classes, LoadOptions, MapGeometry};
use crate::error::{Result, ensure};
use crate::files::{extension, names};
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// JSON files in a folder of labels that are something else.
const OTHER_FILES: [&str; 3] = [Classes::FILE, "label.json", MapGeometry::FILE];
/// The file of CVAT's own export.
const CVAT_FILE: &str = "annotations.xml";
/// The folder of the file of COCO in exports.
const COCO_FOLDER: &str = "annotations";
/// The folder of exports for copies of the photos.
const PHOTO_FOLDER: &str = "images";

/// A file with the shapes of all photos.
pub(crate) struct ShapeFile {
    pub path: PathBuf,
    /// Of CVAT or COCO.
    pub format: RawFormat,
    /// It lies as in exports.
    is_export: bool,
}

impl ShapeFile {
    /// The file that `data.raw_labels` names, or the one in the folder that it names: CVAT's `annotations.xml`, or the only JSON file
    /// in it or in `annotations`.
    pub fn find(dir: &Path, options: &LoadOptions) -> Option<Self> {
        let named = dir.join(options.raw_labels.as_deref()?);
        let found = if named.is_file() {
            let format = match options.raw_format {
                RawFormat::Auto if extension(&named) == "xml" => RawFormat::Cvat,
                RawFormat::Cvat => RawFormat::Cvat,
                _ => RawFormat::CocoInstances,
            };
            Self::new(named, format, false)
        } else if options.raw_format != RawFormat::CocoInstances && named.join(CVAT_FILE).is_file()
        {
            Self::new(named.join(CVAT_FILE), RawFormat::Cvat, true)
        } else {
            let coco = |folder: &Path, is_export| {
                let file = only_json(folder)?;
                Some(Self::new(file, RawFormat::CocoInstances, is_export))
            };
            coco(&named, false).or_else(|| coco(&named.join(COCO_FOLDER), true))?
        };
        let fits = [RawFormat::Auto, found.format].contains(&options.raw_format);
        fits.then_some(found)
    }

    /// Whether it is read where the `maps` lie in the folder that `data.raw_labels` names, too: they are the export's copies of the
    /// photos, or the file certainly holds instances.
    pub fn replaces<'m>(&self, named: &Path, mut maps: impl Iterator<Item = &'m Path>) -> bool {
        let copies = named.join(PHOTO_FOLDER);
        let is_coco = self.format == RawFormat::CocoInstances;
        self.is_export
            && (maps.all(|map| map.starts_with(&copies)) || is_coco && has_instances(&self.path))
    }

    fn new(path: PathBuf, format: RawFormat, is_export: bool) -> Self {
        Self {
            path,
            format,
            is_export,
        }
    }
}

/// The only JSON file of a folder that is not one of [`OTHER_FILES`].
fn only_json(folder: &Path) -> Option<PathBuf> {
    let files = names(folder, |name, path| {
        name.ends_with(".json") && !OTHER_FILES.contains(&name) && path.is_file()
    });
    match &files[..] {
        [only] => Some(folder.join(only)),
        _ => None,
    }
}

/// Whether a JSON file certainly holds COCO instances. In files of panoptic segmentation, categories are those of segments.
fn has_instances(path: &Path) -> bool {
    #[derive(Deserialize)]
    struct Head {
        #[serde(rename = "images")]
        _images: IgnoredAny,
        annotations: Vec<Entry>,
    }
    #[derive(Deserialize)]
    struct Entry {
        category_id: Option<IgnoredAny>,
    }
    let has_category = |entry: &Entry| entry.category_id.is_some();
    drawing::read::<Head>(path, "instances")
        .is_ok_and(|head| head.annotations.iter().any(has_category))
}

/// The drawings on those images in the file at `path` that are photos of `frames`, by the names of these. `drawn` has each with the
/// file name of its image. The notice of `vocabulary` gets a sentence on other images.
///
/// # Errors
/// No image is a photo of the scene, or two are the same one.
pub(super) fn drawings<'a>(
    path: &Path,
    frames: &[RawFile],
    drawn: impl IntoIterator<Item = (&'a str, Drawing)>,
    vocabulary: &mut Vocabulary,
) -> Result<HashMap<String, Drawing>> {
    let photos = Photos::new(frames);
    let mut drawings = HashMap::new();
    let mut others = 0;
    for (image, drawing) in drawn {
        let Some(frame) = photos.frame(image) else {
            others += 1;
            continue;
        };
        ensure!(drawings.insert(frame.name.to_owned(), drawing).is_none(),
            path, "images"; found "{image} and another image of this photo";
            expected "one for each photo"; help "export the shapes again");
    }
    ensure!(!drawings.is_empty(),
        path, "annotations"; found "{others} images with regions, none of which is a photo of the scene";
        expected "regions on photos such as {}", frames.first().map_or("", |frame| frame.name);
        help "give images the file names of the photos");
    if others > 0 {
        let file = path.display();
        let other = format!("{others} labelled images of {file} are not photos of the scene");
        let notice = vocabulary.notice.take();
        vocabulary.notice =
            Some(notice.map_or(other.clone(), |notice| format!("{notice}; {other}")));
    }
    Ok(drawings)
}

/// Finds frames by the file names of images.
struct Photos<'a> {
    /// By their paths without extension and by the ends of these; `None` for an end that several have.
    by_ending: HashMap<PathBuf, Option<&'a RawFile<'a>>>,
    is_one_folder: bool,
}

impl<'a> Photos<'a> {
    fn new(frames: &'a [RawFile<'a>]) -> Self {
        let folder = frames.first().and_then(|frame| frame.photo.parent());
        let mut by_ending = HashMap::new();
        for frame in frames {
            let path = frame.photo.with_extension("");
            let parts: Vec<_> = path.components().collect();
            for start in 0..parts.len() {
                let entry = by_ending.entry(parts[start..].iter().collect());
                entry.and_modify(|of| *of = None).or_insert(Some(frame));
            }
        }
        Self {
            by_ending,
            is_one_folder: frames.iter().all(|frame| frame.photo.parent() == folder),
        }
    }

    /// The frame of an image: the one whose photo has this path. Photos that lie in one folder are found by their names alone.
    fn frame(&self, file_name: &str) -> Option<&'a RawFile<'a>> {
        // Windows' tools write its separators.
        let path = PathBuf::from(file_name.replace('\\', "/")).with_extension("");
        let wanted = if self.is_one_folder {
            Path::new(path.file_name()?)
        } else {
            path.as_path()
        };
        self.by_ending.get(wanted).copied().flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};

    /// The photo that is found for an image of this name.
    fn found<'a>(photos: &[&'a str], file_name: &str) -> Option<&'a str> {
        let frames: Vec<_> = photos.iter().map(|photo| frame(photo)).collect();
        let name = Photos::new(&frames).frame(file_name)?.name;
        photos.iter().copied().find(|photo| *photo == name)
    }

    fn frame(photo: &str) -> RawFile<'_> {
        RawFile {
            name: photo,
            photo: Path::new(photo),
            path: Path::new("coco.json"),
            is_labelme: false,
        }
    }

    #[test]
    fn photos_of_one_folder_are_found_by_name_and_others_by_path() {
        let one = ["/room/images/a.jpg", "/room/images/b.v2.jpg"];
        assert_eq!(found(&one, "a.png"), Some(one[0]));
        assert_eq!(found(&one, "train\\b.v2.png"), Some(one[1]));
        assert_eq!(found(&one, "b.png"), None);
        assert_eq!(found(&one, ""), None);
        let two = [
            "/room/images/left/a.jpg",
            "/room/images/right/a.jpg",
            "/room/images/left/b.jpg",
        ];
        assert_eq!(found(&two, "right\\a.jpg"), Some(two[1]));
        assert_eq!(found(&two, "images/left/a.png"), Some(two[0]));
        assert_eq!(found(&two, "b.jpg"), Some(two[2]));
        for other in ["a.jpg", "ht/a.jpg", "train/left/a.jpg", "", "c.jpg"] {
            assert_eq!(found(&two, other), None, "{other}");
        }
        let same = ["/room/images/a.jpg", "/room/images/a.png"];
        assert_eq!(found(&same, "a.jpg"), None);
    }

    #[test]
    fn photos_are_found_in_time_that_grows_with_their_number() {
        // A comparison of each with each takes minutes.
        let photos: Vec<String> = (0..30_000)
            .map(|i| format!("/room/images/{i}.jpg"))
            .collect();
        let frames: Vec<_> = photos.iter().map(|photo| frame(photo)).collect();
        let started = Instant::now();
        let photos = Photos::new(&frames);
        for frame in &frames {
            assert_eq!(
                photos.frame(frame.name).map(|found| found.name),
                Some(frame.name)
            );
        }
        assert!(started.elapsed() < Duration::from_secs(30));
    }
}

//! One file with the shapes of all photos: where it is, and which photos its pictures are.

use super::drawing::{self, Drawing};
use super::{RawFile, Vocabulary};
use crate::config::RawFormat;
use crate::data::photos::EXTENSIONS;
use crate::data::{Classes, LoadOptions, MapGeometry, first_names};
use crate::error::{Result, ensure};
use crate::files::{extension, names};
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The index of a folder that `coseg label` writes.
pub(crate) const INDEX_FILE: &str = "label.json";
/// JSON files in a folder of labels that are something else.
pub(crate) const OTHER_FILES: [&str; 3] = [Classes::FILE, INDEX_FILE, MapGeometry::FILE];
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
/// file name of its image. The notice of `vocabulary` becomes a sentence on other images.
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
    let mut others = Vec::new();
    for (image, drawing) in drawn {
        let Some(frame) = photos.frame(image) else {
            others.push(image);
            continue;
        };
        ensure!(drawings.insert(frame.name.to_owned(), drawing).is_none(),
            path, "images"; found "{image} and another image of this photo";
            expected "one for each photo"; help "export each image once, without augmentation");
    }
    let (count, first) = (others.len(), first_names(&others));
    ensure!(!drawings.is_empty(),
        path, "annotations"; found "{count} images with regions, none of which is a photo of the scene: {first}";
        expected "regions on photos such as {}", frames.first().map_or("", |frame| frame.name);
        help "give images the file names of the photos");
    if count > 0 {
        let file = path.display();
        vocabulary.notice = Some(format!(
            "{count} labelled images of {file} are not photos of the scene: {first}"
        ));
    }
    Ok(drawings)
}

/// Frames by the paths of their photos without extension, and by the ends of these; `None` for an end that several have.
type Endings<'a> = HashMap<PathBuf, Option<&'a RawFile<'a>>>;

/// Finds frames by the file names of images.
struct Photos<'a> {
    by_ending: Endings<'a>,
    /// The same in lower case.
    by_lower_case: Endings<'a>,
    is_one_folder: bool,
}

impl<'a> Photos<'a> {
    fn new(frames: &'a [RawFile<'a>]) -> Self {
        let folder = frames.first().and_then(|frame| frame.photo.parent());
        let mut by_ending = Endings::new();
        let mut by_lower_case = Endings::new();
        for frame in frames {
            let path = frame.photo.with_extension("");
            let parts: Vec<_> = path.components().collect();
            for start in 0..parts.len() {
                let ending: PathBuf = parts[start..].iter().collect();
                for (all, key) in [
                    (&mut by_lower_case, lower_case(&ending)),
                    (&mut by_ending, ending),
                ] {
                    let entry = all.entry(key);
                    entry.and_modify(|of| *of = None).or_insert(Some(frame));
                }
            }
        }
        Self {
            by_ending,
            by_lower_case,
            is_one_folder: frames.iter().all(|frame| frame.photo.parent() == folder),
        }
    }

    /// The frame of an image: the one whose photo has this path. Photos that lie in one folder are found by their names alone. Where no
    /// photo has exactly this path, it is the only one that has it in other capitals, or one of the [`original_names`].
    fn frame(&self, file_name: &str) -> Option<&'a RawFile<'a>> {
        // Windows' tools write its separators.
        let path = PathBuf::from(file_name.replace('\\', "/")).with_extension("");
        let name = Path::new(path.file_name()?);
        let wanted = if self.is_one_folder { name } else { &path };
        if let Some(exact) = self.by_ending.get(wanted) {
            return *exact;
        }
        let name = lower_case(name);
        let originals = original_names(name.to_str()?);
        let names = originals.into_iter().map(PathBuf::from);
        let mut found = names
            .chain([lower_case(wanted)])
            .filter_map(|name| self.by_lower_case.get(&name));
        let first = (*found.next()?)?;
        let is_first = |other: &Option<&RawFile>| other.is_some_and(|o| o.name == first.name);
        found.all(is_first).then_some(first)
    }
}

fn lower_case(path: &Path) -> PathBuf {
    path.to_string_lossy().to_lowercase().into()
}

/// What an image in lower case and without extension may have been called before a tool took it: `a` for Label Studio's
/// `0123abcd-a`, for Roboflow's `a_jpg.rf.` with 32 hexadecimal digits, and for its `a_jpeg_jpg.rf.`. Both leave folders out.
fn original_names(name: &str) -> Vec<&str> {
    let is_hex = |text: &str, digits: usize| {
        text.len() == digits && text.bytes().all(|byte| byte.is_ascii_hexdigit())
    };
    let mut originals = Vec::new();
    if let Some((upload, original)) = name.split_once('-')
        && is_hex(upload, 8)
    {
        originals.push(original);
    }
    if let Some((mut original, version)) = name.rsplit_once(".rf.")
        && is_hex(version, 32)
    {
        while let Some((stem, extension)) = original.rsplit_once('_')
            && EXTENSIONS.contains(&extension)
        {
            originals.push(stem);
            original = stem;
        }
    }
    originals
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
    fn photos_are_found_by_the_names_that_tools_give_them() {
        let hash = "0123456789abcdef0123456789ABCDEF";
        let one = ["/room/images/train_000.jpg", "/room/images/B-1.JPG"];
        let roboflow = |name: &str| format!("train/{name}.rf.{hash}.jpg");
        for name in [
            "ab12cd34-train_000.jpg",
            "images/ab12cd34-train_000.jpg",
            "..\\..\\media\\upload\\1\\ab12cd34-train_000.jpg",
            "TRAIN_000.PNG",
            &roboflow("train_000_jpg"),
            &roboflow("train_000_jpeg_jpg"),
        ] {
            assert_eq!(found(&one, name), Some(one[0]), "{name}");
        }
        for name in ["b-1.jpg", "0000ffff-B-1.jpg", &roboflow("B-1_JPG_jpg")] {
            assert_eq!(found(&one, name), Some(one[1]), "{name}");
        }
        for name in [
            "ab12cd3-train_000.jpg",
            "ab12cd3x-train_000.jpg",
            "ab12cd34-.jpg",
            "ab12cd34-ab12cd34-train_000.jpg",
            "train_000_jpg.rf.0123.jpg",
            &roboflow("train_000"),
            &roboflow("train_000_gif"),
            &roboflow("_jpg"),
        ] {
            assert_eq!(found(&one, name), None, "{name}");
        }
        // The exact name comes first, and no photo is guessed.
        let both = ["/room/images/ab12cd34-a.jpg", "/room/images/a.jpg"];
        assert_eq!(found(&both, "ab12cd34-a.jpg"), Some(both[0]));
        assert_eq!(found(&both, "AB12CD34-A.jpg"), None);
        let capitals = ["/room/images/A.jpg", "/room/images/a.jpg"];
        assert_eq!(found(&capitals, "a.jpg"), Some(capitals[1]));
        assert_eq!(found(&capitals, "ab12cd34-a.jpg"), None);
        let two = [
            "/room/images/left/a.jpg",
            "/room/images/right/a.jpg",
            "/room/images/left/b.jpg",
        ];
        assert_eq!(found(&two, "images/ab12cd34-b.jpg"), Some(two[2]));
        assert_eq!(found(&two, "images/ab12cd34-a.jpg"), None);
        assert_eq!(found(&two, "Left/A.jpg"), Some(two[0]));
        assert_eq!(found(&two, "train/left/b.jpg"), None);
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

//! Scenes as folders with a `transforms.json` (nerfstudio, instant-ngp): OpenGL camera-to-world poses, photos, and the
//! fields of this crate: per frame `split`, `label_path`, `raw_label_path`, `instance_path`; per folder `classes.json`.
//! `mask_path` is nerfstudio's.

mod named_folder;
pub(crate) mod not_finite;
mod schema;
mod sources;
mod splits;
mod write;

pub(crate) use self::sources::marker;
pub use self::write::write_cameras;
pub use crate::data::NamedCamera;
pub use crate::data::options::LoadOptions;

use super::folder::{Folder, Problems};
use super::frame::Frame;
use super::listing::{Cloud, Listing};
use super::mask_file::Masks;
use crate::config::Layout;
use crate::data::photos::EXTENSIONS;
use crate::data::photos::image_file::ImageFile;
use crate::data::photos::lens::Lens;
use crate::data::{Limits, Scene, Split};
use crate::error::{Error, Result, ensure, invalid};
use crate::files::{file_name, names};
use crate::splat::camera::Camera;
use named_folder::NamedFolder;
use rayon::prelude::*;
use sources::{Kept, Source, Sources};
use std::path::{Path, PathBuf};

/// Usual names of initial clouds, for files that do not name theirs.
const CLOUDS: [&str; 3] = ["points.ply", "sparse_pc.ply", "points3D.ply"];

/// Loads the scene in folder `dir` from its `transforms.json`, even if the folder has other layouts too.
///
/// As [`crate::data::load`]; `up` is +z when the file's `convention` says `world z up`, else that of its cameras
/// ([`crate::splat::camera::level_up`]). `split` of the frames is `train`, `test` or `val` (also `validation`, `eval`);
/// nerfstudio's lists (`train_filenames`, ..) may give it instead. Validation frames are held out where there are no test frames,
/// else left out. Without a split in the file every 8th frame from the first on is test. Blender's files, one for each split, are
/// read together. `ply_file_path` names the initial cloud, without which [`Scene::points`] is empty. Frames may lack labels; where
/// they have some, `classes.json` must be there.
///
/// # Errors
/// As [`crate::data::load`].
pub fn load(dir: &Path, options: &LoadOptions) -> Result<Scene> {
    let options = LoadOptions {
        layout: Layout::Transforms,
        ..options.clone()
    };
    crate::data::load(dir, &options)
}

/// Refuses a folder without the file.
pub(crate) fn expect(dir: &Path, options: &LoadOptions) -> Result<()> {
    if marker(dir, options).is_some() {
        return Ok(());
    }
    let others = alternatives(dir);
    let expected = "cameras and frames as nerfstudio and instant-ngp write them (docs/data.md)";
    let file = &options.transforms;
    Err(match others.first() {
        None => invalid!(dir, "{file}"; found "no such file"; expected "{expected}";
            help "give another folder, or name another layout with data.layout"),
        Some(first) => invalid!(dir, "{file}"; found "no such file, but {}", others.join(", ");
            expected "{expected}"; help "name one with --set data.transforms={first}"),
    })
}

/// Files of `dir` that the user may have meant.
pub(crate) fn alternatives(dir: &Path) -> Vec<String> {
    let mut names = names(dir, |name, _| {
        name.starts_with("transforms") && name.ends_with(".json")
    });
    // Blender's scenes have a file for each split: the one to train on comes first.
    names.sort_by_key(|name| !name.contains("train"));
    names.truncate(4);
    names
}

/// Lists the frames of the folder.
pub(crate) fn list(folder: Folder<'_>, problems: &mut Problems) -> Result<Listing> {
    let Folder { dir, options, .. } = folder;
    let limits = &options.limits;
    let sources = Sources::read(dir, options, problems)?;
    let kept = sources.pick(options, problems);
    limits.check_views(&sources.file, kept.len())?;
    let files = LabelFiles::new(folder, &sources, problems);
    let mut photos = Vec::new();
    let look = |kept: &Kept| photo(dir, &sources.files[kept.source], kept.index, limits);
    kept.par_iter().map(look).collect_into_vec(&mut photos);
    let mut frames = Vec::with_capacity(kept.len());
    for (kept, photo) in kept.into_iter().zip(photos) {
        // Nothing else is reported of a repeated frame.
        if let Some(name) = kept.name {
            let source = &sources.files[kept.source];
            let frame = frame(source, kept.index, kept.split, name, photo, problems);
            frames
                .extend(frame.map(|frame| files.add(frame, &source.transforms.frames[kept.index])));
        }
    }
    let Sources {
        file,
        files,
        mut notices,
    } = sources;
    let named_cloud = files
        .iter()
        .find_map(|source| source.transforms.ply_file_path.as_ref());
    let unnamed = CLOUDS.into_iter().find(|name| dir.join(name).is_file());
    if let (None, Some(cloud)) = (named_cloud, unnamed) {
        let file = file_name(&files[0].path).unwrap_or_default();
        notices.push(format!(
            "{cloud} is not read: {file} does not name it; add \"ply_file_path\": \"{cloud}\" if it is the initial cloud"
        ));
    }
    Ok(Listing {
        z_up: files.iter().all(|source| source.transforms.z_up()),
        cloud: named_cloud.map_or(Cloud::None, |file| Cloud::Ply(dir.join(file))),
        notices,
        ..Listing::new(folder, file, frames, None, problems)
    })
}

/// Where the label maps and masks of frames lie.
struct LabelFiles<'a> {
    dir: &'a Path,
    masks: Masks,
    mask_folder: Option<NamedFolder>,
    raw_folder: Option<NamedFolder>,
}

impl<'a> LabelFiles<'a> {
    fn new(folder: Folder<'a>, sources: &Sources, problems: &mut Problems) -> Self {
        let Folder { dir, options, .. } = folder;
        let masks = Masks::new(folder, problems);
        let mask_folder = match &masks {
            Masks::In(folder) => Some(NamedFolder::new(folder.clone(), sources, |f| {
                f.mask_path.as_ref()
            })),
            Masks::OfFrames | Masks::Off => None,
        };
        let raw_folder = options.raw_labels.as_ref().map(|folder| dir.join(folder));
        let raw_folder = raw_folder
            .map(|folder| NamedFolder::new(folder, sources, |f| f.raw_label_path.as_ref()));
        Self {
            dir,
            masks,
            mask_folder,
            raw_folder,
        }
    }

    /// `frame` with the files of `fields`, which are its entry in the file.
    fn add(&self, frame: Frame, fields: &schema::Frame) -> Frame {
        let given = |path: &Option<String>| path.as_ref().map(|path| self.dir.join(path));
        let mask = match (&self.mask_folder, &self.masks) {
            (Some(folder), _) => folder.file(fields, &frame.name),
            (None, Masks::OfFrames) => given(&fields.mask_path),
            (None, _) => None,
        };
        let raw = match &self.raw_folder {
            Some(folder) => Some(folder.file_or_masks(fields, &frame.name)),
            None => given(&fields.raw_label_path),
        };
        let folder = self.raw_folder.as_ref();
        Frame {
            mask,
            truth: given(&fields.label_path),
            drawn: folder.and_then(|folder| folder.drawn(fields, &frame.name)),
            raw,
            instances: given(&fields.instance_path),
            ..frame
        }
    }
}

/// A frame without labels. It is left out where not even the size of its photo is known.
fn frame(
    source: &Source,
    index: usize,
    split: Split,
    name: String,
    photo: FoundPhoto,
    problems: &mut Problems,
) -> Option<Frame> {
    let present = photo.faults.is_empty();
    photo
        .faults
        .into_iter()
        .for_each(|fault| problems.push(fault));
    let size = photo.size?;
    let camera = problems.ok(source.transforms.camera(&source.path, index, size));
    let posed = camera.is_some();
    let (camera, lens) = camera.unwrap_or_else(|| (Camera::unposed(size), Lens::default()));
    Some(Frame {
        present,
        posed,
        lens,
        ..Frame::new(name, split, photo.path, camera)
    })
}

/// The cameras of a `transforms.json`, in file order, without looking at images: each frame or the file must say `w`
/// and `h`. Lens distortion is taken out as [`crate::data::load`] takes it out of photos. Positions are world units;
/// subtract a scene's origin before rendering. `split` keeps only those frames.
///
/// # Errors
/// As [`load`]; also when no frame is left.
pub fn load_cameras(path: &Path, split: Option<Split>) -> Result<Vec<NamedCamera>> {
    let mut problems = Problems::default();
    let sources = Sources::of_file(path, &mut problems)?;
    let kept = sources.pick(&LoadOptions::default(), &mut problems);
    problems.first()?;
    let transforms = &sources.files[0].transforms;
    let mut cameras = Vec::new();
    for Kept {
        index,
        split: of,
        name,
        ..
    } in kept
    {
        let Some(name) = name.filter(|_| split.is_none_or(|split| split == of)) else {
            continue;
        };
        let size = transforms.declared_size(path, index)?.ok_or_else(|| {
            invalid!(path, "{}.w", transforms.field(index); found "no image size"; expected "w and h in pixels";
                help "add w and h")
        })?;
        Limits::default().check_pixels(path, size.0, size.1)?;
        let (camera, lens) = transforms.camera(path, index, size)?;
        let image = PathBuf::from(&transforms.frames[index].file_path);
        let frame = Frame {
            lens,
            ..Frame::new(name, of, image, camera)
        };
        let camera = frame.own_geometry()?.camera;
        cameras.push(NamedCamera {
            name: frame.name,
            split: of,
            camera,
        });
    }
    ensure!(!cameras.is_empty(), path, "frames"; found "no frame of split {split:?}"; expected "at least one";
        help "choose the other split or all");
    Ok(cameras)
}

/// What is known of a frame's photo.
struct FoundPhoto {
    path: PathBuf,
    faults: Vec<Error>,
    /// The size that the file gives, else the image's own.
    size: Option<(usize, usize)>,
}

fn photo(dir: &Path, source: &Source, i: usize, limits: &Limits) -> FoundPhoto {
    let Source {
        path: file,
        transforms,
        ..
    } = source;
    let path = image_path(dir, &transforms.frames[i].file_path);
    let mut problems = Problems::default();
    let is_there = path.is_file();
    if !is_there {
        problems.push(
            invalid!(file, "{}.file_path", transforms.field(i); found "no file {}", path.display();
            expected "an image"; help "put the image there or drop the frame"),
        );
    }
    let size = match problems.ok(transforms.declared_size(file, i)) {
        Some(None) if is_there => problems
            .ok(ImageFile::open(&path, limits))
            .map(|image| image.size),
        declared => declared.flatten(),
    };
    FoundPhoto {
        path,
        faults: problems.all(),
        size,
    }
}

/// The image of a frame; files made by Blender leave the extension out.
fn image_path(dir: &Path, file: &str) -> PathBuf {
    let path = dir.join(file);
    if path.extension().is_some() || path.is_file() {
        return path;
    }
    let mut paths = EXTENSIONS
        .into_iter()
        .map(|extension| path.with_extension(extension));
    paths
        .find(|path| path.is_file())
        .unwrap_or_else(|| path.with_extension("png"))
}

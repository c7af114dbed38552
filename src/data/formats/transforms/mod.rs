//! Scenes as folders with a `transforms.json` (nerfstudio, instant-ngp): OpenGL camera-to-world poses, photos, and the
//! fields of this crate: per frame `split`, `label_path`, `raw_label_path`, `instance_path`; per folder `classes.json`.
//! `mask_path` is nerfstudio's.
//!
//! +z is up when the file's `convention` says `world z up`, else the cameras tell ([`crate::splat::camera::level_up`]). `split` of the
//! frames is `train`, `test` or `val` (also `validation`, `eval`); nerfstudio's lists (`train_filenames`, ..) may give it instead.
//! Validation frames are held out if there are no test frames, else left out. Without a split in the file every 8th frame from the
//! first on is test. Blender's files, one for each split, are read together. `ply_file_path` names the initial cloud. Frames may lack
//! labels; where they have some, `classes.json` must be there.

mod label_files;
pub(crate) mod not_finite;
mod schema;
mod sources;
mod splits;
mod write;

pub(crate) use self::sources::marker;
pub(crate) use self::write::cameras_text;
pub use self::write::write_cameras;

use super::folder::{Folder, Problems};
use super::frame::Frame;
use super::listing::{Cloud, Listing};
use crate::data::photos::EXTENSIONS;
use crate::data::photos::image_file::ImageFile;
use crate::data::photos::lens::Lens;
use crate::data::{LoadOptions, NamedCamera, Split};
use crate::error::{Error, Result, ensure, invalid};
use crate::files::{check_pixels, check_views, file_name, names};
use crate::splat::camera::Camera;
use label_files::LabelFiles;
use rayon::prelude::*;
use schema::Transforms;
use sources::{Kept, Source, Sources};
use std::path::{Path, PathBuf};

/// Usual names of initial clouds, for files that do not name theirs.
const CLOUDS: [&str; 3] = ["points.ply", "sparse_pc.ply", "points3D.ply"];

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
    let sources = Sources::read(dir, options, problems)?;
    let kept = sources.pick(options, problems);
    check_views(&sources.file, kept.len())?;
    let files = LabelFiles::new(folder, &sources, problems);
    let look_at = |kept: &Kept| frame(dir, &sources.files[kept.source], kept);
    let looked_at: Vec<_> = kept.par_iter().map(look_at).collect();
    let mut frames = Vec::with_capacity(kept.len());
    for (Kept { source, index, .. }, (frame, faults)) in kept.iter().zip(looked_at) {
        faults.into_iter().for_each(|fault| problems.push(fault));
        let fields = &sources.files[*source].transforms.frames[*index];
        frames.extend(frame.map(|frame| files.add(frame, fields)));
    }
    let Sources { file, files, .. } = sources;
    let mut notices = sources.notices;
    let mut transforms = files.iter().map(|source| &source.transforms);
    let named_cloud = transforms
        .clone()
        .find_map(|file| file.ply_file_path.as_ref());
    let unnamed = CLOUDS.into_iter().find(|name| dir.join(name).is_file());
    if let (None, Some(cloud)) = (named_cloud, unnamed) {
        let file = file_name(&files[0].transforms.path).unwrap_or_default();
        notices.push(format!(
            "{cloud} is not read: {file} does not name it; add \"ply_file_path\": \"{cloud}\" if it is the initial cloud"
        ));
    }
    let applied = match options.dataparser_transforms {
        Some(_) => problems.ok(files[0].transforms.applied()),
        None => None,
    };
    Ok(Listing {
        applied: applied.unwrap_or_default(),
        z_up: transforms.all(Transforms::z_up),
        cloud: named_cloud.map_or(Cloud::None, |file| Cloud::Ply(dir.join(file))),
        notices,
        ..Listing::new(folder, file, frames, None, problems)
    })
}

/// A frame without labels, and its faults. It is left out where not even the size of its photo is known, which the file gives, or
/// else the photo.
fn frame(dir: &Path, source: &Source, kept: &Kept) -> (Option<Frame>, Vec<Error>) {
    let transforms = &source.transforms;
    let i = kept.index;
    let file = &transforms.path;
    let mut problems = Problems::default();
    let path = image_path(dir, &transforms.frames[i].file_path);
    let is_there = path.is_file();
    if !is_there {
        problems.push(
            invalid!(file, "{}.file_path", transforms.field(i); found "no file {}", path.display();
            expected "an image"; help "put the image there or drop the frame"),
        );
    }
    let size = match problems.ok(transforms.declared_size(i)) {
        Some(None) if is_there => problems.ok(ImageFile::open(&path)).map(|image| image.size),
        declared => declared.flatten(),
    };
    let present = problems.is_empty();
    let frame = size.map(|size| {
        let camera = problems.ok(transforms.camera(i, size));
        let posed = camera.is_some();
        let (camera, lens) = camera.unwrap_or_else(|| (Camera::unposed(size), Lens::default()));
        Frame {
            present,
            posed,
            lens,
            ..Frame::new(kept.name.clone(), kept.split, path, camera)
        }
    });
    (frame, problems.all())
}

/// The cameras of a `transforms.json`, in file order, without looking at images: each frame or the file must say `w`
/// and `h`. Lens distortion is taken out as [`crate::data::load`] takes it out of photos. Positions are world units;
/// subtract a scene's origin before rendering. `split` keeps only those frames.
///
/// # Errors
/// As [`crate::data::load`]; also when no frame is left.
pub fn load_cameras(path: &Path, split: Option<Split>) -> Result<Vec<NamedCamera>> {
    let (sources, kept) = Problems::first_of(|problems| {
        let sources = Sources::of_file(path, problems)?;
        let kept = sources.pick(&LoadOptions::default(), problems);
        Ok((sources, kept))
    })?;
    let transforms = &sources.files[0].transforms;
    let mut cameras = Vec::new();
    for kept in kept {
        let index = kept.index;
        if split.is_some_and(|split| split != kept.split) {
            continue;
        }
        let size = transforms.declared_size(index)?.ok_or_else(|| {
            invalid!(path, "{}.w", transforms.field(index); found "no image size"; expected "w and h in pixels";
                help "add w and h")
        })?;
        check_pixels(path, size.0, size.1)?;
        let (camera, lens) = transforms.camera(index, size)?;
        let image = PathBuf::from(&transforms.frames[index].file_path);
        let frame = Frame {
            lens,
            ..Frame::new(kept.name.clone(), kept.split, image, camera)
        };
        cameras.push(NamedCamera {
            name: kept.name,
            split: kept.split,
            camera: frame.own_geometry()?.camera,
        });
    }
    ensure!(!cameras.is_empty(), path, "frames"; found "no frame of split {split:?}"; expected "at least one";
        help "choose the other split or all");
    Ok(cameras)
}

/// The image of a frame; files made by Blender leave the extension out.
fn image_path(dir: &Path, file: &str) -> PathBuf {
    let path = dir.join(file);
    if path.extension().is_some() || path.is_file() {
        return path;
    }
    let paths = EXTENSIONS.map(|extension| path.with_extension(extension));
    let found = paths.into_iter().find(|path| path.is_file());
    found.unwrap_or_else(|| path.with_extension("png"))
}

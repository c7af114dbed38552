//! Scenes as folders with a `transforms.json` (nerfstudio, instant-ngp): OpenGL camera-to-world poses, photos, and the
//! fields of this crate: per frame `split`, `label_path`, `raw_label_path`, `instance_path`; per folder `classes.json`.
//! `mask_path` is nerfstudio's.

mod beside;
pub(crate) mod not_finite;
mod schema;
mod sources;
mod splits;
mod write;

pub(crate) use self::sources::found;
pub use self::write::write_cameras;
pub use crate::data::NamedCamera;
pub use crate::data::options::LoadOptions;

use super::frame::Frame;
use super::listing::{Cloud, Listing, Problems, read_classes};
use crate::config::Layout;
use crate::data::labels::map_geometry::MapGeometries;
use crate::data::labels::mask_file::Masks;
use crate::data::labels::raw;
use crate::data::labels::raw::RawLabels;
use crate::data::photos::image_file::ImageFile;
use crate::data::photos::lens::Lens;
use crate::data::{Limits, Scene, Split};
use crate::error::{Error, Result};
use crate::splat::camera::Camera;
use beside::Beside;
use rayon::prelude::*;
use sources::{Kept, Source, Sources};
use std::path::{Path, PathBuf};

/// Initial clouds as tools name them, which a file may have forgotten to name.
const CLOUDS: [&str; 3] = ["points.ply", "sparse_pc.ply", "points3D.ply"];

/// Loads the scene in folder `dir` from its `transforms.json`, whatever else lies there.
///
/// As [`crate::data::load`]; `up` is +z when the file's `convention` says `world z up`, else that of its cameras
/// ([`crate::splat::camera::level_up`]). `split` of the frames is `train`, `test` or `val` (also `validation`, `eval`), or nerfstudio's lists
/// (`train_filenames`, ..) say it: validation frames are held out where there are no test frames, else left out. Without
/// a split in the file every 8th frame from the first on is test. Blender's files, one for each split, are read
/// together. `ply_file_path` names the initial cloud, without which [`Scene::points`] is empty. Frames may lack labels;
/// where they have some, `classes.json` must be there.
///
/// # Errors
/// As [`crate::data::load`].
pub fn load(dir: &Path, options: &LoadOptions) -> Result<Scene> {
    crate::data::load(
        dir,
        &LoadOptions {
            layout: Layout::Transforms,
            ..options.clone()
        },
    )
}

/// Refuses a folder without the file.
pub(crate) fn expect(dir: &Path, options: &LoadOptions) -> Result<()> {
    if found(dir, options).is_some() {
        return Ok(());
    }
    let expected = "cameras and frames as nerfstudio and instant-ngp write them (README, 'Data')";
    let (found, help) = match alternatives(dir) {
        others if others.is_empty() => (
            "no such file".to_owned(),
            "give another folder, or name another layout with data.layout".to_owned(),
        ),
        others => (
            format!("no such file, but {}", others.join(", ")),
            format!("name one with --set data.transforms={}", others[0]),
        ),
    };
    Err(Error::input(
        dir,
        &options.transforms,
        found,
        expected,
        help,
    ))
}

/// What the folder says.
pub(crate) fn list(dir: &Path, options: &LoadOptions, problems: &mut Problems) -> Result<Listing> {
    let sources = Sources::read(dir, options, problems)?;
    let kept = sources.pick(options, problems);
    let masks = Masks::of(dir, options, Layout::Transforms, problems);
    let masks_beside = match &masks {
        Masks::In(folder) => Some(Beside::new(folder.clone(), &sources, |frame| {
            frame.mask_path.as_ref()
        })),
        Masks::OfFrames | Masks::Off => None,
    };
    let raw_beside = options.raw_labels.as_ref().map(|folder| {
        let folder = dir.join(folder);
        Beside::new(folder, &sources, |frame| frame.raw_label_path.as_ref())
    });
    let limits = &options.limits;
    let what = format!("{}: frames", sources.file.display());
    Limits::check(
        what,
        kept.len() as u64,
        limits.views as u64,
        "thin out with data.stride or data.max_frames",
    )?;

    let mut found = Vec::new();
    let look = |kept: &Kept| photo(dir, &sources.files[kept.source], kept.index, limits);
    kept.par_iter().map(look).collect_into_vec(&mut found);
    let mut frames = Vec::with_capacity(kept.len());
    for (
        Kept {
            source,
            index: i,
            split,
            name,
        },
        (image, mut faults, size),
    ) in kept.into_iter().zip(found)
    {
        // Of a repeated frame nothing else is told.
        let Some(name) = name else { continue };
        let Source {
            path, transforms, ..
        } = &sources.files[source];
        let present = faults.is_empty();
        let camera = size.map(|size| match transforms.camera(path, i, size) {
            Ok((camera, lens)) => (camera, lens, true),
            Err(fault) => {
                faults.push(fault);
                (Camera::unposed(size), Lens::default(), false)
            }
        });
        faults.into_iter().for_each(|fault| problems.push(fault));
        let Some((camera, lens, posed)) = camera else {
            continue;
        };
        let frame = &transforms.frames[i];
        let said = |path: &Option<String>| path.as_ref().map(|path| dir.join(path));
        let (truth, instances) = (said(&frame.label_path), said(&frame.instance_path));
        let raw = match &raw_beside {
            Some(beside) => Some(beside.file_or_masks(frame, &name)),
            None => said(&frame.raw_label_path),
        };
        let mask = match (&masks_beside, &masks) {
            (Some(beside), _) => beside.file_of(frame, &name),
            (None, Masks::OfFrames) => said(&frame.mask_path),
            (None, _) => None,
        };
        let scales = false;
        frames.push(Frame {
            name,
            split,
            image,
            present,
            camera,
            posed,
            lens,
            scales,
            mask,
            truth,
            raw,
            instances,
        });
    }
    let Sources {
        file,
        files,
        mut notices,
    } = sources;
    let cloud = files
        .iter()
        .find_map(|source| source.transforms.ply_file_path.as_ref());
    if cloud.is_none()
        && let Some(cloud) = CLOUDS.into_iter().find(|name| dir.join(name).is_file())
    {
        let file = files[0]
            .path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy();
        let told = format!("{cloud} is not read: {file} does not name it");
        notices.push(format!(
            "{told}; add \"ply_file_path\": \"{cloud}\" where it is the initial cloud"
        ));
    }
    let labelled = raw::need_table(dir, options, &frames);
    let classes = problems
        .keep(read_classes(dir, labelled))
        .unwrap_or_default();
    Ok(Listing {
        layout: Layout::Transforms,
        z_up: files.iter().all(|source| source.transforms.z_up()),
        cloud: cloud.map_or(Cloud::None, |file| Cloud::Ply(dir.join(file))),
        file,
        frames,
        classes,
        occurring_classes: false,
        truth_ids: None,
        raw: RawLabels::grey(),
        geometries: MapGeometries::default(),
        resample_labels: false,
        notices,
    })
}

/// The cameras of a `transforms.json`, in file order, without looking at images: each frame or the file must say `w`
/// and `h`. Lens distortion is taken out as [`crate::data::load`] takes it out of photos. Positions are world units; subtract
/// a scene's origin before rendering it. `split` keeps only those frames.
///
/// # Errors
/// As [`load`]; also when no frame is left.
pub fn load_cameras(path: &Path, split: Option<Split>) -> Result<Vec<NamedCamera>> {
    let mut problems = Problems::default();
    let sources = Sources::of_file(path, &mut problems)?;
    let kept = sources.pick(&LoadOptions::default(), &mut problems);
    problems.none()?;
    let transforms = &sources.files[0].transforms;
    let mut cameras = Vec::new();
    for Kept {
        index: i,
        split: s,
        name,
        ..
    } in kept
    {
        let Some(name) = name.filter(|_| split.is_none_or(|wanted| wanted == s)) else {
            continue;
        };
        let Some(size) = transforms.declared_size(path, i)? else {
            let field = format!("{}.w", transforms.field(i));
            return Err(Error::input(
                path,
                field,
                "no image size",
                "w and h in pixels",
                "add w and h",
            ));
        };
        let pixels = (size.0 as u64).saturating_mul(size.1 as u64);
        Limits::check(
            format!("{}: pixels", path.display()),
            pixels,
            Limits::default().image_pixels,
            "lower w and h",
        )?;
        let (camera, lens) = transforms.camera(path, i, size)?;
        let image = PathBuf::from(&transforms.frames[i].file_path);
        let (mask, truth, raw, instances) = (None, None, None, None);
        let (present, posed, scales) = (true, true, false);
        let frame = Frame {
            name,
            split: s,
            image,
            present,
            camera,
            posed,
            lens,
            scales,
            mask,
            truth,
            raw,
            instances,
        };
        cameras.push(NamedCamera {
            camera: frame.geometry(size)?.camera,
            name: frame.name,
            split: s,
        });
    }
    if cameras.is_empty() {
        let found = format!("no frame of split {split:?}");
        return Err(Error::input(
            path,
            "frames",
            found,
            "at least one",
            "choose the other split or all",
        ));
    }
    Ok(cameras)
}

/// Image path of a frame, what is wrong with the image, and its size, which is the image's own where the file leaves it
/// out.
fn photo(
    dir: &Path,
    Source {
        path, transforms, ..
    }: &Source,
    i: usize,
    limits: &Limits,
) -> (PathBuf, Vec<Error>, Option<(usize, usize)>) {
    let mut faults = Vec::new();
    let image = image_path(dir, &transforms.frames[i].file_path);
    if !image.is_file() {
        let field = format!("{}.file_path", transforms.field(i));
        let help = "put the image there or drop the frame";
        faults.push(Error::input(
            path,
            field,
            format!("no file {}", image.display()),
            "an image",
            help,
        ));
    }
    let declared = transforms
        .declared_size(path, i)
        .map_err(|fault| faults.push(fault))
        .ok()
        .flatten();
    let size = match declared {
        None if faults.is_empty() => ImageFile::open(&image, limits)
            .map(|file| file.size)
            .map_err(|e| faults.push(e))
            .ok(),
        declared => declared,
    };
    (image, faults, size)
}

/// Blender-made files leave the extension out.
fn image_path(dir: &Path, file: &str) -> PathBuf {
    let path = dir.join(file);
    if path.extension().is_some() || path.is_file() {
        return path;
    }
    ["png", "jpg", "jpeg"]
        .map(|e| path.with_extension(e))
        .into_iter()
        .find(|p| p.is_file())
        .unwrap_or_else(|| path.with_extension("png"))
}

/// Files of `dir` that may be meant, by name.
pub(crate) fn alternatives(dir: &Path) -> Vec<String> {
    let names = std::fs::read_dir(dir).into_iter().flatten().flatten();
    let names = names.filter_map(|entry| entry.file_name().into_string().ok());
    let mut names: Vec<String> = names
        .filter(|n| n.starts_with("transforms") && n.ends_with(".json"))
        .collect();
    // Blender's scenes have a file for each split: the first to be named is the one to train on.
    names.sort_unstable_by(|a, b| (!a.contains("train"), a).cmp(&(!b.contains("train"), b)));
    names.truncate(4);
    names
}

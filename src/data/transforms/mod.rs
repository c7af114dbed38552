//! Scenes as folders with a `transforms.json` (nerfstudio, instant-ngp): OpenGL camera-to-world poses, photos, and the
//! fields of this crate: per frame `split`, `label_path`, `raw_label_path`; per folder `classes.json`.

mod locate;
mod schema;

pub use locate::locate;

use super::image_file::ImageFile;
use super::{Classes, LabelMap, Limits, Points, Scene, Split, View};
use crate::camera::Camera;
use crate::config::DataConfig;
use crate::error::{Error, Result};
use glam::DVec3;
use rayon::prelude::*;
use schema::Transforms;
use std::path::{Path, PathBuf};

/// How [`load`] reads a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LoadOptions {
    /// File within the folder that lists the frames.
    pub transforms: String,
    /// Folder of raw labels within the scene folder, instead of the one that the frames name.
    pub raw_labels: Option<String>,
    /// Largest sizes accepted.
    pub limits: Limits,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self::from(&DataConfig::default())
    }
}

impl From<&DataConfig> for LoadOptions {
    fn from(config: &DataConfig) -> Self {
        Self {
            transforms: config.transforms.clone(),
            raw_labels: (!config.raw_labels.is_empty()).then(|| config.raw_labels.clone()),
            limits: Limits::default(),
        }
    }
}

/// A camera with the name of its frame.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedCamera {
    /// File stem of the frame.
    pub name: String,
    /// Train or test.
    pub split: Split,
    /// Pose and intrinsics, world units.
    pub camera: Camera,
}

/// Loads the scene in folder `dir`.
///
/// The origin is the mean of all camera centres, subtracted in f64 from cameras and points. `up` is +z when the file's
/// `convention` says `world z up`, else the mean up direction of the cameras. Frames without any `split` in the file:
/// every 8th from the first on is test. Photos are decoded in parallel; `ply_file_path` names the initial cloud, without
/// which [`Scene::points`] is empty. Frames may lack labels; where they have some, `classes.json` must be there.
///
/// # Errors
/// [`Error::Missing`], [`Error::Input`], [`Error::Io`] or [`Error::Limit`] naming file and field: malformed JSON, missing
/// or damaged files, sizes that disagree, poses that are no rotations, distortion, unknown label ids, repeated stems, no
/// training view.
pub fn load(dir: &Path, options: &LoadOptions) -> Result<Scene> {
    let path = locate(dir, &options.transforms)?;
    let transforms = Transforms::read(&path)?;
    let limits = &options.limits;
    Limits::check(
        format!("{}: frames", path.display()),
        transforms.frames.len() as u64,
        limits.views as u64,
        "thin out",
    )?;
    let splits = transforms.splits(&path)?;
    let names = transforms.names(&path)?;
    if !splits.contains(&Split::Train) {
        let found = format!("{} test frames", splits.len());
        return Err(Error::input(&path, "frames", found, "at least one training view", "mark frames \"train\""));
    }
    let labels: Vec<[Option<PathBuf>; 2]> =
        (0..names.len()).map(|i| label_paths(&transforms, i, &names[i], dir, options)).collect();
    let labelled = labels.iter().flatten().any(Option::is_some);
    let classes = read_classes(dir, labelled)?;
    let (images, mut cameras) = photos(dir, &path, &transforms, limits)?;

    let bytes: u64 = cameras
        .iter()
        .zip(&labels)
        .map(|(c, l)| {
            let maps = l.iter().flatten().count() as u64;
            (c.width as u64 * c.height as u64).saturating_mul(3 + 2 * maps)
        })
        .fold(0, u64::saturating_add);
    Limits::check(
        format!("{}: bytes of decoded images", path.display()),
        bytes,
        limits.scene_bytes,
        "scale the images down",
    )?;

    let origin = cameras.iter().map(|c| c.center).sum::<DVec3>() / cameras.len() as f64;
    let up = if transforms.z_up() { DVec3::Z } else { mean_up(&cameras) };
    for camera in &mut cameras {
        camera.center -= origin;
    }
    let points = match &transforms.ply_file_path {
        Some(file) => Points::read(&dir.join(file), origin, limits)?,
        None => Points::default(),
    };
    let lookup = classes.lookup();
    let views = in_order((0..names.len()).into_par_iter().map(|i| {
        let camera = cameras[i].clone();
        let size = (camera.width, camera.height);
        let file = ImageFile::open(&images[i], limits)?;
        file.expect_size(size.0, size.1, &format!("{} says", options.transforms))?;
        let read = |file: &Option<PathBuf>| {
            file.as_ref().map(|f| LabelMap::read_checked(f, size, &classes, &lookup, limits)).transpose()
        };
        let [truth, raw] = &labels[i];
        Ok(View {
            name: names[i].clone(),
            split: splits[i],
            camera,
            image: file.decode_rgb()?,
            truth: read(truth)?,
            raw: read(raw)?,
        })
    }))?;
    Ok(Scene { name: scene_name(dir), views, classes, points, origin, up })
}

/// The cameras of a `transforms.json`, in file order, without looking at images: each frame or the file must say `w` and
/// `h`. Positions are world units; subtract a scene's origin before rendering it. `split` keeps only those frames.
///
/// # Errors
/// As [`load`]; also when no frame is left.
pub fn load_cameras(path: &Path, split: Option<Split>) -> Result<Vec<NamedCamera>> {
    let transforms = Transforms::read(path)?;
    let splits = transforms.splits(path)?;
    let names = transforms.names(path)?;
    let mut cameras = Vec::new();
    for (i, (name, s)) in names.into_iter().zip(splits).enumerate() {
        if split.is_some_and(|wanted| wanted != s) {
            continue;
        }
        let Some(size) = transforms.declared_size(path, i)? else {
            let field = format!("{}.w", transforms.field(i));
            return Err(Error::input(path, field, "no image size", "w and h in pixels", "add w and h"));
        };
        let pixels = (size.0 as u64).saturating_mul(size.1 as u64);
        Limits::check(format!("{}: pixels", path.display()), pixels, Limits::default().image_pixels, "lower w and h")?;
        cameras.push(NamedCamera { name, split: s, camera: transforms.camera(path, i, size)? });
    }
    if cameras.is_empty() {
        let found = format!("no frame of split {split:?}");
        return Err(Error::input(path, "frames", found, "at least one", "choose the other split or all"));
    }
    Ok(cameras)
}

/// Image path and camera (world units) of every frame; sizes that the file leaves out come from the images.
fn photos(dir: &Path, path: &Path, transforms: &Transforms, limits: &Limits) -> Result<(Vec<PathBuf>, Vec<Camera>)> {
    let found = in_order((0..transforms.frames.len()).into_par_iter().map(|i| {
        let image = image_path(dir, &transforms.frames[i].file_path);
        if !image.is_file() {
            let field = format!("{}.file_path", transforms.field(i));
            let mend = "put the image there or drop the frame";
            return Err(Error::input(path, field, format!("no file {}", image.display()), "an image", mend));
        }
        let size = match transforms.declared_size(path, i)? {
            Some(size) => size,
            None => ImageFile::open(&image, limits)?.size,
        };
        Ok((image, transforms.camera(path, i, size)?))
    }))?;
    Ok(found.into_iter().unzip())
}

/// Blender-made files leave the extension out.
fn image_path(dir: &Path, file: &str) -> PathBuf {
    let path = dir.join(file);
    if path.extension().is_some() || path.is_file() {
        return path;
    }
    ["png", "jpg", "jpeg"].map(|e| path.with_extension(e)).into_iter().find(|p| p.is_file()).unwrap_or(path)
}

/// Paths of the true and the raw labels of a frame.
fn label_paths(
    transforms: &Transforms,
    i: usize,
    name: &str,
    dir: &Path,
    options: &LoadOptions,
) -> [Option<PathBuf>; 2] {
    let frame = &transforms.frames[i];
    let truth = frame.label_path.as_ref().map(|p| dir.join(p));
    let raw = match &options.raw_labels {
        Some(folder) => {
            let named = frame.raw_label_path.as_ref().and_then(|p| Path::new(p).file_name());
            let file = named.map_or_else(|| PathBuf::from(format!("{name}.png")), PathBuf::from);
            Some(dir.join(folder).join(file))
        }
        None => frame.raw_label_path.as_ref().map(|p| dir.join(p)),
    };
    [truth, raw]
}

/// `classes.json`; only scenes without labels may lack it.
fn read_classes(dir: &Path, labelled: bool) -> Result<Classes> {
    let path = dir.join("classes.json");
    if path.is_file() {
        return Classes::read(&path);
    }
    if labelled {
        let mend = "list the classes: {\"0\": \"void\", \"1\": \"wall\", ..}";
        return Err(Error::input(&path, "file", "nothing", "a class table, as frames have labels", mend));
    }
    Ok(Classes::default())
}

/// Mean up direction of cameras; +z when they cancel.
fn mean_up(cameras: &[Camera]) -> DVec3 {
    // OpenCV's y points down; row 1 of the world-to-camera rotation is that axis in the world.
    let sum: DVec3 = cameras.iter().map(|c| -c.rotation.row(1)).sum();
    sum.try_normalize().unwrap_or(DVec3::Z)
}

fn scene_name(dir: &Path) -> String {
    let full = dir.canonicalize().unwrap_or_else(|_| dir.to_owned());
    full.file_name().map_or_else(|| "scene".into(), |n| n.to_string_lossy().into_owned())
}

/// All results, or the first error in frame order, whichever thread met one first.
fn in_order<T: Send>(results: impl IndexedParallelIterator<Item = Result<T>>) -> Result<Vec<T>> {
    let mut all = Vec::new();
    results.collect_into_vec(&mut all);
    all.into_iter().collect()
}

//! Replica as two papers rendered it:
//! NICE-SLAM (`results/frame%06d.jpg`, `traj.txt`, `cam_params.json` beside or above the scene; no labels) and
//! Semantic-NeRF (`rgb/rgb_N.png`, `semantic_class/semantic_class_N.png`, `traj_w_c.txt`).
//!
//! In both, row N of the trajectory is the camera-to-world pose of photo N in OpenCV axes. Pixel centres are at whole numbers
//! there, so half a pixel is added to the principal point.

use super::camera_checks::FOCAL;
use super::folder::{Folder, Problems};
use super::frame::Frame;
use super::listing::Listing;
use super::sequence::{self, MILLIMETRES};
use super::side_folders::SideFolders;
use crate::data::Classes;
use crate::data::photos::EXTENSIONS;
use crate::data::photos::image_file::ImageFile;
use crate::error::{Result, bail};
use crate::files::{self, Numbered};
use crate::splat::camera::Camera;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// How a version of the dataset names its files.
#[derive(Clone, Copy, PartialEq)]
struct Version {
    trajectory: &'static str,
    /// Folder of photos and prefix of their numbers; below, the same for depth images.
    photos: [&'static str; 2],
    depth: [&'static str; 2],
    /// Folder of true labels.
    truth: &'static [&'static str],
}

const NICE_SLAM: Version = Version {
    trajectory: "traj.txt",
    photos: ["results", "frame"],
    depth: ["results", "depth"],
    truth: &[],
};
const SEMANTIC_NERF: Version = Version {
    trajectory: "traj_w_c.txt",
    photos: ["rgb", "rgb_"],
    depth: ["depth", "depth_"],
    truth: &["semantic_class"],
};

/// The class names of the dataset (its `info_semantic.json`) in the order of their ids 1 to 101; 0 is undefined.
const CLASSES: &str = include_str!("../labels/tables/replica.txt");

/// The trajectory in a scene folder, if it is of this layout.
pub(crate) fn marker(dir: &Path) -> Option<String> {
    version(dir).map(|version| version.trajectory.to_owned())
}

fn version(dir: &Path) -> Option<Version> {
    [SEMANTIC_NERF, NICE_SLAM]
        .into_iter()
        .find(|v| dir.join(v.trajectory).is_file() && dir.join(v.photos[0]).is_dir())
}

/// Lists the frames of the folder.
pub(crate) fn list(scene: Folder<'_>, problems: &mut Problems) -> Result<Listing> {
    let Folder { dir, options, .. } = scene;
    let version = version(dir).unwrap_or(NICE_SLAM);
    let [folder, prefix] = version.photos;
    let photos = files::numbered(&dir.join(folder), prefix, &EXTENSIONS)?;
    let path = dir.join(version.trajectory);
    let text = files::text(&path)?;
    let rows = (1..).zip(text.lines().map(str::trim));
    let rows: Vec<(usize, &str)> = rows.filter(|(_, row)| !row.is_empty()).collect();
    let mut notices = Vec::from_iter(notice_of_unseen(version, rows.len(), &photos));
    let photos: Vec<(usize, PathBuf)> = photos.into_iter().collect();
    let kept = options.pick(&vec![None; photos.len()]);
    let Some(&(first, _)) = kept.first() else {
        bail!(dir, "{folder}"; found "no photos"; expected "{prefix}0.png and so on";
            help "unpack the whole scene");
    };
    let (intrinsics, scale) = if version == NICE_SLAM {
        nice_slam(dir, &mut notices)?
    } else {
        (right_angle(&photos[first].1)?, MILLIMETRES)
    };
    let truth = sequence::numbered_maps(dir, version.truth, "semantic_class_")?;
    let instances = sequence::numbered_maps(dir, &["semantic_instance"], "semantic_instance_")?;
    let folders = SideFolders::new(scene, problems);
    let mut frames = Vec::with_capacity(kept.len());
    for (i, split) in kept {
        let (number, image) = &photos[i];
        if let Some(camera) = problems.ok(camera(&path, &rows, *number, image, &intrinsics)) {
            let frame = sequence::frame(image, split, camera, &folders, instances.get(number));
            let truth = truth.get(number).cloned().or(frame.truth);
            frames.push(Frame { truth, ..frame });
        }
    }
    let [depth_folder, depth_prefix] = version.depth;
    let cloud = sequence::cloud(dir, &frames, scale, |name| {
        let name = name.replacen(prefix, depth_prefix, 1);
        format!("{depth_folder}/{name}.png")
    });
    let classes = Classes::from_names(0, (1..).zip(CLASSES.lines()));
    Ok(Listing {
        cloud,
        notices,
        ..Listing::new(scene, path, frames, Some(classes), problems)
    })
}

/// Poses without a photo, counted.
fn notice_of_unseen(version: Version, poses: usize, photos: &Numbered) -> Option<String> {
    let unseen = poses - photos.range(..poses).count();
    let [trajectory, folder] = [version.trajectory, version.photos[0]];
    let notice = || format!("{unseen} of {poses} poses in {trajectory} have no photo in {folder}");
    (unseen > 0).then(notice)
}

/// The camera of photo `number`. `rows` are those of the trajectory at `path`, with their line numbers.
fn camera(
    path: &Path,
    rows: &[(usize, &str)],
    number: usize,
    photo: &Path,
    intrinsics: &Camera,
) -> Result<Camera> {
    let Some((line, row)) = rows.get(number) else {
        bail!(path, "rows"; found "{} rows, none for {}", rows.len(), photo.display();
            expected "one for each photo"; help "unpack the whole scene again");
    };
    let field = format!("line {line}");
    let pose = sequence::pose(row, path, &field)?;
    sequence::camera(&pose, intrinsics, path, &field)
}

/// `cam_params.json`.
#[derive(Deserialize)]
struct CameraFile {
    camera: CameraParams,
}

#[derive(Deserialize)]
struct CameraParams {
    w: usize,
    h: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// Value of a metre in the depth images.
    #[serde(default = "scale")]
    scale: f64,
}

/// The depth scale that NICE-SLAM publishes.
const fn scale() -> f64 {
    6553.5
}

/// The parameters that NICE-SLAM publishes for all eight scenes.
const PUBLISHED: CameraParams = CameraParams {
    w: 1200,
    h: 680,
    fx: 600.0,
    fy: 600.0,
    cx: 599.5,
    cy: 339.5,
    scale: scale(),
};

/// Intrinsics and the value of a metre in the depth images.
fn nice_slam(dir: &Path, notices: &mut Vec<String>) -> Result<(Camera, f64)> {
    let candidates = ["cam_params.json", "../cam_params.json"].map(|name| dir.join(name));
    let expected = "{\"camera\": {\"w\", \"h\", \"fx\", \"fy\", \"cx\", \"cy\", ..}}";
    let (path, camera) = match candidates.iter().find(|path| path.is_file()) {
        Some(path) => (path, files::json::<CameraFile>(path, expected)?.camera),
        None => {
            notices.push("no cam_params.json here or above: 1200x680 photos with a focal length of 600 are assumed".into());
            (&candidates[0], PUBLISHED)
        }
    };
    let CameraParams { w, h, fx, fy, .. } = camera;
    let CameraParams { cx, cy, scale, .. } = camera;
    let numbers = [fx, fy, cx, cy, scale];
    if [w, h].iter().any(|side| !(1..=1 << 32).contains(side))
        || !numbers.iter().all(|v| FOCAL.contains(v))
    {
        bail!(path, "camera"; found "{w}x{h} {numbers:?}";
            expected "sizes, focal lengths, centre and scale above 0"; help "copy the file again");
    }
    // Pixel centres move from whole numbers to halves.
    let camera = Camera {
        cx: cx + 0.5,
        cy: cy + 0.5,
        ..Camera::centred([fx, fy], [w, h])
    };
    Ok((camera, scale))
}

/// Semantic-NeRF renders with a field of view of 90 degrees across, square pixels, the centre in the middle.
fn right_angle(photo: &Path) -> Result<Camera> {
    let (width, height) = ImageFile::open(photo)?.size;
    Ok(Camera::centred([0.5 * width as f64; 2], [width, height]))
}

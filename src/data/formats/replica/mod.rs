//! Replica as two papers rendered it, which is what everybody trains on:
//! NICE-SLAM (`results/frame%06d.jpg`, `traj.txt`, `cam_params.json` beside or above the scene; no labels) and
//! Semantic-NeRF (`rgb/rgb_N.png`, `semantic_class/semantic_class_N.png`, `traj_w_c.txt`).
//!
//! In both, row N of the trajectory is the camera-to-world pose of photo N in OpenCV axes, and pixel centres are at
//! whole numbers: half a pixel is added to the principal point.

mod classes;

use super::frame::Frame;
use super::listing::{Cloud, LabelFolder, Listing, Problems, read_classes};
use super::sequence;
use crate::config::Layout;
use crate::data::Limits;
use crate::data::labels::map_geometry::MapGeometries;
use crate::data::labels::mask_file::Masks;
use crate::data::labels::raw;
use crate::data::labels::raw::RawLabels;
use crate::data::options::LoadOptions;
use crate::data::photos::image_file::ImageFile;
use crate::data::photos::lens::Lens;
use crate::error::{Error, Result};
use crate::splat::camera::Intrinsics;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Trajectory, folder of photos, what precedes their numbers.
const NICE_SLAM: [&str; 3] = ["traj.txt", "results", "frame"];
const SEMANTIC_NERF: [&str; 3] = ["traj_w_c.txt", "rgb", "rgb_"];

/// Value of a metre in the depth images of Semantic-NeRF.
const MILLIMETRES: f64 = 1000.0;

/// The trajectory in a scene folder, if it is of this layout.
pub(crate) fn found(dir: &Path) -> Option<String> {
    version(dir).map(|[trajectory, ..]| trajectory.to_owned())
}

fn version(dir: &Path) -> Option<[&'static str; 3]> {
    [SEMANTIC_NERF, NICE_SLAM]
        .into_iter()
        .find(|[t, photos, _]| dir.join(t).is_file() && dir.join(photos).is_dir())
}

/// Refuses a folder of another layout.
pub(crate) fn expect(dir: &Path) -> Result<()> {
    checked_version(dir).map(|_| ())
}

fn checked_version(dir: &Path) -> Result<[&'static str; 3]> {
    version(dir).ok_or_else(|| {
        let expected =
            "traj.txt with results/ (NICE-SLAM) or traj_w_c.txt with rgb/ (Semantic-NeRF)";
        Error::input(
            dir,
            "traj.txt",
            "neither",
            expected,
            "give the folder of one scene or sequence",
        )
    })
}

/// What the folder says.
pub(crate) fn list(dir: &Path, options: &LoadOptions, problems: &mut Problems) -> Result<Listing> {
    let version = checked_version(dir)?;
    let [trajectory, folder, prefix] = version;
    let path = dir.join(trajectory);
    let photos = sequence::numbered(&dir.join(folder), prefix, &["png", "jpg", "jpeg"])?;
    let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, "read", e))?;
    let rows: Vec<(usize, &str)> = text
        .lines()
        .enumerate()
        .map(|(i, row)| (i + 1, row.trim()))
        .filter(|(_, row)| !row.is_empty())
        .collect();
    let mut notices = Vec::new();
    let unseen = (0..rows.len())
        .filter(|number| !photos.contains_key(number))
        .count();
    if unseen > 0 {
        notices.push(format!(
            "{unseen} of {} poses in {trajectory} have no photo in {folder}",
            rows.len()
        ));
    }
    let photos: Vec<(usize, PathBuf)> = photos.into_iter().collect();
    let kept = options.pick(&vec![None; photos.len()]);
    let Some(&(first, _)) = kept.first() else {
        let expected = format!("{prefix}0.png and so on");
        return Err(Error::input(
            dir,
            folder,
            "no photos",
            expected,
            "unpack the whole scene",
        ));
    };
    let (intrinsics, scale) = match version == NICE_SLAM {
        true => nice_slam(dir, &mut notices)?,
        false => (right_angle(&photos[first].1, &options.limits)?, MILLIMETRES),
    };
    let truth = match version == NICE_SLAM {
        true => BTreeMap::new(),
        false => numbered_if_there(dir, "semantic_class")?,
    };
    let instances = numbered_if_there(dir, "semantic_instance")?;
    let other_truth = LabelFolder::optional(dir, "labels");
    let raw_folder = LabelFolder::raw(dir, options.raw_labels.as_deref());
    let masks = Masks::of(dir, options, Layout::Replica, problems);
    let mut frames = Vec::with_capacity(kept.len());
    for (i, split) in kept {
        let (number, image) = &photos[i];
        let file = image.file_name().map_or_else(PathBuf::new, PathBuf::from);
        let Some((line, row)) = rows.get(*number) else {
            let found = format!("{} rows, none for {}", rows.len(), image.display());
            problems.push(Error::input(
                &path,
                "rows",
                found,
                "one for each photo",
                "unpack the whole scene again",
            ));
            continue;
        };
        let field = format!("line {line}");
        let camera = sequence::pose(row, &path, &field)
            .and_then(|p| sequence::camera(&p, intrinsics, &path, &field));
        let Some(camera) = problems.keep(camera) else {
            continue;
        };
        frames.push(Frame {
            name: file.with_extension("").to_string_lossy().into_owned(),
            split,
            image: image.clone(),
            present: true,
            camera,
            posed: true,
            lens: Lens::default(),
            scales: false,
            mask: masks.of_photo(&file),
            truth: truth.get(number).cloned().or_else(|| other_truth.of(&file)),
            raw: raw_folder.of(&file),
            instances: instances.get(number).cloned(),
        });
    }
    let own = dir.join("classes.json").is_file();
    let labelled = raw::need_table(dir, options, &frames);
    let classes = match labelled.is_some() && !own {
        true => Ok(classes::replica()),
        false => read_classes(dir, labelled),
    };
    let depth = |frame: &Frame| match version == NICE_SLAM {
        true => dir.join(format!(
            "{folder}/{}.png",
            frame.name.replacen(prefix, "depth", 1)
        )),
        false => dir.join(format!(
            "depth/{}.png",
            frame.name.replacen(prefix, "depth_", 1)
        )),
    };
    let cloud = Cloud::of_sequence(dir, &frames, scale, depth);
    Ok(Listing {
        layout: Layout::Replica,
        file: path,
        frames,
        classes: problems.keep(classes).unwrap_or_default(),
        occurring_classes: !own,
        truth_ids: None,
        raw: RawLabels::grey(),
        geometries: MapGeometries::default(),
        resample_labels: false,
        cloud,
        z_up: false,
        notices,
    })
}

/// Maps in a folder of Semantic-NeRF, such as `semantic_class/semantic_class_0.png`.
fn numbered_if_there(dir: &Path, name: &str) -> Result<BTreeMap<usize, PathBuf>> {
    let folder = dir.join(name);
    if !folder.is_dir() {
        return Ok(BTreeMap::new());
    }
    sequence::numbered(&folder, &format!("{name}_"), &["png"])
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
    scale: Option<f64>,
}

/// As NICE-SLAM publishes it for all eight scenes.
const PUBLISHED: CameraParams = CameraParams {
    w: 1200,
    h: 680,
    fx: 600.0,
    fy: 600.0,
    cx: 599.5,
    cy: 339.5,
    scale: None,
};
/// Value of a metre in the depth images, as NICE-SLAM publishes it.
const SCALE: f64 = 6553.5;

/// Intrinsics and the value of a metre in the depth images.
fn nice_slam(dir: &Path, notices: &mut Vec<String>) -> Result<(Intrinsics, f64)> {
    let path = [dir.join("cam_params.json"), dir.join("../cam_params.json")]
        .into_iter()
        .find(|path| path.is_file());
    let Some(path) = path else {
        notices.push("no cam_params.json here or above: 1200x680 photos with a focal length of 600 are assumed".into());
        return Ok((intrinsics(&PUBLISHED), SCALE));
    };
    let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, "read", e))?;
    let CameraFile { camera } = serde_json::from_str(&text).map_err(|e| {
        let expected = "{\"camera\": {\"w\", \"h\", \"fx\", \"fy\", \"cx\", \"cy\", ..}}";
        Error::input(
            &path,
            format!("line {}", e.line()),
            e.to_string(),
            expected,
            "copy the file again",
        )
    })?;
    let sides = [camera.w, camera.h];
    let scale = camera.scale.unwrap_or(SCALE);
    let pixels = [camera.fx, camera.fy, camera.cx, camera.cy, scale];
    let positive = |v: &f64| (1e-3..=1e9).contains(v);
    if sides.iter().any(|s| !(1..=1 << 32).contains(s)) || !pixels.iter().all(positive) {
        let found = format!("{sides:?} {pixels:?}");
        let expected = "sizes, focal lengths, centre and scale above 0";
        return Err(Error::input(
            &path,
            "camera",
            found,
            expected,
            "copy the file again",
        ));
    }
    Ok((intrinsics(&camera), scale))
}

/// Pixel centres move from whole numbers to halves.
fn intrinsics(camera: &CameraParams) -> Intrinsics {
    let CameraParams {
        w: width,
        h: height,
        fx,
        fy,
        cx,
        cy,
        ..
    } = *camera;
    Intrinsics {
        fx,
        fy,
        cx: cx + 0.5,
        cy: cy + 0.5,
        width,
        height,
    }
}

/// Semantic-NeRF renders with a field of view of 90 degrees across, square pixels, the centre in the middle.
fn right_angle(photo: &Path, limits: &Limits) -> Result<Intrinsics> {
    let (width, height) = ImageFile::open(photo, limits)?.size;
    let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
    Ok(Intrinsics {
        fx: cx,
        fy: cx,
        cx,
        cy,
        width,
        height,
    })
}

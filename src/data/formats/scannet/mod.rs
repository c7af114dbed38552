//! ScanNet scenes as its SensReader exports them: `color/N.jpg`, `pose/N.txt` (camera-to-world, OpenCV axes),
//! `intrinsic/intrinsic_color.txt`, and `label-filt/N.png` whose ids `scannetv2-labels.combined.tsv` maps to classes.
//!
//! Frames that the tracker lost have poses of infinities: they are left out and counted.

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
use rayon::prelude::*;
use sequence::Pose;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Value of a metre in depth images.
const MILLIMETRES: f64 = 1000.0;

/// The folder of photos in a scene folder, if it is of this layout.
pub(crate) fn found(dir: &Path) -> Option<String> {
    (dir.join("color").is_dir() && dir.join("pose").is_dir())
        .then(|| "color/ with pose/".to_owned())
}

/// Refuses a folder of another layout.
pub(crate) fn expect(dir: &Path) -> Result<()> {
    if found(dir).is_some() {
        return Ok(());
    }
    let expected = "color/ and pose/, as ScanNet's SensReader writes them";
    Err(Error::input(
        dir,
        "color",
        "not both folders",
        expected,
        "export the .sens file of the scan",
    ))
}

/// A photo with the file of its pose.
struct Shot {
    number: usize,
    image: PathBuf,
    pose_file: PathBuf,
}

/// What the folder says.
pub(crate) fn list(dir: &Path, options: &LoadOptions, problems: &mut Problems) -> Result<Listing> {
    let photos = sequence::numbered(&dir.join("color"), "", &["jpg", "jpeg", "png"])?;
    let poses = dir.join("pose");
    let shots = photos.into_iter().map(|(number, image)| {
        let file = image.with_extension("txt");
        Shot {
            number,
            pose_file: file
                .file_name()
                .map_or_else(|| poses.clone(), |f| poses.join(f)),
            image,
        }
    });
    let shots: Vec<Shot> = shots.collect();
    let mut read = Vec::new();
    shots
        .par_iter()
        .map(|shot| read_pose(&shot.pose_file))
        .collect_into_vec(&mut read);
    let mut posed: Vec<(Shot, Pose)> = Vec::with_capacity(shots.len());
    let (all, mut lost) = (shots.len(), 0);
    for (shot, pose) in shots.into_iter().zip(read) {
        match problems.keep(pose) {
            Some(pose) if pose.iter().all(|v| v.is_finite()) => posed.push((shot, pose)),
            Some(_) => lost += 1,
            None => {}
        }
    }
    let mut notices = Vec::new();
    if lost > 0 {
        notices.push(format!(
            "{lost} of {all} frames left out: their poses hold infinities (tracking was lost)"
        ));
    }
    let kept = options.pick(&vec![None; posed.len()]);
    let Some(&(first, _)) = kept.first() else {
        let found = format!("{all} photos, {lost} of them without a finite pose");
        let help = "export the .sens file of the scan, photos and poses";
        return Err(Error::input(dir, "color", found, "photos with poses", help));
    };
    let intrinsics = read_intrinsics(dir, &posed[first].0.image, &options.limits)?;
    let truth = maps_of(dir, ["label-filt", "label"])?;
    let instances = maps_of(dir, ["instance-filt", "instance"])?;
    let raw_folder = LabelFolder::raw(dir, options.raw_labels.as_deref());
    let masks = Masks::of(dir, options, Layout::Scannet, problems);
    let mut frames = Vec::with_capacity(kept.len());
    for (i, split) in kept {
        let (shot, pose) = &posed[i];
        let camera = sequence::camera(pose, intrinsics, &shot.pose_file, "matrix");
        let Some(camera) = problems.keep(camera) else {
            continue;
        };
        let file = shot
            .image
            .file_name()
            .map_or_else(PathBuf::new, PathBuf::from);
        frames.push(Frame {
            name: file.with_extension("").to_string_lossy().into_owned(),
            split,
            image: shot.image.clone(),
            present: true,
            camera,
            posed: true,
            lens: Lens::default(),
            scales: false,
            mask: masks.of_photo(&file),
            truth: truth.get(&shot.number).cloned(),
            raw: raw_folder.of(&file),
            instances: instances.get(&shot.number).cloned(),
        });
    }
    let own = dir.join("classes.json").is_file();
    let labelled = raw::need_table(dir, options, &frames);
    let general = labelled.is_some() && !own;
    let needs_table = general && frames.iter().any(|frame| frame.truth.is_some());
    let table = match needs_table {
        true => problems
            .keep(classes::table(dir, options))
            .map(|file| file.ids),
        false => None,
    };
    if needs_table && table.is_none() {
        // Told once; without the table every map would be told of as well.
        frames.iter_mut().for_each(|frame| frame.truth = None);
    }
    let classes = match general {
        true => Ok(classes::classes(options.scannet_classes)),
        false => read_classes(dir, labelled),
    };
    let cloud = Cloud::of_sequence(dir, &frames, MILLIMETRES, |frame| {
        dir.join(format!("depth/{}.png", frame.name))
    });
    Ok(Listing {
        layout: Layout::Scannet,
        file: dir.join("intrinsic/intrinsic_color.txt"),
        frames,
        classes: problems.keep(classes).unwrap_or_default(),
        occurring_classes: general,
        truth_ids: table,
        raw: RawLabels::grey(),
        geometries: MapGeometries::default(),
        resample_labels: true,
        cloud,
        z_up: true,
        notices,
    })
}

fn read_pose(path: &Path) -> Result<Pose> {
    if !path.is_file() {
        let help = "export the poses again, or take the photo away".into();
        return Err(Error::Missing {
            what: "file",
            path: path.to_owned(),
            help,
        });
    }
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
    sequence::pose(&text, path, "matrix")
}

/// Maps in the first of two folders that is there.
fn maps_of(dir: &Path, names: [&str; 2]) -> Result<BTreeMap<usize, PathBuf>> {
    let folder = names
        .map(|name| dir.join(name))
        .into_iter()
        .find(|folder| folder.is_dir());
    folder.map_or_else(
        || Ok(BTreeMap::new()),
        |folder| sequence::numbered(&folder, "", &["png"]),
    )
}

/// `intrinsic_color.txt`: a 4x4 matrix whose upper left 3x3 is K, for photos of the size of `photo`.
fn read_intrinsics(dir: &Path, photo: &Path, limits: &Limits) -> Result<Intrinsics> {
    let path = dir.join("intrinsic/intrinsic_color.txt");
    if !path.is_file() {
        let help = "export the intrinsics of the .sens file".into();
        return Err(Error::Missing {
            what: "file",
            path,
            help,
        });
    }
    let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, "read", e))?;
    let k = sequence::pose(&text, &path, "matrix")?;
    let (width, height) = ImageFile::open(photo, limits)?.size;
    let (fx, fy, cx, cy) = (k[0], k[5], k[2], k[6]);
    if ![fx, fy].iter().all(|f| (1e-3..=1e9).contains(f)) {
        let help = "export the intrinsics of the .sens file again";
        return Err(Error::input(
            &path,
            "focal length",
            format!("{fx} {fy}"),
            "pixels, 0.001 to 1e9",
            help,
        ));
    }
    let central = |c: f64, side: usize| (0.3..=0.7).contains(&(c / side as f64));
    if !central(cx, width) || !central(cy, height) {
        let found = format!("{cx} {cy}");
        let expected = format!("near the middle of the photos, which are {width}x{height}");
        let help = "where photos were scaled, scale fx fy cx cy of the first three rows with them";
        return Err(Error::input(
            &path,
            "principal point",
            found,
            expected,
            help,
        ));
    }
    Ok(Intrinsics {
        fx,
        fy,
        cx,
        cy,
        width,
        height,
    })
}

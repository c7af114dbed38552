//! ScanNet scenes as its SensReader exports them: `color/N.jpg`, `pose/N.txt` (camera-to-world, OpenCV axes),
//! `intrinsic/intrinsic_color.txt`, and `label-filt/N.png` whose ids `scannetv2-labels.combined.tsv` maps to classes.
//!
//! Frames that the tracker lost have infinite poses. They are left out and counted.

use super::camera_checks::FOCAL;
use super::folder::{Folder, Problems};
use super::frame::Frame;
use super::listing::Listing;
use super::sequence::{self, MILLIMETRES, Pose};
use super::side_folders::SideFolders;
use crate::config::ScannetClasses;
use crate::data::options::LoadOptions;
use crate::data::photos::EXTENSIONS;
use crate::data::photos::image_file::ImageFile;
use crate::data::{Classes, Split};
use crate::error::{Result, bail, ensure, invalid};
use crate::files::{self, Numbered};
use crate::splat::camera::Camera;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// The 40 classes of NYU Depth v2 in the order of their ids, from 1.
const NYU40: &str = include_str!("../labels/tables/nyu40.txt");
/// The ids of those that ScanNet's benchmark counts.
const SCANNET20: [u16; 20] = [
    1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 24, 28, 33, 34, 36, 39,
];
/// Name of the table of labels that comes with the dataset.
const TABLE: &str = "scannetv2-labels.combined.tsv";

/// The folder of photos in a scene folder, if it is of this layout.
pub(crate) fn marker(dir: &Path) -> Option<String> {
    let is_folder = |name| dir.join(name).is_dir();
    (is_folder("color") && is_folder("pose")).then(|| "color/ with pose/".to_owned())
}

/// A photo and its camera-to-world matrix, which is infinite where tracking was lost.
struct PosedPhoto {
    number: usize,
    image: PathBuf,
    pose_file: PathBuf,
    pose: Pose,
}

/// Lists the frames of the folder.
pub(crate) fn list(folder: Folder<'_>, problems: &mut Problems) -> Result<Listing> {
    let Folder { dir, options, .. } = folder;
    let photos = files::numbered(&dir.join("color"), "", &EXTENSIONS)?;
    let all = photos.len();
    let mut posed = posed_photos(dir, photos, problems);
    let readable = posed.len();
    posed.retain(|photo| photo.pose.iter().all(|v| v.is_finite()));
    let lost = readable - posed.len();
    let notice =
        format!("{lost} of {all} frames left out: their poses hold infinities (tracking was lost)");
    let kept = options.pick(&vec![None; posed.len()]);
    let Some(&(first, _)) = kept.first() else {
        bail!(dir, "color"; found "{all} photos, {lost} of them without a finite pose";
            expected "photos with poses"; help "export the .sens file of the scan, photos and poses");
    };
    let intrinsics = read_intrinsics(dir, &posed[first].image)?;
    let frames = list_frames(folder, &posed, &kept, &intrinsics, problems)?;
    let own_classes = dir.join("classes.json").is_file();
    let requires_table = !own_classes && frames.iter().any(|frame| frame.truth.is_some());
    let table = requires_table.then(|| label_table(dir, options));
    let table = table.and_then(|table| problems.ok(table));
    let cloud = sequence::cloud(dir, &frames, MILLIMETRES, |name| {
        format!("depth/{name}.png")
    });
    let file = dir.join("intrinsic/intrinsic_color.txt");
    let dataset = Some(classes(options.scannet_classes));
    let mut listing = Listing::new(folder, file, frames, dataset, problems);
    if requires_table && table.is_none() {
        // Reported once; without the table every map would be reported as well.
        let frames = listing.frames.iter_mut();
        frames.for_each(|frame| frame.truth = None);
    }
    Ok(Listing {
        truth_ids: table,
        resample_labels: true,
        cloud,
        z_up: true,
        notices: if lost > 0 { vec![notice] } else { Vec::new() },
        ..listing
    })
}

/// The photos whose poses can be read; the others are reported.
fn posed_photos(dir: &Path, photos: Numbered, problems: &mut Problems) -> Vec<PosedPhoto> {
    let photos: Vec<(usize, PathBuf)> = photos.into_iter().collect();
    let read = |(number, image): (usize, PathBuf)| -> Result<PosedPhoto> {
        let name = image.with_extension("txt");
        let pose_file = dir.join("pose").join(name.file_name().unwrap_or_default());
        Ok(PosedPhoto {
            pose: read_matrix(&pose_file)?,
            number,
            image,
            pose_file,
        })
    };
    let posed: Vec<Result<PosedPhoto>> = photos.into_par_iter().map(read).collect();
    let readable = posed.into_iter().filter_map(|photo| problems.ok(photo));
    readable.collect()
}

/// The frames of the photos that were picked, as `kept`; those whose pose is no rotation are reported.
fn list_frames(
    folder: Folder<'_>,
    posed: &[PosedPhoto],
    kept: &[(usize, Split)],
    intrinsics: &Camera,
    problems: &mut Problems,
) -> Result<Vec<Frame>> {
    let truth = sequence::numbered_maps(folder.dir, &["label-filt", "label"], "")?;
    let instances = sequence::numbered_maps(folder.dir, &["instance-filt", "instance"], "")?;
    let folders = SideFolders::new(folder, problems);
    let mut frames = Vec::with_capacity(kept.len());
    for &(i, split) in kept {
        let photo = &posed[i];
        let camera = sequence::camera(&photo.pose, intrinsics, &photo.pose_file, "matrix");
        if let Some(camera) = problems.ok(camera) {
            let instances = instances.get(&photo.number);
            let frame = sequence::frame(&photo.image, split, camera, &folders, instances);
            frames.push(Frame {
                truth: truth.get(&photo.number).cloned(),
                ..frame
            });
        }
    }
    Ok(frames)
}

/// A 4x4 matrix in a file of its own.
fn read_matrix(path: &Path) -> Result<Pose> {
    files::expect_file(path, "export it from the .sens file again")?;
    sequence::pose(&files::text(path)?, path, "matrix")
}

/// `intrinsic_color.txt`: a 4x4 matrix whose upper left 3x3 is K, for photos of the size of `photo`.
fn read_intrinsics(dir: &Path, photo: &Path) -> Result<Camera> {
    let path = dir.join("intrinsic/intrinsic_color.txt");
    let [fx, _, cx, _, _, fy, cy, ..] = read_matrix(&path)?;
    let (width, height) = ImageFile::open(photo)?.size;
    ensure!([fx, fy].iter().all(|f| FOCAL.contains(f)),
        &path, "focal length"; found "{fx} {fy}"; expected "pixels, 0.001 to 1e9";
        help "export the intrinsics of the .sens file again");
    let is_central = |c: f64, side: usize| (0.3..=0.7).contains(&(c / side as f64));
    if !is_central(cx, width) || !is_central(cy, height) {
        bail!(&path, "principal point"; found "{cx} {cy}";
            expected "near the middle of the photos, which are {width}x{height}";
            help "where photos were scaled, scale fx fy cx cy of the first three rows with them");
    }
    let centred = Camera::centred([fx, fy], [width, height]);
    Ok(Camera { cx, cy, ..centred })
}

/// Whether the class `id` of NYU40 is in the set.
fn in_set(set: ScannetClasses, id: u16) -> bool {
    set == ScannetClasses::Nyu40 || SCANNET20.contains(&id)
}

/// The classes of a set, with NYU40's ids; 0 is unlabelled.
fn classes(set: ScannetClasses) -> Classes {
    let named = (1_u16..).zip(NYU40.lines());
    Classes::from_names(0, named.filter(|(id, _)| in_set(set, *id)))
}

/// Reads the table of labels that lies in `dir` or one of the three folders above it. Returns the NYU40
/// id of each label id: 0 for labels outside of the set, `None` for labels that are not in the table.
fn label_table(dir: &Path, options: &LoadOptions) -> Result<Vec<Option<u16>>> {
    let full = dir.canonicalize().unwrap_or_else(|_| dir.to_owned());
    let mut near = full.ancestors().take(4).map(|folder| folder.join(TABLE));
    let path = near.find(|path| path.is_file()).ok_or_else(|| {
        invalid!(dir, "{TABLE}"; found "no such file";
            expected "{TABLE} there or in one of the three folders above: the labels' ids mean nothing without it";
            help "copy it from the dataset to the folder of the scene")
    })?;
    let error = |line: usize, found: String, expected: &str| {
        invalid!(&path, "line {line}"; found "{found}"; expected "{expected}";
            help "copy the table from the dataset again")
    };
    let text = files::text(&path)?;
    let mut rows = text
        .lines()
        .map(|row| row.split('\t').map(str::trim).collect::<Vec<_>>())
        .zip(1..);
    let (header, _) = rows.next().unwrap_or_default();
    let column = |name: &'static str| {
        let place = header.iter().position(|column| *column == name);
        let expected = format!("a column {name}, separated by tabs");
        place
            .map(|place| (name, place))
            .ok_or_else(|| error(1, format!("columns {header:?}"), &expected))
    };
    let columns = [column("id")?, column("nyu40id")?];
    let mut ids = vec![None; 1 << 16];
    ids[0] = Some(0);
    for (cells, line) in rows.filter(|(cells, _)| cells.iter().any(|cell| !cell.is_empty())) {
        let value = |(name, place): (&str, usize)| {
            let cell = cells.get(place).copied().unwrap_or_default();
            let found = || format!("{cell:?} in column {name}");
            cell.parse::<u16>()
                .map_err(|_| error(line, found(), "a whole number from 0 to 65535"))
        };
        let [id, class] = [value(columns[0])?, value(columns[1])?];
        if usize::from(class) > NYU40.lines().count() {
            return Err(error(line, format!("nyu40id {class}"), "0 to 40"));
        }
        let is_counted = in_set(options.scannet_classes, class);
        ids[usize::from(id)] = Some(if is_counted { class } else { 0 });
    }
    Ok(ids)
}

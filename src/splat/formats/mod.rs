//! Files of Gaussians, and files of labels beside them.
//!
//! 3DGS PLY keeps all values, positions rounded to float where they bear it, and holds labels. Compressed PLY, SPZ and SOG round the
//! values and reorder the rows; beside a file `NAME` of theirs, `NAME.labels.json` holds the labels: `{"sha256": .., "labels": [..]}`
//! has the SHA-256 of `NAME` and one class id for each of its rows.

mod antimatter15;
mod compressed_ply;
pub mod glb;
pub mod ply;
mod point_cloud;
mod scene;
pub mod sog;
mod spz;

use self::scene::{PlyScene, scene_of};
use super::{Gaussians, ZERO_QUATERNION};
use crate::error::{Result, ensure, invalid};
use crate::files::ply::PlyFile;
use crate::files::{self, atomic, extension, sha256};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Opacities are kept this far from 0 and 1, whose logits are infinite.
const OPACITY_MARGIN: f64 = 1e-6;

/// Formats that are read.
const READ: [&str; 4] = ["ply", "spz", "sog", "splat"];

/// Formats that `coseg export` writes and nothing here reads.
const WRITTEN_ONLY: [&str; 3] = ["glb", "las", "laz"];

/// Mean distance that rounding to float may move positions, in mean standard deviations.
const POSITION_LOSS: f64 = 0.01;

/// A format that can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// 3DGS PLY, exact.
    Ply,
    /// Compressed PLY of PlayCanvas.
    CompressedPly,
    /// SPZ of Niantic.
    Spz,
    /// The centres as points of a PLY, with colour, opacity and label.
    PointsPly,
    /// The centres as points of LAS 1.4, with colour, opacity and label.
    Las,
    /// [`Format::Las`], compressed.
    Laz,
}

/// The labels of a file that has no place for them.
#[derive(Serialize, Deserialize)]
struct LabelFile {
    sha256: String,
    labels: Vec<u16>,
}

/// The file with the labels of the scene `path`, for formats without a place for them.
pub fn label_path(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".labels.json");
    name.into()
}

/// Reads 3DGS PLY, compressed PLY, SPZ (`.spz`, versions 2 to 4), SOG (`.sog`, version 2) and the files of antimatter15's viewer
/// (`.splat`), with the labels of the file or those beside it.
///
/// # Errors
/// As [`ply::read`]; [`crate::Error::Input`] for labels beside it that belong to another file, and for formats that are not read.
pub fn read(path: &Path) -> Result<PlyScene> {
    let format = extension(path);
    ensure!(!WRITTEN_ONLY.contains(&&*format), path, "format"; found ".{format}, which is written but not read";
        expected "a .ply, .spz, .sog or .splat file"; help "give the scene that it was made from");
    let mut scene = match &*format {
        "spz" => spz::read(path)?,
        "sog" => sog::read(path)?,
        "splat" => antimatter15::read(path)?,
        _ => ply::read(path)?,
    };
    if scene.labels.is_none() {
        scene.labels = labels_beside(path, scene.gaussians.len())?;
    }
    Ok(scene)
}

/// Whether the name of a file is that of a scene, in a format that is read or written here.
pub(crate) fn is_scene(path: &Path) -> bool {
    let format = extension(path);
    READ.contains(&&*format) || WRITTEN_ONLY.contains(&&*format)
}

/// Whether the scene `path` has its labels, if any, in the file [`label_path`].
pub fn has_labels_beside(path: &Path) -> bool {
    let name = path.to_string_lossy().to_lowercase();
    [".spz", ".sog", ".splat", ".compressed.ply"]
        .iter()
        .any(|end| name.ends_with(end))
}

/// Writes `gaussians` to `path` in `format`, adding `origin` to the positions, and `labels` where the format has a place for them,
/// else beside it. Compressed formats have the rows in [`Gaussians::spatial_order`].
///
/// # Errors
/// As [`ply::write`]; [`crate::Error::Argument`] for positions that a compressed format cannot hold.
pub fn write(
    path: &Path,
    format: Format,
    gaussians: &Gaussians,
    origin: DVec3,
    labels: Option<&[u16]>,
) -> Result<()> {
    gaussians.check(labels)?;
    let points = || gaussians.positions(origin);
    let write = match format {
        Format::Ply => return ply::write(path, gaussians, origin, labels),
        Format::PointsPly => return point_cloud::write_ply(path, gaussians, &points(), labels),
        Format::Las => return point_cloud::write_las(path, false, gaussians, &points(), labels),
        Format::Laz => return point_cloud::write_las(path, true, gaussians, &points(), labels),
        Format::CompressedPly => compressed_ply::write,
        Format::Spz => spz::write,
    };
    let order = gaussians.spatial_order();
    let gaussians = gaussians.select(&order);
    let positions = gaussians.positions(origin);
    check_positions(&gaussians, &positions)?;
    write(path, &gaussians, &positions)?;
    let label = |labels: &[u16]| order.iter().map(|&row| labels[row as usize]).collect();
    write_labels_beside(path, labels.map(label))
}

/// Writes the file [`label_path`] of the scene `path`, which has one of the `labels` for each row; without any, an earlier file
/// is removed.
///
/// # Errors
/// [`crate::Error::Io`].
pub fn write_labels_beside(path: &Path, labels: Option<Vec<u16>>) -> Result<()> {
    let beside = label_path(path);
    let Some(labels) = labels else {
        return atomic::remove(beside);
    };
    let sha256 = sha256(path)?;
    let file = LabelFile { sha256, labels };
    atomic::write(beside, |out| Ok(serde_json::to_writer(out, &file)?))
}

/// Refuses positions that lose too much where they become floats.
fn check_positions(gaussians: &Gaussians, positions: &[DVec3]) -> Result<()> {
    let moved = positions
        .iter()
        .map(|p| (p - p.as_vec3().as_dvec3()).length());
    let sizes = gaussians.log_scales.as_flattened().iter();
    let [moved, size] = [
        moved.sum::<f64>(),
        sizes.map(|&v| f64::from(v).exp()).sum::<f64>() / 3.0,
    ];
    ensure!(moved <= POSITION_LOSS * size, argument "positions";
        found "Gaussians so far from zero that float moves them by {:.3} of their size", moved / size;
        expected "at most {POSITION_LOSS}"; help "write a .ply file, which has such positions as double");
    Ok(())
}

/// The labels beside the scene `path`, which has `rows` Gaussians; `None` if there is no such file.
fn labels_beside(path: &Path, rows: usize) -> Result<Option<Vec<u16>>> {
    let beside = label_path(path);
    if !beside.is_file() {
        return Ok(None);
    }
    let file: LabelFile = files::json(&beside, "{\"sha256\": .., \"labels\": [..]}")?;
    ensure!(file.sha256 == sha256(path)?, &beside, "sha256"; found "that of another file"; expected "that of {}", path.display();
        help "remove it: the scene was rewritten since, and its rows may have another order");
    let found = file.labels.len();
    ensure!(found == rows, &beside, "labels"; found "{found}"; expected "{rows}, one for each Gaussian";
        help "export the scene again");
    Ok(Some(file.labels))
}

/// The SH degree of the columns `f_rest_*` of the file at `path`.
fn sh_degree(path: &Path, file: &PlyFile) -> Result<usize> {
    let rest = file.names().filter(|n| n.starts_with("f_rest_")).count();
    let degree = (0..=3).find(|d: &usize| 3 * ((d + 1).pow(2) - 1) == rest);
    degree.ok_or_else(|| {
        invalid!(path, "element vertex"; found "{rest} columns f_rest_*";
            expected "0, 9, 24 or 45 of them (SH degree 0 to 3)"; help "export with a whole SH degree")
    })
}

/// The logit of an opacity of 8 bits.
fn logit(opacity: u8) -> f32 {
    let p = (f64::from(opacity) / 255.0).clamp(OPACITY_MARGIN, 1.0 - OPACITY_MARGIN);
    (p / (1.0 - p)).ln() as f32
}

/// The opacity of a logit, in 0..=1.
fn opacity(logit: f32) -> f64 {
    1.0 / (1.0 + (-f64::from(logit)).exp())
}

/// The place of the largest component of a quaternion, and the three others, where the largest is positive. They are at most
/// sqrt(1/2). Components keep their order. A quaternion of length 0 is `one`.
fn smallest_three(quaternion: [f64; 4], one: [f64; 4]) -> (usize, [f64; 3]) {
    let square: f64 = quaternion.iter().map(|v| v * v).sum();
    let q = if square < ZERO_QUATERNION {
        one
    } else {
        quaternion.map(|v| v / square.sqrt())
    };
    let larger = |a: usize, b: usize| if q[b].abs() > q[a].abs() { b } else { a };
    let largest = (1..4).fold(0, larger);
    let place = |i: usize| i + usize::from(i >= largest);
    (
        largest,
        [0, 1, 2].map(|i| q[place(i)] * q[largest].signum()),
    )
}

/// The quaternion of [`smallest_three`].
fn from_smallest_three(largest: usize, three: [f64; 3]) -> [f32; 4] {
    let square: f64 = three.iter().map(|v| v * v).sum();
    let mut others = three.into_iter();
    std::array::from_fn(|i| {
        if i == largest {
            (1.0 - square).max(0.0).sqrt() as f32
        } else {
            others.next().unwrap_or_default() as f32
        }
    })
}

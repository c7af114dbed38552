//! Gaussian scenes as 3DGS PLY: `x y z nx ny nz f_dc_* f_rest_* opacity scale_* rot_*`, and a `label` column.
//!
//! `f_rest` is channel-major: all red coefficients, then green, then blue. Values are unactivated (log-scales, opacity
//! logits, quaternions w x y z), as every 3DGS tool has them. `label` (ushort) holds class ids; other viewers ignore it
//! and `splat-transform` can filter on it. Compressed PLY is read too.

pub use super::scene::PlyScene;

use super::scene::{floats_lose, origin_of};
use super::{compressed_ply, logit, sh_degree};
use crate::error::{Result, bail, ensure};
use crate::files::atomic;
use crate::files::ply::{self, PlyFile};
use crate::splat::Gaussians;
use glam::DVec3;
use ply_rs_bw::ply::ScalarType;
use std::path::Path;

/// x y z, nx ny nz, 3 + 45 SH, opacity, 3 scales, 4 rotations, label.
const COLUMNS: usize = 63;
/// Header comment that carries the origin, so that a file read back has the coordinates it was trained in.
const ORIGIN: &str = "coseg origin";

/// Writes `gaussians` to `path` (binary little-endian), adding `origin` back to the positions in f64.
///
/// `labels` are class ids, one per Gaussian. Normals are zero. The file appears complete or not at all.
///
/// # Errors
/// [`crate::Error::NonFinite`] naming tensor and row; [`crate::Error::Argument`] when `labels` or a field has the wrong length;
/// [`crate::Error::Io`].
pub fn write(
    path: &Path,
    gaussians: &Gaussians,
    origin: DVec3,
    labels: Option<&[u16]>,
) -> Result<()> {
    gaussians.check(labels)?;
    let names = column_names(gaussians.sh_degree, labels.is_some());
    let position = if floats_lose(&gaussians.positions(origin)) {
        ScalarType::Double
    } else {
        ScalarType::Float
    };
    let columns: Vec<_> = names
        .into_iter()
        .enumerate()
        .map(|(i, name)| {
            let scalar = match name.as_str() {
                "label" => ScalarType::UShort,
                _ if i < 3 => position.clone(),
                _ => ScalarType::Float,
            };
            (name, scalar)
        })
        .collect();
    // Rust prints the shortest decimal that reads back as the same f64.
    let comments = vec![format!("{ORIGIN} {} {} {}", origin.x, origin.y, origin.z)];
    let rest = gaussians.sh_len() - 1;
    atomic::write(path, |out| {
        ply::write::<COLUMNS, _>(out, gaussians.len(), &columns, comments, |i, row| {
            for c in 0..3 {
                row[c] = f64::from(gaussians.means[i][c]) + origin[c];
            }
            let sh = &gaussians.sh[i * 3 * (rest + 1)..][..3 * (rest + 1)];
            for c in 0..3 {
                row[6 + c] = f64::from(sh[c]);
                for k in 0..rest {
                    row[9 + c * rest + k] = f64::from(sh[(k + 1) * 3 + c]);
                }
            }
            let tail = &mut row[9 + 3 * rest..];
            tail[0] = f64::from(gaussians.opacity_logits[i]);
            for c in 0..3 {
                tail[1 + c] = f64::from(gaussians.log_scales[i][c]);
            }
            for c in 0..4 {
                tail[4 + c] = f64::from(gaussians.rotations[i][c]);
            }
            tail[8] = labels.map_or(0.0, |l| f64::from(l[i]));
        })
    })
}

/// Reads a 3DGS PLY (ascii or binary, either byte order). Unknown columns are ignored. The SH degree follows from the number of
/// `f_rest` columns (0, 9, 24 or 45). Positions may be float or double. Infinite logits become those of 10^-6 and 1 - 10^-6.
///
/// The origin is what [`write()`] recorded. In other files it is the mean position, where that lies so far out that float positions
/// would lose precision, else zero.
///
/// # Errors
/// [`crate::Error::Input`] naming file, row and column: missing columns, cut-off files, non-finite values, labels that are not
/// u16; naming the origin where positions relative to it are not finite in f32; [`crate::Error::Io`].
pub fn read(path: &Path) -> Result<PlyScene> {
    let file = PlyFile::open(path, "vertex")?;
    if file.scalar("packed_position").is_some() {
        return compressed_ply::read(path);
    }
    expect_gaussians(path, &file)?;
    let sh_degree = sh_degree(path, &file)?;
    let labelled = file.scalar("label").is_some();
    let recorded = recorded_origin(&file);
    let mut names = column_names(sh_degree, labelled).into_iter();
    // Normals are zero.
    let columns: [_; COLUMNS] =
        std::array::from_fn(|_| names.next().filter(|name| !name.starts_with('n')));
    let mut gaussians = Gaussians {
        sh_degree,
        ..Gaussians::default()
    };
    let opacity = 6 + 3 * gaussians.sh_len();
    let mut labels = labelled.then(Vec::new);
    let mut positions: Vec<DVec3> = Vec::new();
    file.read(&columns, |row, cells| {
        let cells = checked_row(path, row, &columns, cells, opacity)?;
        positions.push(DVec3::new(cells[0], cells[1], cells[2]));
        push_row(&mut gaussians, &cells.map(|v| v as f32));
        if let Some(labels) = &mut labels {
            labels.push(cells[opacity + 8] as u16);
        }
        Ok(())
    })?;
    let origin = recorded.unwrap_or_else(|| origin_of(&positions));
    let field = recorded.map_or("columns x y z", |_| "comment coseg origin");
    gaussians.means = relative_to(origin, &positions, path, field)?;
    Ok(PlyScene {
        gaussians,
        origin,
        labels,
    })
}

/// The cells of a row. An infinite logit of the opacity becomes a finite one: some programs write it for an opacity of 0 or 1.
fn checked_row(
    path: &Path,
    row: usize,
    columns: &[Option<String>; COLUMNS],
    cells: &[f64; COLUMNS],
    opacity: usize,
) -> Result<[f64; COLUMNS]> {
    let name = |column: usize| columns[column].as_deref().unwrap_or_default();
    let mut cells = *cells;
    if cells[opacity].is_infinite() {
        let byte = if cells[opacity] > 0.0 { 255 } else { 0 };
        cells[opacity] = f64::from(logit(byte));
    }
    // A value that does not fit an f32 counts as not finite.
    if let Some(column) = cells.iter().position(|&v| !(v as f32).is_finite()) {
        bail!(path, "row {row}, column {}", name(column); found "{}", cells[column]; expected "a finite number";
            help "remove this Gaussian (splat-transform --filter-nan)");
    }
    // 0 without a label column.
    let label = opacity + 8;
    let id = cells[label];
    ensure!(id.fract() == 0.0 && (0.0..=65_535.0).contains(&id), path, "row {row}, column {}", name(label);
        found "{id}"; expected "a class id from 0 to 65535"; help "correct or drop the label column");
    Ok(cells)
}

/// Adds the Gaussian of a row, except its mean.
fn push_row(g: &mut Gaussians, row: &[f32; COLUMNS]) {
    let rest = g.sh_len() - 1;
    g.sh.extend_from_slice(&row[6..9]);
    for k in 0..rest {
        g.sh.extend((0..3).map(|c| row[9 + c * rest + k]));
    }
    let tail = &row[9 + 3 * rest..];
    g.opacity_logits.push(tail[0]);
    g.log_scales.push([tail[1], tail[2], tail[3]]);
    g.rotations.push([tail[4], tail[5], tail[6], tail[7]]);
}

/// `positions` relative to `origin`, which is from `field` of the file.
fn relative_to(
    origin: DVec3,
    positions: &[DVec3],
    path: &Path,
    field: &str,
) -> Result<Vec<[f32; 3]>> {
    let relative = |position: &DVec3| {
        let mean = (position - origin).as_vec3();
        ensure!(mean.is_finite(), path, "{field}"; found "a position {position} about the origin {origin}";
            expected "positions that are finite numbers (f32) relative to the origin";
            help "export the scene again, or remove Gaussians that lie far from all others");
        Ok(mean.to_array())
    };
    positions.iter().map(relative).collect()
}

/// Column names in file order.
fn column_names(sh_degree: usize, labelled: bool) -> Vec<String> {
    let numbered = |stem: &'static str, n: usize| (0..n).map(move |i| format!("{stem}_{i}"));
    let mut names: Vec<String> = ["x", "y", "z", "nx", "ny", "nz"].map(String::from).into();
    names.extend(numbered("f_dc", 3));
    names.extend(numbered("f_rest", 3 * ((sh_degree + 1).pow(2) - 1)));
    names.push("opacity".into());
    names.extend(numbered("scale", 3));
    names.extend(numbered("rot", 4));
    names.extend(labelled.then(|| "label".into()));
    names
}

/// [`crate::Error::Input`] for point clouds, which users may take for 3DGS PLY files.
fn expect_gaussians(path: &Path, file: &PlyFile) -> Result<()> {
    let has = |name: &str| file.scalar(name).is_some();
    let found = if file.has_element("face") {
        "a mesh"
    } else {
        "a point cloud"
    };
    ensure!(!has("x") || has("f_dc_0") || has("opacity"), path, "element vertex"; found "{found}";
        expected "3D Gaussians: x y z, f_dc_*, opacity, scale_*, rot_*";
        help "name a scene of Gaussians; to train some from a point cloud, name it by ply_file_path in transforms.json");
    Ok(())
}

fn recorded_origin(file: &PlyFile) -> Option<DVec3> {
    let text = file
        .comments()
        .iter()
        .find_map(|c| c.trim().strip_prefix(ORIGIN))?;
    let values: Vec<f64> = text
        .split_whitespace()
        .map_while(|v| v.parse().ok())
        .collect();
    match values[..] {
        [x, y, z] if values.iter().all(|v| v.is_finite()) => Some(DVec3::new(x, y, z)),
        _ => None,
    }
}

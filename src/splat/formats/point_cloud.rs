//! Point clouds of the centres of Gaussians, for programs that do not read Gaussians: PLY, LAS and LAZ. They are written, not
//! read.

use crate::error::{Error, Result};
use crate::files::atomic;
use crate::files::ply;
use crate::splat::{Gaussians, bounds};
use glam::DVec3;
use las::point::{Classification, Format};
use las::{Builder, Color, Point, Transform, Vector, Version, Writer};
use ply_rs_bw::ply::ScalarType;
use std::io::{self, Cursor};
use std::path::Path;

/// x y z, red green blue, opacity, label.
const COLUMNS: usize = 8;
/// LAS stores a coordinate as a whole number of steps, of which an `i32` has about 2 * 10^9.
const MOST_STEPS: f64 = 1e9;
/// The first of the classes that LAS leaves to its users; they end at 255.
const FIRST_CLASS: u16 = 64;

/// Writes the points as PLY: positions as double, colours as `uchar`, the opacity as float in 0..1, and labels as `ushort`.
pub(super) fn write_ply(
    path: &Path,
    gaussians: &Gaussians,
    positions: &[DVec3],
    labels: Option<&[u16]>,
) -> Result<()> {
    let mut columns = Vec::new();
    let mut add = |names: &[&str], scalar: ScalarType| {
        columns.extend(names.iter().map(|&name| (name.to_owned(), scalar.clone())));
    };
    add(&["x", "y", "z"], ScalarType::Double);
    add(&["red", "green", "blue"], ScalarType::UChar);
    add(&["opacity"], ScalarType::Float);
    if labels.is_some() {
        add(&["label"], ScalarType::UShort);
    }
    let colors = gaussians.base_colors();
    atomic::write(path, |out| {
        let comments = Vec::new();
        ply::write::<COLUMNS, _>(out, gaussians.len(), &columns, comments, |i, row| {
            row[..3].copy_from_slice(&positions[i].to_array());
            for (value, color) in row[3..6].iter_mut().zip(colors[i]) {
                *value = f64::from(color * 255.0).round();
            }
            row[6] = super::opacity(gaussians.opacity_logits[i]);
            row[7] = labels.map_or(0.0, |labels| f64::from(labels[i]));
        })
    })
}

/// Writes the points as LAS 1.4, format 7, or as LAZ. The intensity is the opacity. The label is the point source id, and, up to
/// 191, 64 below the classification; points without labels are unclassified. No date is written: equal scenes give equal files.
///
/// # Errors
/// [`crate::Error::Io`].
pub(super) fn write_las(
    path: &Path,
    compressed: bool,
    gaussians: &Gaussians,
    positions: &[DVec3],
    labels: Option<&[u16]>,
) -> Result<()> {
    let failed = |e| Error::io(path, "write", io::Error::other(e));
    let mut builder = Builder::from(Version::new(1, 4));
    builder.point_format = Format::new(7).map_err(failed)?;
    builder.point_format.is_compressed = compressed;
    builder.generating_software = format!("coseg {}", env!("CARGO_PKG_VERSION"));
    builder.date = None;
    builder.transforms = transforms(positions);
    let header = builder.into_header().map_err(failed)?;
    let mut writer = Writer::new(Cursor::new(Vec::new()), header).map_err(failed)?;
    let to_16_bits = |share: f64| (share * 65_535.0).round() as u16;
    for (i, (position, color)) in positions.iter().zip(gaussians.base_colors()).enumerate() {
        let [red, green, blue] = color.map(|c| to_16_bits(f64::from(c)));
        let label = labels.map(|labels| labels[i]);
        let point = Point {
            x: position.x,
            y: position.y,
            z: position.z,
            intensity: to_16_bits(super::opacity(gaussians.opacity_logits[i])),
            return_number: 1,
            number_of_returns: 1,
            classification: classification(label),
            point_source_id: label.unwrap_or(0),
            gps_time: Some(0.0),
            color: Some(Color { red, green, blue }),
            ..Point::default()
        };
        writer.write_point(point).map_err(failed)?;
    }
    let bytes = writer.into_inner().map_err(failed)?.into_inner();
    atomic::write_bytes(path, &bytes)
}

/// The class of LAS that stands for a label.
fn classification(label: Option<u16>) -> Classification {
    let code = label.and_then(|label| u8::try_from(label.checked_add(FIRST_CLASS)?).ok());
    code.map_or(Classification::Unclassified, Classification::UserDefinable)
}

/// Steps by powers of ten, and offsets, so that the box of `positions` has [`MOST_STEPS`] at most.
fn transforms(positions: &[DVec3]) -> Vector<Transform> {
    let (low, high) = bounds(positions.iter().copied()).unwrap_or_default();
    // Points in one place need no finer steps than those of a box of 1.
    let extent = (high - low).max_element().max(1.0);
    let scale = 10_f64.powi((extent / MOST_STEPS).log10().ceil() as i32);
    let axis = |low: f64| Transform {
        scale,
        // A multiple of the step, so that coordinates are round numbers of steps.
        offset: (low / scale).floor() * scale,
    };
    Vector {
        x: axis(low.x),
        y: axis(low.y),
        z: axis(low.z),
    }
}

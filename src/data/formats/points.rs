//! Initial point clouds from PLY files.

use super::ply::PlyFile;
use crate::data::{Limits, Points};
use crate::error::Result;
use glam::DVec3;
use ply_rs_bw::ply::ScalarType;
use std::path::Path;

impl Points {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Reads element `vertex` of a PLY file: `x y z` (any scalar type) and `red green blue`.
    ///
    /// Colours: integer columns are divided by the largest value of their type; float columns are taken as 0..1, or as
    /// 0..255 when one of them exceeds 1; without colour columns the points are mid-grey. `origin` is subtracted in f64.
    ///
    /// # Errors
    /// The file cannot be read, is cut off, lacks a column, or holds a non-finite value (its row and column are named).
    pub fn read(path: &Path, origin: DVec3, limits: &Limits) -> Result<Self> {
        let file = PlyFile::open(path, "vertex", limits)?;
        let color = ["red", "green", "blue"];
        let colored = color.iter().any(|c| file.scalar(c).is_some());
        let scale = match file.scalar("red") {
            Some(ScalarType::UChar | ScalarType::Char) => 255.0,
            Some(ScalarType::UShort | ScalarType::Short) => 65_535.0,
            _ => 1.0,
        };
        let name = |c: &str| Some(c.to_owned());
        let mut columns = [name("x"), name("y"), name("z"), None, None, None];
        if colored {
            columns[3..].clone_from_slice(&color.map(name));
        }
        let mut points = Self::default();
        let mut brightest = 0.0_f32;
        file.read(&columns, |row, cells| {
            if let Some(bad) = cells.iter().position(|&v| !(v as f32).is_finite()) {
                let column = columns[bad].clone().unwrap_or_default();
                return Err(crate::Error::input(
                    path,
                    format!("row {row}, column {column}"),
                    cells[bad].to_string(),
                    "a finite number (f32)",
                    "remove this point",
                ));
            }
            points.positions.push(
                [
                    cells[0] - origin.x,
                    cells[1] - origin.y,
                    cells[2] - origin.z,
                ]
                .map(|v| v as f32),
            );
            let rgb = [cells[3], cells[4], cells[5]]
                .map(|v| if colored { (v / scale) as f32 } else { 0.5 });
            brightest = rgb.iter().fold(brightest, |a, &b| a.max(b));
            points.colors.push(rgb);
            Ok(())
        })?;
        let range = if brightest > 1.0 { 255.0 } else { 1.0 };
        for c in points.colors.iter_mut().flatten() {
            *c = (*c / range).clamp(0.0, 1.0);
        }
        Ok(points)
    }
}

//! Initial point clouds from PLY files.

use super::camera_checks::is_coordinate;
use crate::error::{Result, bail};
use crate::files::ply::PlyFile;
use crate::splat::median;
use glam::DVec3;
use ply_rs_bw::ply::ScalarType;
use std::path::Path;

/// Points this many times as far from the middle of the cloud as half of all points are strays.
pub(super) const MAX_STRAY: f64 = 1_000.0;
/// Clouds of fewer points have none.
const MIN_POINTS: usize = 16;

/// Points with colours, for initialisation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Points {
    /// `[N, 3]`, world units relative to the scene origin.
    pub positions: Vec<[f32; 3]>,
    /// `[N, 3]` sRGB in 0..1.
    pub colors: Vec<[f32; 3]>,
}

impl Points {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Removes strays, which COLMAP triangulates from wrong matches: they lie as far away as 10^8, become Gaussians of that size, and
    /// inflate the extent of the scene. Returns their number.
    pub(super) fn remove_strays(&mut self) -> usize {
        let count = self.len();
        if count < MIN_POINTS {
            return 0;
        }
        let along = |axis: usize| self.positions.iter().map(move |p| f64::from(p[axis]));
        let middle = DVec3::from([0, 1, 2].map(|axis| median(along(axis))));
        let distance = |p: &[f32; 3]| DVec3::from(p.map(f64::from)).distance(middle);
        let most = MAX_STRAY * median(self.positions.iter().map(distance));
        // Where half of all points coincide, no distance is known.
        let is_kept = |p: &[f32; 3]| most == 0.0 || distance(p) <= most;
        let kept: Vec<bool> = self.positions.iter().map(is_kept).collect();
        self.retain(&kept);
        count - self.len()
    }

    /// Keeps those points for which `kept` says so.
    pub(crate) fn retain(&mut self, kept: &[bool]) {
        let mut keeps = kept.iter();
        self.positions.retain(|_| *keeps.next().unwrap_or(&true));
        let mut keeps = kept.iter();
        self.colors.retain(|_| *keeps.next().unwrap_or(&true));
    }

    /// Reads element `vertex` of a PLY file: `x y z` (any scalar type) and `red green blue`.
    ///
    /// Integer colours are divided by the largest value of their type. Float colours are 0..1, or 0..255 when one of them exceeds
    /// 1. Without colour columns the points are mid-grey. `origin` is subtracted in f64.
    ///
    /// # Errors
    /// The file cannot be read, is cut off, lacks a column, or holds a non-finite value (its row and column are named).
    pub fn read(path: &Path, origin: DVec3) -> Result<Self> {
        let file = PlyFile::open(path, "vertex")?;
        let colors = ["red", "green", "blue"];
        let colored = colors.iter().any(|color| file.scalar(color).is_some());
        let scale = match file.scalar("red") {
            Some(ScalarType::UChar | ScalarType::Char) => 255.0,
            Some(ScalarType::UShort | ScalarType::Short) => 65_535.0,
            _ => 1.0,
        };
        let [r, g, b] = colors.map(|color| colored.then(|| color.to_owned()));
        let [x, y, z] = ["x", "y", "z"].map(|axis| Some(axis.to_owned()));
        let columns = [x, y, z, r, g, b];
        let mut points = Self::default();
        let mut brightest = 0.0_f32;
        file.read(&columns, |row, cells| {
            if let Some(bad) = cells.iter().position(|v| !is_coordinate(*v)) {
                bail!(path, "row {row}, column {}", columns[bad].as_deref().unwrap_or_default();
                    found "{}", cells[bad]; expected "a finite number (f32)"; help "remove this point");
            }
            let [x, y, z, r, g, b] = *cells;
            let position = (DVec3::new(x, y, z) - origin).to_array();
            points.positions.push(position.map(|v| v as f32));
            let rgb = [r, g, b].map(|v| if colored { (v / scale) as f32 } else { 0.5 });
            brightest = rgb.iter().fold(brightest, |a, &b| a.max(b));
            points.colors.push(rgb);
            Ok(())
        })?;
        let range = if brightest > 1.0 { 255.0 } else { 1.0 };
        for color in points.colors.iter_mut().flatten() {
            *color = (*color / range).clamp(0.0, 1.0);
        }
        Ok(points)
    }
}

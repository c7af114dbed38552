//! The world that nerfstudio trains in. It moves, turns and scales the poses of a scene; `dataparser_transforms.json` of a run says how.

use crate::data::Points;
use crate::error::{Result, ensure, invalid};
use crate::files;
use crate::splat::camera::{Camera, is_rotation};
use glam::{DMat3, DVec3};
use serde::Deserialize;
use serde_json::Value;
use std::path::Path;

/// `p -> scale (turn p + shift)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Similarity {
    /// A rotation.
    pub turn: DMat3,
    /// World units before scaling.
    pub shift: DVec3,
    /// Above 0.
    pub scale: f64,
}

impl Default for Similarity {
    fn default() -> Self {
        Self {
            turn: DMat3::IDENTITY,
            shift: DVec3::ZERO,
            scale: 1.0,
        }
    }
}

/// The file.
#[derive(Deserialize)]
struct Fields {
    transform: Value,
    scale: f64,
}

const HELP: &str =
    "give the dataparser_transforms.json of the run, which nerfstudio writes beside its config.yml";

impl Similarity {
    /// Reads nerfstudio's file.
    pub fn read(path: &Path) -> Result<Self> {
        files::expect_file(path, HELP)?;
        let fields: Fields = files::json(path, "transform and scale, as nerfstudio writes them")?;
        Self::new(
            path,
            ["transform", "scale"],
            &fields.transform,
            fields.scale,
        )
    }

    /// Of a matrix of 3 or 4 rows of 4 numbers and a scale, which these fields of `path` give.
    pub fn new(path: &Path, [matrix, factor]: [&str; 2], rows: &Value, scale: f64) -> Result<Self> {
        let unusable = || invalid!(path, "{matrix}"; found "{rows}"; expected "3 rows of 4 numbers, a rotation and a shift"; help "{HELP}");
        let rows: Vec<[f64; 4]> = serde_json::from_value(rows.clone()).map_err(|_| unusable())?;
        let [x, y, z] = rows.first_chunk().ok_or_else(unusable)?;
        let turn =
            DMat3::from_cols_array_2d(&[x, y, z].map(|row| [row[0], row[1], row[2]])).transpose();
        let shift = DVec3::new(x[3], y[3], z[3]);
        if !is_rotation(&turn) || !shift.is_finite() {
            return Err(unusable());
        }
        ensure!(scale > 0.0 && scale.is_finite(), path, "{factor}"; found "{scale}"; expected "a number above 0"; help "{HELP}");
        Ok(Self { turn, shift, scale })
    }

    /// This, for poses that `applied` had moved before: nerfstudio's file counts from the poses before that.
    pub fn after(self, applied: &Self) -> Self {
        let turn = self.turn * applied.turn.transpose();
        Self {
            turn,
            shift: self.shift - turn * applied.shift,
            scale: self.scale / applied.scale,
        }
    }

    /// The camera in the new world.
    pub fn camera(&self, camera: &Camera) -> Camera {
        Camera {
            rotation: camera.rotation * self.turn.transpose(),
            center: self.scale * (self.turn * camera.center + self.shift),
            ..camera.clone()
        }
    }

    /// Where a point of the new world was before.
    pub fn undo(&self, point: DVec3) -> DVec3 {
        self.turn.transpose() * (point / self.scale - self.shift)
    }

    /// Turns and scales points, which are relative to an origin.
    pub fn turn_points(&self, points: &mut Points) {
        for position in &mut points.positions {
            let turned = self.scale * (self.turn * DVec3::from(position.map(f64::from)));
            *position = turned.as_vec3().to_array();
        }
    }
}

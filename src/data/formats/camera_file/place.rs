//! Where something stands in a file of cameras, and checks that name the place.

use crate::data::Limits;
use crate::data::formats::camera_checks::{FOCAL, posed};
use crate::error::{Error, Result, ensure, invalid};
use crate::splat::camera::Camera;
use glam::DMat4;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::path::Path;

/// Where a camera stands in a file.
pub(super) struct Place<'a> {
    pub path: &'a Path,
    /// What precedes its fields in messages, such as `cameras[3].`; empty for the whole file.
    pub prefix: String,
}

impl Place<'_> {
    pub fn error(&self, field: &str, found: &str, expected: &str, help: &str) -> Error {
        invalid!(self.path, "{}{field}", self.prefix; found "{found}"; expected "{expected}"; help "{help}")
    }

    /// Refuses a focal length, in pixels, that `field` gave.
    pub fn check_focal(&self, field: &str, focal: f64) -> Result<f64> {
        if FOCAL.contains(&focal) {
            return Ok(focal);
        }
        let expected = "a focal length of 0.001 to 1e9 pixels";
        let help = "correct the focal length or field of view";
        Err(self.error(field, &format!("{focal:?} pixels"), expected, help))
    }

    /// Width and height in pixels, in all no more than an image may have.
    pub fn size(&self, sides: [(&str, f64); 2]) -> Result<[usize; 2]> {
        for (field, side) in sides {
            if side.fract() != 0.0 || !(1.0..=f64::from(u32::MAX)).contains(&side) {
                let expected = "a whole number of pixels, at least 1";
                return Err(self.error(field, &format!("{side:?}"), expected, "correct the size"));
            }
        }
        let size = sides.map(|(_, side)| side as usize);
        let place = self.path.join(self.prefix.trim_end_matches('.'));
        Limits::default().check_pixels(&place, size[0], size[1])?;
        Ok(size)
    }

    /// The camera that `with_pose` makes of the pose that `field` gave.
    pub fn posed(
        &self,
        field: &str,
        pose: &DMat4,
        with_pose: impl Fn(&DMat4) -> Option<Camera>,
    ) -> Result<Camera> {
        posed(
            self.path,
            &format!("{}{field}", self.prefix),
            pose,
            with_pose,
        )
    }
}

/// Characters of a fault that an error shows.
const MAX_SHOWN: usize = 120;

/// What serde makes of `value`, which is called `name` in messages; `expected` describes it there.
pub(super) fn parsed<T: DeserializeOwned>(
    path: &Path,
    name: &str,
    value: Value,
    expected: &str,
) -> Result<T> {
    serde_path_to_error::deserialize(value).map_err(|error| {
        let field = match error.path().iter().next() {
            Some(_) => error.path().to_string(),
            None => "fields".to_owned(),
        };
        // A value of the file may be long.
        let found: String = error.inner().to_string().chars().take(MAX_SHOWN).collect();
        invalid!(path, "{name}{field}"; found "{found}"; expected "{expected}";
            help "correct the field, or export the cameras again")
    })
}

/// Refuses a list of cameras that is empty, or longer than a scene may be.
pub(super) fn check_count(path: &Path, field: &str, count: usize) -> Result<()> {
    ensure!(count > 0, path, "{field}"; found "no cameras"; expected "at least one"; help "export them again");
    Limits::default().check_views(path, count)
}

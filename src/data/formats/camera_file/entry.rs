//! Fields of a JSON object, with errors that name file and field.

use crate::data::Limits;
use crate::data::formats::camera_checks::{FOCAL, describe_rotation, fits_f32, is_coordinate};
use crate::error::{Error, Result, ensure, invalid};
use crate::splat::camera::Camera;
use glam::DMat4;
use serde_json::Value;
use std::path::Path;

/// An object in a file of cameras.
pub(super) struct Entry<'a> {
    path: &'a Path,
    /// What precedes its fields in messages, such as `cameras[3].`; empty for the whole file.
    prefix: String,
    value: &'a Value,
}

/// Longest value that an error shows, in characters.
const MAX_SHOWN: usize = 60;

impl<'a> Entry<'a> {
    pub fn new(path: &'a Path, prefix: String, value: &'a Value) -> Self {
        Self {
            path,
            prefix,
            value,
        }
    }

    pub fn error(&self, field: &str, found: &str, expected: &str, help: &str) -> Error {
        invalid!(self.path, "{}{field}", self.prefix; found "{found}"; expected "{expected}"; help "{help}")
    }

    /// The field, where it is there.
    pub fn get(&self, field: &str) -> Option<&'a Value> {
        self.value.get(field)
    }

    /// What `read` makes of the field.
    fn read<T>(
        &self,
        field: &str,
        expected: &str,
        read: impl Fn(&'a Value) -> Option<T>,
    ) -> Result<T> {
        let value = self.get(field);
        value.and_then(read).ok_or_else(|| {
            let mut found = value.map_or_else(|| "nothing".to_owned(), Value::to_string);
            if let Some((end, _)) = found.char_indices().nth(MAX_SHOWN) {
                found.truncate(end);
                found += "...";
            }
            let help = "correct the field, or export the cameras again";
            self.error(field, &found, expected, help)
        })
    }

    /// A list of cameras: not empty, and no longer than a scene may be.
    pub fn cameras(&self, field: &str) -> Result<&'a [Value]> {
        let list = self.read(field, "a list", Value::as_array)?;
        check_count(self.path, field, list)?;
        Ok(list)
    }

    /// A number that is finite in f32 as well.
    pub fn number(&self, field: &str) -> Result<f64> {
        self.read(field, "a finite number (f32)", number)
    }

    /// `N` such numbers.
    pub fn numbers<const N: usize>(&self, field: &str) -> Result<[f64; N]> {
        self.read(field, &format!("{N} finite numbers (f32)"), numbers)
    }

    /// Three rows of three such numbers.
    pub fn rows(&self, field: &str) -> Result<[[f64; 3]; 3]> {
        self.read(field, "3 rows of 3 finite numbers (f32)", |value| {
            let rows: Option<Vec<_>> = value.as_array()?.iter().map(numbers).collect();
            rows?.try_into().ok()
        })
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
    pub fn size(&self, fields: [&str; 2]) -> Result<[usize; 2]> {
        let mut size = [0; 2];
        for (size, field) in size.iter_mut().zip(fields) {
            let value = self.number(field)?;
            if value.fract() != 0.0 || !(1.0..=f64::from(u32::MAX)).contains(&value) {
                let expected = "a whole number of pixels, at least 1";
                return Err(self.error(field, &format!("{value:?}"), expected, "correct the size"));
            }
            *size = value as usize;
        }
        let place = self.path.join(self.prefix.trim_end_matches('.'));
        Limits::default().check_pixels(&place, size[0], size[1])?;
        Ok(size)
    }

    /// A camera with its principal point in the middle; `field` holds its pose `c2w`, in OpenCV axes.
    pub fn centred(
        &self,
        field: &str,
        focals: [f64; 2],
        size: [usize; 2],
        c2w: &DMat4,
    ) -> Result<Camera> {
        Camera::centred(focals, size)
            .with_opencv_pose(c2w)
            .ok_or_else(|| {
                let expected = "a rotation (orthonormal columns, determinant +1)";
                let help = "remove scale, shear and mirroring from the pose";
                self.error(field, &describe_rotation(c2w), expected, help)
            })
    }
}

/// Refuses a list of cameras that is empty, or longer than a scene may be.
pub(super) fn check_count(path: &Path, field: &str, list: &[Value]) -> Result<()> {
    ensure!(!list.is_empty(), path, "{field}"; found "no cameras"; expected "at least one"; help "export them again");
    Limits::default().check_views(path, list.len())
}

fn number(value: &Value) -> Option<f64> {
    value.as_f64().filter(|value| fits_f32(*value))
}

fn numbers<const N: usize>(value: &Value) -> Option<[f64; N]> {
    let coordinate = |value: &Value| number(value).filter(|value| is_coordinate(*value));
    let values: Option<Vec<f64>> = value.as_array()?.iter().map(coordinate).collect();
    values?.try_into().ok()
}

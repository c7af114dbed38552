//! Fields of a JSON object, with errors that say where they are.

use crate::data::Limits;
use crate::error::{Error, Result};
use serde_json::Value;
use std::path::Path;

/// An object in a file of cameras.
pub(crate) struct Entry<'a> {
    path: &'a Path,
    /// Where it stands in the file, such as `cameras[3]`; empty for the whole.
    place: String,
    value: &'a Value,
}

/// Longest value that an error shows, in characters.
const SHOWN: usize = 60;

/// Focal lengths beyond these are mistakes, pixels.
const FOCAL: std::ops::RangeInclusive<f64> = 1e-3..=1e9;

impl<'a> Entry<'a> {
    pub fn new(path: &'a Path, place: String, value: &'a Value) -> Self {
        Self { path, place, value }
    }

    pub fn error(
        &self,
        field: &str,
        found: impl Into<String>,
        expected: &str,
        help: &str,
    ) -> Error {
        let dot = if self.place.is_empty() { "" } else { "." };
        Error::input(
            self.path,
            format!("{}{dot}{field}", self.place),
            found,
            expected,
            help,
        )
    }

    fn unlike(&self, field: &str, value: Option<&Value>, expected: &str) -> Error {
        let found = value.map_or_else(|| "nothing".to_owned(), |value| value.to_string());
        let short: String = found.chars().take(SHOWN).collect();
        let found = if short.len() < found.len() {
            format!("{short}...")
        } else {
            found
        };
        self.error(
            field,
            found,
            expected,
            "correct the field, or export the cameras again",
        )
    }

    /// The field, where it is there.
    pub fn get(&self, field: &str) -> Option<&'a Value> {
        self.value.get(field)
    }

    /// A list.
    pub fn list(&self, field: &str) -> Result<&'a [Value]> {
        let list = self.get(field).and_then(Value::as_array);
        list.map(Vec::as_slice)
            .ok_or_else(|| self.unlike(field, self.get(field), "a list"))
    }

    /// A number that is finite in f32 too.
    pub fn number(&self, field: &str) -> Result<f64> {
        let value = self.get(field);
        number(value).ok_or_else(|| self.unlike(field, value, "a finite number (f32)"))
    }

    /// `N` numbers, each finite in f32 too.
    pub fn numbers<const N: usize>(&self, field: &str) -> Result<[f64; N]> {
        numbers(self.get(field)).ok_or_else(|| {
            self.unlike(field, self.get(field), &format!("{N} finite numbers (f32)"))
        })
    }

    /// Three rows of three such numbers.
    pub fn rows(&self, field: &str) -> Result<[[f64; 3]; 3]> {
        let rows = self
            .get(field)
            .and_then(Value::as_array)
            .filter(|rows| rows.len() == 3);
        let read =
            rows.and_then(|r| Some([numbers(r.first())?, numbers(r.get(1))?, numbers(r.get(2))?]));
        read.ok_or_else(|| self.unlike(field, self.get(field), "3 rows of 3 finite numbers (f32)"))
    }

    /// A focal length, in pixels.
    pub fn focal(&self, field: &str) -> Result<f64> {
        let value = self.number(field)?;
        self.check_focal(field, value)
    }

    /// `focal`, which `field` gave.
    pub fn check_focal(&self, field: &str, focal: f64) -> Result<f64> {
        if FOCAL.contains(&focal) {
            return Ok(focal);
        }
        let expected = "a focal length of 0.001 to 1e9 pixels";
        Err(self.error(
            field,
            format!("{focal:?} pixels"),
            expected,
            "correct the focal length or field of view",
        ))
    }

    /// Width and height in pixels, no more in all than an image may have.
    pub fn size(&self, fields: [&str; 2]) -> Result<[usize; 2]> {
        let mut size = [0; 2];
        for (size, field) in size.iter_mut().zip(fields) {
            let value = self.number(field)?;
            if value.fract() != 0.0 || !(1.0..=f64::from(u32::MAX)).contains(&value) {
                let expected = "a whole number of pixels, at least 1";
                return Err(self.error(field, format!("{value:?}"), expected, "correct the size"));
            }
            *size = value as usize;
        }
        let pixels = (size[0] as u64).saturating_mul(size[1] as u64);
        let what = format!(
            "{}: pixels of {} {}",
            self.path.display(),
            self.place,
            fields.join(" x ")
        );
        Limits::check(
            what,
            pixels,
            Limits::default().image_pixels,
            "lower the size",
        )?;
        Ok(size)
    }
}

fn number(value: Option<&Value>) -> Option<f64> {
    value?.as_f64().filter(|&value| (value as f32).is_finite())
}

fn numbers<const N: usize>(value: Option<&Value>) -> Option<[f64; N]> {
    let list = value?.as_array()?;
    let values: Option<Vec<f64>> = list.iter().map(|value| number(Some(value))).collect();
    values?.try_into().ok()
}

//! COLMAP's camera models.

use crate::data::photos::lens::Lens;
use crate::error::{Error, Result};
use crate::splat::camera::Intrinsics;
use std::path::Path;

/// All models by their number, with the number of their parameters; those with a `true` are read.
const MODELS: [(&str, usize, bool); 16] = [
    ("SIMPLE_PINHOLE", 3, true),
    ("PINHOLE", 4, true),
    ("SIMPLE_RADIAL", 4, true),
    ("RADIAL", 5, true),
    ("OPENCV", 8, true),
    ("OPENCV_FISHEYE", 8, false),
    ("FULL_OPENCV", 12, false),
    ("FOV", 5, false),
    ("SIMPLE_RADIAL_FISHEYE", 4, false),
    ("RADIAL_FISHEYE", 5, false),
    ("THIN_PRISM_FISHEYE", 12, false),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16, false),
    ("SIMPLE_DIVISION", 4, false),
    ("DIVISION", 5, false),
    ("SIMPLE_FISHEYE", 3, false),
    ("FISHEYE", 4, false),
];
/// Intrinsics beyond this many pixels are mistakes.
const MAX_PIXELS: f64 = 1e9;

/// A camera of the model.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ModelCamera {
    pub id: u32,
    /// Name of the model, of those that are read.
    pub model: &'static str,
    pub size: [u64; 2],
    pub params: Vec<f64>,
    /// Where it stands in the file, for messages.
    pub place: String,
}

/// A model with the number of its parameters.
pub(crate) struct Model {
    pub name: &'static str,
    pub params: usize,
}

impl Model {
    /// # Errors
    /// [`Error::Input`] for numbers of no model and of models that are not read.
    pub fn from_number(number: i32, path: &Path, place: &str) -> Result<Self> {
        let known = usize::try_from(number).ok().and_then(|n| MODELS.get(n));
        known
            .filter(|m| m.2)
            .map(|m| Self {
                name: m.0,
                params: m.1,
            })
            .ok_or_else(|| {
                let name =
                    known.map_or_else(|| format!("model number {number}"), |m| m.0.to_owned());
                refused(path, place, name)
            })
    }

    /// # Errors
    /// As [`Model::from_number`].
    pub fn from_name(name: &str, path: &Path, place: &str) -> Result<Self> {
        let known = MODELS.iter().find(|m| m.0 == name && m.2);
        known
            .map(|m| Self {
                name: m.0,
                params: m.1,
            })
            .ok_or_else(|| refused(path, place, name.to_owned()))
    }
}

fn refused(path: &Path, place: &str, found: String) -> Error {
    let read: Vec<_> = MODELS.iter().filter(|m| m.2).map(|m| m.0).collect();
    let help = "run `colmap image_undistorter` and give the folder that it writes";
    Error::input(
        path,
        format!("{place}: MODEL"),
        found,
        format!("one of {}", read.join(", ")),
        help,
    )
}

impl ModelCamera {
    /// Intrinsics and lens, in range.
    pub fn checked(&self, path: &Path) -> Result<(Intrinsics, Lens)> {
        let error = |field: &str, found: String, expected: &str| {
            let field = format!("{} (camera {}): {field}", self.place, self.id);
            Err(Error::input(
                path,
                field,
                found,
                expected,
                "calibrate again, or copy the file again",
            ))
        };
        let [width, height] = self.size;
        if ![width, height]
            .iter()
            .all(|side| (1..=u64::from(u32::MAX)).contains(side))
        {
            return error(
                "WIDTH HEIGHT",
                format!("{width} {height}"),
                "pixels, at least 1 and below 2^32",
            );
        }
        let p = &self.params;
        if p.iter().any(|v| !v.is_finite()) {
            return error("PARAMS", format!("{p:?}"), "finite numbers");
        }
        let (f, c, lens) = match (self.model, &p[..]) {
            ("SIMPLE_PINHOLE", &[f, cx, cy]) => ([f, f], [cx, cy], Lens::default()),
            ("PINHOLE", &[fx, fy, cx, cy]) => ([fx, fy], [cx, cy], Lens::default()),
            ("SIMPLE_RADIAL", &[f, cx, cy, k]) => (
                [f, f],
                [cx, cy],
                Lens {
                    k: [k, 0.0, 0.0],
                    p: [0.0; 2],
                },
            ),
            ("RADIAL", &[f, cx, cy, k1, k2]) => (
                [f, f],
                [cx, cy],
                Lens {
                    k: [k1, k2, 0.0],
                    p: [0.0; 2],
                },
            ),
            ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => (
                [fx, fy],
                [cx, cy],
                Lens {
                    k: [k1, k2, 0.0],
                    p: [p1, p2],
                },
            ),
            _ => {
                return error(
                    "PARAMS",
                    format!("{} numbers", p.len()),
                    "as many as the model has",
                );
            }
        };
        if f.iter().any(|f| !(1e-3..=MAX_PIXELS).contains(f)) {
            return error(
                "PARAMS, focal length",
                format!("{f:?}"),
                "a positive number of pixels, 0.001 to 1e9",
            );
        }
        if c.iter().any(|c| c.abs() > MAX_PIXELS) {
            return error(
                "PARAMS, principal point",
                format!("{c:?}"),
                "pixels from the image corner",
            );
        }
        let (width, height) = (width as usize, height as usize);
        Ok((
            Intrinsics {
                fx: f[0],
                fy: f[1],
                cx: c[0],
                cy: c[1],
                width,
                height,
            },
            lens,
        ))
    }
}

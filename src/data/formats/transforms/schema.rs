//! What a `transforms.json` says, field by field, and the camera that follows from it.

use super::not_finite::{Token, blanked};
use crate::data::photos::lens::Lens;
use crate::error::{Error, Result};
use crate::splat::camera::{Camera, Intrinsics};
use glam::{DMat4, DVec4};
use serde::Deserialize;
use std::path::Path;

/// The file. Unknown keys are ignored: every tool adds its own.
#[derive(Deserialize)]
pub(crate) struct Transforms {
    #[serde(flatten)]
    pub lens: LensFields,
    pub convention: Option<String>,
    pub ply_file_path: Option<String>,
    pub frames: Vec<Frame>,
    /// Files of each split, as nerfstudio may list them.
    pub train_filenames: Option<Vec<String>>,
    pub val_filenames: Option<Vec<String>>,
    pub test_filenames: Option<Vec<String>>,
    /// What stood where matrices have `None`, in order.
    #[serde(skip)]
    not_finite: Vec<Token>,
}

/// One frame. Its own intrinsics come before those of the file.
#[derive(Deserialize)]
pub(crate) struct Frame {
    pub file_path: String,
    pub label_path: Option<String>,
    pub raw_label_path: Option<String>,
    pub instance_path: Option<String>,
    pub mask_path: Option<String>,
    pub split: Option<String>,
    /// `None` where the file has NaN or an infinity.
    pub transform_matrix: Vec<Vec<Option<f64>>>,
    #[serde(flatten)]
    pub lens: LensFields,
}

/// Intrinsics, each of which may be missing. Sizes are JSON numbers of any kind (some tools write `1080.0`).
#[derive(Clone, Default, Deserialize)]
pub(crate) struct LensFields {
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    k5: Option<f64>,
    k6: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

/// Models that are a pinhole once the distortion is taken out.
const PINHOLE_MODELS: [&str; 7] = [
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "OPENCV",
    "OPENCV_PINHOLE",
    "FULL_OPENCV",
    "SIMPLE_RADIAL",
    "RADIAL",
];

/// Intrinsics beyond this many pixels are mistakes.
const MAX_PIXELS: f64 = 1e9;

impl Transforms {
    /// Reads and checks what concerns the file as a whole.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
        let parse = |text: &str| serde_json::from_str::<Self>(text);
        let transforms = parse(&text).or_else(|e| {
            // Python writes NaN into JSON. In a pose, the frame can be named.
            let (blank, tokens) = blanked(&text);
            let lenient = parse(&blank)
                .ok()
                .filter(|t| !tokens.is_empty() && t.gaps().count() == tokens.len());
            lenient
                .map(|t| Self {
                    not_finite: tokens,
                    ..t
                })
                .ok_or(e)
        });
        let transforms = transforms.map_err(|e| {
            let line = text
                .lines()
                .nth(e.line().saturating_sub(1))
                .unwrap_or_default();
            let not_finite = e.is_syntax() && ["NaN", "Infinity"].iter().any(|w| line.contains(w));
            let found = if not_finite {
                format!("{} ({e})", line.trim())
            } else {
                e.to_string()
            };
            let expected = if not_finite {
                "finite numbers"
            } else {
                "transforms.json as nerfstudio and instant-ngp have it"
            };
            Error::input(
                path,
                format!("line {}", e.line()),
                found,
                expected,
                "correct the file there or export it again",
            )
        })?;
        if transforms.frames.is_empty() {
            return Err(Error::input(
                path,
                "frames",
                "no frames",
                "at least one",
                "add views",
            ));
        }
        let convention = transforms
            .convention
            .as_deref()
            .unwrap_or_default()
            .to_lowercase();
        if convention.contains("opencv") && !convention.contains("opengl") {
            let help = "negate the second and third column of every transform_matrix";
            return Err(Error::input(
                path,
                "convention",
                convention,
                "OpenGL camera-to-world",
                help,
            ));
        }
        Ok(transforms)
    }

    /// Whether the file says that the world's z axis points up.
    pub fn z_up(&self) -> bool {
        self.convention
            .as_deref()
            .is_some_and(|c| c.to_lowercase().contains("world z up"))
    }

    /// Cells of matrices that hold no number, as (frame, row, column), in order.
    fn gaps(&self) -> impl Iterator<Item = (usize, usize, usize)> {
        self.frames.iter().enumerate().flat_map(|(i, frame)| {
            let rows = frame.transform_matrix.iter().enumerate();
            let cells =
                rows.flat_map(|(r, row)| row.iter().enumerate().map(move |(c, cell)| (r, c, cell)));
            cells
                .filter(|(.., cell)| cell.is_none())
                .map(move |(r, c, _)| (i, r, c))
        })
    }

    /// `frames[I] (FILE)`, for messages.
    pub fn field(&self, frame: usize) -> String {
        format!("frames[{frame}] ({})", self.frames[frame].file_path)
    }

    /// Width and height that the file gives for a frame.
    pub fn declared_size(&self, path: &Path, frame: usize) -> Result<Option<(usize, usize)>> {
        let lens = &self.frames[frame].lens;
        let whole = |name: &str, value: f64| {
            if value.fract() == 0.0 && (1.0..=4_294_967_295.0).contains(&value) {
                return Ok(value as usize);
            }
            let field = format!("{}.{name}", self.field(frame));
            Err(Error::input(
                path,
                field,
                format!("{value:?}"),
                "a whole number of pixels, at least 1",
                "correct the size",
            ))
        };
        match (lens.w.or(self.lens.w), lens.h.or(self.lens.h)) {
            (Some(w), Some(h)) => Ok(Some((whole("w", w)?, whole("h", h)?))),
            _ => Ok(None),
        }
    }

    /// The camera of a frame, in world units, and its lens.
    pub fn camera(
        &self,
        path: &Path,
        frame: usize,
        (width, height): (usize, usize),
    ) -> Result<(Camera, Lens)> {
        let (intrinsics, lens) = self.intrinsics(path, frame, width, height)?;
        let matrix = self.matrix(path, frame)?;
        let camera = Camera::from_opengl(&matrix, intrinsics).ok_or_else(|| {
            let m = glam::DMat3::from_mat4(matrix);
            let lengths = [m.x_axis, m.y_axis, m.z_axis].map(|a| a.length());
            // Exporters of Blender leave the scale of the object that a camera belongs to in its matrix.
            let scale = lengths[0];
            let unscaled = DMat4::from_mat3(m * scale.recip());
            let (scaled, help) = match Camera::from_opengl(&unscaled, intrinsics) {
                Some(_) => (
                    format!(", which is a rotation times {scale:.6}"),
                    format!("divide its first three columns by {scale:.6}; the translation stays"),
                ),
                None => (
                    String::new(),
                    "remove scale, shear and mirroring from the pose".to_owned(),
                ),
            };
            Error::input(
                path,
                format!("{}.transform_matrix", self.field(frame)),
                format!(
                    "column lengths {lengths:.4?}, determinant {:.4}{scaled}",
                    m.determinant()
                ),
                "a rotation (orthonormal columns, determinant +1) and a translation",
                help,
            )
        })?;
        Ok((camera, lens))
    }

    /// The pose, finite, 4x4.
    fn matrix(&self, path: &Path, frame: usize) -> Result<DMat4> {
        let rows = &self.frames[frame].transform_matrix;
        let error = |field: &str, found: String, expected: &str| {
            let field = format!("{}.transform_matrix{field}", self.field(frame));
            Err(Error::input(
                path,
                field,
                found,
                expected,
                "export the pose again",
            ))
        };
        if !(3..=4).contains(&rows.len()) || rows.iter().any(|r| r.len() != 4) {
            let lengths: Vec<_> = rows.iter().map(Vec::len).collect();
            return error(
                "",
                format!("rows of lengths {lengths:?}"),
                "4 rows of 4 numbers",
            );
        }
        let mut m = [[0.0, 0.0, 0.0, 1.0]; 4];
        for (r, row) in rows.iter().enumerate() {
            for (c, &value) in row.iter().enumerate() {
                let Some(value) = value else {
                    let token = self
                        .gaps()
                        .position(|gap| gap == (frame, r, c))
                        .and_then(|k| self.not_finite.get(k));
                    let line = token.map_or(String::new(), |t| format!(", line {}", t.line));
                    let found = token.map_or("null", |t| t.text).to_owned();
                    return error(&format!("[{r}][{c}]{line}"), found, "a finite number");
                };
                if !(value as f32).is_finite() {
                    return error(
                        &format!("[{r}][{c}]"),
                        format!("{value:?}"),
                        "a finite number (f32)",
                    );
                }
                m[r][c] = value;
            }
        }
        if m[3] != [0.0, 0.0, 0.0, 1.0] {
            return error("[3]", format!("{:?}", m[3]), "[0, 0, 0, 1]");
        }
        let [x, y, z, w] = m.map(DVec4::from);
        Ok(DMat4::from_cols(x, y, z, w).transpose())
    }

    fn intrinsics(
        &self,
        path: &Path,
        frame: usize,
        width: usize,
        height: usize,
    ) -> Result<(Intrinsics, Lens)> {
        let (own, all) = (&self.frames[frame].lens, &self.lens);
        let error = |name: &str, found: String, expected: &str, help: &str| {
            Error::input(
                path,
                format!("{}.{name}", self.field(frame)),
                found,
                expected,
                help,
            )
        };
        let model = own.camera_model.as_ref().or(all.camera_model.as_ref());
        if let Some(model) = model.filter(|m| !PINHOLE_MODELS.contains(&m.to_uppercase().as_str()))
        {
            let help = "undistort the images (colmap image_undistorter) and export again";
            return Err(error(
                "camera_model",
                model.clone(),
                "PINHOLE, OPENCV, SIMPLE_RADIAL or RADIAL",
                help,
            ));
        }
        if own.is_fisheye.or(all.is_fisheye) == Some(true) {
            let help = "undistort the images (colmap image_undistorter) and export again";
            return Err(error(
                "is_fisheye",
                "true".into(),
                "a lens that is no fisheye",
                help,
            ));
        }
        // Of what follows k3 tools differ on the meaning: a further power of the radius, or a denominator.
        let beyond = [
            ("k4", own.k4.or(all.k4)),
            ("k5", own.k5.or(all.k5)),
            ("k6", own.k6.or(all.k6)),
        ];
        if let Some((name, Some(k))) = beyond.iter().find(|(_, k)| k.is_some_and(|k| k != 0.0)) {
            let help = "undistort the images (colmap image_undistorter, or OpenCV undistort) and export poses with zeros";
            return Err(error(
                name,
                k.to_string(),
                "0: of lens distortion only k1 k2 k3 p1 p2 are read",
                help,
            ));
        }
        let value = |own: Option<f64>, all: Option<f64>| own.or(all).unwrap_or(0.0);
        let lens = Lens {
            k: [
                value(own.k1, all.k1),
                value(own.k2, all.k2),
                value(own.k3, all.k3),
            ],
            p: [value(own.p1, all.p1), value(own.p2, all.p2)],
        };
        let from_angle = |pixels: usize, angle: Option<f64>| {
            angle.map(|a| 0.5 * pixels as f64 / (0.5 * a).tan())
        };
        let fx = own
            .fl_x
            .or(all.fl_x)
            .or_else(|| from_angle(width, own.camera_angle_x.or(all.camera_angle_x)));
        let Some(fx) = fx else {
            let help = "add the focal length in pixels";
            return Err(error(
                "fl_x",
                "neither fl_x nor camera_angle_x".into(),
                "one of them",
                help,
            ));
        };
        let fy = own
            .fl_y
            .or(all.fl_y)
            .or_else(|| from_angle(height, own.camera_angle_y.or(all.camera_angle_y)));
        // One focal length only: square pixels.
        let fy = fy.unwrap_or(fx);
        for (name, f) in [("fl_x", fx), ("fl_y", fy)] {
            if !(1e-3..=MAX_PIXELS).contains(&f) {
                let expected = "a positive number of pixels, 0.001 to 1e9";
                return Err(error(
                    name,
                    format!("{f:?}"),
                    expected,
                    "correct the focal length or camera_angle",
                ));
            }
        }
        let cx = own.cx.or(all.cx).unwrap_or(0.5 * width as f64);
        let cy = own.cy.or(all.cy).unwrap_or(0.5 * height as f64);
        for (name, c) in [("cx", cx), ("cy", cy)] {
            if c.abs() > MAX_PIXELS {
                return Err(error(
                    name,
                    format!("{c:?}"),
                    "pixels from the image corner",
                    "correct the principal point",
                ));
            }
        }
        Ok((
            Intrinsics {
                fx,
                fy,
                cx,
                cy,
                width,
                height,
            },
            lens,
        ))
    }
}

//! The fields of a `transforms.json`, and the cameras that they give.

use super::not_finite::quoted;
use crate::data::formats::camera_checks::{check_center, check_focal, posed, side};
use crate::data::formats::dataparser::Similarity;
use crate::data::photos::lens::Lens;
use crate::error::{Error, Result, bail, ensure, invalid};
use crate::files;
use crate::splat::camera::Camera;
use glam::DMat4;
use serde::Deserialize;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// The file. Unknown keys are ignored: every tool adds its own.
#[derive(Deserialize)]
pub(super) struct Transforms {
    #[serde(skip)]
    pub path: PathBuf,
    #[serde(flatten)]
    lens: LensFields,
    convention: Option<String>,
    /// How nerfstudio moved the poses of the COLMAP model.
    applied_transform: Option<Value>,
    applied_scale: Option<f64>,
    pub ply_file_path: Option<String>,
    pub frames: Vec<Frame>,
    /// Files of each split, as nerfstudio may list them.
    pub train_filenames: Option<Vec<String>>,
    pub val_filenames: Option<Vec<String>>,
    pub test_filenames: Option<Vec<String>>,
}

/// One frame. Its own intrinsics come before those of the file.
#[derive(Deserialize)]
pub(super) struct Frame {
    pub file_path: String,
    pub label_path: Option<String>,
    pub raw_label_path: Option<String>,
    pub instance_path: Option<String>,
    pub mask_path: Option<String>,
    pub split: Option<String>,
    /// Numbers, or text where the file has NaN or an infinity.
    transform_matrix: Vec<Vec<Value>>,
    #[serde(flatten)]
    lens: LensFields,
}

/// Intrinsics, each of which may be missing. Sizes are JSON numbers of any kind (some tools write `1080.0`).
#[derive(Clone, Default, Deserialize)]
struct LensFields {
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

impl LensFields {
    /// These fields, with missing ones taken from `all`.
    fn or(&self, all: &Self) -> Self {
        let mut merged = self.clone();
        macro_rules! fill {
            ($($field:ident)*) => { $(merged.$field = merged.$field.or_else(|| all.$field.clone());)* };
        }
        fill!(camera_model is_fisheye camera_angle_x camera_angle_y fl_x fl_y cx cy w h k1 k2 k3 k4 k5 k6 p1 p2);
        merged
    }
}

/// Models that are pinholes once the distortion is removed.
const PINHOLE_MODELS: &str =
    "PINHOLE SIMPLE_PINHOLE OPENCV OPENCV_PINHOLE FULL_OPENCV SIMPLE_RADIAL RADIAL";

/// Names of the numbers among the intrinsics.
const NUMBERS: [&str; 16] = [
    "camera_angle_x",
    "camera_angle_y",
    "fl_x",
    "fl_y",
    "cx",
    "cy",
    "w",
    "h",
    "k1",
    "k2",
    "k3",
    "k4",
    "k5",
    "k6",
    "p1",
    "p2",
];

/// The error for a number of the file, or of a frame, that is something else: serde tells neither its key nor its line.
fn no_number(path: &Path, text: &str) -> Option<Error> {
    let file: Value = serde_json::from_str(text).ok()?;
    let frames = file["frames"].as_array().into_iter().flatten();
    let frames = frames
        .enumerate()
        .map(|(i, frame)| (format!("frames[{i}]."), frame));
    [(String::new(), &file)]
        .into_iter()
        .chain(frames)
        .find_map(|(of, fields)| {
            let is_wrong = |name: &&str| !matches!(fields[*name], Value::Null | Value::Number(_));
            let name = NUMBERS.into_iter().find(|name| is_wrong(name))?;
            Some(
                invalid!(path, "{of}{name}"; found "{}", fields[name]; expected "a number";
            help "write it without quotation marks, or export the file again"),
            )
        })
}

const UNDISTORT: &str = "undistort the images (colmap image_undistorter) and export again";

impl Transforms {
    /// Reads the file and checks it as a whole.
    pub fn read(path: &Path) -> Result<Self> {
        let original = files::text(path)?;
        // Python writes NaN into JSON. In a pose, the frame can be named.
        let (text, tokens) = quoted(&original);
        let expected = "transforms.json as nerfstudio and instant-ngp have it";
        let mut file: Self = serde_json::from_str(&text).map_err(|e| {
            let Some(token) = tokens.first() else {
                return no_number(path, &text).unwrap_or_else(|| files::json_error(path, &e, expected));
            };
            let line = original.lines().nth(token.line - 1).unwrap_or_default();
            invalid!(path, "line {}", token.line; found "{}", line.trim(); expected "finite numbers";
                help "correct the file there or export it again")
        })?;
        ensure!(!file.frames.is_empty(),
            path, "frames"; found "no frames"; expected "at least one"; help "add views");
        file.path = path.to_owned();
        let convention = file.convention();
        if convention.contains("opencv") && !convention.contains("opengl") {
            bail!(path, "convention"; found "{convention}"; expected "OpenGL camera-to-world";
                help "negate the second and third column of every transform_matrix");
        }
        Ok(file)
    }

    fn convention(&self) -> String {
        self.convention
            .as_deref()
            .unwrap_or_default()
            .to_lowercase()
    }

    /// Whether the file says that the world's z axis points up.
    pub fn z_up(&self) -> bool {
        self.convention().contains("world z up")
    }

    /// How nerfstudio moved the poses of the COLMAP model before it wrote them here.
    pub fn applied(&self) -> Result<Similarity> {
        let Some(rows) = &self.applied_transform else {
            return Ok(Similarity::default());
        };
        let fields = ["applied_transform", "applied_scale"];
        Similarity::new(&self.path, fields, rows, self.applied_scale.unwrap_or(1.0))
    }

    /// `frames[I] (FILE)`, for messages.
    pub fn field(&self, frame: usize) -> String {
        format!("frames[{frame}] ({})", self.frames[frame].file_path)
    }

    fn lens_fields(&self, frame: usize) -> LensFields {
        self.frames[frame].lens.or(&self.lens)
    }

    /// Width and height that the file gives for a frame.
    pub fn declared_size(&self, frame: usize) -> Result<Option<(usize, usize)>> {
        let whole = |name: &str, length: f64| {
            side(&self.path, &format!("{}.{name}", self.field(frame)), length)
        };
        let lens = self.lens_fields(frame);
        match (lens.w, lens.h) {
            (Some(w), Some(h)) => Ok(Some((whole("w", w)?, whole("h", h)?))),
            _ => Ok(None),
        }
    }

    /// The camera of a frame, in world units, and its lens.
    pub fn camera(&self, frame: usize, size: (usize, usize)) -> Result<(Camera, Lens)> {
        let (intrinsics, lens) = self.intrinsics(frame, size)?;
        let field = format!("{}.transform_matrix", self.field(frame));
        let matrix = self.matrix(frame, &field)?;
        let camera = posed(&self.path, &field, &matrix, |pose| {
            intrinsics.clone().with_opengl_pose(pose)
        })?;
        Ok((camera, lens))
    }

    /// The numbers of a pose, 4x4, which `field` gives.
    fn matrix(&self, frame: usize, field: &str) -> Result<DMat4> {
        let rows = &self.frames[frame].transform_matrix;
        const DAMAGED_HELP: &str = "export the pose again";
        let path = &self.path;
        let lengths: Vec<_> = rows.iter().map(Vec::len).collect();
        ensure!((3..=4).contains(&rows.len()) && lengths.iter().all(|length| *length == 4),
            path, "{field}"; found "rows of lengths {lengths:?}"; expected "4 rows of 4 numbers"; help "{DAMAGED_HELP}");
        let mut m = DMat4::IDENTITY.to_cols_array_2d();
        for (r, row) in rows.iter().enumerate() {
            for (c, value) in row.iter().enumerate() {
                m[r][c] = value.as_f64().ok_or_else(|| {
                    let text = value.as_str().map(str::to_owned);
                    let found = text.unwrap_or_else(|| value.to_string());
                    invalid!(path, "{field}[{r}][{c}]"; found "{found}"; expected "a finite number (f32)"; help "{DAMAGED_HELP}")
                })?;
            }
        }
        Ok(DMat4::from_cols_array_2d(&m).transpose())
    }

    /// A camera without its pose, and its lens.
    fn intrinsics(&self, frame: usize, (width, height): (usize, usize)) -> Result<(Camera, Lens)> {
        let path = &self.path;
        let place = self.field(frame);
        let fields = self.lens_fields(frame);
        let is_pinhole = |model: &str| {
            PINHOLE_MODELS
                .split(' ')
                .any(|known| known == model.to_uppercase())
        };
        if let Some(model) = fields.camera_model.filter(|model| !is_pinhole(model)) {
            bail!(path, "{place}.camera_model"; found "{model}";
                expected "PINHOLE, OPENCV, SIMPLE_RADIAL or RADIAL"; help "{UNDISTORT}");
        }
        ensure!(fields.is_fisheye != Some(true),
            path, "{place}.is_fisheye"; found "true"; expected "a lens that is not a fisheye"; help "{UNDISTORT}");
        // Tools differ on the meaning of what follows k3: a further power of the radius, or a denominator.
        let beyond = [("k4", fields.k4), ("k5", fields.k5), ("k6", fields.k6)];
        for (name, k) in beyond {
            if let Some(k) = k.filter(|k| *k != 0.0) {
                bail!(path, "{place}.{name}"; found "{k}";
                    expected "0: of lens distortion only k1 k2 k3 p1 p2 are read"; help "{UNDISTORT}");
            }
        }
        let lens = Lens {
            k: [fields.k1, fields.k2, fields.k3].map(Option::unwrap_or_default),
            p: [fields.p1, fields.p2].map(Option::unwrap_or_default),
        };
        let from_angle = |pixels: usize, angle: f64| 0.5 * pixels as f64 / (0.5 * angle).tan();
        let from_width = || fields.camera_angle_x.map(|angle| from_angle(width, angle));
        let from_height = || fields.camera_angle_y.map(|angle| from_angle(height, angle));
        let fx = fields.fl_x.or_else(from_width).ok_or_else(|| {
            invalid!(path, "{place}.fl_x"; found "neither fl_x nor camera_angle_x"; expected "one of them";
                help "add the focal length in pixels")
        })?;
        // One focal length only: square pixels.
        let fy = fields.fl_y.or_else(from_height).unwrap_or(fx);
        let help = "correct the focal length or camera_angle";
        check_focal(path, &format!("{place}.fl_x"), fx, help)?;
        check_focal(path, &format!("{place}.fl_y"), fy, help)?;
        let cx = fields.cx.unwrap_or(0.5 * width as f64);
        let cy = fields.cy.unwrap_or(0.5 * height as f64);
        let help = "correct the principal point";
        check_center(path, &format!("{place}.cx"), cx, help)?;
        check_center(path, &format!("{place}.cy"), cy, help)?;
        let centred = Camera::centred([fx, fy], [width, height]);
        Ok((Camera { cx, cy, ..centred }, lens))
    }
}

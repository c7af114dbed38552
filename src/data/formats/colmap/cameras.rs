//! COLMAP's camera models.

use super::reader::Reader;
use crate::data::formats::camera_checks::{check_center, check_focal};
use crate::data::photos::lens::Lens;
use crate::error::{Error, Result, ensure, invalid};
use crate::splat::camera::Camera;
use std::collections::BTreeMap;
use std::path::Path;

/// The models that are read, by their numbers in binary files: name, number of focal lengths, and number of distortion
/// coefficients k1 k2 p1 p2. Between these two the parameters have the principal point.
const MODELS: [(&str, usize, usize); 5] = [
    ("SIMPLE_PINHOLE", 1, 0),
    ("PINHOLE", 2, 0),
    ("SIMPLE_RADIAL", 1, 1),
    ("RADIAL", 1, 2),
    ("OPENCV", 2, 4),
];
/// The models that follow them, which are not pinholes after undistortion.
const UNSUPPORTED_MODELS: &str = "OPENCV_FISHEYE FULL_OPENCV FOV SIMPLE_RADIAL_FISHEYE RADIAL_FISHEYE THIN_PRISM_FISHEYE \
    RAD_TAN_THIN_PRISM_FISHEYE SIMPLE_DIVISION DIVISION SIMPLE_FISHEYE FISHEYE";
/// The help of numbers out of range.
const HELP: &str = "calibrate again, or copy the file again";

/// The cameras of a model, by their numbers.
pub(super) type Cameras = BTreeMap<u32, ModelCamera>;

/// A camera of the model. Its numbers are checked for each image that uses it.
#[derive(Debug)]
pub(super) struct ModelCamera {
    size: [u64; 2],
    params: Vec<f64>,
    /// Number of focal lengths among the parameters.
    focals: usize,
    /// Where it stands in the file, for messages.
    place: String,
}

/// Reads `cameras.bin` or `cameras.txt`.
pub(super) fn read(path: &Path) -> Result<Cameras> {
    let mut reader = Reader::open(path, "camera", 4 + 4 + 16 + 3 * 8)?;
    let mut cameras = Cameras::new();
    while reader.next()? {
        let place = reader.place();
        let id = reader.value("CAMERA_ID")?;
        let name = reader.model(model_name)?;
        let model = MODELS.into_iter().find(|(known, ..)| *known == name);
        let (_, focals, distortion) = model.ok_or_else(|| unsupported(path, &place, &name))?;
        let size = reader.values("WIDTH HEIGHT")?;
        let count = focals + 2 + distortion;
        let params = (0..count)
            .map(|_| reader.value("PARAMS"))
            .collect::<Result<_>>()?;
        reader.expect_end("PARAMS", &format!("{count} numbers for {name}"))?;
        let camera = ModelCamera {
            size,
            params,
            focals,
            place: format!("{place} (camera {id})"),
        };
        ensure!(cameras.insert(id, camera).is_none(), path, "{place}: CAMERA_ID";
            found "{id}, which an earlier camera has too"; expected "a number of its own for each camera";
            help "drop the repeated camera from the model");
    }
    Ok(cameras)
}

impl ModelCamera {
    /// A camera without its pose, and its lens, in range.
    pub fn checked(&self, path: &Path) -> Result<(Camera, Lens)> {
        let Self { size, place, .. } = self;
        let [width, height] = size;
        let in_range = |side: &u64| (1..=u64::from(u32::MAX)).contains(side);
        ensure!(size.iter().all(in_range), path, "{place}: WIDTH HEIGHT"; found "{width} {height}";
            expected "pixels, at least 1 and below 2^32"; help "{HELP}");
        let (focals, rest) = self.params.split_at(self.focals);
        let (center, distortion) = rest.split_at(2);
        for focal in focals {
            let field = format!("{place}: PARAMS, focal length");
            check_focal(path, &field, *focal, HELP)?;
        }
        for center in center {
            let field = format!("{place}: PARAMS, principal point");
            check_center(path, &field, *center, HELP)?;
        }
        ensure!(distortion.iter().all(|k| k.is_finite()), path, "{place}: PARAMS, distortion"; found "{distortion:?}";
            expected "finite numbers"; help "{HELP}");
        let coefficient = |i: usize| distortion.get(i).copied().unwrap_or(0.0);
        let lens = Lens {
            k: [coefficient(0), coefficient(1), 0.0],
            p: [coefficient(2), coefficient(3)],
        };
        let focals = [focals[0], focals[focals.len() - 1]];
        let camera = Camera {
            cx: center[0],
            cy: center[1],
            ..Camera::centred(focals, size.map(|side| side as usize))
        };
        Ok((camera, lens))
    }
}

fn model_name(number: i32) -> String {
    let supported = MODELS.into_iter().map(|(name, ..)| name);
    let mut names = supported.chain(UNSUPPORTED_MODELS.split_ascii_whitespace());
    let name = usize::try_from(number).ok().and_then(|i| names.nth(i));
    name.map_or_else(|| format!("model number {number}"), str::to_owned)
}

fn unsupported(path: &Path, place: &str, name: &str) -> Error {
    let names = MODELS.map(|(name, ..)| name).join(", ");
    invalid!(path, "{place}: MODEL"; found "{name}"; expected "one of {names}";
        help "run `colmap image_undistorter` and give the folder that it writes")
}

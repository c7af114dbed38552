//! `cameras.json` as graphdeco's 3DGS writes it (`camera_to_JSON`): a list of cameras, camera-to-world with OpenCV axes.

use super::{check_count, parsed, size};
use crate::data::formats::camera_checks::{check_focal, posed};
use crate::data::photos::EXTENSIONS;
use crate::data::{NamedCamera, Split};
use crate::error::{Result, bail, ensure};
use crate::splat::camera::Camera;
use glam::{DMat3, DMat4, DVec3};
use serde::Deserialize;
use serde_json::Value;
use std::collections::HashMap;
use std::path::Path;

/// A camera of the list. Its other fields are not read.
#[derive(Deserialize)]
#[serde(expecting = "a camera with img_name, width, height, position, rotation, fx and fy")]
struct Entry {
    /// Text, or a number as text.
    #[serde(default)]
    img_name: Value,
    /// Pixels; some tools write `90.0`.
    width: f64,
    height: f64,
    position: [f64; 3],
    /// By rows.
    rotation: [[f64; 3]; 3],
    fx: f64,
    fy: f64,
}

pub(super) fn cameras(path: &Path, list: Value) -> Result<Vec<NamedCamera>> {
    let entries: Vec<Entry> = parsed(path, "cameras", list, "cameras as 3DGS writes them")?;
    check_count(path, "cameras", entries.len())?;
    let mut cameras = Vec::with_capacity(entries.len());
    let mut first = HashMap::new();
    for (i, entry) in entries.iter().enumerate() {
        let place = format!("cameras[{i}]");
        let name = entry.name();
        ensure!(!name.is_empty(), path, "{place}.img_name"; found "no name"; expected "the name of an image";
            help "name the camera");
        if let Some(first) = first.insert(name.clone(), i) {
            bail!(path, "{place}.img_name"; found "{name:?}, which cameras[{first}] has too";
                expected "names that differ: outputs are named by them"; help "rename one of the cameras or drop it");
        }
        cameras.push(NamedCamera {
            name,
            split: Split::Train,
            camera: entry.camera(path, &place)?,
        });
    }
    Ok(cameras)
}

impl Entry {
    fn camera(&self, path: &Path, place: &str) -> Result<Camera> {
        let sides = [("width", self.width), ("height", self.height)];
        let size = size(path, place, sides)?;
        let help = "correct the focal length";
        check_focal(path, &format!("{place}.fx"), self.fx, help)?;
        check_focal(path, &format!("{place}.fy"), self.fy, help)?;
        let rotation = DMat3::from_cols_array_2d(&self.rotation).transpose();
        let mut c2w = DMat4::from_mat3(rotation);
        c2w.w_axis = DVec3::from(self.position).extend(1.0);
        posed(path, &format!("{place}.position, rotation"), &c2w, |pose| {
            Camera::centred([self.fx, self.fy], size).with_opencv_pose(pose)
        })
    }

    /// The image's name without its extension, which newer versions keep; folders become part of the name. Empty without a name.
    fn name(&self) -> String {
        let file_name = match &self.img_name {
            Value::String(name) => name.clone(),
            Value::Number(number) => number.to_string(),
            _ => String::new(),
        };
        let stem = match file_name.rsplit_once('.') {
            Some((stem, extension)) if EXTENSIONS.contains(&&*extension.to_lowercase()) => stem,
            _ => &file_name,
        };
        stem.replace(['/', '\\'], "_")
    }
}

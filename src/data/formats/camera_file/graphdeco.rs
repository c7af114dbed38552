//! `cameras.json` as graphdeco's 3DGS writes it (`camera_to_JSON`): a list of cameras, camera-to-world with OpenCV axes.

use super::place::{Place, check_count, parsed};
use crate::data::photos::EXTENSIONS;
use crate::data::{NamedCamera, Split};
use crate::error::Result;
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
    for (i, entry) in entries.into_iter().enumerate() {
        let prefix = format!("cameras[{i}].");
        let place = Place { path, prefix };
        let name = entry.name(&place)?;
        if let Some(first) = first.insert(name.clone(), i) {
            let found = format!("{name:?}, which cameras[{first}] has too");
            let expected = "names that differ: outputs are named by them";
            let help = "rename one of the cameras or drop it";
            return Err(place.error("img_name", &found, expected, help));
        }
        let camera = entry.camera(&place)?;
        cameras.push(NamedCamera {
            name,
            split: Split::Train,
            camera,
        });
    }
    Ok(cameras)
}

impl Entry {
    fn camera(&self, place: &Place<'_>) -> Result<Camera> {
        let size = place.size([("width", self.width), ("height", self.height)])?;
        let fx = place.check_focal("fx", self.fx)?;
        let fy = place.check_focal("fy", self.fy)?;
        let rotation = DMat3::from_cols_array_2d(&self.rotation).transpose();
        let mut c2w = DMat4::from_mat3(rotation);
        c2w.w_axis = DVec3::from(self.position).extend(1.0);
        place.posed("position, rotation", &c2w, |pose| {
            Camera::centred([fx, fy], size).with_opencv_pose(pose)
        })
    }

    /// The image's name without its extension, which newer versions keep; folders become part of the name.
    fn name(&self, place: &Place<'_>) -> Result<String> {
        let given = match &self.img_name {
            Value::String(name) => name.clone(),
            Value::Number(number) => number.to_string(),
            _ => String::new(),
        };
        let stem = match given.rsplit_once('.') {
            Some((stem, extension)) if EXTENSIONS.contains(&&*extension.to_lowercase()) => stem,
            _ => &given,
        };
        if stem.is_empty() {
            let expected = "the name of an image";
            return Err(place.error("img_name", "no name", expected, "name the camera"));
        }
        Ok(stem.replace(['/', '\\'], "_"))
    }
}

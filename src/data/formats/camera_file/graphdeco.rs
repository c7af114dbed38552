//! `cameras.json` as graphdeco's 3DGS writes it (`camera_to_JSON`): a list of cameras, camera-to-world with OpenCV axes.

use super::entry::{Entry, check_count};
use crate::data::photos::EXTENSIONS;
use crate::data::{NamedCamera, Split};
use crate::error::Result;
use glam::{DMat3, DMat4, DVec3};
use serde_json::Value;
use std::collections::HashMap;
use std::path::Path;

pub(super) fn cameras(path: &Path, list: &[Value]) -> Result<Vec<NamedCamera>> {
    check_count(path, "cameras", list)?;
    let mut cameras = Vec::with_capacity(list.len());
    let mut first = HashMap::new();
    for (i, value) in list.iter().enumerate() {
        let entry = Entry::new(path, format!("cameras[{i}]."), value);
        let name = name(&entry)?;
        if let Some(first) = first.insert(name.clone(), i) {
            let found = format!("{name:?}, which cameras[{first}] has too");
            let expected = "names that differ: outputs are named by them";
            let help = "rename one of the cameras or drop it";
            return Err(entry.error("img_name", &found, expected, help));
        }
        let size = entry.size(["width", "height"])?;
        let focal = |field| entry.check_focal(field, entry.number(field)?);
        let focals = [focal("fx")?, focal("fy")?];
        let rotation = DMat3::from_cols_array_2d(&entry.rows("rotation")?).transpose();
        let mut c2w = DMat4::from_mat3(rotation);
        c2w.w_axis = DVec3::from(entry.numbers("position")?).extend(1.0);
        let camera = entry.centred("rotation", focals, size, &c2w)?;
        cameras.push(NamedCamera {
            name,
            split: Split::Train,
            camera,
        });
    }
    Ok(cameras)
}

/// The image's name without its extension, which newer versions keep; folders become part of the name.
fn name(entry: &Entry<'_>) -> Result<String> {
    let given = match entry.get("img_name") {
        Some(Value::String(name)) => name.clone(),
        Some(Value::Number(number)) => number.to_string(),
        _ => String::new(),
    };
    let stem = match given.rsplit_once('.') {
        Some((stem, extension)) if EXTENSIONS.contains(&&*extension.to_lowercase()) => stem,
        _ => &given,
    };
    if stem.is_empty() {
        let expected = "the name of an image";
        return Err(entry.error("img_name", "no name", expected, "name the camera"));
    }
    Ok(stem.replace(['/', '\\'], "_"))
}

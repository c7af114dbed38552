//! `cameras.json` as graphdeco's 3DGS writes it (`camera_to_JSON`): a list of cameras, camera-to-world with OpenCV axes.

use super::{Entry, centred, check_count};
use crate::data::{NamedCamera, Split};
use crate::error::Result;
use glam::{DMat3, DMat4, DVec3};
use serde_json::Value;
use std::collections::HashMap;
use std::path::Path;

pub(crate) fn cameras(path: &Path, list: &[Value]) -> Result<Vec<NamedCamera>> {
    check_count(path, "cameras", list)?;
    let (mut cameras, mut seen) = (Vec::with_capacity(list.len()), HashMap::new());
    for (i, value) in list.iter().enumerate() {
        let entry = Entry::new(path, format!("cameras[{i}]"), value);
        let name = name(&entry)?;
        if let Some(first) = seen.insert(name.clone(), i) {
            let found = format!("{name:?}, which cameras[{first}] has too");
            let expected = "names that differ: outputs are named by them";
            return Err(entry.error(
                "img_name",
                found,
                expected,
                "rename one of the cameras or drop it",
            ));
        }
        let size = entry.size(["width", "height"])?;
        let focal = [entry.focal("fx")?, entry.focal("fy")?];
        let rotation = DMat3::from_cols_array_2d(&entry.rows("rotation")?).transpose();
        let position = DVec3::from(entry.numbers::<3>("position")?);
        let mut c2w = DMat4::from_mat3(rotation);
        c2w.w_axis = position.extend(1.0);
        let camera = centred(&entry, "rotation", focal, size, c2w)?;
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
    let extension = given
        .rsplit_once('.')
        .filter(|(_, e)| ["png", "jpg", "jpeg"].contains(&&*e.to_lowercase()));
    let name = extension
        .map_or(&*given, |(stem, _)| stem)
        .replace(['/', '\\'], "_");
    match name.is_empty() {
        true => Err(entry.error(
            "img_name",
            "no name",
            "the name of an image",
            "name the camera",
        )),
        false => Ok(name),
    }
}

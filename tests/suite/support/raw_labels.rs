//! The plates with raw labels in another format.

use crate::support::assert_names;
use crate::support::plates::{WIDTH, scene};
use crate::support::program::read_json;
use coseg::config::Association;
use coseg::data::{LabelMap, LoadOptions, Scene, check, load};
use image::{Rgb, RgbImage};
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// A folder of the plates.
pub fn folder() -> TempDir {
    let folder = tempfile::tempdir().expect("folder");
    scene(folder.path());
    folder
}

/// With the raw labels in the folder or file `raw`.
pub fn options(raw: &str) -> LoadOptions {
    LoadOptions {
        raw_labels: Some(raw.into()),
        ..LoadOptions::default()
    }
}

/// Writes JSON below `dir`.
pub fn write(dir: &Path, name: &str, value: &Value) {
    let path = dir.join(name);
    fs::create_dir_all(path.parent().expect("folder")).expect("folder");
    fs::write(path, value.to_string()).expect("write");
}

/// Raw labels of one view.
pub fn raw(scene: &Scene, view: usize) -> LabelMap {
    scene.views[view].raw.as_ref().expect("raw labels").map()
}

/// Labels at (x, y).
pub fn at(map: &LabelMap, places: &[(usize, usize)]) -> Vec<u16> {
    places.iter().map(|(x, y)| map.ids[y * WIDTH + x]).collect()
}

/// Names of the views with raw labels.
pub fn labelled(scene: &Scene) -> Vec<&str> {
    let views = scene.views.iter().filter(|view| view.raw.is_some());
    views.map(|view| view.name.as_str()).collect()
}

/// Asserts that loading and checking report a fault with all of `parts`.
#[track_caller]
pub fn refused(dir: &Path, options: &LoadOptions, parts: &[&str]) {
    assert_names(&load(dir, options).expect_err("broken"), parts);
    let problems = check(dir, options).problems;
    let names = |problem: &coseg::Error| {
        let message = problem.to_string();
        parts.iter().all(|part| message.contains(part))
    };
    assert!(problems.iter().any(names), "{problems:?}");
}

/// Takes the true labels and the class table away.
pub fn without_truth(dir: &Path) {
    let path = dir.join("transforms.json");
    let mut value = read_json(&path);
    for frame in value["frames"].as_array_mut().expect("frames") {
        frame.as_object_mut().expect("frame").remove("label_path");
    }
    fs::write(path, value.to_string()).expect("write");
    fs::remove_file(dir.join("classes.json")).expect("remove");
}

/// [`options`] for segments that are not classes.
pub fn associated(folder: &str) -> LoadOptions {
    LoadOptions {
        association: Association::Gaussians,
        ..options(folder)
    }
}

/// Raw labels of the views, from the scene's own grey maps.
pub fn own_maps(dir: &Path) -> Vec<LabelMap> {
    let scene = load(dir, &LoadOptions::default()).expect("scene");
    scene
        .views
        .into_iter()
        .map(|view| view.raw.expect("raw labels").map())
        .collect()
}

/// Writes the map as an RGB picture.
pub fn save(path: &Path, map: &LabelMap, color: impl Fn(u16) -> [u8; 3]) {
    fs::create_dir_all(path.parent().expect("folder")).expect("folder");
    let pixel = |x: u32, y: u32| Rgb(color(map.ids[y as usize * map.width + x as usize]));
    RgbImage::from_fn(map.width as u32, map.height as u32, pixel)
        .save(path)
        .expect("map");
}

/// Raw labels of all views.
pub fn maps_of(scene: &Scene) -> Vec<LabelMap> {
    scene
        .views
        .iter()
        .map(|view| view.raw.as_ref().expect("raw labels").map())
        .collect()
}

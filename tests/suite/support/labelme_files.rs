//! Files of LabelMe for the plates.

use crate::support::plates::{HEIGHT, WIDTH};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

pub fn shape(label: &str, kind: &str, points: Value) -> Value {
    json!({ "label": label, "points": points, "shape_type": kind, "group_id": null, "flags": {} })
}

/// As LabelMe 5 writes it.
pub fn labelme(shapes: &[Value]) -> Value {
    json!({
        "version": "5.5.0", "flags": {}, "shapes": shapes, "imagePath": "v0.png", "imageData": "aGVsbG8=",
        "imageHeight": HEIGHT, "imageWidth": WIDTH,
    })
}

pub fn rectangle(x: f64, y: f64, right: f64, bottom: f64) -> Value {
    json!([[x, y], [right, bottom]])
}

pub fn triangle() -> Value {
    json!([[40.0, 0.0], [80.0, 0.0], [80.0, 40.0]])
}

/// Makes the plates a COLMAP scene.
pub fn colmap(dir: &Path) {
    fs::remove_file(dir.join("transforms.json")).expect("remove");
    fs::create_dir_all(dir.join("sparse/0")).expect("folder");
    let cameras = format!("1 PINHOLE {WIDTH} {HEIGHT} 80 80 40 32\n");
    fs::write(dir.join("sparse/0/cameras.txt"), cameras).expect("cameras");
    let images = (0..6).map(|i| format!("{} 1 0 0 0 {i} 0 0 1 v{i}.png\n\n", i + 1));
    fs::write(dir.join("sparse/0/images.txt"), images.collect::<String>()).expect("images");
    fs::write(dir.join("sparse/0/points3D.txt"), "").expect("points");
}

//! A small scene with a `transforms.json`: three photos with labels, and two points.

use coseg::data::{LabelMap, LoadOptions, load};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

pub const WIDTH: u32 = 16;
pub const HEIGHT: u32 = 12;

/// A camera at x = `i`, y = 2, z = 10^6, looking along -z with up +y.
fn pose(i: usize) -> Value {
    json!([
        [1, 0, 0, i as f64],
        [0, 1, 0, 2],
        [0, 0, 1, 1e6],
        [0, 0, 0, 1]
    ])
}

/// Its `transforms.json`.
pub fn manifest() -> Value {
    let frame = |i: usize| {
        json!({
            "file_path": format!("images/v{i}.png"), "label_path": format!("labels/v{i}.png"),
            "raw_label_path": format!("labels_raw/v{i}.png"), "split": if i == 0 { "test" } else { "train" },
            "transform_matrix": pose(i),
        })
    };
    json!({
        "fl_x": 20.0, "fl_y": 21.0, "cx": 8.5, "cy": 6.25, "w": WIDTH, "h": HEIGHT, "k1": 0, "k2": 0.0,
        "camera_model": "OPENCV", "ply_file_path": "points.ply", "frames": [frame(0), frame(1), frame(2)],
    })
}

/// The small scene: three photos with labels, classes 1, 2 and 300, two points.
pub fn scene() -> TempDir {
    let dir = tempfile::tempdir().expect("folder");
    let at = |p: String| dir.path().join(p);
    fs::create_dir(at("images".into())).expect("folder");
    for i in 0..3_u8 {
        let photo = image::RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
            image::Rgb([x as u8 * 9, y as u8 * 7, i])
        });
        photo.save(at(format!("images/v{i}.png"))).expect("photo");
        let ids: Vec<u16> = (0..WIDTH * HEIGHT)
            .map(|k| [0, 1, 2, 300][k as usize % 4])
            .collect();
        let map = LabelMap {
            width: WIDTH as usize,
            height: HEIGHT as usize,
            ids,
        };
        for folder in ["labels", "labels_raw", "labels_raw_corr"] {
            map.write(&at(format!("{folder}/v{i}.png")))
                .expect("labels");
        }
    }
    write(
        dir.path(),
        "classes.json",
        r#"{"0": "void", "300": "lamp", "1": "wall", "2": "floor"}"#,
    );
    let points = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\n\
        property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n\
        1 2 1000000.5 255 0 51\n2.5 2 1000000 0 0 0\n";
    write(dir.path(), "points.ply", points);
    write(dir.path(), "transforms.json", &manifest().to_string());
    dir
}

fn write(dir: &Path, name: &str, text: &str) {
    fs::write(dir.join(name), text).expect("write");
}

/// Changes the small scene's manifest.
pub fn edit(dir: &TempDir, change: impl Fn(&mut Value)) {
    let mut value = manifest();
    change(&mut value);
    write(dir.path(), "transforms.json", &value.to_string());
}

/// The message of the error that loading gives, which must contain all of `parts`.
#[track_caller]
pub fn expect_error(dir: &Path, options: &LoadOptions, parts: &[&str]) {
    crate::support::assert_names(&load(dir, options).expect_err("an error"), parts);
}

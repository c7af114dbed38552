//! A scene in the layout of NeRF's Blender files: a disc on nothing, with a file of cameras for each split.

use glam::{DMat4, DVec3};
use image::{Rgba, RgbaImage};
use serde_json::json;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

pub const SIZE: u32 = 40;

/// A red disc, half transparent at its rim, on nothing.
fn photo(split: &str, i: usize) -> RgbaImage {
    RgbaImage::from_fn(SIZE, SIZE, |x, y| {
        let r = (f64::from(x) - 19.5).hypot(f64::from(y) - 19.5);
        let alpha = if r < 10.0 {
            255
        } else {
            128 * u8::from(r < 12.0)
        };
        Rgba([
            200,
            if split == "train" { 40 } else { 80 },
            10 * i as u8,
            alpha,
        ])
    })
}

/// `count` photos of a split, as the files have them, from a circle around the disc.
pub fn write(dir: &Path, split: &str, count: usize) {
    fs::create_dir_all(dir.join(split)).unwrap();
    let frame = |i: usize| {
        photo(split, i)
            .save(dir.join(format!("{split}/r_{i}.png")))
            .unwrap();
        let angle = 0.4 * i as f64 + split.len() as f64;
        let eye = 4.0 * DVec3::new(angle.sin(), angle.cos(), 0.5);
        let pose = DMat4::look_at_rh(eye, DVec3::ZERO, DVec3::Z).inverse();
        let rows: Vec<_> = (0..4).map(|r| pose.row(r).to_array()).collect();
        json!({ "file_path": format!("./{split}/r_{i}"), "rotation": 0.0125, "transform_matrix": rows })
    };
    let frames: Vec<_> = (0..count).map(frame).collect();
    let file = json!({ "camera_angle_x": std::f64::consts::FRAC_PI_3, "frames": frames });
    fs::write(
        dir.join(format!("transforms_{split}.json")),
        file.to_string(),
    )
    .unwrap();
}

/// Training, test and validation photos, 5, 3 and 2.
pub fn scene() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (split, count) in [("train", 5), ("test", 3), ("val", 2)] {
        write(folder.path(), split, count);
    }
    folder
}

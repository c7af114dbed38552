//! A scene folder of large photos in PNG and JPEG, taken through a lens that bends them.

use coseg::data::{LoadOptions, Scene, load};
use image::RgbImage;
use serde_json::json;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use tempfile::TempDir;

pub const WIDTH: u32 = 400;
pub const HEIGHT: u32 = 300;
pub const VIEWS: usize = 8;
/// Bytes of a decoded photo.
pub const PHOTO: usize = (WIDTH * HEIGHT * 3) as usize;

/// Photos as PNG and JPEG, taken through a lens that bends them.
pub fn scene() -> TempDir {
    let dir = tempfile::tempdir().expect("folder");
    fs::create_dir(dir.path().join("images")).expect("folder");
    let name = |i: usize| {
        format!(
            "images/v{i}.{}",
            if i.is_multiple_of(2) { "png" } else { "jpg" }
        )
    };
    for i in 0..VIEWS {
        picture(i as u32)
            .save(dir.path().join(name(i)))
            .expect("photo");
    }
    let pose = |i: usize| json!([[1, 0, 0, i], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
    let frames: Vec<_> = (0..VIEWS)
        .map(|i| json!({ "file_path": name(i), "transform_matrix": pose(i) }))
        .collect();
    let file = json!({
        "camera_model": "OPENCV", "w": WIDTH, "h": HEIGHT, "fl_x": 300.0, "fl_y": 300.0, "cx": 200.0, "cy": 150.0,
        "k1": -0.1, "frames": frames,
    });
    fs::write(dir.path().join("transforms.json"), file.to_string()).expect("transforms");
    dir
}

pub fn picture(i: u32) -> RgbImage {
    RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
        image::Rgb([(x + 31 * i) as u8, (y * (i + 1)) as u8, (x * y / 64) as u8])
    })
}

/// The scene, with at most `decoded_mb` of decoded photos in memory.
pub fn loaded(dir: &Path, decoded_mb: usize) -> Scene {
    load(
        dir,
        &LoadOptions {
            decoded_mb,
            ..LoadOptions::default()
        },
    )
    .expect("scene")
}

/// Number of photos of a scene whose pixels stay in memory.
pub fn kept(scene: &Scene) -> usize {
    let stays = |i: &usize| Arc::ptr_eq(&pixels(scene, *i), &pixels(scene, *i));
    (0..scene.views.len()).filter(stays).count()
}

/// Photo `i`, decoded.
pub fn pixels(scene: &Scene, i: usize) -> Arc<RgbImage> {
    scene.views[i].image.pixels().expect("photo")
}

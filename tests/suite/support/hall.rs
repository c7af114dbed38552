//! A long hall: cameras in a row that look at a wall, and one at its end that looks along it.

use coseg::data::{Classes, LabelMap};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

/// Cameras in the row, a world unit of a half apart along x; every eighth is held out.
pub const ROW: usize = 24;
/// The camera that looks along the hall.
pub const ALONG: &str = "along";
const SIZE: [usize; 2] = [8, 6];

/// Writes the scene: small photos with labels and a cloud of points. With a `screen`, the camera at the end sees nothing else.
pub fn hall(dir: &Path, screen: bool) {
    let mut frames: Vec<Value> = (0..ROW)
        .map(|i| {
            let x = 0.5 * i as f64;
            let pose = [
                [1.0, 0.0, 0.0, x],
                [0.0, 0.0, -1.0, 0.0],
                [0.0, 1.0, 0.0, 0.0],
                [0.0, 0.0, 0.0, 1.0],
            ];
            frame(
                dir,
                &format!("v{i:02}"),
                if i % 8 == 0 { "test" } else { "train" },
                pose,
            )
        })
        .collect();
    let pose = [
        [0.0, 0.0, 1.0, 10.0],
        [1.0, 0.0, 0.0, -2.0],
        [0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ];
    frames.push(frame(dir, ALONG, "train", pose));
    let file = json!({
        "fl_x": 8.0, "fl_y": 8.0, "cx": 4.0, "cy": 3.0, "w": SIZE[0], "h": SIZE[1], "convention": "world z up",
        "ply_file_path": "points.ply", "frames": frames,
    });
    fs::write(dir.join("transforms.json"), file.to_string()).unwrap();
    Classes::from_names(0, [(1, "wall"), (2, "door")])
        .write(&dir.join("classes.json"))
        .unwrap();
    cloud(&dir.join("points.ply"), screen);
}

fn frame(dir: &Path, name: &str, split: &str, pose: [[f64; 4]; 4]) -> Value {
    let [width, height] = SIZE;
    fs::create_dir_all(dir.join("images")).unwrap();
    let photo = image::RgbImage::from_pixel(width as u32, height as u32, image::Rgb([90, 120, 60]));
    photo.save(dir.join(format!("images/{name}.png"))).unwrap();
    let ids = vec![1; width * height];
    let map = LabelMap { width, height, ids };
    map.write(&dir.join(format!("raw/{name}.png"))).unwrap();
    json!({
        "file_path": format!("images/{name}.png"), "raw_label_path": format!("raw/{name}.png"), "split": split,
        "transform_matrix": pose,
    })
}

/// The wall along y = 4, a panel at x = 1 that only the camera at the end looks at, and perhaps a screen before it.
fn cloud(path: &Path, screen: bool) {
    let mut points = Vec::new();
    for z in [-1.5, -0.5, 0.5, 1.5] {
        points.extend((-8..56).map(|i| [0.25 * f64::from(i), 4.0, z]));
        points.extend((-40..-1).map(|i| [1.0, 0.1 * f64::from(i), z]));
    }
    if screen {
        let at = |i: i32| {
            [
                8.0,
                -3.5 + 0.1 * f64::from(i % 31),
                -1.5 + 0.1 * f64::from(i / 31),
            ]
        };
        points.extend((0..31 * 31).map(at));
    }
    let header = "property float x\nproperty float y\nproperty float z\nend_header\n";
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\n{header}",
        points.len()
    );
    points
        .iter()
        .for_each(|[x, y, z]| text += &format!("{x} {y} {z}\n"));
    fs::write(path, text).unwrap();
}

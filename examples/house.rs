//! Writes a house of six furnished rooms as a scene folder: the generator of the built-in room, once for each room.
//!
//!     cargo run --release --example house -- scenes/house

use coseg::data::builtin::{BuiltinOptions, EVALUATED_SEED, classes, scene_with};
use coseg::data::{LabelMap, Scene, View};
use glam::DVec3;
use serde_json::{Value, json};
use std::error::Error;
use std::fmt::Write;
use std::fs;
use std::path::Path;

/// Rooms along x and y.
const ROOMS: [u64; 2] = [3, 2];
/// From the middle of a room to that of the next, metres: rooms are 6.4 by 5.2 m.
const PITCH: [f64; 2] = [6.6, 5.4];
/// Object ids of a room begin after this many for each room before it.
const OBJECTS: u16 = 200;

fn main() -> Result<(), Box<dyn Error>> {
    let Some(folder) = std::env::args_os().nth(1) else {
        return Err("give the folder to write".into());
    };
    let folder = Path::new(&folder);
    fs::create_dir_all(folder.join("images"))?;
    let mut frames = Vec::new();
    let mut points = String::new();
    let mut count = 0;
    for room in 0..ROOMS[0] * ROOMS[1] {
        let [x, y] = [room % ROOMS[0], room / ROOMS[0]].map(|i| i as f64);
        let offset = DVec3::new(PITCH[0] * x, PITCH[1] * y, 0.0);
        let scene = scene_with(&BuiltinOptions {
            seed: EVALUATED_SEED + room,
            ..BuiltinOptions::default()
        })?;
        for view in &scene.views {
            frames.push(frame(folder, room as u16, view, offset)?);
        }
        count += scene.points.len();
        add_points(&mut points, &scene, offset)?;
    }
    let columns = "property float x\nproperty float y\nproperty float z\nproperty float red\nproperty float green\nproperty float blue";
    let header = format!("ply\nformat ascii 1.0\nelement vertex {count}\n{columns}\nend_header\n");
    fs::write(folder.join("points.ply"), header + &points)?;
    let file = json!({"convention": "OpenGL camera-to-world, world z up", "ply_file_path": "points.ply", "frames": frames});
    fs::write(folder.join("transforms.json"), file.to_string())?;
    classes().write(&folder.join("classes.json"))?;
    Ok(())
}

/// Writes photo and label maps of a view; its entry in the list of frames.
fn frame(folder: &Path, room: u16, view: &View, offset: DVec3) -> Result<Value, Box<dyn Error>> {
    let name = format!("room{room}_{}.png", view.name);
    view.image
        .pixels()?
        .save(folder.join("images").join(&name))?;
    let camera = view.camera.moved(offset);
    let mut frame = json!({
        "file_path": format!("images/{name}"), "split": view.split,
        "w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy,
        "transform_matrix": camera.to_opengl().transpose().to_cols_array_2d(),
    });
    let maps = [
        ("label_path", "labels", &view.truth),
        ("raw_label_path", "labels_raw", &view.raw),
        ("instance_path", "instances", &view.instances),
    ];
    for (field, kind, map) in maps {
        let Some(map) = map else { continue };
        let mut map: LabelMap = map.map();
        if kind == "instances" {
            map.ids.iter_mut().for_each(|id| *id += OBJECTS * room);
        }
        map.write(&folder.join(kind).join(&name))?;
        frame[field] = json!(format!("{kind}/{name}"));
    }
    Ok(frame)
}

fn add_points(text: &mut String, scene: &Scene, offset: DVec3) -> Result<(), Box<dyn Error>> {
    for (position, [r, g, b]) in scene.points.positions.iter().zip(&scene.points.colors) {
        let [x, y, z] = (DVec3::from(position.map(f64::from)) + scene.origin + offset).to_array();
        writeln!(text, "{x} {y} {z} {r} {g} {b}")?;
    }
    Ok(())
}

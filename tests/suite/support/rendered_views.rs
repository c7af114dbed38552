//! New views of the plates by the program.

use crate::support::plates::{camera, scene};
use crate::support::program::{cpu_backend, succeeds, utf8};
use coseg::data::formats::transforms;
use coseg::data::{NamedCamera, Split};
use std::fs;
use std::path::{Path, PathBuf};

/// A folder like a run's: scene.ply, cameras.json and classes.json.
pub fn run_folder(dir: &Path) -> PathBuf {
    let run = dir.join("run");
    fs::create_dir(&run).unwrap();
    fs::rename(scene(dir), run.join("scene.ply")).unwrap();
    fs::copy(dir.join("classes.json"), run.join("classes.json")).unwrap();
    let split = |i| {
        if i % 3 == 2 {
            Split::Test
        } else {
            Split::Train
        }
    };
    let named = |i| NamedCamera {
        name: format!("v{i}"),
        split: split(i),
        camera: camera(i),
    };
    transforms::write_cameras(
        &run.join("cameras.json"),
        &(0..6).map(named).collect::<Vec<_>>(),
    )
    .unwrap();
    run
}

/// Width and height of a picture.
pub fn size(path: &Path) -> (u32, u32) {
    image::image_dimensions(path).unwrap()
}

/// Renders from `scene` into `out`, on the CPU.
pub fn render(scene: &Path, out: &Path, more: &[&str]) -> String {
    let cpu = cpu_backend();
    succeeds(
        &[
            &[
                "render",
                "--scene",
                utf8(scene),
                "--out",
                utf8(out),
                "--backend",
                &cpu,
            ],
            more,
        ]
        .concat(),
    )
}

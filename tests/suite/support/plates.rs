//! A small scene for tests of the program: three coloured plates before a wall, photographed and labelled.

use crate::support::hard_labels::hard_label_map;
use burn::tensor::Device;
use coseg::config::SegmentationConfig;
use coseg::data::{Classes, LabelMap, LoadOptions, Scene, Split, load};
use coseg::pipeline::train_decoder::TrainingViews;
use coseg::raster::{Projected, Settings, render};
use coseg::splat::camera::Camera;
use coseg::splat::{Gaussians, ply};
use glam::{DMat4, DVec3, Vec3};
use std::path::{Path, PathBuf};

pub const WIDTH: usize = 80;
pub const HEIGHT: usize = 64;
const VIEWS: usize = 6;

/// Three square plates of Gaussians and a wall behind them.
pub fn plates() -> (Gaussians, Vec<u16>) {
    let (mut means, mut log_scales, mut colors, mut labels) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let plates = [
        ([-0.9, 0.0, 0.1], [0.9, 0.1, 0.1]),
        ([0.0, 0.3, 0.0], [0.1, 0.8, 0.2]),
        ([0.8, -0.3, 0.2], [0.2, 0.3, 0.9]),
    ];
    for (label, (center, color)) in (1..).zip(plates) {
        for i in 0..25 {
            means.push([
                center[0] + 0.15 * (i % 5 - 2) as f32,
                center[1] + 0.15 * (i / 5 - 2) as f32,
                center[2],
            ]);
            log_scales.push([-2.3_f32; 3]);
            colors.push(color);
            labels.push(label);
        }
    }
    for i in 0..36 {
        means.push([
            -2.0 + 0.8 * (i % 6) as f32,
            -2.0 + 0.8 * (i / 6) as f32,
            -1.5,
        ]);
        log_scales.push([-0.6, -0.6, -3.0]);
        colors.push([
            0.6 + 0.05 * (i % 5) as f32,
            0.5,
            0.4 + 0.05 * (i % 7) as f32,
        ]);
        labels.push(4);
    }
    let n = means.len();
    let sh = colors
        .iter()
        .flatten()
        .map(|c| (c - 0.5) / 0.282_094_8)
        .collect();
    let rotations = vec![[1.0, 0.0, 0.0, 0.0]; n];
    (
        Gaussians {
            means,
            log_scales,
            rotations,
            opacity_logits: vec![3.0; n],
            sh,
            sh_degree: 0,
        },
        labels,
    )
}

/// Cameras on an arc, looking at the plates from +z.
fn pose(i: usize) -> DMat4 {
    let angle = -0.3 + 0.6 * i as f64 / (VIEWS - 1) as f64;
    let eye = DVec3::new(4.0 * angle.sin(), 0.3, 4.0 * angle.cos());
    DMat4::look_at_rh(eye, DVec3::ZERO, DVec3::Y).inverse()
}

pub fn camera(i: usize) -> Camera {
    let camera = Camera::centred([80.0; 2], [WIDTH, HEIGHT]);
    camera.with_opengl_pose(&pose(i)).unwrap()
}

/// The scene of the plates, its Gaussians in the scene's own world, and their labels. Its photos are read from the folder.
pub fn loaded() -> (Scene, Gaussians, Vec<u16>, tempfile::TempDir) {
    let folder = tempfile::tempdir().expect("a folder");
    scene(folder.path());
    let scene = load(folder.path(), &LoadOptions::default()).expect("a scene");
    let (mut gaussians, labels) = plates();
    for mean in &mut gaussians.means {
        *mean = (Vec3::from(*mean) - scene.origin.as_vec3()).to_array();
    }
    (scene, gaussians, labels, folder)
}

/// The training views of `scene` with raw labels.
pub fn training_views<'a>(
    gaussians: &'a Gaussians,
    scene: &'a Scene,
    config: &SegmentationConfig,
    device: &Device,
) -> TrainingViews<'a> {
    let views = scene.split(Split::Train);
    let settings = Settings::default();
    TrainingViews::new(gaussians, views, &scene.classes, settings, config, device)
}

/// A scene folder of the plates: photos, exact labels, raw labels with one object swapped in one view, a PLY file.
pub fn scene(dir: &Path) -> PathBuf {
    let (gaussians, labels) = plates();
    let mut frames = Vec::new();
    for i in 0..VIEWS {
        let picture = render(&gaussians, &camera(i), &Settings::default(), [0.0; 3]).unwrap();
        let bytes = picture
            .rgb
            .iter()
            .map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8)
            .collect();
        let photo = image::RgbImage::from_raw(WIDTH as u32, HEIGHT as u32, bytes).unwrap();
        std::fs::create_dir_all(dir.join("images")).unwrap();
        photo.save(dir.join(format!("images/v{i}.png"))).unwrap();
        let projected =
            Projected::new(&gaussians.splats(), &camera(i), &Settings::default()).unwrap();
        let truth = hard_label_map(&projected, &labels, 0.5);
        truth.write(&dir.join(format!("labels/v{i}.png"))).unwrap();
        let swap = |id: &u16| if i == 1 && *id == 1 { 2 } else { *id };
        let raw = LabelMap {
            ids: truth.ids.iter().map(swap).collect(),
            ..truth
        };
        raw.write(&dir.join(format!("raw/v{i}.png"))).unwrap();
        frames.push(serde_json::json!({
            "file_path": format!("images/v{i}.png"),
            "label_path": format!("labels/v{i}.png"),
            "raw_label_path": format!("raw/v{i}.png"),
            "split": if i % 3 == 2 { "test" } else { "train" },
            "transform_matrix": (0..4).map(|r| pose(i).row(r).to_array()).collect::<Vec<_>>(),
        }));
    }
    let transforms = serde_json::json!({
        "fl_x": 80.0, "fl_y": 80.0, "cx": WIDTH as f64 / 2.0, "cy": HEIGHT as f64 / 2.0, "w": WIDTH, "h": HEIGHT,
        "frames": frames,
    });
    std::fs::write(dir.join("transforms.json"), transforms.to_string()).unwrap();
    Classes::from_names(0, [(1, "red"), (2, "green"), (3, "blue"), (4, "wall")])
        .write(&dir.join("classes.json"))
        .unwrap();
    let path = dir.join("plates.ply");
    ply::write(&path, &gaussians, DVec3::ZERO, Some(&labels)).unwrap();
    path
}

//! What point encoders are worth before any training: accuracy and mIoU of a linear map of their frozen features to true classes,
//! on rooms that no encoder was trained on and on scenes of points by true depth. `cargo bench --bench probe -- WEIGHTS...`.
//! Random weights of two seeds come beside the files. The environment variables `BACKEND` and `COSEG_SHARED` (`../shared`, the
//! folder of the scenes; without it only rooms are scored) change the run.

mod linear;
#[path = "../../examples/pretrain_encoder/rooms.rs"]
mod rooms;

use coseg::backend::device;
use coseg::segmentation::encoder::random_weights;
use coseg::segmentation::pixels::NO_CLASS;
use coseg::segmentation::randla::RandlaEncoder;
use coseg::weights::WeightFile;
use linear::linear_probe;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rooms::{LabelledCloud, room};
use std::path::{Path, PathBuf};

/// Points of each room.
const ROOM_POINTS: usize = 40_000;
/// Points of each scene.
const SCENE_POINTS: usize = 60_000;
const SCENES: [&str; 3] = ["house_living", "house_kitchen", "studio"];

/// What encoders are compared on.
struct Task {
    name: String,
    fitted: Vec<LabelledCloud>,
    scored: Vec<LabelledCloud>,
}

fn main() -> coseg::Result<()> {
    let name = std::env::var("BACKEND").ok();
    let device = device::open(name.and_then(|name| name.parse().ok()))?;
    let mut weights = vec![
        ("random, seed 0".to_owned(), random_weights(3, 0)),
        ("random, seed 1".to_owned(), random_weights(3, 1)),
    ];
    for file in std::env::args()
        .skip(1)
        .filter(|argument| argument != "--bench")
    {
        let read = WeightFile::open(PathBuf::from(&file))?;
        weights.push((file, read));
    }
    let encoders: Vec<(String, RandlaEncoder)> = weights
        .iter()
        .map(|(name, weights)| Ok((name.clone(), RandlaEncoder::load(weights, &device)?)))
        .collect::<coseg::Result<_>>()?;
    for task in tasks() {
        let labels = task.fitted.iter().flat_map(|cloud| &cloud.labels);
        let known = labels.filter(|&&label| label != NO_CLASS);
        let classes = known.max().map_or(0, |&label| usize::from(label) + 1);
        for (name, encoder) in &encoders {
            let scores = linear_probe(encoder, &task.fitted, &task.scored, classes, 0, &device)?;
            println!(
                "{} | {name} | accuracy {:.3} | mIoU {:.3}",
                task.name, scores.accuracy, scores.miou
            );
        }
    }
    Ok(())
}

fn tasks() -> Vec<Task> {
    let mut fitted: Vec<LabelledCloud> = (0..12).map(|i| room(0, 2_000 + i, ROOM_POINTS)).collect();
    let scored = fitted.split_off(8);
    let mut tasks = vec![Task {
        name: "rooms never trained on: 8 to fit, 4 to score".to_owned(),
        fitted,
        scored,
    }];
    let shared = std::env::var_os("COSEG_SHARED").map_or_else(|| "../shared".into(), PathBuf::from);
    for scene in SCENES {
        let dir = shared.join("data").join(scene);
        if dir.is_dir() {
            let [fitted, scored] = split_in_space(&scene_points(&dir));
            tasks.push(Task {
                name: format!("{scene}: half of its columns to fit, half to score"),
                fitted: vec![fitted],
                scored: vec![scored],
            });
        }
    }
    tasks
}

/// Points of a labelled scene's training views by true depth, with 1 cm of noise, and their true labels.
fn scene_points(dir: &Path) -> LabelledCloud {
    let text = std::fs::read_to_string(dir.join("transforms.json")).expect("transforms.json");
    let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let number = |v: &serde_json::Value| v.as_f64().expect("a number");
    let [fx, fy, cx, cy] = ["fl_x", "fl_y", "cx", "cy"].map(|key| number(&json[key]));
    let frames: Vec<_> = json["frames"]
        .as_array()
        .expect("frames")
        .iter()
        .filter(|f| f["split"] == "train")
        .collect();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut cloud = LabelledCloud::default();
    for frame in &frames {
        let open = |key: &str| image::open(dir.join(frame[key].as_str().expect(key))).expect(key);
        let (depth, labels) = (
            open("depth_path").into_luma16(),
            open("label_path").into_luma8(),
        );
        for _ in 0..SCENE_POINTS / frames.len() {
            let (x, y) = (
                rng.random_range(0..depth.width()),
                rng.random_range(0..depth.height()),
            );
            let z = f64::from(depth.get_pixel(x, y).0[0]) / 1000.0;
            if z == 0.0 {
                continue;
            }
            let camera = [
                (f64::from(x) + 0.5 - cx) / fx * z,
                -(f64::from(y) + 0.5 - cy) / fy * z,
                -z,
                1.0,
            ];
            let row = |r: usize| {
                (0..4)
                    .map(|c| number(&frame["transform_matrix"][r][c]) * camera[c])
                    .sum::<f64>()
            };
            cloud.positions.push(std::array::from_fn(|r| {
                row(r) as f32 + rng.random_range(-0.017f32..0.017)
            }));
            cloud.labels.push(match labels.get_pixel(x, y).0[0] {
                0 => NO_CLASS,
                id => u16::from(id) - 1,
            });
        }
    }
    cloud
}

/// The cloud twice: labels of random half-metre columns of space, and of the others.
fn split_in_space(cloud: &LabelledCloud) -> [LabelledCloud; 2] {
    let part = |half: u64| {
        let masked = cloud
            .positions
            .iter()
            .zip(&cloud.labels)
            .map(|(p, &label)| {
                let [x, y] = [p[0], p[1]].map(|v| (v * 2.0).floor() as i64 as u64);
                let cell = (x.wrapping_mul(0x9e37_79b9) ^ y.wrapping_mul(0x85eb_ca6b))
                    .wrapping_mul(0x2545_f491_4f6c_dd1d);
                if (cell >> 40) & 1 == half {
                    label
                } else {
                    NO_CLASS
                }
            });
        LabelledCloud {
            positions: cloud.positions.clone(),
            labels: masked.collect(),
        }
    };
    [part(0), part(1)]
}

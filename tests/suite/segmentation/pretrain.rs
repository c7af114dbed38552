//! Pretraining on procedural rooms: it learns, it repeats, and what it stores is what it trained.

use crate::support::point_probe::linear_probe;
use crate::support::pretraining::{LabelledCloud, PretrainOptions, TrainedEncoder, pretrain, room};
use coseg::segmentation::encoder::random_weights;
use coseg::segmentation::pixels::UNLABELLED;
use coseg::segmentation::randla::RandlaEncoder;
use coseg::weights::WeightFile;
use coseg::{Error, Result};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;

fn run(options: &PretrainOptions) -> Result<TrainedEncoder> {
    pretrain(options, &crate::support::device(), &mut |_, _| ())
}

fn small() -> PretrainOptions {
    let points = [600, 1_200];
    PretrainOptions {
        rooms: 2,
        held_out: 1,
        room_points: 1_500,
        points,
        steps: 24,
        ..PretrainOptions::default()
    }
}

#[test]
fn the_loss_falls_and_the_stored_file_is_what_was_trained() {
    let trained = run(&small()).expect("finite");
    let (first, last) = (trained.curve[0], trained.curve[trained.curve.len() - 1]);
    assert!(last < 0.9 * first, "{:?}", trained.curve);
    assert!(
        trained.held_out.accuracy > 0.1 && trained.held_out.accuracy <= 1.0,
        "{:?}",
        trained.held_out
    );
    let bytes = trained.weights.to_safetensors().expect("whole tensors");
    let read =
        WeightFile::from_safetensors(&bytes, "pretrained RandLA weights").expect("just written");
    assert_eq!(read, trained.weights);
    assert!(
        read.metadata["options"].contains("seed: 0") && read.metadata.contains_key("held_out_miou")
    );
}

#[test]
fn same_seed_same_bits_at_one_and_two_threads() {
    let options = PretrainOptions {
        steps: 3,
        ..small()
    };
    let weights = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        pool.install(|| run(&options)).expect("finite").weights
    };
    let one = weights(1);
    assert_eq!(one, weights(2));
    let other = run(&PretrainOptions {
        seed: 1,
        ..options.clone()
    })
    .expect("finite")
    .weights;
    assert_ne!(one.tensors, other.tensors);
}

#[test]
fn impossible_sizes_are_refused() {
    for options in [
        PretrainOptions {
            rooms: 0,
            ..small()
        },
        PretrainOptions {
            steps: 0,
            ..small()
        },
        PretrainOptions {
            points: [2_000, 1_000],
            ..small()
        },
        PretrainOptions {
            points: [100, 2_000],
            ..small()
        },
    ] {
        assert!(
            matches!(run(&options), Err(Error::Argument { .. })),
            "{options:?}"
        );
    }
}

fn shipped() -> WeightFile {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/randla_builtin.safetensors");
    WeightFile::open(file).expect("weights")
}

#[test]
fn the_notes_of_the_weights_inside_the_crate_name_todays_options() {
    let notes = shipped().metadata;
    assert_eq!(
        notes["options"],
        format!("{:?}", PretrainOptions::default())
    );
    assert_eq!(notes["command"], "coseg pretrain --seed 0");
}

#[test]
#[ignore = "minutes: pretrains in full"]
fn the_weights_inside_the_crate_are_what_pretraining_gives() {
    let (notes, made) = (
        shipped().metadata,
        run(&PretrainOptions::default()).expect("finite"),
    );
    // Processors that round differently drift apart over the steps.
    for (note, found) in [
        ("held_out_accuracy", made.held_out.accuracy),
        ("held_out_miou", made.held_out.miou),
    ] {
        let stored: f64 = notes[note].parse().expect("a number");
        assert!(
            (stored - found).abs() < 0.03,
            "{note}: {stored} stored, {found} found"
        );
    }
}

/// Points of a labelled scene's training views by true depth, with 1 cm of noise, and their true labels.
fn scene_points(dir: &Path, count: usize) -> LabelledCloud {
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
        for _ in 0..count / frames.len() {
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
                0 => UNLABELLED,
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
                    UNLABELLED
                }
            });
        LabelledCloud {
            positions: cloud.positions.clone(),
            labels: masked.collect(),
        }
    };
    [part(0), part(1)]
}

/// `cargo test --release -- --ignored probe_table --nocapture` prints the figures quoted in `assets/README.md`.
#[test]
#[ignore = "minutes; prints a table"]
fn probe_table() {
    let device = crate::support::device();
    let shared = crate::support::shared_dir();
    let mut encoders = Vec::new();
    let mut add = |name: &str, weights: WeightFile| {
        encoders.push((
            name.to_owned(),
            RandlaEncoder::load(&weights, &device).expect("RandLA weights"),
        ));
    };
    if let Some(file) = std::env::var_os("COSEG_PROBE_WEIGHTS") {
        add("file", WeightFile::open(file).expect("weights"));
    }
    (0..2).for_each(|seed| add(&format!("random, seed {seed}"), random_weights(3, seed)));
    if let Some(dir) = &shared {
        let file = dir.join("weights/randlanet/randlanet_semantickitti.safetensors");
        add("SemanticKITTI", WeightFile::open(file).expect("weights"));
    }
    let rooms: Vec<LabelledCloud> = (0..12).map(|i| room(0, 2_000 + i, 40_000)).collect();
    let mut scenes = vec![(
        "rooms never trained on: 8 to fit, 4 to score".to_owned(),
        rooms[..8].to_vec(),
        rooms[8..].to_vec(),
    )];
    for name in ["house_living", "house_kitchen", "studio"] {
        if let Some(dir) = &shared {
            let [fitted, scored] =
                split_in_space(&scene_points(&dir.join("data").join(name), 60_000));
            scenes.push((
                format!("{name}: half of its columns to fit, half to score"),
                vec![fitted],
                vec![scored],
            ));
        }
    }
    for (scene, fitted, scored) in &scenes {
        let classes = fitted
            .iter()
            .flat_map(|c| &c.labels)
            .filter(|&&l| l != UNLABELLED)
            .max()
            .map_or(0, |&l| l + 1);
        for (name, encoder) in &encoders {
            let scores =
                linear_probe(encoder, fitted, scored, classes.into(), 0, &device).expect("finite");
            eprintln!(
                "{scene} | {name} | accuracy {:.3} | mIoU {:.3}",
                scores.accuracy, scores.miou
            );
        }
    }
}

//! Every reader of files on thousands of damaged ones: a result or an error, no panic, and an end. Those of a scene and of a run.

use crate::support::colmap::{self, pinhole};
use crate::support::damage::Damage;
use crate::support::glb::glb;
use crate::support::onnx::Onnx;
use crate::support::pictures::picture;
use crate::support::spz::version_4;
use crate::support::{plates, small_scene, torch_file};
use coseg::checkpoint::Checkpoint;
use coseg::compare::Plan;
use coseg::config::Config;
use coseg::data::{
    self, Classes, LabelMap, LoadOptions, Points, ScoreGrid, ScoreMap, read_cameras,
};
use coseg::objects::Identities;
use coseg::segmenter::{ClassFile, Contract, Network};
use coseg::splat::formats::glb::with_labels;
use coseg::splat::formats::{self, Format};
use coseg::splat::ply;
use coseg::weights::WeightFile;
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use glam::DVec3;
use serde_json::{Map, json};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};
use std::{fs, process, thread};

/// Mutations of each file.
const MUTATIONS: usize = 2_000;
/// The longest time that reading one may take.
const LONGEST: Duration = Duration::from_secs(10);
/// When the process ends: a test cannot end a read that hangs.
const HANGS: Duration = Duration::from_secs(60);

/// Reads mutations of the file. With COSEG_CORPUS in the environment, a copy of it goes to a folder there by its extension, for `fuzz/`.
pub fn survives<T>(path: &Path, read: impl Fn(&Path) -> T) {
    let whole = fs::read(path).expect("a file of the corpus");
    if let Some(corpus) = std::env::var_os("COSEG_CORPUS") {
        let folder = Path::new(&corpus).join(path.extension().unwrap_or_default());
        fs::create_dir_all(&folder).expect("a folder");
        let name = format!("{:x}", Sha256::digest(&whole));
        fs::write(folder.join(name), &whole).expect("a copy");
    }
    let mut damage = Damage::new(3);
    let begun = watchdog(path);
    for number in 0..MUTATIONS {
        fs::write(path, damage.mutated(&whole)).expect("write");
        begun.send(number).expect("a watchdog");
        let start = Instant::now();
        let read = catch_unwind(AssertUnwindSafe(|| drop(read(path))));
        let (place, took) = (path.display(), start.elapsed());
        assert!(read.is_ok(), "{place}: mutation {number}");
        assert!(took < LONGEST, "{place}: mutation {number} took {took:?}");
    }
    fs::write(path, whole).expect("write");
}

/// Takes the numbers of mutations as their reads begin, and ends the process where the next one does not come.
fn watchdog(path: &Path) -> Sender<usize> {
    let (sender, begun) = mpsc::channel();
    let path = path.to_owned();
    thread::spawn(move || {
        let mut current = 0;
        loop {
            match begun.recv_timeout(HANGS) {
                Ok(number) => current = number,
                Err(RecvTimeoutError::Disconnected) => return,
                Err(RecvTimeoutError::Timeout) => break,
            }
        }
        // A test would keep the text of `eprintln` to itself.
        let hangs = format!("{}: mutation {current} hangs\n", path.display());
        let _ = io::stderr().write_all(hangs.as_bytes());
        process::abort();
    });
    sender
}

#[test]
fn scenes_with_transforms() {
    let dir = small_scene::scene();
    let at = |name: &str| dir.path().join(name);
    let options = LoadOptions::default();
    data::load(dir.path(), &options).expect("a scene");
    survives(&at("transforms.json"), |_| data::load(dir.path(), &options));
    survives(&at("transforms.json"), |file| read_cameras(file, None));
    survives(&at("classes.json"), Classes::read);
    survives(&at("images/v1.png"), |_| data::check(dir.path(), &options));
    survives(&at("labels/v1.png"), LabelMap::read);
    survives(&at("points.ply"), |file| Points::read(file, DVec3::ZERO));
    let photo = at("images/v1.jpg");
    picture(16, 12, 1).save(&photo).expect("JPEG");
    small_scene::edit(&dir, |v| {
        v["frames"][1]["file_path"] = json!("images/v1.jpg")
    });
    survives(&photo, |_| data::load(dir.path(), &options));
}

#[test]
fn scenes_of_colmap() {
    for (write, form) in [
        (colmap::binary as fn(&Path, &_), "bin"),
        (colmap::text, "txt"),
    ] {
        let dir = colmap::scene(write, &pinhole());
        let options = LoadOptions::default();
        data::load(dir.path(), &options).expect("a scene");
        for part in ["cameras", "images"] {
            let file = dir.path().join(format!("sparse/0/{part}.{form}"));
            survives(&file, |_| data::load_cameras(dir.path(), &options, None));
        }
        let points = dir.path().join(format!("sparse/0/points3D.{form}"));
        survives(&points, |_| data::load(dir.path(), &options));
    }
}

#[test]
fn drawn_labels() {
    let dir = small_scene::scene();
    let square = json!([[2.0, 2.0], [9.0, 2.0], [9.0, 8.0], [2.0, 8.0]]);
    let shape = json!({ "label": "wall", "points": square, "shape_type": "polygon" });
    let drawn = json!({ "version": "5.5.0", "shapes": [shape], "imagePath": "v1.png", "imageHeight": 12, "imageWidth": 16 });
    let coco = json!({
        "categories": [{ "id": 1, "name": "wall" }],
        "images": [{ "id": 11, "file_name": "v1.png", "width": 16, "height": 12 }],
        "annotations": [
            { "id": 1, "image_id": 11, "category_id": 1, "segmentation": [[2, 2, 9, 2, 9, 8, 2, 8]] },
            { "id": 2, "image_id": 11, "category_id": 1, "segmentation": { "size": [12, 16], "counts": [30, 12, 150] } },
            { "id": 3, "image_id": 11, "category_id": 1, "segmentation": [], "bbox": [1, 2, 3, 4] },
        ],
    });
    // The same runs, as pycocotools packs them.
    let mut packed = coco.clone();
    packed["annotations"] = json!([
        { "id": 2, "image_id": 11, "category_id": 1, "segmentation": { "size": [12, 16], "counts": "n0<f4" } },
    ]);
    let cvat = "<annotations><image id=\"0\" name=\"v1.png\" width=\"16\" height=\"12\">\
        <polygon label=\"wall\" points=\"2.00,2.00;9.00,2.00;9.00,8.00\" z_order=\"1\"/>\
        <box label=\"wall\" xtl=\"1\" ytl=\"1\" xbr=\"5\" ybr=\"4\" rotation=\"30\" group_id=\"2\"/>\
        <ellipse label=\"wall\" cx=\"8\" cy=\"6\" rx=\"3\" ry=\"2\"/>\
        <mask label=\"wall\" rle=\"1, 3, 2\" left=\"5\" top=\"5\" width=\"3\" height=\"2\"/></image></annotations>";
    fs::create_dir(dir.path().join("drawn")).expect("folder");
    for (raw, file, content) in [
        ("drawn", "drawn/v1.json", drawn.to_string()),
        ("coco.json", "coco.json", coco.to_string()),
        ("coco.json", "coco.json", packed.to_string()),
        ("annotations.xml", "annotations.xml", cvat.to_owned()),
    ] {
        let file = dir.path().join(file);
        fs::write(&file, content).expect("write");
        let options = LoadOptions {
            raw_labels: Some(raw.to_owned()),
            ..LoadOptions::default()
        };
        data::load(dir.path(), &options).expect("a scene");
        survives(&file, |_| data::load(dir.path(), &options));
    }
}

#[test]
fn gaussians_and_files_of_a_run() {
    let dir = tempfile::tempdir().expect("folder");
    let at = |name: &str| dir.path().join(name);
    let (gaussians, labels) = plates::plates();
    let rows: Vec<u32> = (0..8).collect();
    ply::write(
        &at("scene.ply"),
        &gaussians.select(&rows),
        DVec3::ZERO,
        Some(&labels[..8]),
    )
    .expect("write");
    survives(&at("scene.ply"), ply::read);
    let identities = Identities {
        scores: vec![0.5; 24],
        classes: 3,
    };
    identities
        .write(&at("identities.safetensors"))
        .expect("write");
    survives(&at("identities.safetensors"), Identities::read);
    let mut checkpoint = Checkpoint::new("building");
    checkpoint
        .put("means", &[2, 3], vec![1.0_f32; 6])
        .expect("fits");
    checkpoint.save(&at("building.safetensors")).expect("write");
    survives(&at("building.safetensors"), |file| {
        Checkpoint::load(file, "building")
    });
}

#[test]
fn gaussians_in_other_formats() {
    let dir = tempfile::tempdir().expect("folder");
    let at = |name: &str| dir.path().join(name);
    let read = |file: &Path| formats::read(file).map(|scene| scene.labels);
    let (gaussians, labels) = plates::plates();
    let gaussians = gaussians.with_sh_degree(1);
    for (name, format) in [("a.spz", Format::Spz), ("a.ply", Format::CompressedPly)] {
        formats::write(&at(name), format, &gaussians, DVec3::ZERO, Some(&labels)).expect("write");
        let beside = at(&format!("{name}.labels.json"));
        survives(&beside, |_| read(&at(name)));
        fs::remove_file(beside).expect("removed");
        assert_eq!(read(&at(name)).expect("a scene"), None);
        survives(&at(name), read);
    }
    // The checksum of gzip hides most changes, so the content is changed as well.
    let mut content = Vec::new();
    let packed = fs::read(at("a.spz")).expect("read");
    GzDecoder::new(&packed[..])
        .read_to_end(&mut content)
        .expect("gzip");
    fs::write(at("c.spz"), version_4(&content)).expect("write");
    read(&at("c.spz")).expect("a scene");
    survives(&at("c.spz"), read);
    fs::write(at("content"), content).expect("write");
    survives(&at("content"), |file| {
        let mut packed = GzEncoder::new(Vec::new(), Compression::none());
        packed
            .write_all(&fs::read(file).expect("read"))
            .expect("gzip");
        fs::write(at("b.spz"), packed.finish().expect("gzip")).expect("write");
        read(&at("b.spz"))
    });
    fs::write(at("a.splat"), [90; 320]).expect("write");
    read(&at("a.splat")).expect("a scene");
    survives(&at("a.splat"), read);
}

#[test]
fn gaussians_of_gltf_that_get_labels() {
    let dir = tempfile::tempdir().expect("folder");
    let file = dir.path().join("a.glb");
    let (gaussians, labels) = plates::plates();
    let rows: Vec<u32> = (0..8).collect();
    let gaussians = gaussians.select(&rows);
    let origin = DVec3::new(0.25, -7.0, 3.0);
    fs::write(&file, glb(&gaussians, origin)).expect("write");
    let read = |file: &Path| {
        let bytes = fs::read(file).expect("read");
        let names = Map::from_iter([("1".to_owned(), json!("red"))]);
        with_labels(file, &bytes, (&gaussians, origin), &labels[..8], names)
    };
    read(&file).expect("labelled");
    survives(&file, read);
}

#[test]
fn settings_and_plans() {
    let dir = tempfile::tempdir().expect("folder");
    let at = |name: &str| dir.path().join(name);
    fs::write(
        at("config.toml"),
        Config::default().to_toml().expect("TOML"),
    )
    .expect("write");
    survives(&at("config.toml"), |file| Config::load(Some(file), &[]));
    let plan = "title = \"t\"\nscenes = [\"builtin\"]\nseeds = 2\n[settings]\nsegmentation.lr = 6e-3\n[[labels]]\nname = \"raw\"\n\
        [[rows]]\nname = \"vote\"\nvariant = \"vote\"\n";
    fs::write(at("plan.toml"), plan).expect("write");
    Plan::read(&at("plan.toml"), None).expect("a plan");
    survives(&at("plan.toml"), |file| Plan::read(file, None));
    fs::write(at("net.toml"), Onnx::contract(16, 12)).expect("write");
    survives(&at("net.toml"), Contract::read);
    fs::write(at("classes.toml"), "[classes]\nwall = [\"plaster\"]\n").expect("write");
    survives(&at("classes.toml"), ClassFile::read);
}

#[test]
fn networks_and_what_they_write() {
    let dir = tempfile::tempdir().expect("folder");
    let at = |name: &str| dir.path().join(name);
    let net = Onnx::write_sound(dir.path(), 16, 12);
    let contract = Contract::read(&at("net.toml")).expect("a contract");
    survives(&net, |file| Network::load(file, contract.clone()));
    let tensors = BTreeMap::from([("conv.weight".to_owned(), (vec![2, 3], vec![0.5; 6]))]);
    fs::write(
        at("net.pth"),
        torch_file::bytes(&torch_file::state_dict(&tensors, "")),
    )
    .expect("write");
    WeightFile::open(at("net.pth")).expect("weights");
    survives(&at("net.pth"), |file| WeightFile::open(file));
    let scores = ScoreMap {
        grid: ScoreGrid {
            photo: [12, 8],
            scale: [0.25; 2],
            offset: [-0.5; 2],
        },
        width: 3,
        height: 2,
        classes: 2,
        id_limit: 10,
        ids: vec![1, 1, 2, 3, 9, 4, 5, 0, 1, 0, 3, 0],
        probabilities: vec![200, 255, 128, 130, 100, 99, 55, 0, 127, 0, 80, 0],
    };
    scores.write(&at("a.scores")).expect("write");
    survives(&at("a.scores"), ScoreMap::read);
}

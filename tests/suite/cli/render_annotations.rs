//! `coseg render --annotations`: the photos that its files name and copy.

use crate::support::exif_photo::photo;
use crate::support::plates::{HEIGHT, WIDTH, scene};
use crate::support::program::{cpu_backend, fails, listed, read_json, succeeds, text, utf8};
use crate::support::skip_without_program;
use coseg::data::formats::transforms::write_cameras;
use coseg::data::read_cameras;
use image::metadata::Orientation;
use image::{ImageDecoder, ImageReader};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The scene of the plates whose photo v5 is a JPEG.
fn scene_with_jpeg(folder: &Path) {
    scene(folder);
    let photo = |name: &str| folder.join("images").join(name);
    let picture = image::open(photo("v5.png")).unwrap();
    picture.save(photo("v5.jpg")).unwrap();
    fs::remove_file(photo("v5.png")).unwrap();
    let cameras = folder.join("transforms.json");
    let text = fs::read_to_string(&cameras).unwrap();
    assert!(text.contains("images/v5.png"));
    fs::write(&cameras, text.replace("images/v5.png", "images/v5.jpg")).unwrap();
}

/// Renders the scene with annotations, and returns what the command says.
fn annotate(scene: &Path, out: &Path, more: &[&str]) -> String {
    let arguments = [
        "render",
        "--scene",
        utf8(scene),
        "--out",
        utf8(out),
        "--labels",
    ];
    let cpu = cpu_backend();
    let all = ["--annotations", "coco,yolo", "--backend", &cpu];
    succeeds(&[&arguments[..], &all, more].concat())
}

fn coco_names(out: &Path) -> Vec<String> {
    let file = read_json(&out.join("instances.json"));
    let images = file["images"].as_array().unwrap().iter();
    images
        .map(|image| image["file_name"].as_str().unwrap().to_owned())
        .collect()
}

#[test]
fn annotations_have_the_photos_of_a_scene_folder() {
    let folder = tempfile::tempdir().unwrap();
    let room = room(folder.path());
    let out = folder.path().join("out");
    let said = annotate(&room.join("plates.ply"), &out, &["--cameras", utf8(&room)]);
    for part in ["instances.json: 6 photos", "images: 6 photos"] {
        assert!(said.contains(part), "{said}");
    }
    assert!(!said.contains("of frames whose photo"), "{said}");
    let photos = ["v0.png", "v1.png", "v2.png", "v3.png", "v4.png", "v5.jpg"];
    assert_eq!(coco_names(&out), photos);
    assert_eq!(listed(&out.join("images")), photos);
    for photo in photos {
        let [copy, original] =
            [&out, &room].map(|dir| fs::read(dir.join("images").join(photo)).unwrap());
        assert_eq!(copy, original, "{photo}");
    }
    let labels = listed(&out.join("labels"));
    assert_eq!(
        labels,
        ["v0.txt", "v1.txt", "v2.txt", "v3.txt", "v4.txt", "v5.txt"]
    );
    let text = |name: &str| fs::read_to_string(out.join(name)).unwrap();
    assert_eq!(text("val.txt"), "./images/v2.png\n./images/v5.jpg\n");
    assert_eq!(text("train.txt").lines().count(), 4);
    assert!(
        text("data.yaml").starts_with("train: train.txt\nval: val.txt\nnames:\n  0: \"red\"\n")
    );
    // The photos do not fit maps of other proportions.
    let square = folder.path().join("square");
    let more = [
        "--cameras",
        utf8(&room),
        "--size",
        "64,64",
        "--split",
        "test",
    ];
    let said = annotate(&room.join("plates.ply"), &square, &more);
    assert!(
        said.contains("images: 0 photos, and 2 rendered pictures"),
        "{said}"
    );
    assert!(
        said.contains("instances.json: 0 photos, and 2 names STEM.png"),
        "{said}"
    );
    assert_eq!(coco_names(&square), ["v2.png", "v5.png"]);
    let picture = image::open(square.join("images/v5.png")).unwrap();
    assert_eq!((picture.width(), picture.height()), (64, 64));
    let lists = fs::read_to_string(square.join("data.yaml")).unwrap();
    assert!(
        lists.starts_with("train: val.txt\nval: val.txt\n"),
        "{lists}"
    );
}

#[test]
fn annotations_have_the_photos_that_a_run_was_trained_on() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for name in ["room", "run"] {
        fs::create_dir(at(name)).unwrap();
    }
    scene_with_jpeg(&at("room"));
    fs::copy(at("room/plates.ply"), at("run/scene.ply")).unwrap();
    let cameras = read_cameras(&at("room"), None).unwrap();
    write_cameras(&at("run/cameras.json"), &cameras).unwrap();
    let test = ["--split", "test"];
    // Without settings, nothing says where the photos are.
    let said = annotate(&at("run"), &at("unknown"), &test);
    assert!(
        said.contains("images: 0 photos, and 2 rendered pictures"),
        "{said}"
    );
    assert_eq!(coco_names(&at("unknown")), ["v2.png", "v5.png"]);
    let rendered = [at("unknown/images/v5.png"), at("unknown/v5.rgb.png")];
    let [image, rgb] = rendered.map(|path| image::open(path).unwrap().into_rgb8());
    assert_eq!(image, rgb);

    let room = serde_json::Value::from(utf8(&at("room")));
    fs::write(at("run/config.toml"), format!("[data]\ndir = {room}\n")).unwrap();
    let said = annotate(&at("run"), &at("known"), &test);
    assert!(said.contains("images: 2 photos"), "{said}");
    assert_eq!(coco_names(&at("known")), ["v2.png", "v5.jpg"]);
    // Frames of a path are of no photos.
    let path = ["--path", "interpolate", "--frames", "2"];
    let said = annotate(&at("run"), &at("path"), &path);
    assert!(
        said.contains("images: 0 photos, and 2 rendered pictures"),
        "{said}"
    );
    assert_eq!(coco_names(&at("path")), ["path_0000.png", "path_0001.png"]);
}

/// A folder `room` with the scene whose photo v5 is a JPEG.
fn room(folder: &Path) -> PathBuf {
    let room = folder.join("room");
    fs::create_dir(&room).unwrap();
    scene_with_jpeg(&room);
    room
}

#[test]
fn photos_with_lens_distortion_are_not_those_of_the_maps() {
    let folder = tempfile::tempdir().unwrap();
    let room = room(folder.path());
    let out = folder.path().join("out");
    let cameras = room.join("transforms.json");
    let mut file = read_json(&cameras);
    file["k1"] = 0.05.into();
    fs::write(&cameras, file.to_string()).unwrap();
    let more = ["--cameras", utf8(&room), "--split", "test"];
    let said = annotate(&room.join("plates.ply"), &out, &more);
    for part in [
        "instances.json: 0 photos, and 2 names STEM.png of frames whose photo",
        "images: 0 photos, and 2 rendered pictures of frames whose photo",
    ] {
        assert!(said.contains(part), "{said}");
    }
    assert_eq!(coco_names(&out), ["v2.png", "v5.png"]);
    assert_eq!(listed(&out.join("images")), ["v2.png", "v5.png"]);
}

#[test]
fn photos_are_copied_without_orientation_and_not_turned() {
    let folder = tempfile::tempdir().unwrap();
    let room = room(folder.path());
    let out = folder.path().join("out");
    let original = room.join("images/v5.jpg");
    photo(&original, (WIDTH, HEIGHT), 6);
    let orientation = |path: &Path| {
        let mut decoder = ImageReader::open(path).unwrap().into_decoder().unwrap();
        decoder.orientation().unwrap()
    };
    assert_eq!(orientation(&original), Orientation::Rotate90);
    let more = ["--cameras", utf8(&room), "--split", "test"];
    annotate(&room.join("plates.ply"), &out, &more);
    let copy = out.join("images/v5.jpg");
    assert_eq!(orientation(&copy), Orientation::NoTransforms);
    let [copy, original] = [copy, original].map(|path| image::open(path).unwrap().into_rgb8());
    assert_eq!(copy, original);
}

#[test]
fn the_lists_of_both_splits_stay_in_a_folder() {
    let folder = tempfile::tempdir().unwrap();
    let room = room(folder.path());
    let out = folder.path().join("out");
    let plates = room.join("plates.ply");
    for split in ["train", "test"] {
        annotate(&plates, &out, &["--cameras", utf8(&room), "--split", split]);
    }
    let text = |name: &str| fs::read_to_string(out.join(name)).unwrap();
    assert_eq!(text("train.txt").lines().count(), 4);
    assert_eq!(text("val.txt"), "./images/v2.png\n./images/v5.jpg\n");
    assert!(text("data.yaml").starts_with("train: train.txt\nval: val.txt\n"));
}

#[test]
fn files_of_others_are_refused_before_rendering() {
    let folder = tempfile::tempdir().unwrap();
    let room = room(folder.path());
    for (format, name) in [("coco", "instances.json"), ("yolo", "val.txt")] {
        let out = folder.path().join(format);
        fs::create_dir(&out).unwrap();
        fs::write(out.join(name), "of somebody else").unwrap();
        let plates = room.join("plates.ply");
        let cpu = cpu_backend();
        let arguments = ["render", "--scene", utf8(&plates), "--cameras", utf8(&room)];
        let more = ["--out", utf8(&out), "--split", "train", "--labels"];
        let formats = ["--annotations", format, "--backend", &cpu];
        let message = fails(&[&arguments[..], &more, &formats].concat(), 1);
        assert!(message.contains(name), "{message}");
        assert_eq!(listed(&out), [name]);
    }
}

#[test]
fn pycocotools_and_the_convention_of_yolo_accept_annotations() {
    let python = std::env::var("COSEG_PYTHON").unwrap_or("python3".to_owned());
    let modules = "import numpy, PIL, yaml, pycocotools";
    let there = Command::new(&python).args(["-c", modules]).output();
    if !there.is_ok_and(|output| output.status.success()) {
        skip_without_program(&format!("{python} has no pycocotools and PyYAML"));
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let room = room(folder.path());
    let out = folder.path().join("out");
    annotate(&room.join("plates.ply"), &out, &["--cameras", utf8(&room)]);
    let check = || {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/scripts/check_annotations.py");
        let output = Command::new(&python).args([script, utf8(&out)]).output();
        let output = output.unwrap();
        let said = text(&[output.stdout, output.stderr].concat());
        (output.status.success(), said)
    };
    let (accepted, said) = check();
    assert!(accepted && said.contains("6 images"), "{said}");
    // A label of another class.
    let file = out.join("labels/v0.txt");
    let lines = fs::read_to_string(&file).unwrap();
    let (class, outline) = lines.split_once(' ').unwrap();
    let other = (class.parse::<usize>().unwrap() + 1) % 4;
    fs::write(&file, format!("{other} {outline}")).unwrap();
    let (accepted, said) = check();
    assert!(!accepted && said.contains("v0"), "{said}");
}

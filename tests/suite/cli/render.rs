//! `coseg render` and `coseg vote`: the files that they write.

use crate::support::plates::{HEIGHT, WIDTH, camera, plates, scene};
use crate::support::program::{cpu_backend, listed, read_json, read_npy, succeeds, utf8};
use coseg::data::formats::transforms::write_cameras;
use coseg::data::{Classes, Limits, read_cameras};
use coseg::raster::{Projected, Settings, render};
use coseg::splat::camera::Camera;
use coseg::splat::ply;
use glam::DVec3;
use std::fs;
use std::path::Path;

#[test]
fn render_writes_arrays_labels_and_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (scene(folder.path()), folder.path().join("out"));
    let cameras = folder.path().join("transforms.json");
    let render_args = [
        "render",
        "--scene",
        utf8(&scene),
        "--cameras",
        utf8(&cameras),
        "--out",
        utf8(&out),
    ];
    let more = [
        "--format",
        "npy",
        "--labels",
        "--split",
        "test",
        "--background",
        "1,0.5,0",
        "--alpha-max",
        "0.9",
    ];
    let cpu = cpu_backend();
    succeeds(&[&render_args[..], &more, &["--backend", &cpu]].concat());
    let files = listed(&out);
    let of_view = |view: &str| {
        ["alpha.npy", "label.png", "label_color.png", "rgb.npy"]
            .map(|kind| format!("{view}.{kind}"))
    };
    let expected = [of_view("v2"), of_view("v5")].concat();
    assert_eq!(files, expected);

    let read = ply::read(&scene, &Limits::default()).unwrap();
    let camera = Camera {
        center: camera(5).center - read.origin,
        ..camera(5)
    };
    let settings = Settings {
        alpha_max: 0.9,
        ..Settings::default()
    };
    let expected = render(&read.gaussians, &camera, &settings, [1.0, 0.5, 0.0]).unwrap();
    let (shape, rgb) = read_npy(&out.join("v5.rgb.npy"));
    assert_eq!(shape, [HEIGHT as u64, WIDTH as u64, 3]);
    assert_eq!(rgb, expected.rgb);
    let (shape, alpha) = read_npy(&out.join("v5.alpha.npy"));
    assert_eq!(shape, [HEIGHT as u64, WIDTH as u64]);
    assert!(
        alpha
            .iter()
            .zip(&expected.transmittance)
            .all(|(a, t)| *a == 1.0 - t)
    );

    let labels = image::open(out.join("v5.label.png")).unwrap().into_luma8();
    assert_eq!(
        (labels.width() as usize, labels.height() as usize),
        (WIDTH, HEIGHT)
    );
    let mut seen: Vec<u8> = labels.as_raw().clone();
    for (id, a) in seen.iter().zip(&alpha) {
        assert_eq!(
            *id == 0,
            *a < 0.5,
            "no label exactly where the scene covers less than half"
        );
    }
    seen.sort_unstable();
    seen.dedup();
    assert!([1, 2, 3, 4].iter().all(|id| seen.contains(id)), "{seen:?}");
    #[cfg(feature = "wgpu")]
    if crate::support::gpu().is_some() {
        succeeds(&[&render_args[..], &more, &["--backend", "wgpu"]].concat());
        let (_, on_gpu) = read_npy(&out.join("v5.rgb.npy"));
        let differ = on_gpu
            .iter()
            .zip(&rgb)
            .filter(|(a, b)| (*a - *b).abs() > 1e-4)
            .count();
        assert!(
            on_gpu.len() == rgb.len() && differ * 1000 < rgb.len(),
            "{differ} of {}",
            rgb.len()
        );
        assert_eq!(
            image::open(out.join("v5.label.png")).unwrap().into_luma8(),
            labels
        );
    }

    succeeds(&[&render_args[..], &["--split", "train"]].concat());
    let picture = image::open(out.join("v0.rgb.png")).unwrap().into_rgb8();
    let photo = image::open(folder.path().join("images/v0.png"))
        .unwrap()
        .into_rgb8();
    let largest = picture
        .iter()
        .zip(photo.iter())
        .map(|(a, b)| a.abs_diff(*b))
        .max()
        .unwrap();
    assert!(
        largest <= 1,
        "a render of the scene that made the photo differs by {largest}"
    );
    assert!(out.join("v0.alpha.png").is_file() && !out.join("v0.label.png").exists());
}

#[test]
fn vote_outvotes_wrong_views() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (scene(folder.path()), folder.path().join("voted"));
    // Without the label column: labels come from the raw maps alone.
    let (gaussians, truth) = plates();
    ply::write(&scene, &gaussians, DVec3::ZERO, None).unwrap();
    let said = succeeds(&[
        "vote",
        "--scene",
        utf8(&scene),
        "--data",
        utf8(folder.path()),
        "--out",
        utf8(&out),
    ]);
    assert!(
        said.contains("mIoU") && said.contains("2 held-out views"),
        "{said}"
    );
    let voted = ply::read(&out.join("scene.ply"), &Limits::default()).unwrap();
    // Red is called green in one training view of four. The outermost Gaussians of a plate reach over its border.
    let labels = voted.labels.unwrap();
    let right = labels.iter().zip(&truth).filter(|(a, b)| a == b).count();
    assert!(
        right * 10 >= truth.len() * 9,
        "{right} of {}: {labels:?}",
        truth.len()
    );
    for middle in [12, 37, 62] {
        assert_eq!(labels[middle], truth[middle]);
    }
    assert_eq!(Classes::read(&out.join("classes.json")).unwrap().len(), 4);
}

#[test]
fn annotations_and_depth_are_those_of_the_views() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let render = |out: &str, more: &[&str]| {
        let out = folder.path().join(out);
        let arguments = [
            "render",
            "--scene",
            utf8(&scene),
            "--cameras",
            utf8(folder.path()),
            "--split",
            "test",
            "--out",
            utf8(&out),
        ];
        succeeds(
            &[
                &arguments[..],
                &[
                    "--labels",
                    "--depth",
                    "--normals",
                    "--backend",
                    &cpu_backend(),
                ],
                more,
            ]
            .concat(),
        );
        out
    };
    let out = render("out", &["--annotations", "coco,yolo,index"]);
    let names = listed(&out);
    for name in [
        "instances.json",
        "data.yaml",
        "val.txt",
        "images",
        "labels",
        "v5.index.png",
        "v5.depth.png",
        "v5.normal.png",
    ] {
        assert!(names.iter().any(|file| file == name), "{name}: {names:?}");
    }
    let grey = image::open(out.join("v5.label.png")).unwrap().into_luma8();
    let file = read_json(&out.join("instances.json"));
    let images: Vec<_> = file["images"]
        .as_array()
        .unwrap()
        .iter()
        .map(|image| &image["file_name"])
        .collect();
    assert_eq!(images, ["v2.png", "v5.png"]);
    let classes = Classes::read(&folder.path().join("classes.json")).unwrap();
    for annotation in file["annotations"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|a| a["image_id"] == 2)
    {
        let id = annotation["label"].as_u64().unwrap();
        assert_eq!(annotation["category_id"], id);
        assert_eq!(
            annotation["area"],
            grey.iter().filter(|v| u64::from(**v) == id).count()
        );
    }
    let indexed = image::open(out.join("v5.index.png")).unwrap().into_rgb8();
    for (color, id) in indexed.pixels().zip(grey.iter()) {
        assert_eq!(color.0, classes.legend_color((*id).into()));
    }
    let arrays = render("arrays", &["--format", "npy"]);
    let (shape, depth) = read_npy(&arrays.join("v5.depth.npy"));
    assert_eq!(shape, [HEIGHT as u64, WIDTH as u64]);
    let (shape, normals) = read_npy(&arrays.join("v5.normal.npy"));
    assert_eq!(shape, [HEIGHT as u64, WIDTH as u64, 3]);
    let colors = image::open(out.join("v5.normal.png")).unwrap().into_rgb8();
    for (color, n) in colors.iter().zip(&normals) {
        assert!((f32::from(*color) - 127.5 * (n + 1.0)).abs() < 0.51);
    }
    let millimetres = image::open(out.join("v5.depth.png")).unwrap().into_luma16();
    let (gaussians, camera) = (plates().0, camera(5));
    let of_center = |mean: &[f32; 3]| {
        let offset = DVec3::from(mean.map(f64::from)) - camera.center;
        (camera.rotation * offset).z as f32
    };
    let depths: Vec<f32> = gaussians.means.iter().map(of_center).collect();
    let projected = Projected::new(&gaussians.splats(), &camera, &Settings::default()).unwrap();
    let blended = projected.blend(&depths, 1);
    let expected = blended.image.iter().zip(&blended.transmittance);
    for (i, (sum, t)) in expected.enumerate() {
        assert_eq!((1000.0 * depth[i]).round() as u16, millimetres.as_raw()[i]);
        assert_eq!(grey.as_raw()[i] == 0, depth[i] == 0.0);
        assert!(
            depth[i] == 0.0 || (depth[i] - sum / (1.0 - t)).abs() < 1e-4,
            "pixel {i}"
        );
    }
}

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
    let (room, out) = (folder.path().join("room"), folder.path().join("out"));
    fs::create_dir(&room).unwrap();
    scene_with_jpeg(&room);
    let said = annotate(&room.join("plates.ply"), &out, &["--cameras", utf8(&room)]);
    assert!(
        said.contains("images: 6 photos") && !said.contains("rendered"),
        "{said}"
    );
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
    assert_eq!(coco_names(&square), ["v2.png", "v5.jpg"]);
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

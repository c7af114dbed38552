//! `transforms.json` scenes: the real ones, and one small one in many broken forms.

use coseg::data::formats::transforms::{LoadOptions, load, load_cameras};
use coseg::data::{LabelMap, Limits, Split};
use coseg::splat::camera::Camera;
use glam::DVec3;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

const WIDTH: u32 = 16;
const HEIGHT: u32 = 12;

/// A camera at x = `i`, y = 2, z = 10^6, looking along -z with up +y.
fn pose(i: usize) -> Value {
    json!([
        [1, 0, 0, i as f64],
        [0, 1, 0, 2],
        [0, 0, 1, 1e6],
        [0, 0, 0, 1]
    ])
}

fn manifest() -> Value {
    let frame = |i: usize| {
        json!({
            "file_path": format!("images/v{i}.png"), "label_path": format!("labels/v{i}.png"),
            "raw_label_path": format!("labels_raw/v{i}.png"), "split": if i == 0 { "test" } else { "train" },
            "transform_matrix": pose(i),
        })
    };
    json!({
        "fl_x": 20.0, "fl_y": 21.0, "cx": 8.5, "cy": 6.25, "w": WIDTH, "h": HEIGHT, "k1": 0, "k2": 0.0,
        "camera_model": "OPENCV", "ply_file_path": "points.ply", "frames": [frame(0), frame(1), frame(2)],
    })
}

/// The small scene: three photos with labels, classes 1, 2 and 300, two points.
fn scene() -> TempDir {
    let dir = tempfile::tempdir().expect("folder");
    let at = |p: String| dir.path().join(p);
    fs::create_dir(at("images".into())).expect("folder");
    for i in 0..3_u8 {
        let photo = image::RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
            image::Rgb([x as u8 * 9, y as u8 * 7, i])
        });
        photo.save(at(format!("images/v{i}.png"))).expect("photo");
        let ids: Vec<u16> = (0..WIDTH * HEIGHT)
            .map(|k| [0, 1, 2, 300][k as usize % 4])
            .collect();
        let map = LabelMap {
            width: WIDTH as usize,
            height: HEIGHT as usize,
            ids,
        };
        for folder in ["labels", "labels_raw", "labels_raw_corr"] {
            map.write(&at(format!("{folder}/v{i}.png")))
                .expect("labels");
        }
    }
    write(
        dir.path(),
        "classes.json",
        r#"{"0": "void", "300": "lamp", "1": "wall", "2": "floor"}"#,
    );
    let points = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\n\
        property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n\
        1 2 1000000.5 255 0 51\n2.5 2 1000000 0 0 0\n";
    write(dir.path(), "points.ply", points);
    write(dir.path(), "transforms.json", &manifest().to_string());
    dir
}

fn write(dir: &Path, name: &str, text: &str) {
    fs::write(dir.join(name), text).expect("write");
}

/// Changes the small scene's manifest.
fn edit(dir: &TempDir, change: impl Fn(&mut Value)) {
    let mut value = manifest();
    change(&mut value);
    write(dir.path(), "transforms.json", &value.to_string());
}

/// The message of the error that loading gives, which must contain all of `parts`.
#[track_caller]
fn expect_error(dir: &Path, options: &LoadOptions, parts: &[&str]) {
    crate::support::assert_names(&load(dir, options).expect_err("an error"), parts);
}

#[test]
fn the_small_scene_loads_as_written() {
    let dir = scene();
    let scene = load(dir.path(), &LoadOptions::default()).expect("scene");
    assert_eq!(scene.origin, DVec3::new(1.0, 2.0, 1e6));
    assert_eq!(scene.up, DVec3::Y);
    let ids: Vec<_> = scene
        .classes
        .entries
        .iter()
        .map(|c| (c.id, c.name.as_str()))
        .collect();
    assert_eq!(ids, [(1, "wall"), (2, "floor"), (300, "lamp")]);
    assert_eq!(scene.classes.ignore, 0);
    assert_eq!(scene.points.positions, [[0.0, 0.0, 0.5], [1.5, 0.0, 0.0]]);
    assert_eq!(scene.points.colors, [[1.0, 0.0, 0.2], [0.0; 3]]);
    let names: Vec<_> = scene
        .views
        .iter()
        .map(|v| (v.name.as_str(), v.split))
        .collect();
    assert_eq!(
        names,
        [
            ("v0", Split::Test),
            ("v1", Split::Train),
            ("v2", Split::Train)
        ]
    );
    let view = &scene.views[2];
    let Camera {
        center,
        fx,
        fy,
        cx,
        cy,
        width,
        height,
        ..
    } = view.camera;
    assert_eq!(
        (center, fx, fy, cx, cy),
        (DVec3::new(1.0, 0.0, 0.0), 20.0, 21.0, 8.5, 6.25)
    );
    assert_eq!((width, height), (WIDTH as usize, HEIGHT as usize));
    assert_eq!(
        view.image.pixels().expect("photo").get_pixel(3, 4).0,
        [27, 28, 2]
    );
    assert_eq!(
        view.rgb().expect("photo")[(4 * WIDTH as usize + 3) * 3..][..3],
        [27.0 / 255.0, 28.0 / 255.0, 2.0 / 255.0]
    );
    assert_eq!(
        view.truth.as_ref().expect("truth").map().ids[..5],
        [0, 1, 2, 300, 0]
    );
    // Cameras look along -z with y up: straight ahead is the principal point, right is +u, up is -v.
    assert_eq!(
        view.camera.project(DVec3::new(1.0, 0.0, -2.0)),
        Some((8.5, 6.25, 2.0))
    );
    let (u, v, _) = view
        .camera
        .project(DVec3::new(1.2, 0.1, -2.0))
        .expect("in front");
    assert!(
        (u - 10.5).abs() < 1e-12 && (v - (6.25 - 1.05)).abs() < 1e-12,
        "{u} {v}"
    );
}

#[test]
fn options_and_fallbacks() {
    let dir = scene();
    // Raw labels from another folder.
    let map = LabelMap {
        width: 16,
        height: 12,
        ids: vec![2; 192],
    };
    for i in 0..3 {
        map.write(&dir.path().join(format!("labels_raw_corr/v{i}.png")))
            .expect("labels");
    }
    let options = LoadOptions {
        raw_labels: Some("labels_raw_corr".into()),
        ..LoadOptions::default()
    };
    let loaded = load(dir.path(), &options).expect("scene");
    assert_eq!(loaded.views[1].raw, Some(map.into()));
    // No split: every 8th, from the first. No sizes, one angle: sizes of the images, square pixels, central.
    edit(&dir, |v| {
        for f in v["frames"].as_array_mut().expect("frames") {
            f.as_object_mut().expect("frame").remove("split");
        }
        let file = v.as_object_mut().expect("file");
        for key in ["fl_x", "fl_y", "cx", "cy", "w", "h", "ply_file_path"] {
            file.remove(key);
        }
        file.insert("camera_angle_x".into(), json!(std::f64::consts::FRAC_PI_2));
        file.insert(
            "convention".into(),
            json!("OpenGL camera-to-world; world z up, metres"),
        );
    });
    let loaded = load(dir.path(), &LoadOptions::default()).expect("scene");
    assert!(loaded.points.is_empty());
    assert_eq!(loaded.up, DVec3::Z);
    let splits: Vec<_> = loaded.views.iter().map(|v| v.split).collect();
    assert_eq!(splits, [Split::Test, Split::Train, Split::Train]);
    let c = &loaded.views[0].camera;
    assert!(
        (c.fx - 8.0).abs() < 1e-12 && c.fx == c.fy && (c.cx, c.cy) == (8.0, 6.0),
        "{c:?}"
    );
    // A frame's own intrinsics come first; a frame without labels has none; an extension may be missing.
    edit(&dir, |v| {
        let frame = v["frames"][1].as_object_mut().expect("frame");
        frame.remove("label_path");
        frame.insert("fl_x".into(), json!(33.0));
        frame.insert("file_path".into(), json!("./images/v1"));
    });
    let loaded = load(dir.path(), &LoadOptions::default()).expect("scene");
    assert_eq!(loaded.views[1].camera.fx, 33.0);
    assert_eq!(loaded.views[0].camera.fx, 20.0);
    assert!(loaded.views[1].truth.is_none() && loaded.views[1].raw.is_some());
}

#[test]
fn cameras_alone_need_no_images() {
    let dir = scene();
    fs::remove_dir_all(dir.path().join("images")).expect("remove");
    let path = dir.path().join("transforms.json");
    let all = load_cameras(&path, None).expect("cameras");
    assert_eq!(all.len(), 3);
    assert_eq!(all[2].camera.center, DVec3::new(2.0, 2.0, 1e6));
    let test = load_cameras(&path, Some(Split::Test)).expect("cameras");
    assert_eq!(
        test.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(),
        ["v0"]
    );
    assert_eq!(test[0], all[0]);
    edit(&dir, |v| {
        v["frames"].as_array_mut().expect("frames").truncate(1)
    });
    let message = load_cameras(&path, Some(Split::Train))
        .expect_err("none")
        .to_string();
    assert!(message.contains("transforms.json: frames"), "{message}");
    edit(&dir, |v| {
        v.as_object_mut().expect("file").remove("w");
    });
    let message = load_cameras(&path, None).expect_err("no size").to_string();
    assert!(message.contains("frames[0] (images/v0.png).w"), "{message}");
    edit(&dir, |v| v["w"] = json!(4_000_000_000_u32));
    let message = load_cameras(&path, None)
        .expect_err("absurd size")
        .to_string();
    assert!(message.contains("exceeds the limit"), "{message}");
}

#[test]
fn broken_manifests_are_refused_by_name() {
    type Change = fn(&mut Value);
    let cases: [(Change, &[&str]); 26] = [
        (
            |v| v["frames"][1]["file_path"] = json!("images/none.png"),
            &["frames[1]", "none.png", "file_path"],
        ),
        (
            |v| v["frames"][1]["file_path"] = json!("images/v0.png"),
            &["frames[1]", "frames[0]", "v0", "rename"],
        ),
        (
            |v| v["frames"][1]["label_path"] = json!("labels/none.png"),
            &["none.png", "no such file", "label map"],
        ),
        (|v| v["frames"] = json!([]), &["frames", "no frames"]),
        (
            |v| {
                v["frames"]
                    .as_array_mut()
                    .into_iter()
                    .flatten()
                    .for_each(|f| f["split"] = json!("test"))
            },
            &["frames", "at least one training view"],
        ),
        (
            |v| v["frames"][2]["split"] = json!("dev"),
            &["frames[2]", "split", "\"dev\"", "\"test\" or \"val\""],
        ),
        (
            |v| v["frames"][2]["split"] = Value::Null,
            &["frames[2]", "split", "nothing"],
        ),
        (
            |v| v["w"] = json!(17),
            &["v0.png", "16x12", "17x12", "transforms.json"],
        ),
        (
            |v| v["w"] = json!(0),
            &["frames[0]", ".w", "0", "at least 1"],
        ),
        (|v| v["h"] = json!(12.5), &["frames[0]", ".h", "12.5"]),
        (|v| v["w"] = json!(1e300), &["frames[0]", ".w"]),
        (
            |v| v["k4"] = json!(-0.05),
            &["frames[0]", "k4", "-0.05", "undistort"],
        ),
        (
            |v| v["frames"][1]["p2"] = json!(1e3),
            &["v1.png", "lens distortion", "1000", "fold"],
        ),
        (
            |v| v["is_fisheye"] = json!(true),
            &["is_fisheye", "undistort"],
        ),
        (
            |v| v["camera_model"] = json!("OPENCV_FISHEYE"),
            &["camera_model", "OPENCV_FISHEYE", "undistort"],
        ),
        (|v| v["fl_x"] = Value::Null, &["fl_x", "camera_angle_x"]),
        (|v| v["fl_y"] = json!(-3), &["fl_y", "-3", "positive"]),
        (|v| v["fl_x"] = json!(1e300), &["fl_x", "1e300", "1e9"]),
        (
            |v| v["cy"] = json!(-1e12),
            &["cy", "-1000000000000", "principal point"],
        ),
        (
            |v| {
                v["fl_x"] = Value::Null;
                v["camera_angle_x"] = json!(0);
            },
            &["fl_x", "inf", "camera_angle"],
        ),
        (
            |v| v["frames"][1]["transform_matrix"][1][3] = json!(-1e300),
            &["frames[1]", "[1][3]", "finite"],
        ),
        (
            |v| v["convention"] = json!("OpenCV camera-to-world"),
            &["convention", "OpenGL", "negate"],
        ),
        (
            |v| v["frames"][1]["transform_matrix"][0][0] = json!(1.1),
            &["frames[1]", "transform_matrix", "1.1", "rotation"],
        ),
        (
            |v| v["frames"][1]["transform_matrix"][0][0] = json!(-1.0),
            &["frames[1]", "determinant -1", "mirror"],
        ),
        (
            |v| v["frames"][1]["transform_matrix"][3][3] = json!(2.0),
            &["frames[1]", "transform_matrix[3]"],
        ),
        (
            |v| v["frames"][1]["transform_matrix"] = json!([[1, 0, 0, 0], [0, 1]]),
            &["frames[1]", "[4, 2]", "4 rows"],
        ),
    ];
    let dir = scene();
    for (change, parts) in cases {
        edit(&dir, change);
        expect_error(dir.path(), &LoadOptions::default(), parts);
    }
}

#[test]
fn json_errors_name_the_line() {
    let dir = scene();
    let path = dir.path().join("transforms.json");
    let pretty = serde_json::to_string_pretty(&manifest()).expect("json");
    let line_of =
        |text: &str, what: &str| text.lines().position(|l| l.contains(what)).expect("there") + 1;
    let options = LoadOptions::default();
    let broken = pretty.replacen("\"fl_y\": 21.0", "\"fl_y\" 21.0", 1);
    fs::write(&path, &broken).expect("write");
    expect_error(
        dir.path(),
        &options,
        &[
            "transforms.json",
            &format!("line {}:", line_of(&broken, "\"fl_y\"")),
        ],
    );
    // Python writes NaN into JSON.
    let broken = pretty.replacen("1000000.0", "NaN", 1);
    fs::write(&path, &broken).expect("write");
    let line = format!("found NaN in line {}", line_of(&broken, "NaN"));
    expect_error(
        dir.path(),
        &options,
        &[
            "frames[0] (images/v0.png).transform_matrix[2][3]",
            &line,
            "finite",
        ],
    );
    let broken = pretty.replacen("21.0", "NaN", 1);
    fs::write(&path, &broken).expect("write");
    expect_error(
        dir.path(),
        &options,
        &[
            &format!("line {}: found \"fl_y\": NaN", line_of(&broken, "NaN")),
            "finite",
        ],
    );
    let broken = pretty.replacen("1000000.0", "1e999", 1);
    fs::write(&path, &broken).expect("write");
    expect_error(
        dir.path(),
        &options,
        &[
            &format!("line {}", line_of(&broken, "1e999")),
            "number out of range",
        ],
    );
    let broken = pretty.replacen("\"transform_matrix\"", "\"matrix\"", 1);
    fs::write(&path, &broken).expect("write");
    expect_error(
        dir.path(),
        &options,
        &["line ", "missing field `transform_matrix`"],
    );
    let broken = pretty.replacen("21.0", "\"wide\"", 1);
    fs::write(&path, &broken).expect("write");
    expect_error(dir.path(), &options, &["line ", "wide"]);
    fs::write(&path, [0xFF, 0xFE, b'{']).expect("write");
    expect_error(dir.path(), &options, &["transforms.json", "read failed"]);
    fs::remove_file(&path).expect("remove");
    expect_error(
        dir.path(),
        &options,
        &["transforms.json", "no such file", "nerfstudio"],
    );
}

#[test]
fn broken_label_maps_are_refused_by_name() {
    let dir = scene();
    let options = LoadOptions::default();
    let file = dir.path().join("labels/v1.png");
    let good = fs::read(&file).expect("labels");
    let mut ids = vec![1_u16; 192];
    ids[3 * 16 + 5] = 77;
    LabelMap {
        width: 16,
        height: 12,
        ids,
    }
    .write(&file)
    .expect("labels");
    expect_error(
        dir.path(),
        &options,
        &["v1.png", "x 5, y 3", "77", "[1 2 300]", "classes.json"],
    );
    LabelMap {
        width: 12,
        height: 16,
        ids: vec![1; 192],
    }
    .write(&file)
    .expect("labels");
    expect_error(
        dir.path(),
        &options,
        &["v1.png", "12x16", "16x12", "its photo"],
    );
    image::RgbImage::new(16, 12).save(&file).expect("labels");
    expect_error(
        dir.path(),
        &options,
        &["v1.png", "pixel format", "colours", "grey"],
    );
    image::GrayAlphaImage::new(16, 12)
        .save(&file)
        .expect("labels");
    expect_error(dir.path(), &options, &["v1.png", "pixel format", "alpha"]);
    image::GrayImage::new(16, 12)
        .save_with_format(&file, image::ImageFormat::Jpeg)
        .expect("labels");
    expect_error(dir.path(), &options, &["v1.png", "JPEG", "PNG"]);
    fs::write(&file, b"not an image").expect("write");
    expect_error(dir.path(), &options, &["v1.png", "not an i", "PNG or JPEG"]);
    fs::write(&file, good).expect("write");
    let options = LoadOptions {
        raw_labels: Some("labels_none".into()),
        ..options
    };
    expect_error(dir.path(), &options, &["labels_none", "v0.png"]);
    fs::remove_file(dir.path().join("classes.json")).expect("remove");
    expect_error(
        dir.path(),
        &LoadOptions::default(),
        &["classes.json", "class table"],
    );
}

#[test]
fn sizes_beyond_the_limits_are_refused() {
    let dir = scene();
    for (limits, what) in [
        (
            Limits {
                views: 2,
                ..Limits::default()
            },
            "frames",
        ),
        (
            Limits {
                image_pixels: 191,
                ..Limits::default()
            },
            "pixels",
        ),
        (
            Limits {
                points: 1,
                ..Limits::default()
            },
            "points",
        ),
    ] {
        expect_error(
            dir.path(),
            &LoadOptions {
                limits,
                ..LoadOptions::default()
            },
            &[what, "exceeds the limit"],
        );
    }
    let limits = Limits {
        views: 3,
        image_pixels: 192,
        points: 2,
    };
    load(
        dir.path(),
        &LoadOptions {
            limits,
            ..LoadOptions::default()
        },
    )
    .expect("just within the limits");
}

#[test]
fn any_truncated_file_is_an_error() {
    let dir = scene();
    let options = LoadOptions::default();
    let jpeg = dir.path().join("images/v2.jpg");
    image::open(dir.path().join("images/v2.png"))
        .expect("photo")
        .into_rgb8()
        .save(&jpeg)
        .expect("jpeg");
    edit(&dir, |v| {
        v["frames"][2]["file_path"] = json!("images/v2.jpg")
    });
    load(dir.path(), &options).expect("whole");
    for file in [
        "transforms.json",
        "classes.json",
        "images/v0.png",
        "images/v2.jpg",
        "labels/v0.png",
    ] {
        let path = dir.path().join(file);
        let whole = fs::read(&path).expect("read");
        for length in 0..whole.len() {
            fs::write(&path, &whole[..length]).expect("write");
            let error = load(dir.path(), &options).err();
            let error = error
                .unwrap_or_else(|| panic!("{file} cut to {length} of {} bytes loads", whole.len()));
            assert!(
                error
                    .to_string()
                    .contains(file.rsplit('/').next().unwrap_or(file)),
                "{length}: {error}"
            );
        }
        fs::write(&path, whole).expect("write");
    }
    load(dir.path(), &options).expect("whole again");
}

#[test]
fn damaged_files_never_panic() {
    let dir = scene();
    let options = LoadOptions::default();
    let mut state = 1_u64;
    for file in [
        "transforms.json",
        "classes.json",
        "images/v0.png",
        "labels/v0.png",
        "points.ply",
    ] {
        let path = dir.path().join(file);
        let whole = fs::read(&path).expect("read");
        for _ in 0..300 {
            let mut damaged = whole.clone();
            for _ in 0..3 {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                let at = (state >> 33) as usize % damaged.len();
                damaged[at] = (state >> 25) as u8;
            }
            fs::write(&path, &damaged).expect("write");
            if let Ok(scene) = load(dir.path(), &options) {
                assert!(
                    scene
                        .points
                        .positions
                        .iter()
                        .flatten()
                        .all(|v| v.is_finite())
                );
            }
        }
        fs::write(&path, whole).expect("write");
    }
}

#[test]
fn real_scenes_load() {
    let Some(shared) = crate::support::shared_dir() else {
        return;
    };
    let cases = [
        ("fox", "transforms_4.json", 43, 7, (270, 480), 0, 15_019),
        (
            "tabletop_bin",
            "transforms.json",
            44,
            6,
            (640, 480),
            0,
            24_791,
        ),
        (
            "house_living",
            "transforms.json",
            80,
            22,
            (480, 360),
            18,
            35_000,
        ),
        (
            "house_kitchen",
            "transforms.json",
            80,
            22,
            (480, 360),
            17,
            35_000,
        ),
        ("studio", "transforms.json", 80, 22, (480, 360), 29, 35_000),
    ];
    for (name, transforms, train, test, size, classes, points) in cases {
        let dir = shared.join("data").join(name);
        let options = LoadOptions {
            transforms: transforms.into(),
            ..LoadOptions::default()
        };
        let scene = load(&dir, &options).expect("scene");
        let counts = [Split::Train, Split::Test].map(|s| scene.split(s).count());
        assert_eq!((scene.name.as_str(), counts), (name, [train, test]));
        assert_eq!(
            (scene.classes.len(), scene.points.len()),
            (classes, points),
            "{name}"
        );
        let mean =
            scene.views.iter().map(|v| v.camera.center).sum::<DVec3>() / scene.views.len() as f64;
        assert!(mean.length() < 1e-12, "{name}: {mean}");
        assert!(
            scene
                .views
                .iter()
                .all(|v| (v.camera.width, v.camera.height) == size)
        );
        assert!(
            scene
                .views
                .iter()
                .all(|v| v.truth.is_some() == (classes > 0) && v.raw.is_some() == (classes > 0))
        );
        // Poses, intrinsics and points agree: most points that fall into a photo have nearly its colour there (a wrong
        // axis or sign leaves no more than chance).
        let view = scene.split(Split::Train).nth(10).expect("view");
        let (rgb, mut seen, mut near) = (view.rgb().expect("photo"), 0, 0);
        for (p, c) in scene.points.positions.iter().zip(&scene.points.colors) {
            let Some((u, v, _)) = view.camera.project(DVec3::from(p.map(f64::from))) else {
                continue;
            };
            if u >= 0.0 && v >= 0.0 && u < size.0 as f64 && v < size.1 as f64 {
                let pixel = &rgb[(v as usize * size.0 + u as usize) * 3..][..3];
                seen += 1;
                near += usize::from(pixel.iter().zip(c).all(|(a, b)| (a - b).abs() < 0.1));
            }
        }
        eprintln!("{name}: {near} of {seen} points have the photo's colour");
        assert!(seen > 500 && near * 2 > seen, "{name}: {near} of {seen}");
        let cameras = load_cameras(&dir.join(transforms), Some(Split::Test)).expect("cameras");
        assert_eq!(cameras.len(), test);
        let first = scene.split(Split::Test).next().expect("view");
        assert!((cameras[0].camera.center - scene.origin - first.camera.center).length() < 1e-12);
    }
}

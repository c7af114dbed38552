//! `transforms.json` scenes in many broken forms, cut off and damaged.

use crate::support::damage::Damage;
use crate::support::small_scene::{edit, expect_error, manifest, scene};
use coseg::data::{LabelMap, LoadOptions, load};
use coseg::files::{MAX_POINTS, MAX_VIEWS};
use serde_json::{Value, json};
use std::fs;

#[test]
fn broken_manifests_are_refused_by_name() {
    type Change = fn(&mut Value);
    let cases: [(Change, &[&str]); 28] = [
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
        (|v| v["w"] = json!("16"), &["w", "\"16\"", "a number"]),
        (
            |v| v["frames"][1]["fl_x"] = json!([1.0]),
            &["frames[1].fl_x", "[1.0]", "a number"],
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
            &[
                "frames[1]",
                "transform_matrix",
                "-1e300 in row 1, column 3",
                "finite",
            ],
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
            &[
                "frames[1]",
                "transform_matrix",
                "last row [0.0, 0.0, 0.0, 2.0]",
            ],
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
    expect_error(dir.path(), &options, &["fl_y", "wide", "a number"]);
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
    expect_error(
        dir.path(),
        &options,
        &["data.raw_labels", "labels_none", "labels_raw"],
    );
    fs::remove_file(dir.path().join("classes.json")).expect("remove");
    expect_error(
        dir.path(),
        &LoadOptions::default(),
        &["classes.json", "class table"],
    );
}

#[test]
fn sizes_beyond_the_limits_are_refused() {
    let options = LoadOptions::default();
    let dir = scene();
    edit(&dir, |v| {
        let frame = |i: usize| {
            let mut frame = v["frames"][1].clone();
            frame["file_path"] = json!(format!("images/v{i}.png"));
            frame
        };
        let frames = (0..=MAX_VIEWS as usize).map(frame).collect();
        v["frames"] = Value::Array(frames);
    });
    expect_error(
        dir.path(),
        &options,
        &["transforms.json", "frames", "65537", "exceeds the limit"],
    );
    // Headers that declare too much before data that is not there.
    let dir = scene();
    let photo = dir.path().join("images/v1.png");
    let mut png = fs::read(&photo).expect("photo");
    png[16..20].copy_from_slice(&(1_u32 << 14).to_be_bytes());
    png[20..24].copy_from_slice(&((1_u32 << 13) + 1).to_be_bytes());
    let mut crc = flate2::Crc::new();
    crc.update(&png[12..29]);
    png[29..33].copy_from_slice(&crc.sum().to_be_bytes());
    fs::write(&photo, png).expect("write");
    expect_error(
        dir.path(),
        &options,
        &["v1.png", "pixels", "134234112", "exceeds the limit"],
    );
    let dir = scene();
    let cloud = dir.path().join("points.ply");
    let text = fs::read_to_string(&cloud).expect("cloud");
    let declared = format!("element vertex {}", MAX_POINTS + 1);
    fs::write(&cloud, text.replace("element vertex 2", &declared)).expect("write");
    expect_error(
        dir.path(),
        &options,
        &["points.ply", "points", "268435457", "exceeds the limit"],
    );
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
    let mut damage = Damage::new(3);
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
            let damaged = damage.of(&whole);
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

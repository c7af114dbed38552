//! `coseg data check` and `info`, and the layouts that nothing tells apart.

use crate::support::plates::scene;
use crate::support::program::{fails, succeeds, utf8};
use crate::support::transforms_json::edit;
use coseg::config::{Config, Layout};
use coseg::data::{LabelMap, LoadOptions, check, load, locate};
use serde_json::json;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Ten frames, from the six of the small scene.
fn ten_frames(dir: &Path) {
    scene(dir);
    edit(dir, |v| {
        let frames = v["frames"].as_array_mut().unwrap();
        for i in 6..10 {
            let mut frame = frames[i - 5].clone();
            for (key, folder) in [
                ("file_path", "images"),
                ("label_path", "labels"),
                ("raw_label_path", "raw"),
            ] {
                let copy = format!("{folder}/v{i}.png");
                fs::copy(dir.join(frame[key].as_str().unwrap()), dir.join(&copy)).unwrap();
                frame[key] = json!(copy);
            }
            frames.push(frame);
        }
        v["ply_file_path"] = json!("cloud.ply");
    });
    fs::copy(dir.join("plates.ply"), dir.join("cloud.ply")).unwrap();
}

#[test]
fn check_names_all_planted_faults_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    ten_frames(dir);
    assert!(
        succeeds(&["data", "check", utf8(dir)])
            .contains("layout transforms, 10 frames, no problems")
    );

    // 1: a missing image. 2: an image of another size. 3: a pose with NaN. 4: a label id that no class has.
    fs::remove_file(dir.join("images/v1.png")).unwrap();
    image::RgbImage::new(40, 32)
        .save(dir.join("images/v2.png"))
        .unwrap();
    let unknown = LabelMap {
        width: 80,
        height: 64,
        ids: vec![77; 80 * 64],
    };
    unknown.write(&dir.join("labels/v4.png")).unwrap();
    // 5: a label map of another size. 6: a frame twice. 7: a PLY cut off. 8: a missing label map. 9: an image cut off.
    LabelMap {
        width: 64,
        height: 80,
        ids: vec![1; 80 * 64],
    }
    .write(&dir.join("raw/v5.png"))
    .unwrap();
    edit(dir, |v| {
        v["frames"][6]["file_path"] = json!("images/v0.png")
    });
    let ply = fs::read(dir.join("cloud.ply")).unwrap();
    fs::write(dir.join("cloud.ply"), &ply[..ply.len() - 10]).unwrap();
    fs::remove_file(dir.join("labels/v7.png")).unwrap();
    let png = fs::read(dir.join("images/v8.png")).unwrap();
    fs::write(dir.join("images/v8.png"), &png[..png.len() - 20]).unwrap();
    // A second fault in the frame whose photo is missing, and in the one whose pose is.
    unknown.write(&dir.join("raw/v1.png")).unwrap();
    unknown.write(&dir.join("raw/v3.png")).unwrap();
    let text = fs::read_to_string(dir.join("transforms.json")).unwrap();
    let mut value: serde_json::Value = serde_json::from_str(&text).unwrap();
    value["frames"][3]["transform_matrix"][1][3] = json!("HERE");
    fs::write(
        dir.join("transforms.json"),
        value.to_string().replace("\"HERE\"", "NaN"),
    )
    .unwrap();

    let message = fails(&["data", "check", utf8(dir)], 1);
    let lines: Vec<&str> = message
        .lines()
        .filter(|line| line.starts_with("error: "))
        .collect();
    let planted: [&[&str]; 11] = [
        &[
            "transforms.json",
            "frames[1] (images/v1.png).file_path",
            "no file",
            "put the image there",
        ],
        &["v2.png", "size", "40x32", "80x64", "scale the photo"],
        &[
            "transforms.json",
            "frames[3] (images/v3.png).transform_matrix[1][3]",
            "NaN",
            "export the pose again",
        ],
        &[
            "labels/v4.png",
            "label id 77",
            "[1 2 3 4]",
            "add the id to classes.json",
        ],
        &["raw/v5.png", "size", "64x80", "80x64"],
        &[
            "transforms.json",
            "frames[6] (images/v0.png).file_path",
            "frames[0]",
            "drop the repeated frame",
        ],
        &["cloud.ply", "size", "bytes", "cut off"],
        &["labels/v7.png", "no such file", "label map"],
        &[
            "images/v8.png",
            "image data",
            "without the end",
            "copy or export it again",
        ],
        &[
            "raw/v1.png",
            "label id 77",
            "set data.association=gaussians",
        ],
        &["raw/v3.png", "label id 77"],
    ];
    for parts in planted {
        let found = lines
            .iter()
            .filter(|line| parts.iter().all(|part| line.contains(part)))
            .count();
        assert_eq!(found, 1, "{parts:?} in\n{message}");
    }
    assert_eq!(lines.len(), planted.len() + 1, "{message}");
    assert!(
        lines[planted.len()].contains("found 11 problems"),
        "{message}"
    );

    // Without a class table that is reported once, and not for each label map.
    fs::remove_file(dir.join("classes.json")).unwrap();
    let message = fails(&["data", "check", utf8(dir)], 1);
    assert!(
        message.contains("classes.json: file: found nothing, expected a class table"),
        "{message}"
    );
    assert!(message.contains("found 9 problems"), "{message}");
    let message = fails(&["data", "check", utf8(&dir.join("absent"))], 1);
    assert!(
        message.contains("no such folder") && message.contains("1 problem"),
        "{message}"
    );
}

#[test]
fn a_misspelt_folder_of_labels_is_one_problem() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let set = "data.raw_labels=label";
    let message = fails(&["data", "check", utf8(folder.path()), "--set", set], 1);
    let expected = "setting data.raw_labels: found label, expected a folder or file of label maps";
    assert!(message.contains(expected), "{message}");
    assert!(message.contains("the scene folder has labels"), "{message}");
    assert!(message.contains("found 1 problem"), "{message}");

    // So it is where the frames name no labels and there is no class table.
    edit(folder.path(), |scene| {
        for frame in scene["frames"].as_array_mut().unwrap() {
            let frame = frame.as_object_mut().unwrap();
            frame.remove("raw_label_path");
            frame.remove("label_path");
        }
    });
    fs::remove_file(folder.path().join("classes.json")).unwrap();
    let message = fails(&["data", "check", utf8(folder.path()), "--set", set], 1);
    assert!(message.contains(expected), "{message}");
    assert!(message.contains("found 1 problem"), "{message}");

    // A folder that lies where the program was started.
    let started_in = tempfile::tempdir().unwrap();
    let labels = started_in.path().join("label");
    fs::create_dir(&labels).unwrap();
    let said = Command::new(env!("CARGO_BIN_EXE_coseg"))
        .current_dir(started_in.path())
        .args(["data", "check", utf8(folder.path()), "--set", set])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&[said.stdout, said.stderr].concat()).into_owned();
    let absolute = format!("write {}", labels.canonicalize().unwrap().display());
    assert!(said.contains(&absolute), "{said}");
}

#[test]
fn check_finds_what_load_finds() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let options = LoadOptions::default();
    assert!(check(folder.path(), &options).problems.is_empty());
    fs::remove_file(folder.path().join("raw/v2.png")).unwrap();
    fs::remove_file(folder.path().join("raw/v4.png")).unwrap();
    let checked = check(folder.path(), &options);
    assert_eq!(
        (checked.layout, checked.frames, checked.problems.len()),
        (Some(Layout::Transforms), 6, 2)
    );
    let first = load(folder.path(), &options).unwrap_err().to_string();
    assert_eq!(checked.problems[0].to_string(), first);
}

#[test]
fn info_counts_and_draws() {
    let folder = tempfile::tempdir().unwrap();
    ten_frames(folder.path());
    let sheet = folder.path().join("sheet.png");
    let text = succeeds(&["data", "info", utf8(folder.path()), "--sheet", utf8(&sheet)]);
    for part in [
        "layout transforms",
        "7 train, 3 test",
        "10 of 80x64 pixels",
        "extent",
        "10 views true, 10 views raw",
        "wall",
    ] {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
    let picture = image::open(&sheet).unwrap().into_rgb8();
    assert!(
        picture.width() > 5 * 200 && picture.height() > 4 * 160,
        "{:?}",
        picture.dimensions()
    );
    let json: serde_json::Value = serde_json::from_str(&succeeds(&[
        "data",
        "info",
        utf8(folder.path()),
        "--json",
        "--set",
        "data.stride=2",
    ]))
    .unwrap();
    assert_eq!(
        (json["train"].as_u64(), json["test"].as_u64()),
        (Some(4), Some(2))
    );
    assert_eq!(json["sizes"], json!([[80, 64, 6]]));
    let classes = json["classes"].as_array().unwrap();
    let sum = |key: &str| {
        classes
            .iter()
            .map(|c| c[key].as_f64().unwrap())
            .sum::<f64>()
    };
    assert!(
        (sum("truth") - 1.0).abs() < 1e-9 && (sum("raw") - 1.0).abs() < 1e-9,
        "{classes:?}"
    );
    assert_eq!(
        (classes.len(), &classes[4]["name"]),
        (5, &json!("unlabelled"))
    );
    assert!(json["cameras"]["extent"].as_f64().unwrap() > 0.5);
    // Shares of labels that are not there are unknown.
    let lines = |key: &str| {
        edit(folder.path(), |scene| {
            for frame in scene["frames"].as_array_mut().unwrap() {
                _ = frame.as_object_mut().unwrap().remove(key);
            }
        });
        let said = succeeds(&["data", "info", utf8(folder.path())]);
        let wall = said.lines().find(|line| line.ends_with("  wall")).unwrap();
        let shares = wall.split_whitespace().skip(1).take(2);
        shares.map(|share| share.ends_with('%')).collect::<Vec<_>>()
    };
    assert_eq!(lines("label_path"), [false, true]);
    assert_eq!(lines("raw_label_path"), [false, false]);
    fails(&["data", "info", utf8(&folder.path().join("images"))], 1);
    fails(&["data", "look"], 2);
}

#[test]
fn layouts_are_told_apart_or_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let options = LoadOptions::default();
    let message = locate(dir, &options).unwrap_err().to_string();
    for part in [
        "transforms.json",
        "sparse/0",
        "traj.txt",
        "traj_w_c.txt",
        "color/ with pose/",
        "docs/data.md",
    ] {
        assert!(message.contains(part), "{part}: {message}");
    }
    for sub in ["color", "pose", "results"] {
        fs::create_dir(dir.join(sub)).unwrap();
    }
    assert_eq!(locate(dir, &options).unwrap(), Layout::Scannet);
    fs::write(dir.join("traj.txt"), "").unwrap();
    let message = locate(dir, &options).unwrap_err().to_string();
    assert!(
        message.contains("traj.txt (replica) and color/ with pose/ (scannet)"),
        "{message}"
    );
    assert!(message.contains("--set data.layout=replica"), "{message}");
    fs::write(dir.join("transforms_4.json"), "{}").unwrap();
    let named = LoadOptions {
        transforms: "transforms_4.json".into(),
        ..LoadOptions::default()
    };
    assert_eq!(locate(dir, &named).unwrap(), Layout::Transforms);
    let config = Config::load(None, &["data.layout=scannet".into()]).unwrap();
    assert_eq!(
        locate(dir, &LoadOptions::from(&config.data)).unwrap(),
        Layout::Scannet
    );
    let message = Config::load(None, &["data.layout=blender".into()])
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("data.layout") && message.contains("\"colmap\""),
        "{message}"
    );
    let message = Config::load(None, &["data.stride=0".into()])
        .unwrap_err()
        .to_string();
    assert!(message.contains("data.stride"), "{message}");
    // A layout that is asked for and is not there.
    for (layout, part) in [("transforms", "transforms.json"), ("colmap", "sparse/0")] {
        let config = Config::load(None, &[format!("data.layout={layout}")]).unwrap();
        let message = load(dir, &LoadOptions::from(&config.data))
            .unwrap_err()
            .to_string();
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn a_layout_that_is_asked_for_is_named_with_the_files_that_are_there() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    scene(dir);
    let refused = |options: LoadOptions, parts: &[&str]| {
        crate::support::assert_names(&locate(dir, &options).unwrap_err(), parts);
    };
    let replica = LoadOptions {
        layout: Layout::Replica,
        ..LoadOptions::default()
    };
    let found = "data.layout: found replica, but transforms.json of layout transforms";
    let parts = [found, "traj.txt", "--set data.layout=transforms"];
    refused(replica, &parts);
    // As nerfstudio keeps the model that it started from.
    let model = dir.join("colmap/sparse/0");
    fs::create_dir_all(&model).unwrap();
    for file in ["cameras.bin", "images.bin"] {
        fs::write(model.join(file), [0; 8]).unwrap();
    }
    let mistyped = LoadOptions {
        layout: Layout::Transforms,
        transforms: "transform.json".into(),
        ..LoadOptions::default()
    };
    let found = "transform.json: found no such file, but transforms.json";
    refused(mistyped, &[found, "--set data.transforms=transforms.json"]);
}

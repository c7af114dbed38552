//! Labels drawn in LabelMe: whole, then broken.

use crate::support::labelme_files::{colmap, labelme, rectangle, shape, triangle};
use crate::support::plates::{HEIGHT, WIDTH};
use crate::support::program::{fails, read_json, succeeds, utf8};
use crate::support::raw_labels::{at, folder, labelled, options, raw, refused, write};
use coseg::config::Association;
use coseg::data::{LoadOptions, Segment, check, info, load};
use serde_json::{Value, json};
use std::fs;

#[test]
fn shapes_of_labelme_are_painted_in_their_order() {
    let folder = folder();
    let dir = folder.path();
    let shapes = [
        shape("Wall", "rectangle", rectangle(0.0, 0.0, 40.0, 32.0)),
        shape("red", "polygon", triangle()),
        shape("green", "circle", json!([[20.0, 16.0], [20.0, 26.0]])),
        shape("unknown", "rectangle", rectangle(18.0, 14.0, 22.0, 18.0)),
        shape("blue", "point", json!([[5.0, 5.0]])),
        shape("vase", "rectangle", rectangle(0.0, 0.0, 2.0, 2.0)),
    ];
    write(dir, "drawn/v0.json", &labelme(&shapes));
    write(dir, "drawn/v4.json", &labelme(&shapes[..1]));
    let loaded = load(dir, &options("drawn")).expect("scene");
    assert!(loaded.drawn);
    assert_eq!(labelled(&loaded), ["v0", "v4"]);
    let map = raw(&loaded, 0);
    let places = [
        (5, 5),
        (20, 10),
        (20, 16),
        (70, 10),
        (70, 35),
        (45, 10),
        (1, 1),
        (39, 31),
        (40, 31),
    ];
    assert_eq!(at(&map, &places), [4, 2, 0, 1, 0, 0, 0, 4, 0]);
    let circle = map.ids.iter().filter(|id| **id == 2).count() as f64;
    assert!(
        (circle + 16.0 - 100.0 * std::f64::consts::PI).abs() < 6.0,
        "{circle}"
    );
    assert_eq!(
        raw(&loaded, 4).ids.iter().filter(|id| **id == 4).count(),
        40 * 32
    );

    let checked = check(dir, &options("drawn"));
    assert!(checked.problems.is_empty(), "{:?}", checked.problems);
    let told = |part: &str| checked.notices.iter().any(|notice| notice.contains(part));
    assert!(
        told("2 of 4 training frames have no raw labels"),
        "{:?}",
        checked.notices
    );
    assert!(told("2 have some"), "{:?}", checked.notices);
    assert!(
        told("4 of the 5 classes") && told("vase"),
        "{:?}",
        checked.notices
    );
    let told = info(dir, &options("drawn")).expect("info");
    assert_eq!(told.raw_labelled, 2);
    let said = succeeds(&["data", "check", utf8(dir), "--set", "data.raw_labels=drawn"]);
    assert!(said.contains("no problems"), "{said}");
}

#[test]
fn without_a_class_table_the_labels_are_the_classes() {
    let folder = folder();
    let dir = folder.path();
    let path = dir.join("transforms.json");
    let mut value = read_json(&path);
    for frame in value["frames"].as_array_mut().expect("frames") {
        frame.as_object_mut().expect("frame").remove("label_path");
    }
    fs::write(path, value.to_string()).expect("write");
    fs::remove_file(dir.join("classes.json")).expect("remove");
    let whole = rectangle(0.0, 0.0, 80.0, 64.0);
    write(
        dir,
        "drawn/v0.json",
        &labelme(&[shape("sofa", "rectangle", whole.clone())]),
    );
    let shapes = [
        shape("Sofa ", "rectangle", whole),
        shape("arm-chair", "polygon", triangle()),
        shape("__ignore__", "rectangle", rectangle(0.0, 0.0, 9.0, 9.0)),
    ];
    write(dir, "drawn/v1.json", &labelme(&shapes));
    let loaded = load(dir, &options("drawn")).expect("scene");
    let classes: Vec<_> = loaded
        .classes
        .entries
        .iter()
        .map(|c| (c.id, c.name.as_str()))
        .collect();
    assert_eq!(classes, [(1, "arm-chair"), (2, "Sofa")]);
    assert_eq!(
        at(&raw(&loaded, 1), &[(70, 5), (20, 20), (4, 4)]),
        [1, 2, 0]
    );
}

#[test]
fn files_beside_the_photos_hide_no_photo_and_may_be_of_a_smaller_copy() {
    let folder = folder();
    let dir = folder.path();
    // The photos are PNG, and could be taken for maps.
    let mut half = labelme(&[shape("red", "rectangle", rectangle(0.0, 0.0, 20.0, 32.0))]);
    half["imageWidth"] = json!(WIDTH / 2);
    half["imageHeight"] = json!(HEIGHT / 2);
    write(dir, "images/v3.json", &half);
    let loaded = load(dir, &options("images")).expect("scene");
    assert_eq!(labelled(&loaded), ["v3"]);
    assert_eq!(at(&raw(&loaded, 3), &[(39, 63), (40, 63)]), [1, 0]);
    // A frame may name its file.
    let path = dir.join("transforms.json");
    let mut value = read_json(&path);
    value["frames"][3]["raw_label_path"] = json!("images/v3.json");
    for i in [0, 1, 2, 4, 5] {
        let frame = value["frames"][i].as_object_mut().expect("frame");
        frame.remove("raw_label_path");
    }
    fs::write(path, value.to_string()).expect("write");
    let named = load(dir, &LoadOptions::default()).expect("scene");
    assert_eq!(labelled(&named), ["v3"]);
    assert_eq!(named.views[3].raw, loaded.views[3].raw);
}

#[test]
fn shapes_are_segments_and_groups_join_them() {
    let folder = folder();
    let dir = folder.path();
    let mut shapes = [
        shape("red", "rectangle", rectangle(0.0, 0.0, 10.0, 10.0)),
        shape("red", "rectangle", rectangle(20.0, 0.0, 30.0, 10.0)),
        shape("red", "rectangle", rectangle(40.0, 0.0, 50.0, 10.0)),
    ];
    shapes[0]["group_id"] = json!(7);
    shapes[2]["group_id"] = json!(7);
    write(dir, "drawn/v0.json", &labelme(&shapes));
    let options = LoadOptions {
        association: Association::Gaussians,
        ..options("drawn")
    };
    let loaded = load(dir, &options).expect("scene");
    assert_eq!(
        at(&raw(&loaded, 0), &[(5, 5), (25, 5), (45, 5), (5, 50)]),
        [1, 2, 1, 0]
    );
    let segment = |id| Segment {
        id,
        class: Some(1),
        thing: true,
    };
    assert_eq!(loaded.views[0].segments, [segment(1), segment(2)]);
}

#[test]
fn a_named_folder_may_lack_maps_but_not_all_of_them() {
    let folder = folder();
    let dir = folder.path();
    fs::create_dir(dir.join("few")).expect("folder");
    refused(dir, &options("few"), &["no such file", "few"]);
    fs::copy(dir.join("raw/v3.png"), dir.join("few/v3.png")).expect("copy");
    // Of another program.
    fs::write(dir.join("few/v3.json"), "{\"area\": 3}").expect("write");
    let loaded = load(dir, &options("few")).expect("scene");
    assert_eq!(labelled(&loaded), ["v3"]);
    assert!(!loaded.drawn);
}

#[test]
fn labelme_is_found_in_a_colmap_scene() {
    let folder = folder();
    let dir = folder.path();
    colmap(dir);
    fs::remove_dir_all(dir.join("labels")).expect("true labels");
    let shapes = [shape("red", "polygon", triangle())];
    write(dir, "labels_raw/v0.json", &labelme(&shapes));
    write(dir, "labels_raw/v3.png.json", &labelme(&shapes));
    let loaded = load(dir, &LoadOptions::default()).expect("scene");
    assert_eq!(labelled(&loaded), ["v3"]);
    // v0 is held out: it is scored against what was drawn.
    let drawn = |name: &str| {
        let view = loaded.views.iter().find(|view| view.name == name);
        let view = view.expect("a view");
        (view.truth.is_some(), view.raw.is_some())
    };
    assert_eq!([drawn("v0"), drawn("v3")], [(true, false), (false, true)]);
    let notices = check(dir, &LoadOptions::default()).notices;
    let told = |notice: &String| {
        notice.contains("1 photos with drawn labels are held out") && notice.contains("v0")
    };
    assert!(notices.iter().any(told), "{notices:?}");
}

#[test]
fn broken_files_of_labelme_are_refused() {
    let folder = folder();
    let dir = folder.path();
    let drawn = options("drawn");
    let good = labelme(&[
        shape("red", "polygon", triangle()),
        shape("green", "circle", json!([[20.0, 16.0], [20.0, 26.0]])),
    ]);
    let broken = |change: &dyn Fn(&mut Value), parts: &[&str]| {
        let mut value = good.clone();
        change(&mut value);
        write(dir, "drawn/v0.json", &value);
        refused(dir, &drawn, &[&["drawn"], parts].concat());
    };
    write(dir, "drawn/v0.json", &good);
    load(dir, &drawn).expect("whole");
    let points = "shapes[0] (red).points";
    broken(
        &|v| v["shapes"][0]["points"] = json!([[1.0, 2.0], [3.0, 4.0]]),
        &[points, "2 of a polygon"],
    );
    broken(
        &|v| v["shapes"][0]["points"] = json!([]),
        &[points, "0 of a polygon"],
    );
    broken(
        &|v| v["shapes"][1]["points"] = json!([[1.0, 2.0]]),
        &["1 of a circle"],
    );
    broken(
        &|v| v["shapes"][0]["points"][1] = json!([1.0]),
        &["line 1", "v0.json"],
    );
    broken(
        &|v| v["shapes"][0]["points"][1] = json!([1.0, "2"]),
        &["line 1"],
    );
    broken(
        &|v| v["shapes"][0]["points"][1] = json!([1.0, null]),
        &["line 1"],
    );
    broken(
        &|v| v["shapes"][0]["points"][1] = json!([1e300, 3.0]),
        &["v0.json: points", "80x64"],
    );
    broken(
        &|v| v["shapes"][0]["points"][1] = json!([3.0, -900.0]),
        &["v0.json: points", "-900"],
    );
    broken(
        &|v| v["shapes"][0]["shape_type"] = json!("cuboid"),
        &["shapes[0] (red).shape_type", "\"cuboid\""],
    );
    broken(
        &|v| v["shapes"][0]["label"] = json!(7),
        &["line 1", "string"],
    );
    broken(&|v| v["shapes"] = json!({}), &["line 1", "shapes"]);
    broken(
        &|v| v["shapes"] = json!([]),
        &["shapes", "none with a label"],
    );
    broken(
        &|v| v["imageWidth"] = json!(u64::MAX),
        &["size of the picture", "18446744073709551615x64"],
    );
    broken(
        &|v| v["imageWidth"] = json!(0),
        &["size of the picture", "0x64"],
    );
    broken(&|v| v["imageWidth"] = json!(-80), &["line 1"]);
    broken(
        &|v| {
            v["imageWidth"] = json!(HEIGHT);
            v["imageHeight"] = json!(WIDTH);
        },
        &["64x80", "80x64", "EXIF"],
    );
    broken(
        &|v| {
            v["shapes"]
                .as_array_mut()
                .expect("shapes")
                .iter_mut()
                .for_each(|s| s["label"] = json!("thing"));
        },
        &["categories", "class table", "rename"],
    );
    broken(
        &|v| {
            let spiral: Vec<_> = (0..300_000).map(|i| json!([i % 80, i % 64])).collect();
            v["shapes"][0]["points"] = json!(spiral);
        },
        &["points on a photo", "300080", "limit"],
    );
    broken(
        &|v| v["shapes"] = json!(vec![v["shapes"][0].clone(); 70_000]),
        &["shapes of a photo", "65535", "limit"],
    );
    let text = good.to_string();
    for end in [text.len() / 2, text.len() - 1] {
        fs::write(dir.join("drawn/v0.json"), &text[..end]).expect("write");
        refused(dir, &drawn, &["v0.json", "line 1", "EOF"]);
    }
    for number in ["NaN", "Infinity", "1e999"] {
        let text = text.replacen("40.0", number, 1);
        fs::write(dir.join("drawn/v0.json"), text).expect("write");
        refused(dir, &drawn, &["v0.json", "line 1"]);
    }
    fs::write(dir.join("drawn/v0.json"), [0xFF, 0xFE, 0x00]).expect("write");
    refused(dir, &drawn, &["v0.json", "read"]);
    let message = fails(
        &["data", "info", utf8(dir), "--set", "data.raw_labels=drawn"],
        1,
    );
    assert!(message.contains("v0.json"), "{message}");
}

#[test]
fn photos_to_label_are_suggested() {
    let folder = folder();
    let dir = folder.path();
    let said = succeeds(&["data", "suggest", utf8(dir), "--count", "2"]);
    let lines: Vec<&str> = said.lines().collect();
    assert!(lines[0].starts_with("photo") && lines.len() == 3, "{said}");
    assert!(lines[1].contains(".png"), "{said}");
    let ply = dir.join("plates.ply");
    let arguments = [
        "data",
        "suggest",
        "--data",
        utf8(dir),
        "--scene",
        utf8(&ply),
        "--json",
    ];
    let said: Value = serde_json::from_str(&succeeds(&arguments)).expect("JSON");
    let photos = said.as_array().expect("list");
    assert!((1..=4).contains(&photos.len()), "{said}");
    let number = |photo: &Value, key: &str| photo[key].as_f64().expect("number");
    let mut together = 0.0;
    for photo in photos {
        // Held-out photos are v2 and v5.
        let name = photo["photo"].as_str().expect("name");
        assert!(
            ["v0.png", "v1.png", "v3.png", "v4.png"].contains(&name),
            "{said}"
        );
        together += number(photo, "adds");
        assert!(
            (number(photo, "together") - together).abs() < 1e-9,
            "{said}"
        );
    }
    assert!(together > 0.95 && together <= 1.0 + 1e-9, "{said}");
    fails(&["data", "suggest", utf8(dir), "--count", "0"], 2);
    let message = fails(&["data", "suggest"], 2);
    assert!(message.contains("DIR"), "{message}");
}

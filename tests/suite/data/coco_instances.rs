//! Labels drawn in tools that write COCO instances: whole, then broken.

use crate::support::plates::{HEIGHT, WIDTH};
use crate::support::raw_labels::{at, folder, labelled, options, raw, refused, write};
use coseg::config::RawFormat;
use coseg::data::{LoadOptions, check, load};
use serde_json::{Value, json};
use std::fs;

/// Run lengths of a picture, in the order of columns.
fn runs(covers: impl Fn(usize, usize) -> bool) -> Vec<u64> {
    let mut counts = vec![0];
    let mut inside = false;
    for pixel in 0..WIDTH * HEIGHT {
        if covers(pixel / HEIGHT, pixel % HEIGHT) != inside {
            inside = !inside;
            counts.push(0);
        }
        *counts.last_mut().expect("a run") += 1;
    }
    counts
}

/// As CVAT writes it: three annotations on v1, a box on v3, one on an image that is not a photo of the scene.
fn coco() -> Value {
    let square =
        |x: f64, y: f64, side: f64| json!([[x, y, x + side, y, x + side, y + side, x, y + side]]);
    let left = runs(|x, y| x < 8 && y >= 60);
    json!({
        "info": {},
        "categories": [{ "id": 0, "name": "red" }, { "id": 5, "name": "Green" }, { "id": 9, "name": "lamp" }],
        "images": [
            { "id": 11, "file_name": "room\\v1.png", "width": WIDTH, "height": HEIGHT },
            { "id": 13, "file_name": "v3.png", "width": WIDTH, "height": HEIGHT },
            { "id": 14, "file_name": "v4.png", "width": WIDTH, "height": HEIGHT },
            { "id": 77, "file_name": "other.png", "width": 5, "height": 5 },
        ],
        "annotations": [
            { "id": 1, "image_id": 11, "category_id": 0, "segmentation": square(10.0, 10.0, 10.0), "area": 1e9, "iscrowd": 0 },
            { "id": 2, "image_id": 11, "category_id": 5, "segmentation": square(0.0, 0.0, 40.0) },
            { "id": 3, "image_id": 11, "category_id": 9, "segmentation": square(30.0, 30.0, 5.0) },
            { "id": 4, "image_id": 11, "category_id": 0, "iscrowd": 1,
              "segmentation": { "size": [HEIGHT, WIDTH], "counts": left } },
            { "id": 5, "image_id": 13, "category_id": 0, "bbox": [1, 2, 3, 4], "segmentation": [] },
            { "id": 6, "image_id": 77, "category_id": 0, "segmentation": square(0.0, 0.0, 4.0) },
        ],
    })
}

#[test]
fn coco_instances_lie_over_larger_ones() {
    let folder = folder();
    let dir = folder.path();
    write(dir, "export/instances_default.json", &coco());
    let loaded = load(dir, &options("export")).expect("scene");
    assert!(loaded.drawn);
    assert_eq!(labelled(&loaded), ["v1", "v3"]);
    let places = [(5, 5), (15, 15), (32, 32), (3, 62), (3, 50), (60, 20)];
    assert_eq!(at(&raw(&loaded, 1), &places), [2, 1, 0, 1, 0, 0]);
    // A box alone.
    let places = [(1, 2), (3, 5), (4, 5), (3, 6), (0, 2)];
    assert_eq!(at(&raw(&loaded, 3), &places), [1, 1, 0, 0, 0]);
    // The file itself.
    let file = load(dir, &options("export/instances_default.json")).expect("scene");
    assert_eq!(file.views[1].raw, loaded.views[1].raw);
    let notices = check(dir, &options("export")).notices;
    for part in [
        "2 of the 3 classes",
        "lamp",
        "1 labelled images of",
        "are not photos of the scene: other.png",
        "2 of 4 training frames",
    ] {
        assert!(
            notices.iter().any(|n| n.contains(part)),
            "{part}: {notices:?}"
        );
    }
}

#[test]
fn coco_instances_are_found_in_an_export_beside_copies_of_the_photos() {
    let folder = folder();
    let dir = folder.path();
    write(dir, "zip/annotations/instances_default.json", &coco());
    fs::create_dir(dir.join("zip/images")).expect("folder");
    for i in 0..6 {
        let photo = format!("images/v{i}.png");
        fs::copy(dir.join(&photo), dir.join("zip").join(&photo)).expect("copy");
    }
    let loaded = load(dir, &options("zip")).expect("scene");
    assert_eq!(labelled(&loaded), ["v1", "v3"]);
    let places = [(5, 5), (15, 15), (32, 32), (3, 62)];
    assert_eq!(at(&raw(&loaded, 1), &places), [2, 1, 0, 1]);
}

#[test]
fn photos_are_found_by_the_names_of_label_studio_and_roboflow() {
    let folder = folder();
    let dir = folder.path();
    write(dir, "coco.json", &coco());
    let expected = load(dir, &options("coco.json")).expect("scene");
    for [before, after] in [
        ["..\\..\\media\\upload\\1\\0123abcd-", ".png"],
        ["images/0123abcd-", ".png"],
        ["train/", "_png.rf.0123456789abcdef0123456789abcdef.jpg"],
    ] {
        let mut value = coco();
        for (i, photo) in ["v1", "v3", "v4"].iter().enumerate() {
            value["images"][i]["file_name"] = json!(format!("{before}{photo}{after}"));
        }
        write(dir, "coco.json", &value);
        let loaded = load(dir, &options("coco.json")).expect("scene");
        assert_eq!(labelled(&loaded), ["v1", "v3"]);
        assert_eq!(loaded.views[1].raw, expected.views[1].raw);
    }
}

#[test]
fn boxes_are_read_where_nothing_else_is_there_alone() {
    let folder = folder();
    let dir = folder.path();
    write(dir, "coco.json", &coco());
    let expected = load(dir, &options("coco.json")).expect("scene");
    let same = |change: &dyn Fn(&mut Value)| {
        let mut value = coco();
        change(&mut value["annotations"]);
        write(dir, "coco.json", &value);
        let loaded = load(dir, &options("coco.json")).expect("scene");
        for i in [1, 3] {
            assert_eq!(loaded.views[i].raw, expected.views[i].raw, "{value}");
        }
    };
    for nothing in [json!(null), json!([[]]), json!([[], []])] {
        same(&|v| v[4]["segmentation"] = nothing.clone());
    }
    same(&|v| {
        drop(
            v[4].as_object_mut()
                .expect("annotation")
                .remove("segmentation"),
        )
    });
    // Beside polygons and run lengths.
    for wrong in [json!([null, 2, 3, 4]), json!([1, 2, -3, 4]), json!("box")] {
        same(&|v| {
            v[1]["bbox"] = wrong.clone();
            v[3]["bbox"] = wrong.clone();
        });
    }
    let square = coco()["annotations"][0]["segmentation"][0].clone();
    same(&|v| v[0]["segmentation"] = json!([[], square]));
    // Neither: the annotation says nothing.
    same(&|v| {
        let nothing =
            json!({ "image_id": 13, "category_id": 0, "segmentation": null, "bbox": null });
        v.as_array_mut().expect("annotations").push(nothing);
    });
}

#[test]
fn label_maps_come_before_a_json_that_holds_no_instances() {
    let folder = folder();
    let dir = folder.path();
    let maps = load(dir, &options("raw")).expect("scene");
    let file = "raw/annotations/file.json";
    let panoptic = json!({
        "images": [{ "id": 1, "file_name": "v1.png" }],
        "annotations": [{ "image_id": 1, "segments_info": [{ "id": 1, "category_id": 0 }] }],
        "categories": [{ "id": 0, "name": "red" }],
    });
    let mut without_images = coco();
    without_images
        .as_object_mut()
        .expect("file")
        .remove("images");
    for other in [json!({ "notes": [] }), panoptic, without_images, json!(7)] {
        write(dir, file, &other);
        let loaded = load(dir, &options("raw")).expect("scene");
        assert!(!loaded.drawn, "{other}");
        assert_eq!(labelled(&loaded).len(), 6);
        for (found, expected) in loaded.views.iter().zip(&maps.views) {
            assert_eq!(found.raw, expected.raw, "{other}");
        }
    }
    write(dir, file, &coco());
    let loaded = load(dir, &options("raw")).expect("scene");
    assert!(loaded.drawn);
    assert_eq!(labelled(&loaded), ["v1", "v3"]);
    // Its format is named.
    write(dir, file, &json!({ "notes": [] }));
    let named = LoadOptions {
        raw_format: RawFormat::CocoInstances,
        ..options("raw")
    };
    refused(dir, &named, &["file.json", "missing field"]);
}

#[test]
fn broken_coco_instances_are_refused() {
    let folder = folder();
    let dir = folder.path();
    let named = options("coco.json");
    let good = coco();
    let broken = |change: &dyn Fn(&mut Value), parts: &[&str]| {
        let mut value = good.clone();
        change(&mut value);
        write(dir, "coco.json", &value);
        refused(dir, &named, &[&["coco.json"], parts].concat());
    };
    let segmentation = "annotations[0].segmentation";
    broken(
        &|v| v["annotations"][0]["category_id"] = json!(4),
        &["annotations[0].category_id", "3 ids"],
    );
    broken(
        &|v| v["annotations"][0]["image_id"] = json!(4),
        &["annotations[0].image_id", "4 ids"],
    );
    broken(
        &|v| v["annotations"][0]["segmentation"] = json!([[1, 2, 3, 4]]),
        &[segmentation, "4 numbers"],
    );
    broken(
        &|v| v["annotations"][0]["segmentation"] = json!([[1, 2, 3, 4, 5, 6, 7]]),
        &[segmentation, "7 numbers"],
    );
    broken(
        &|v| v["annotations"][0]["segmentation"] = json!([1, 2, 3, 4, 5, 6]),
        &["line 1"],
    );
    broken(
        &|v| v["annotations"][0]["segmentation"] = json!("polygon"),
        &["line 1", "a list of polygons"],
    );
    broken(
        &|v| v["annotations"][0]["segmentation"][0][3] = json!(1e200),
        &["points", "80x64"],
    );
    for wrong in [
        json!([1, 2, 3]),
        json!([1, 2, -3, 4]),
        json!([null, 2, 3, 4]),
        json!("box"),
    ] {
        broken(
            &|v| v["annotations"][4]["bbox"] = wrong.clone(),
            &["annotations[4].bbox", "left, top, width and height"],
        );
    }
    broken(
        &|v| v["annotations"][4]["bbox"][2] = json!(900),
        &["points", "80x64"],
    );
    let with_runs = |size: Value, counts: Value, parts: &[&str]| {
        let value = json!({ "size": size, "counts": counts });
        broken(
            &|v| v["annotations"][0]["segmentation"] = value.clone(),
            parts,
        );
    };
    let counts = "annotations[0].segmentation.counts";
    with_runs(json!([64, 80]), json!([1, 2, 3]), &[counts, "80x64"]);
    with_runs(json!([64, 80]), json!([u64::MAX, 5121]), &[counts]);
    with_runs(json!([64, 80]), json!("52203"), &[counts]);
    with_runs(
        json!([64, 80]),
        json!("\u{1}oooooooooooooooooooo"),
        &[counts],
    );
    with_runs(json!([0, 0]), json!([]), &[counts]);
    with_runs(
        json!([1_000_000_000, 1_000_000_000]),
        json!([1]),
        &["pixels", "limit"],
    );
    with_runs(
        json!([u64::MAX, u64::MAX]),
        json!([1]),
        &["pixels", "limit"],
    );
    with_runs(json!([64]), json!([1]), &["line 1"]);
    with_runs(json!([64, 80]), json!([-5]), &["line 1"]);
    broken(
        &|v| v["categories"][1]["id"] = json!(0),
        &["categories[1].id", "each id once"],
    );
    broken(&|v| v["categories"] = json!([]), &["categories", "none"]);
    broken(
        &|v| v["images"][1]["id"] = json!(11),
        &["images[1].id", "11 twice"],
    );
    broken(
        &|v| v["images"][3]["file_name"] = json!("v1.jpg"),
        &["images", "another image of this photo"],
    );
    broken(
        &|v| v["images"][0]["width"] = json!(64),
        &["size of the picture", "64x64"],
    );
    broken(
        &|v| {
            v["images"]
                .as_array_mut()
                .expect("images")
                .iter_mut()
                .for_each(|i| i["file_name"] = json!("x.png"))
        },
        &[
            "annotations",
            "none of which is a photo of the scene: x.png",
            "v0",
        ],
    );
    broken(
        &|v| {
            v["images"][0]["file_name"] = json!("0123abcd-v1.png");
            v["images"][3]["file_name"] = json!("4567abcd-v1.png");
        },
        &[
            "images",
            "4567abcd-v1.png and another image of this photo",
            "augmentation",
        ],
    );
    broken(
        &|v| *v = json!({ "images": [] }),
        &["line 1", "missing field"],
    );
    let text = good.to_string();
    fs::write(dir.join("coco.json"), &text[..text.len() / 2]).expect("write");
    refused(dir, &named, &["coco.json", "line 1", "EOF"]);
    fs::write(dir.join("coco.json"), text.replacen("10.0", "NaN", 1)).expect("write");
    refused(dir, &named, &["coco.json", "line 1"]);
    // Named as one format, and of another.
    let wrong = LoadOptions {
        raw_format: RawFormat::CocoInstances,
        ..options("nothing")
    };
    refused(dir, &wrong, &["nothing"]);
}

//! Files that begin with the byte order mark that programs of Windows write.

use crate::support::plates::{HEIGHT, WIDTH};
use crate::support::raw_labels::{folder, labelled, options, write};
use coseg::data::{LoadOptions, load, read_cameras};
use coseg::objects::Edits;
use serde_json::json;
use std::fs;
use std::path::Path;

/// Puts the mark in front of the file.
fn mark(path: &Path) {
    let marked = [b"\xEF\xBB\xBF".to_vec(), fs::read(path).expect("read")];
    fs::write(path, marked.concat()).expect("write");
}

#[test]
fn json_may_begin_with_a_byte_order_mark() {
    let folder = folder();
    let dir = folder.path();
    let square = [[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]];
    write(dir, "raw/geometry.json", &json!({ "maps": "photos" }));
    let shape = json!({ "label": "red", "points": square });
    write(dir, "drawn/v1.json", &json!({ "shapes": [shape] }));
    let coco = json!({
        "images": [{ "id": 1, "file_name": "v1.png", "width": WIDTH, "height": HEIGHT }],
        "annotations": [{ "image_id": 1, "category_id": 1, "segmentation": [square.concat()] }],
        "categories": [{ "id": 1, "name": "red" }],
    });
    write(dir, "coco.json", &coco);
    let kinds = [
        LoadOptions::default(),
        options("drawn"),
        options("coco.json"),
    ];
    let expected = kinds.clone().map(|kind| load(dir, &kind).expect("scene"));
    let files = [
        "transforms.json",
        "classes.json",
        "raw/geometry.json",
        "drawn/v1.json",
        "coco.json",
    ];
    for file in files {
        mark(&dir.join(file));
    }
    for (kind, expected) in kinds.iter().zip(expected) {
        let loaded = load(dir, kind).expect("scene");
        assert_eq!(labelled(&loaded), labelled(&expected));
        assert_eq!(loaded.classes, expected.classes);
        assert_eq!(loaded.views[1].raw, expected.views[1].raw);
    }
    let pose = json!({ "img_name": "a", "width": 9, "height": 9, "fx": 9, "fy": 9, "position": [0, 0, 0],
        "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]] });
    write(dir, "cameras.json", &json!([pose]));
    mark(&dir.join("cameras.json"));
    assert_eq!(
        read_cameras(&dir.join("cameras.json"), None)
            .expect("cameras")
            .len(),
        1
    );
    let edits = json!({ "version": 1, "scene": "0".repeat(64), "operations": [] });
    write(dir, "edits.json", &edits);
    mark(&dir.join("edits.json"));
    Edits::read(&dir.join("edits.json")).expect("edits");
}

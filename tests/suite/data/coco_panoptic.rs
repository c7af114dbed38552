//! Raw labels as COCO panoptic maps: whole, then broken.

use crate::support::plates::{HEIGHT, WIDTH};
use crate::support::program::read_json;
use crate::support::raw_labels::{
    associated, folder, maps_of, options, own_maps, refused, save, without_truth,
};
use coseg::config::RawFormat;
use coseg::data::{LabelMap, LoadOptions, check, info, load};
use image::{GrayImage, RgbImage};
use serde_json::json;
use std::fs;
use std::path::Path;

/// Segment id of class `id` in the panoptic maps: needs all three channels.
fn panoptic_id(id: u16) -> u32 {
    70_000 * u32::from(id) + 3
}

fn panoptic_color(id: u16) -> [u8; 3] {
    let [r, g, b, _] = if id == 0 {
        [0; 4]
    } else {
        panoptic_id(id).to_le_bytes()
    };
    [r, g, b]
}

/// COCO panoptic maps of the raw labels in `coco/`, and `coco.json`: a category more than the scene has classes.
fn coco(dir: &Path) -> Vec<LabelMap> {
    let maps = own_maps(dir);
    let mut annotations = Vec::new();
    for (i, map) in maps.iter().enumerate() {
        save(&dir.join(format!("coco/v{i}.png")), map, panoptic_color);
        let mut ids = map.ids.clone();
        ids.sort_unstable();
        ids.dedup();
        let segments: Vec<_> = ids
            .iter()
            .filter(|id| **id > 0)
            .map(|&id| json!({ "id": panoptic_id(id), "category_id": 10 * id, "iscrowd": 0, "area": 1 }))
            .collect();
        annotations.push(
            json!({ "image_id": i, "file_name": format!("v{i}.png"), "segments_info": segments }),
        );
    }
    let category =
        |id: u16, name: &str, thing: u8| json!({ "id": id, "name": name, "isthing": thing });
    let categories = [
        category(10, "Red", 1),
        category(20, "green", 1),
        category(30, "sky-other", 1),
        category(40, "wall", 0),
    ];
    let file = json!({ "annotations": annotations, "categories": categories });
    fs::write(dir.join("coco.json"), file.to_string()).expect("json");
    maps
}

#[test]
fn coco_panoptic_names_classes_and_segments() {
    let folder = folder();
    let dir = folder.path();
    let maps = coco(dir);
    let loaded = load(dir, &options("coco")).expect("scene");
    for (found, map) in maps_of(&loaded).into_iter().zip(&maps) {
        // Class 3, blue, is called otherwise in the JSON, and no class of the scene.
        let want: Vec<u16> = map
            .ids
            .iter()
            .map(|&id| if id == 3 { 0 } else { id })
            .collect();
        assert_eq!(found.ids, want);
    }
    assert!(loaded.views.iter().all(|view| view.segments.is_empty()));
    let notices = check(dir, &options("coco")).notices;
    assert!(
        notices
            .iter()
            .any(|n| n.contains("3 of the 4 classes") && n.contains("coco.json")),
        "{notices:?}"
    );

    let loaded = load(dir, &associated("coco")).expect("scene");
    let segments = &loaded.views[0].segments;
    let told: Vec<_> = segments.iter().map(|s| (s.class, s.thing)).collect();
    assert_eq!(told, [(Some(1), true), (Some(2), true), (Some(4), false)]);
    for (view, map) in loaded.views.iter().zip(&maps) {
        let found = view.raw.as_ref().expect("raw labels").map();
        for (&id, &class) in found.ids.iter().zip(&map.ids) {
            let of = view
                .segments
                .iter()
                .find(|s| s.id == id)
                .and_then(|s| s.class);
            assert_eq!(of, (class != 0 && class != 3).then_some(class));
        }
    }
}

#[test]
fn without_a_class_table_the_categories_are_the_classes() {
    let folder = folder();
    let dir = folder.path();
    let maps = coco(dir);
    without_truth(dir);
    let loaded = load(dir, &options("coco")).expect("scene");
    let classes: Vec<_> = loaded
        .classes
        .entries
        .iter()
        .map(|c| (c.id, &*c.name))
        .collect();
    assert_eq!(
        classes,
        [(10, "Red"), (20, "green"), (30, "sky-other"), (40, "wall")]
    );
    let want: Vec<u16> = maps[2].ids.iter().map(|id| 10 * id).collect();
    assert_eq!(maps_of(&loaded)[2].ids, want);
    // Inside the folder, and as Detectron2 calls it.
    fs::rename(dir.join("coco.json"), dir.join("coco/predictions.json")).expect("rename");
    assert_eq!(
        load(dir, &options("coco")).expect("scene").classes,
        loaded.classes
    );
    let told = info(dir, &associated("coco")).expect("info");
    let segments: usize = maps
        .iter()
        .map(|m| (1..5).filter(|id| m.ids.contains(id)).count())
        .sum();
    assert_eq!((told.segments, told.classes.len()), (segments, 5));
    assert!(told.classes.iter().any(|c| c.name == "wall" && c.raw > 0.2));
    let unlabelled = told.classes.last().expect("unlabelled").raw;
    assert!((told.in_segments + unlabelled - 1.0).abs() < 1e-9);
}

#[test]
fn broken_panoptic_files_are_refused() {
    let folder = folder();
    let dir = folder.path();
    coco(dir);
    let path = dir.join("coco.json");
    let good = read_json(&path);
    let broken = |change: &dyn Fn(&mut serde_json::Value), parts: &[&str]| {
        let mut value = good.clone();
        change(&mut value);
        fs::write(&path, value.to_string()).expect("write");
        refused(dir, &options("coco"), parts);
    };
    broken(
        &|v| v["annotations"][1]["segments_info"][0]["category_id"] = json!(99),
        &[
            "coco.json",
            "annotations[1] (v1.png).segments_info[0].category_id",
            "99",
            "4 ids",
        ],
    );
    broken(
        &|v| v["annotations"][2]["file_name"] = json!("other.png"),
        &["coco.json", "v2.png", "none for", "together"],
    );
    broken(
        &|v| v["annotations"][2]["file_name"] = json!("v1.png"),
        &["coco.json", "second annotation"],
    );
    broken(
        &|v| v["categories"][1]["id"] = json!(10),
        &["coco.json", "categories[1].id", "10 twice"],
    );
    broken(
        &|v| v["categories"] = json!([]),
        &["coco.json", "categories", "none"],
    );
    broken(
        &|v| v["categories"][0]["id"] = json!(4_294_967_295_u32),
        &["categories[0].id", "4294967295", "65534"],
    );
    broken(
        &|v| *v = json!({ "images": [] }),
        &["coco.json", "line 1", "annotations"],
    );
    let last = format!("segment id {}", panoptic_id(4));
    broken(
        &|v| {
            v["annotations"][0]["segments_info"]
                .as_array_mut()
                .expect("list")
                .truncate(3)
        },
        &["v0.png", &last, "pixel x"],
    );
    for name in ["Red", "green", "wall"] {
        assert!(good["categories"].to_string().contains(name));
    }
    broken(
        &|v| {
            v["categories"]
                .as_array_mut()
                .expect("list")
                .iter_mut()
                .for_each(|c| c["name"] = json!("thing"))
        },
        &["coco.json", "categories", "class table", "rename"],
    );
    let text = good.to_string();
    fs::write(&path, &text[..text.len() / 2]).expect("write");
    refused(dir, &options("coco"), &["coco.json", "line 1", "EOF"]);
    fs::write(&path, &text).expect("write");

    let named = LoadOptions {
        raw_format: RawFormat::CocoPanoptic,
        ..options("coco")
    };
    let map = dir.join("coco/v3.png");
    let whole = fs::read(&map).expect("map");
    fs::write(&map, &whole[..whole.len() - 9]).expect("write");
    refused(
        dir,
        &named,
        &["coco/v3.png", "without the end of the image"],
    );
    GrayImage::new(WIDTH as u32, HEIGHT as u32)
        .save(&map)
        .expect("map");
    refused(dir, &named, &["coco/v3.png", "pixel format", "RGB PNG"]);
    RgbImage::new(40, 32).save(&map).expect("map");
    refused(dir, &named, &["coco/v3.png", "40x32", "80x64"]);
    fs::remove_file(&map).expect("remove");
    let loaded = load(dir, &named).expect("a photo without a map is unlabelled");
    assert!(loaded.views[3].raw.is_none() && loaded.views[2].raw.is_some());
    fs::write(&map, whole).expect("write");
    fs::remove_file(&path).expect("remove");
    refused(
        dir,
        &named,
        &["coco", "no such file", "coco.json", "predictions.json"],
    );
}

//! Raw labels as segmenters write them: COCO panoptic, ADE20K colours, folders of masks; whole, then broken.

use crate::support::assert_names;
use crate::support::plates::{HEIGHT, WIDTH, scene};
use crate::support::program::{fails, read_json, succeeds, utf8};
use coseg::config::{Association, RawFormat};
use coseg::data::{LabelMap, LoadOptions, Scene, Segment, check, info, load};
use image::{GrayImage, Luma, Rgb, RgbImage};
use serde_json::json;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

const VIEWS: usize = 6;

fn folder() -> TempDir {
    let folder = tempfile::tempdir().expect("folder");
    scene(folder.path());
    folder
}

/// Takes the true labels and the class table away.
fn without_truth(dir: &Path) {
    let path = dir.join("transforms.json");
    let mut value = read_json(&path);
    for frame in value["frames"].as_array_mut().expect("frames") {
        frame.as_object_mut().expect("frame").remove("label_path");
    }
    fs::write(path, value.to_string()).expect("write");
    fs::remove_file(dir.join("classes.json")).expect("remove");
}

fn options(folder: &str) -> LoadOptions {
    LoadOptions {
        raw_labels: Some(folder.into()),
        ..LoadOptions::default()
    }
}

fn associated(folder: &str) -> LoadOptions {
    LoadOptions {
        association: Association::Gaussians,
        ..options(folder)
    }
}

#[track_caller]
fn refused(dir: &Path, options: &LoadOptions, parts: &[&str]) {
    assert_names(&load(dir, options).expect_err("broken"), parts);
    let problems = check(dir, options).problems;
    assert!(
        problems
            .iter()
            .any(|p| parts.iter().all(|part| p.to_string().contains(part))),
        "{problems:?}"
    );
}

/// Raw labels of the views, from the scene's own grey maps.
fn raw(dir: &Path) -> Vec<LabelMap> {
    let scene = load(dir, &LoadOptions::default()).expect("scene");
    scene
        .views
        .into_iter()
        .map(|view| view.raw.expect("raw labels").map())
        .collect()
}

fn save(path: &Path, map: &LabelMap, color: impl Fn(u16) -> [u8; 3]) {
    fs::create_dir_all(path.parent().expect("folder")).expect("folder");
    let pixel = |x: u32, y: u32| Rgb(color(map.ids[y as usize * map.width + x as usize]));
    RgbImage::from_fn(map.width as u32, map.height as u32, pixel)
        .save(path)
        .expect("map");
}

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
    let maps = raw(dir);
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

fn maps_of(scene: &Scene) -> Vec<LabelMap> {
    scene
        .views
        .iter()
        .map(|view| view.raw.as_ref().expect("raw labels").map())
        .collect()
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

/// Colours of wall (1), floor (4) and chair (20) of ADE20K.
const ADE: [(u16, [u8; 3]); 3] = [(1, [120, 120, 120]), (4, [80, 50, 50]), (20, [204, 70, 3])];

/// ADE's class for a label of the plates.
fn ade(id: u16) -> (u16, [u8; 3]) {
    match id {
        0 => (0, [0; 3]),
        4 => ADE[0],
        1 => ADE[2],
        _ => ADE[1],
    }
}

/// A PNG with a palette: header, colours, uncompressed rows.
fn indexed(map: &LabelMap, colors: &[[u8; 3]], index: impl Fn(u16) -> u8) -> Vec<u8> {
    let crc = |bytes: &[u8]| {
        !bytes.iter().fold(!0_u32, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |c, _| {
                if c & 1 == 1 {
                    c >> 1 ^ 0xEDB8_8320
                } else {
                    c >> 1
                }
            })
        })
    };
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |kind: &[u8], data: &[u8]| {
        out.extend((data.len() as u32).to_be_bytes());
        out.extend(kind);
        out.extend(data);
        out.extend(crc(&[kind, data].concat()).to_be_bytes());
    };
    let size = [map.width as u32, map.height as u32]
        .map(u32::to_be_bytes)
        .concat();
    chunk(b"IHDR", &[&size[..], &[8, 3, 0, 0, 0]].concat());
    chunk(b"PLTE", colors.as_flattened());
    let rows: Vec<u8> = map
        .ids
        .chunks(map.width)
        .flat_map(|row| std::iter::once(0).chain(row.iter().map(|id| index(*id))))
        .collect();
    let (mut a, mut b) = (1_u32, 0_u32);
    for &byte in &rows {
        a = (a + u32::from(byte)) % 65_521;
        b = (b + a) % 65_521;
    }
    let length = rows.len() as u16;
    let stored = [
        &[0x78, 1, 1][..],
        &length.to_le_bytes(),
        &(!length).to_le_bytes(),
        &rows,
        &(b << 16 | a).to_be_bytes(),
    ];
    chunk(b"IDAT", &stored.concat());
    chunk(b"IEND", &[]);
    out
}

#[test]
fn ade20k_colours_are_classes() {
    let folder = folder();
    let dir = folder.path();
    let maps = raw(dir);
    let colors = [[0; 3], ADE[0].1, ADE[1].1, ADE[2].1];
    let index = |id: u16| colors.iter().position(|c| *c == ade(id).1).expect("colour") as u8;
    for (i, map) in maps.iter().enumerate() {
        save(&dir.join(format!("ade/v{i}.png")), map, |id| ade(id).1);
        fs::create_dir_all(dir.join("indexed")).expect("folder");
        fs::write(
            dir.join(format!("indexed/v{i}.png")),
            indexed(map, &colors, index),
        )
        .expect("map");
    }
    // Of ADE's classes the scene has the wall alone.
    let loaded = load(dir, &options("ade")).expect("scene");
    let want: Vec<u16> = maps[1]
        .ids
        .iter()
        .map(|&id| if id == 4 { 4 } else { 0 })
        .collect();
    assert_eq!(maps_of(&loaded)[1].ids, want);
    // Where nothing is to be put together, stuff stays one segment a class.
    let stuff = load(dir, &associated("ade")).expect("scene");
    assert!(stuff.views[0].segments.contains(&Segment {
        id: 4,
        class: Some(4),
        thing: false
    }));

    without_truth(dir);
    for name in ["ade", "indexed"] {
        let loaded = load(dir, &options(name)).expect(name);
        let classes: Vec<_> = loaded
            .classes
            .entries
            .iter()
            .map(|c| (c.id, &*c.name))
            .collect();
        assert_eq!(
            classes,
            [(1, "wall"), (4, "floor"), (20, "chair")],
            "{name}: those that occur"
        );
        let want: Vec<u16> = maps[3].ids.iter().map(|&id| ade(id).0).collect();
        assert_eq!(maps_of(&loaded)[3].ids, want, "{name}");
    }

    let path = dir.join("ade/v4.png");
    let mut image = image::open(&path).expect("map").into_rgb8();
    image.put_pixel(7, 9, Rgb([1, 2, 3]));
    image.save(&path).expect("map");
    refused(
        dir,
        &options("ade"),
        &["ade/v4.png", "x 7, y 9", "[1, 2, 3]", "150 colours"],
    );
    maps[4].write(&path).expect("map");
    refused(
        dir,
        &options("ade"),
        &["ade/v4.png", "pixel format", "grey", "data.raw_format"],
    );
}

fn mask(path: &Path, covers: impl Fn(u32, u32) -> bool) {
    fs::create_dir_all(path.parent().expect("folder")).expect("folder");
    let pixel = |x, y| Luma([if covers(x, y) { 255 } else { 0 }]);
    GrayImage::from_fn(WIDTH as u32, HEIGHT as u32, pixel)
        .save(path)
        .expect("mask");
}

/// Three masks a photo: a large one, one within it, one that laps over its rim, and as large as the second.
fn sam(dir: &Path) {
    for i in 0..VIEWS {
        let at = |n: usize| dir.join(format!("sam/v{i}/{n}.png"));
        mask(&at(0), |x, y| x < 40 && y < 40);
        mask(&at(2), |x, y| x < 10 && y < 10);
        mask(&at(10), |x, y| (35..45).contains(&x) && y < 10);
        let rows = "0,1600,0,0,40,40,0.9\n2,100,0,0,10,10,0.8\n10,100,35,0,10,10,0.95\n";
        fs::write(
            dir.join(format!("sam/v{i}/metadata.csv")),
            format!("id,area,bbox_x0,..\n{rows}"),
        )
        .expect("table");
    }
}

#[test]
fn folders_of_masks_are_one_map_each() {
    let folder = folder();
    let dir = folder.path();
    sam(dir);
    let loaded = load(dir, &associated("sam")).expect("scene");
    for map in maps_of(&loaded) {
        let at = |x: usize, y: usize| map.ids[y * WIDTH + x];
        // The third mask is number 10; small masks lie over large ones.
        assert_eq!(
            [
                at(5, 5),
                at(20, 20),
                at(37, 5),
                at(44, 5),
                at(37, 15),
                at(60, 60)
            ],
            [2, 1, 3, 3, 1, 0]
        );
    }
    assert!(loaded.views.iter().all(|view| view.segments.is_empty()));
    assert_eq!(
        info(dir, &associated("sam")).expect("info").segments,
        3 * VIEWS
    );
    refused(
        dir,
        &options("sam"),
        &["data.association", "gaussians", "differ from view to view"],
    );

    let raw = format!("data.raw_labels={}", "sam");
    let arguments = ["--set", &raw, "--set", "data.association=gaussians"];
    let said = succeeds(&[&["data", "check", utf8(dir)][..], &arguments].concat());
    assert!(said.contains("no problems"), "{said}");
    let said = succeeds(&[&["data", "info", utf8(dir)][..], &arguments].concat());
    assert!(said.contains("18 in the raw labels"), "{said}");
    let message = fails(&["data", "check", utf8(dir), "--set", &raw], 1);
    assert!(message.contains("data.association"), "{message}");
    let message = fails(
        &["data", "check", utf8(dir), "--set", "data.raw_format=coco"],
        2,
    );
    assert!(message.contains("coco_panoptic"), "{message}");
}

#[test]
fn broken_folders_of_masks_are_refused() {
    let folder = folder();
    let dir = folder.path();
    sam(dir);
    let options = associated("sam");
    let at = |file: &str| dir.join("sam/v1").join(file);
    let table = fs::read_to_string(at("metadata.csv")).expect("table");
    let rewrite = |text: String| fs::write(at("metadata.csv"), text).expect("table");
    rewrite(format!("{table}11,5\n"));
    refused(
        dir,
        &options,
        &["v1/metadata.csv", "line 5, id", "11", "11.png"],
    );
    rewrite(table.replace("\n10,", "\nten,"));
    refused(dir, &options, &["v1/metadata.csv", "line 4, id", "\"ten\""]);
    rewrite(table.lines().take(3).collect::<Vec<_>>().join("\n"));
    refused(
        dir,
        &options,
        &["v1/metadata.csv", "rows", "none for 10.png"],
    );
    fs::remove_file(at("metadata.csv")).expect("remove");
    load(dir, &options).expect("no table is needed");

    let whole = fs::read(at("2.png")).expect("mask");
    fs::write(at("2.png"), &whole[..whole.len() - 3]).expect("write");
    refused(dir, &options, &["v1/2.png", "without the end of the image"]);
    GrayImage::new(64, 80).save(at("2.png")).expect("mask");
    refused(dir, &options, &["v1/2.png", "64x80", "80x64"]);
    RgbImage::new(WIDTH as u32, HEIGHT as u32)
        .save(at("2.png"))
        .expect("mask");
    refused(dir, &options, &["v1/2.png", "pixel format", "grey PNG"]);
    fs::write(at("2.png"), whole).expect("write");
    fs::write(at("02.png"), fs::read(at("2.png")).expect("mask")).expect("write");
    refused(
        dir,
        &options,
        &["sam/v1", "number 2", "one file for each number"],
    );
    fs::rename(at("02.png"), at("best.png")).expect("rename");
    refused(dir, &options, &["sam/v1", "best.png", "whole numbers"]);
    fs::remove_dir_all(dir.join("sam/v1")).expect("remove");
    let named = LoadOptions {
        raw_format: RawFormat::Masks,
        ..options
    };
    let loaded = load(dir, &named).expect("a photo without masks is unlabelled");
    assert!(loaded.views[1].raw.is_none() && loaded.views[2].raw.is_some());
    fs::create_dir(dir.join("sam/v1")).expect("folder");
    refused(dir, &named, &["sam/v1", "no PNG files"]);
}

#[test]
fn folders_of_masks_are_found_in_a_colmap_scene() {
    let folder = folder();
    let dir = folder.path();
    sam(dir);
    fs::rename(dir.join("sam"), dir.join("labels_raw")).expect("rename");
    fs::remove_file(dir.join("transforms.json")).expect("remove");
    fs::create_dir_all(dir.join("sparse/0")).expect("folder");
    fs::write(
        dir.join("sparse/0/cameras.txt"),
        format!("1 PINHOLE {WIDTH} {HEIGHT} 80 80 40 32\n"),
    )
    .expect("cameras");
    let images = (0..VIEWS).map(|i| format!("{} 1 0 0 0 {i} 0 0 1 v{i}.png\n\n", i + 1));
    fs::write(dir.join("sparse/0/images.txt"), images.collect::<String>()).expect("images");
    fs::write(dir.join("sparse/0/points3D.txt"), "").expect("points");
    fs::create_dir(dir.join("instances")).expect("folder");
    fs::copy(dir.join("labels/v3.png"), dir.join("instances/v3.png")).expect("instances");
    let options = LoadOptions {
        association: Association::Gaussians,
        ..LoadOptions::default()
    };
    let loaded = load(dir, &options).expect("scene");
    assert_eq!(
        maps_of(&loaded)[4]
            .ids
            .iter()
            .filter(|id| **id == 3)
            .count(),
        100
    );
    let known: Vec<&str> = loaded
        .views
        .iter()
        .filter(|v| v.instances.is_some())
        .map(|v| &*v.name)
        .collect();
    assert_eq!(known, ["v3"]);
}

//! Raw labels as folders of masks, one for each photo: whole, then broken.

use crate::support::plates::{HEIGHT, WIDTH};
use crate::support::program::{fails, succeeds, utf8};
use crate::support::raw_labels::{associated, folder, maps_of, options, refused};
use coseg::config::{Association, RawFormat};
use coseg::data::{LoadOptions, info, load};
use image::{GrayImage, Luma, RgbImage};
use std::fs;
use std::path::Path;

const VIEWS: usize = 6;

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
    // 40 x 40 pixels, and half of the mask over their rim.
    assert!(said.contains("18 in the raw labels, 32.23 % of"), "{said}");
    let line = |name: &str| {
        let line = said.lines().find(|line| line.ends_with(name));
        line.expect(name).split_whitespace().nth(2).expect("raw")
    };
    assert_eq!(
        [line("red"), line("wall"), line("unlabelled")],
        ["-", "-", "67.77%"]
    );
    let told = info(dir, &associated("sam")).expect("info");
    assert_eq!(told.in_segments, 1650.0 / 5120.0);
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

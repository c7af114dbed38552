//! Masks of LabelMe, as its AI tools draw them: whole, then broken.

use crate::support::labelme_files::{labelme, rectangle, shape};
use crate::support::plates::{HEIGHT, WIDTH};
use crate::support::raw_labels::{at, folder, options, raw, refused, write};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use coseg::data::load;
use image::{DynamicImage, GrayImage, ImageFormat, RgbImage};
use serde_json::{Value, json};
use std::io::Cursor;

/// A mask of these pixels, row by row, with the corners of its box.
fn mask(label: &str, corners: Value, (width, height): (u32, u32), pixels: &[u8]) -> Value {
    let picture = GrayImage::from_raw(width, height, pixels.to_vec()).expect("pixels");
    let mut shape = shape(label, "mask", corners);
    shape["mask"] = json!(base64(&picture.into()));
    shape
}

/// The picture as PNG in base64.
fn base64(picture: &DynamicImage) -> String {
    let mut png = Cursor::new(Vec::new());
    picture.write_to(&mut png, ImageFormat::Png).expect("PNG");
    STANDARD.encode(png.into_inner())
}

#[test]
fn masks_of_labelme_are_painted_in_their_boxes() {
    let folder = folder();
    let dir = folder.path();
    // . # #
    // # . .
    let pixels = [0, 1, 1, 255, 0, 0];
    let rim = json!([[77.0, 62.0], [80.0, 64.0]]);
    let shapes = [
        shape("Wall", "rectangle", rectangle(0.0, 0.0, 80.0, 64.0)),
        mask("red", rectangle(50.0, 50.0, 52.0, 51.0), (3, 2), &pixels),
        mask("green", rim, (3, 2), &[1; 6]),
        mask("blue", rectangle(10.9, 10.9, 11.9, 10.9), (2, 1), &[0, 7]),
    ];
    write(dir, "drawn/v0.json", &labelme(&shapes));
    let map = raw(&load(dir, &options("drawn")).expect("scene"), 0);
    let places = [
        (50, 50),
        (51, 50),
        (52, 50),
        (50, 51),
        (51, 51),
        (53, 50),
        (50, 52),
    ];
    assert_eq!(at(&map, &places), [4, 1, 1, 1, 4, 4, 4]);
    let places = [(76, 62), (77, 62), (79, 63), (77, 61)];
    assert_eq!(at(&map, &places), [4, 2, 2, 4]);
    assert_eq!(at(&map, &[(10, 10), (11, 10), (12, 10)]), [4, 3, 4]);
    // On a reduced copy, a pixel stands for four.
    let mut half = labelme(&[mask("red", rectangle(5.0, 5.0, 6.0, 5.0), (2, 1), &[0, 1])]);
    half["imageWidth"] = json!(WIDTH / 2);
    half["imageHeight"] = json!(HEIGHT / 2);
    write(dir, "drawn/v0.json", &half);
    let map = raw(&load(dir, &options("drawn")).expect("scene"), 0);
    let places = [(11, 10), (12, 10), (13, 11), (14, 10), (12, 12)];
    assert_eq!(at(&map, &places), [0, 1, 1, 0, 0]);
}

#[test]
fn broken_masks_of_labelme_are_refused() {
    let folder = folder();
    let dir = folder.path();
    let good = mask("red", rectangle(50.0, 50.0, 52.0, 51.0), (3, 2), &[1; 6]);
    let broken = |change: &dyn Fn(&mut Value), parts: &[&str]| {
        let mut value = labelme(std::slice::from_ref(&good));
        change(&mut value);
        write(dir, "drawn/v0.json", &value);
        refused(dir, &options("drawn"), &[&["v0.json"], parts].concat());
    };
    let field = "shapes[0] (red).mask";
    let with_mask = |mask: Value, parts: &[&str]| {
        broken(
            &|v| v["shapes"][0]["mask"] = mask.clone(),
            &[&[field, "a grey PNG in base64"], parts].concat(),
        );
    };
    with_mask(json!(null), &["nothing"]);
    with_mask(json!("no base64"), &["Invalid"]);
    with_mask(json!("aGVsbG8="), &["hello"]);
    let whole = good["mask"].as_str().expect("mask");
    with_mask(json!(whole[..whole.len() / 8 * 4]), &["without the end"]);
    with_mask(json!(base64(&RgbImage::new(3, 2).into())), &["colours"]);
    for corners in [
        rectangle(50.0, 50.0, 54.0, 51.0),
        rectangle(50.0, 50.0, 52.0, 49.0),
        rectangle(52.0, 51.0, 50.0, 50.0),
        rectangle(-1.0, 50.0, 1.0, 51.0),
        rectangle(78.0, 50.0, 80.0, 51.0),
        rectangle(1e300, 50.0, 1e300, 51.0),
    ] {
        broken(
            &|v| v["shapes"][0]["points"] = corners.clone(),
            &[field, "3x2 pixels for", "80x64"],
        );
    }
    broken(
        &|v| v["shapes"][0]["points"] = json!([[1.0, 2.0]]),
        &["shapes[0] (red).points", "1 of a mask"],
    );
    broken(
        &|v| v["imageWidth"] = json!(null),
        &[field, "no imageWidth"],
    );
    broken(&|v| v["imageWidth"] = json!(u64::MAX), &["pixels", "limit"]);
    // A PNG whose header says that it is larger than any picture.
    let mut bytes = STANDARD.decode(whole).expect("base64");
    bytes[16..24].fill(0x7F);
    broken(
        &|v| v["shapes"][0]["mask"] = json!(STANDARD.encode(&bytes)),
        &["v0.json"],
    );
    let rows = |x: usize| (x % 2) as u8;
    let fine: Vec<u8> = (0..WIDTH * HEIGHT).map(rows).collect();
    let size = (WIDTH as u32, HEIGHT as u32);
    let corners = rectangle(0.0, 0.0, WIDTH as f64, HEIGHT as f64);
    let fine = mask("red", corners, size, &fine);
    broken(
        &|v| v["shapes"] = json!(vec![fine.clone(); 900]),
        &["runs of pixels", "limit", "4194304"],
    );
}

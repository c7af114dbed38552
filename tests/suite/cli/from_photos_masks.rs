//! `coseg from-photos --masks`, with scripts in the place of colmap and Python.

use crate::support::exif_photo::photo;
use crate::support::plates::{HEIGHT, WIDTH};
use crate::support::program::{listed, text, utf8};
use crate::support::programs::Sandbox;
use coseg::data::{LoadOptions, load};
use image::{GrayImage, Luma};
use std::fs;
use std::path::Path;

/// A grey picture that is black where `left_out`, and 7 elsewhere.
fn mask(path: &Path, (width, height): (u32, u32), left_out: impl Fn(u32, u32) -> bool) {
    let pixel = |x, y| Luma([if left_out(x, y) { 0 } else { 7 }]);
    let mask = GrayImage::from_fn(width, height, pixel);
    mask.save(path).unwrap();
}

fn pixel(path: &Path, x: u32, y: u32) -> u8 {
    image::open(path).unwrap().into_luma8().get_pixel(x, y).0[0]
}

#[test]
fn masks_go_to_colmap_and_into_the_scene_folder() {
    for python in [false, true] {
        let sandbox = Sandbox::new();
        let photos = sandbox.photos();
        let masks = sandbox.path("people");
        let room = sandbox.path("room");
        if python {
            sandbox.pycolmap();
        } else {
            sandbox.colmap();
        }
        fs::create_dir(&masks).unwrap();
        // Of half the size.
        let half = (WIDTH as u32 / 2, HEIGHT as u32 / 2);
        for name in ["Bild ö 1.png", "Bild ö 3.png.png"] {
            mask(&masks.join(name), half, |x, _| x < half.0 / 2);
        }
        let given = ["--masks", utf8(&masks)];
        let said = sandbox.succeeds(&photos, &given);
        assert!(said.contains("6 photos (2 with masks)"), "{said}");
        let arguments = fs::read_to_string(sandbox.path("arguments")).unwrap();
        let to_colmap = room.join("masks");
        assert!(arguments.contains(utf8(&to_colmap)), "{arguments}");
        assert_eq!(python, !arguments.contains("--ImageReader.mask_path"));
        // COLMAP leaves photos without a mask out, so that each one has a mask.
        let names: Vec<String> = (0..6).map(|i| format!("Bild ö {i}.png.png")).collect();
        assert_eq!(listed(&to_colmap), names);
        for (i, name) in names.iter().enumerate() {
            let file = to_colmap.join(name);
            let left = if [1, 3].contains(&i) { 0 } else { 255 };
            assert_eq!(pixel(&file, WIDTH as u32 / 2 - 1, 5), left, "{name}");
            assert_eq!(pixel(&file, WIDTH as u32 / 2, 5), 255, "{name}");
        }
        let scene = load(&room, &LoadOptions::default()).unwrap();
        let masked: Vec<bool> = scene.views.iter().map(|view| view.mask.is_some()).collect();
        assert_eq!(masked, [false, true, false, true, false, false]);
        // They are part of what the folder was made from.
        sandbox.succeeds(&photos, &given);
        sandbox.fails(&photos, &[], &["--out", "made from", "masks"]);
    }
}

#[test]
fn masks_are_turned_with_their_photos() {
    let sandbox = Sandbox::new();
    sandbox.script("colmap", "exit 0");
    let (photos, masks) = (sandbox.path("photos"), sandbox.path("people"));
    fs::create_dir(&photos).unwrap();
    fs::create_dir(&masks).unwrap();
    for name in ["a.jpg", "b.jpg"] {
        photo(&photos.join(name), (30, 20), 6);
    }
    // The upper half as the photo is stored, which is the right one once it is turned; and the upper half of the turned photo.
    mask(&masks.join("a.png"), (30, 20), |_, y| y < 10);
    mask(&masks.join("b.jpg.png"), (20, 30), |_, y| y < 15);
    let given = ["--masks", utf8(&masks)];
    let output = sandbox.run(&photos, &given);
    let said = text(&output.stderr);
    assert!(said.contains("none of 2 photos"), "{said}");
    assert!(!said.contains("EXIF"), "{said}");
    let written = sandbox.path("room/masks");
    let corners = |name: &str| {
        let places = [(0, 0), (19, 0), (0, 29), (19, 29)];
        places.map(|(x, y)| pixel(&written.join(name), x, y))
    };
    assert_eq!(corners("a.jpg.png"), [255, 0, 255, 0]);
    assert_eq!(corners("b.jpg.png"), [0, 0, 255, 255]);
}

#[test]
fn masks_of_photos_that_turn_without_a_trace_are_taken_as_stored() {
    // Upside down, and a quarter turn of equal sides.
    for (size, orientation, turned) in [
        ((30, 20), 3, [255, 255, 0, 0]),
        ((20, 20), 6, [255, 0, 255, 0]),
    ] {
        let sandbox = Sandbox::new();
        sandbox.script("colmap", "exit 0");
        let (photos, masks) = (sandbox.path("photos"), sandbox.path("people"));
        fs::create_dir(&photos).unwrap();
        fs::create_dir(&masks).unwrap();
        for name in ["a.jpg", "b.jpg", "c.jpg"] {
            photo(&photos.join(name), size, orientation);
        }
        let (width, height) = (size.0 as u32, size.1 as u32);
        for name in ["b.png", "c.png"] {
            mask(&masks.join(name), (width, height), |_, y| y < 10);
        }
        let output = sandbox.run(&photos, &["--masks", utf8(&masks)]);
        let said = text(&output.stderr);
        let warnings: Vec<&str> = said.lines().filter(|line| line.contains("EXIF")).collect();
        let [warning] = warnings[..] else {
            panic!("not one warning: {said}");
        };
        assert!(
            warning.contains("b.jpg") && warning.contains("as the photo is stored"),
            "{said}"
        );
        let written = sandbox.path("room/masks/b.jpg.png");
        let (right, low) = (width - 1, height - 1);
        let corners = [(0, 0), (right, 0), (0, low), (right, low)];
        assert_eq!(
            corners.map(|(x, y)| pixel(&written, x, y)),
            turned,
            "{orientation}"
        );
    }
}

#[test]
fn nothing_is_written_before_all_masks_are_right() {
    let sandbox = Sandbox::new();
    sandbox.script("colmap", "exit 0");
    let (photos, masks) = (sandbox.path("photos"), sandbox.path("people"));
    fs::create_dir(&photos).unwrap();
    fs::create_dir(&masks).unwrap();
    let names: Vec<String> = (10..60).map(|i| format!("{i}.jpg")).collect();
    for name in &names {
        photo(&photos.join(name), (30, 20), 6);
        mask(&masks.join(format!("{name}.png")), (30, 20), |_, y| y < 10);
    }
    let given = ["--masks", utf8(&masks)];
    let last = masks.join("59.jpg.png");
    let whole = fs::read(&last).unwrap();
    let refused = |parts: &[&str]| {
        sandbox.fails(&photos, &given, &[&["59.jpg.png"], parts].concat());
        for part in ["images", "masks", "from-photos.json"] {
            assert!(!sandbox.path("room").join(part).exists(), "{part}");
        }
    };
    mask(&last, (30, 30), |_, y| y < 10);
    refused(&["30x30 pixels", "30x20"]);
    // The header is right, the pixels are not.
    let mut damaged = whole.clone();
    let data = whole.windows(4).position(|name| name == b"IDAT").unwrap();
    damaged[data + 4] ^= 0xFF;
    fs::write(&last, damaged).unwrap();
    refused(&["image data"]);
    // The same folder is filled once it is corrected.
    fs::write(&last, whole).unwrap();
    sandbox.fails(&photos, &given, &["none of 50 photos"]);
    assert_eq!(listed(&sandbox.path("room/images")), names);
    assert_eq!(listed(&sandbox.path("room/masks")).len(), 50);
}

#[test]
fn masks_that_fit_no_photo_are_refused() {
    let sandbox = Sandbox::new();
    sandbox.colmap();
    let (photos, masks) = (sandbox.photos(), sandbox.path("people"));
    let given = ["--masks", utf8(&masks)];
    sandbox.fails(&photos, &given, &["no such folder", "people"]);
    fs::create_dir(&masks).unwrap();
    mask(&masks.join("Bild 1.png"), (80, 64), |x, _| x < 9);
    sandbox.fails(
        &photos,
        &given,
        &["--masks", "no mask of any photo", "a.jpg.png"],
    );
    // The photos themselves are not masks.
    let of_photos = ["--masks", utf8(&photos)];
    sandbox.fails(&photos, &of_photos, &["--masks", "no mask of any photo"]);
    let video = sandbox.path("walk.mp4");
    fs::write(&video, "film").unwrap();
    sandbox.fails(&video, &given, &["--masks", "masks of a video"]);
    assert!(sandbox.log().is_empty());
}

//! Masks of photos: how they are read in each layout, and what they leave out.

use crate::support::colmap;
use crate::support::masked_plates::{ONE_BIT, PIXELS, corner, grey, is_corner, masked, used};
use crate::support::plates::{HEIGHT, WIDTH, scene};
use crate::support::program::{fails, succeeds, utf8};
use crate::support::transforms_json::edit;
use coseg::data::{LabelMap, LoadOptions, Scene, View, check, load};
use image::{DynamicImage, Luma};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

fn loaded(dir: &Path, options: &LoadOptions) -> Scene {
    load(dir, options).unwrap()
}

fn view<'a>(scene: &'a Scene, name: &str) -> &'a View {
    scene.views.iter().find(|view| view.name == name).unwrap()
}

#[test]
fn masks_leave_pixels_out_and_labels_unlabelled() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let options = LoadOptions::default();
    masked(dir);
    let instances = LabelMap {
        width: WIDTH,
        height: HEIGHT,
        ids: vec![9; WIDTH * HEIGHT],
    };
    instances.write(&dir.join("instances.png")).unwrap();
    edit(dir, |v| {
        v["frames"][1]["instance_path"] = json!("instances.png")
    });
    let scene = loaded(dir, &options);
    let found = view(&scene, "v1");
    let mask = found.mask.as_ref().unwrap();
    assert!(is_corner(mask) && mask.left_out() == PIXELS);
    assert!(
        scene
            .views
            .iter()
            .all(|view| view.mask.is_some() == (view.name == "v1"))
    );
    edit(dir, |v| {
        _ = v["frames"][1].as_object_mut().unwrap().remove("mask_path")
    });
    let whole = loaded(dir, &options);
    let whole = view(&whole, "v1");
    assert_eq!(
        found.image.pixels().unwrap(),
        whole.image.pixels().unwrap(),
        "photos stay as they are"
    );
    for (found, whole) in [
        (&found.truth, &whole.truth),
        (&found.raw, &whole.raw),
        (&found.instances, &whole.instances),
    ] {
        let (found, whole) = (found.as_ref().unwrap().map(), whole.as_ref().unwrap().map());
        assert!(
            (0..WIDTH * HEIGHT)
                .all(|i| found.ids[i] == if mask.uses(i) { whole.ids[i] } else { 0 })
        );
        assert_ne!(found, whole);
    }
}

#[test]
fn black_is_left_out_whatever_the_png_holds() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    masked(dir);
    let (w, h) = (WIDTH as u32, HEIGHT as u32);
    let pick = |x: u32, y: u32, shown: [u8; 4], hidden: [u8; 4]| {
        image::Rgba(if used(x, y) { shown } else { hidden })
    };
    let rgba = |shown, hidden| -> DynamicImage {
        image::RgbaImage::from_fn(w, h, |x, y| pick(x, y, shown, hidden)).into()
    };
    let sixteen =
        image::ImageBuffer::<Luma<u16>, _>::from_fn(w, h, |x, y| Luma([u16::from(used(x, y))]));
    let kinds = [
        corner(),
        DynamicImage::ImageLuma16(sixteen),
        // One colour alone, grey with alpha, and what is transparent.
        rgba([0, 0, 1, 255], [0, 0, 0, 255]).into_rgb8().into(),
        rgba([7, 7, 7, 255], [0, 0, 0, 255])
            .into_luma_alpha8()
            .into(),
        rgba([255, 255, 255, 1], [255, 255, 255, 0]),
        rgba([255, 255, 255, 255], [0, 0, 0, 255]),
    ];
    for (i, kind) in kinds.into_iter().enumerate() {
        kind.save(dir.join("masks/v1.png")).unwrap();
        let scene = loaded(dir, &LoadOptions::default());
        assert!(
            is_corner(view(&scene, "v1").mask.as_ref().unwrap()),
            "kind {i}"
        );
    }
    let bytes = ONE_BIT
        .as_bytes()
        .chunks(2)
        .map(|two| u8::from_str_radix(str::from_utf8(two).unwrap(), 16).unwrap());
    fs::write(dir.join("masks/v1.png"), bytes.collect::<Vec<u8>>()).unwrap();
    assert!(
        is_corner(
            view(&loaded(dir, &LoadOptions::default()), "v1")
                .mask
                .as_ref()
                .unwrap()
        ),
        "one bit"
    );
    // A mask that leaves nothing out is none.
    grey(w, h, |_, _| true)
        .save(dir.join("masks/v1.png"))
        .unwrap();
    assert!(
        view(&loaded(dir, &LoadOptions::default()), "v1")
            .mask
            .is_none()
    );
}

#[test]
fn masks_go_the_way_of_label_maps() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    scene(dir);
    // A ring as a label map and as a mask, through a lens, reduced, and from a file of half the size.
    let ring = |x: u32, y: u32| {
        ((x as f64 - 31.0).powi(2) + (y as f64 - 40.0).powi(2)).sqrt() as u32 % 16 < 9
    };
    let ids = |w: u32, h: u32| {
        (0..w * h)
            .map(|i| 1 + u16::from(ring(i % w, i / w)))
            .collect()
    };
    let (w, h) = (WIDTH as u32, HEIGHT as u32);
    LabelMap {
        width: WIDTH,
        height: HEIGHT,
        ids: ids(w, h),
    }
    .write(&dir.join("labels/v0.png"))
    .unwrap();
    fs::create_dir(dir.join("masks")).unwrap();
    let both = |options: &LoadOptions| {
        edit(dir, |v| v["frames"][0]["mask_path"] = json!("masks/v0.png"));
        let mask = view(&loaded(dir, options), "v0").mask.clone().unwrap();
        edit(dir, |v| {
            _ = v["frames"][0].as_object_mut().unwrap().remove("mask_path")
        });
        (
            mask,
            view(&loaded(dir, options), "v0")
                .truth
                .clone()
                .unwrap()
                .map(),
        )
    };
    grey(w, h, ring).save(dir.join("masks/v0.png")).unwrap();
    for k1 in [0.0, -0.2] {
        edit(dir, |v| v["k1"] = json!(k1));
        for max_side in [0, 50, 40] {
            let (mask, labels) = both(&LoadOptions {
                max_side,
                ..LoadOptions::default()
            });
            assert_eq!((mask.width(), mask.height()), (labels.width, labels.height));
            assert!(
                labels
                    .ids
                    .iter()
                    .enumerate()
                    .all(|(i, id)| mask.uses(i) == (*id == 2)),
                "{k1} {max_side}"
            );
        }
    }
    edit(dir, |v| v["k1"] = json!(0));
    grey(w / 2, h / 2, ring)
        .save(dir.join("masks/v0.png"))
        .unwrap();
    let (mask, _) = both(&LoadOptions::default());
    assert!(
        (0..WIDTH * HEIGHT).all(|i| mask.uses(i) == ring(i as u32 % w / 2, i as u32 / w / 2)),
        "nearest"
    );
}

#[test]
fn masks_of_colmap_projects_are_found_by_name() {
    let folder = colmap::scene(colmap::text, &colmap::pinhole());
    let dir = folder.path();
    let options = LoadOptions::default();
    let mask = |folder: &str, name: &str| {
        let path = dir.join(folder).join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        grey(16, 12, |x, _| x > 2).save(path).unwrap();
    };
    mask("masks", &format!("{}.png", colmap::name(1)));
    mask("masks", &colmap::name(2));
    mask("masks", "photo 5.png");
    let scene = loaded(dir, &options);
    let with: Vec<&str> = scene
        .views
        .iter()
        .filter(|view| view.mask.is_some())
        .map(|view| &*view.name)
        .collect();
    assert_eq!(with, ["cam0_photo 2", "cam1_photo 1", "cam1_photo 5"]);
    assert!(
        scene
            .views
            .iter()
            .filter_map(|view| view.mask.as_ref())
            .all(|mask| mask.left_out() == 36)
    );
    let checked = check(dir, &options);
    let told = "6 of 9 photos have no mask and are used whole: cam0_photo 0, cam0_photo 4, cam0_photo 6 and 3 more";
    assert!(
        checked.problems.is_empty() && checked.notices.iter().any(|n| n == told),
        "{checked:?}"
    );
    // Another folder, which has to exist. One with other names is reported.
    let named = |name: &str| LoadOptions {
        masks: Some(name.into()),
        ..LoadOptions::default()
    };
    for i in 0..colmap::VIEWS {
        mask("people", &colmap::name(i));
    }
    assert!(
        loaded(dir, &named("people"))
            .views
            .iter()
            .all(|view| view.mask.is_some())
    );
    let error = load(dir, &named("nobody")).unwrap_err();
    crate::support::assert_names(&error, &["nobody", "no such folder", "data.masks"]);
    mask("others", "a.png");
    let notices = check(dir, &named("others")).notices;
    assert!(
        notices
            .iter()
            .any(|n| n.starts_with("no photo has a mask in others")),
        "{notices:?}"
    );
    // Photos of half the size in a folder that is named: masks follow.
    for i in 0..colmap::VIEWS {
        let path = dir.join("images_2").join(colmap::name(i));
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        image::RgbImage::new(8, 6).save(path).unwrap();
    }
    let half = LoadOptions {
        images: "images_2".into(),
        ..LoadOptions::default()
    };
    let mask = view(&loaded(dir, &half), "cam0_photo 2")
        .mask
        .clone()
        .unwrap();
    assert_eq!((mask.width(), mask.height(), mask.left_out()), (8, 6, 6));
}

#[test]
fn a_folder_of_masks_serves_every_layout() {
    let named = LoadOptions {
        masks: Some("people".into()),
        ..LoadOptions::default()
    };
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    masked(dir);
    fs::create_dir(dir.join("people")).unwrap();
    corner().save(dir.join("people/v4.png.png")).unwrap();
    let scene = loaded(dir, &named);
    let with: Vec<&str> = scene
        .views
        .iter()
        .filter(|view| view.mask.is_some())
        .map(|view| &*view.name)
        .collect();
    assert_eq!(with, ["v4"], "not those that the frames name");
    let scannet = crate::support::scannet::scene();
    fs::create_dir(scannet.path().join("people")).unwrap();
    grey(64, 48, |_, y| y > 9)
        .save(scannet.path().join("people/5.png"))
        .unwrap();
    let scene = loaded(scannet.path(), &named);
    assert_eq!(view(&scene, "5").mask.as_ref().unwrap().left_out(), 640);
    assert!(view(&scene, "6").mask.is_none());
}

#[test]
fn info_counts_masks_and_draws_them() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    masked(dir);
    let without = |v: &mut Value| _ = v["frames"][1].as_object_mut().unwrap().remove("mask_path");
    let info = || {
        succeeds(&[
            "data",
            "info",
            utf8(dir),
            "--sheet",
            utf8(&dir.join("sheet.png")),
        ])
    };
    let text = info();
    assert!(
        text.contains("masks  1 views, 1.04 % of all pixels left out"),
        "{text}"
    );
    let sheet = fs::read(dir.join("sheet.png")).unwrap();
    let json: Value =
        serde_json::from_str(&succeeds(&["data", "info", utf8(dir), "--json"])).unwrap();
    assert_eq!(
        (&json["masked"], &json["left_out"]),
        (&json!(1), &json!(320.0 / 30_720.0))
    );
    edit(dir, without);
    assert!(!info().contains("masks  ") && fs::read(dir.join("sheet.png")).unwrap() != sheet);
    let json: Value =
        serde_json::from_str(&succeeds(&["data", "info", utf8(dir), "--json"])).unwrap();
    assert_eq!(
        (&json["masked"], &json["left_out"]),
        (&json!(0), &json!(0.0))
    );
}

#[test]
fn a_run_notices_that_masks_have_changed() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    masked(dir);
    let run = dir.join("run");
    let small = [
        "building.iterations=4",
        "building.random_points=300",
        "segmentation.rows=[]",
        "data.masks=masks",
    ];
    let sets = small.iter().flat_map(|set| ["--set", set]);
    succeeds(
        &["train", "--data", utf8(dir), "--out", utf8(&run)]
            .into_iter()
            .chain(sets)
            .collect::<Vec<_>>(),
    );
    assert!(
        fs::read_to_string(run.join("config.toml"))
            .unwrap()
            .contains("masks = \"masks\"")
    );
    assert!(
        fs::read_to_string(run.join("report.html"))
            .unwrap()
            .contains("pixels of 1 of 6 photos")
    );
    succeeds(&["train", "--resume", utf8(&run)]);
    grey(80, 64, |x, y| x != 30 || y != 30)
        .save(dir.join("masks/v1.png"))
        .unwrap();
    assert!(
        fails(&["train", "--resume", utf8(&run)], 1).contains("photos, masks, cameras and points")
    );
    corner().save(dir.join("masks/v1.png")).unwrap();
    succeeds(&["train", "--resume", utf8(&run)]);
}

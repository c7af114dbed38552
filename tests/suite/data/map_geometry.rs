//! Which camera label maps belong to: maps that were made of the scene come back as they were, and maps of photos have the
//! distortion of the lens taken out once.

use crate::support::colmap;
use crate::support::plates::{HEIGHT, WIDTH, scene};
use crate::support::program::{succeeds, utf8};
use crate::support::transforms_json::edit;
use coseg::config::Association;
use coseg::data::formats::transforms::load_cameras;
use coseg::data::{LabelMap, LoadOptions, MapGeometry, check, info, load};
use serde_json::json;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// The plates, said to be photographed through a lens that bends.
fn bent() -> TempDir {
    let folder = tempfile::tempdir().expect("folder");
    scene(folder.path());
    edit(folder.path(), |v| v["k1"] = json!(-0.2));
    folder
}

fn options(raw: &str, max_side: usize) -> LoadOptions {
    LoadOptions {
        raw_labels: Some(raw.into()),
        max_side,
        ..LoadOptions::default()
    }
}

/// The raw labels of all views.
fn raw(dir: &Path, options: &LoadOptions) -> Vec<LabelMap> {
    let views = load(dir, options).expect("scene").views;
    views
        .into_iter()
        .map(|view| view.raw.expect("raw labels").map())
        .collect()
}

fn write(maps: &[LabelMap], folder: &Path) {
    for (i, map) in maps.iter().enumerate() {
        map.write(&folder.join(format!("v{i}.png"))).expect("map");
    }
}

#[test]
fn maps_made_of_the_scene_are_not_undistorted_again() {
    let folder = bent();
    let dir = folder.path();
    let [whole, half] = [0, 40].map(|max_side| raw(dir, &options("raw", max_side)));
    for (name, maps) in [("whole", &whole), ("half", &half)] {
        write(maps, &dir.join(name));
        MapGeometry::Undistorted
            .write(&dir.join(name))
            .expect("geometry");
    }
    // Whatever the size of the photos is now.
    assert!(raw(dir, &options("whole", 0)) == whole && raw(dir, &options("half", 40)) == half);
    assert!(
        raw(dir, &options("whole", 40)) == half,
        "reduced as photos are"
    );
    let larger = raw(dir, &options("half", 0));
    assert_eq!((larger[0].width, larger[0].height), (WIDTH, HEIGHT));
    let off = larger[0]
        .ids
        .iter()
        .zip(&whole[0].ids)
        .filter(|(a, b)| a != b)
        .count();
    assert!(
        10 * off < WIDTH * HEIGHT,
        "{off} pixels, at the rims of things"
    );
    for (name, max_side) in [("whole", 0), ("half", 0), ("whole", 40), ("half", 40)] {
        let options = options(name, max_side);
        let checked = check(dir, &options);
        assert!(checked.problems.is_empty(), "{checked:?}");
        assert!(
            checked
                .notices
                .iter()
                .all(|notice| !notice.contains("geometry.json")),
            "{checked:?}"
        );
        info(dir, &options).expect("info");
    }
    // The lens is strong enough to tell, and a size is all that tells without the file.
    fs::remove_file(dir.join("whole/geometry.json")).expect("remove");
    assert!(raw(dir, &options("whole", 0)) != whole);
    fs::remove_file(dir.join("half/geometry.json")).expect("remove");
    assert!(raw(dir, &options("half", 40)) == half);
    let notices = check(dir, &options("half", 40)).notices;
    let told = notices
        .iter()
        .filter(|n| n.contains("40x32") && n.contains("half/geometry.json"))
        .count();
    assert_eq!(told, 1, "{notices:?}");
    assert!(
        load(dir, &options("half", 0)).is_err(),
        "a size that is neither"
    );
}

#[test]
fn maps_of_reduced_photos_are_undistorted_where_that_is_said() {
    let folder = bent();
    let dir = folder.path();
    let ring =
        |x: usize, y: usize| ((x as f64 - 15.0).hypot(y as f64 - 20.0) as usize % 8 / 5) as u16 + 1;
    // The same rings over photos and over photos of half their size.
    for (name, grow) in [("small", 1), ("large", 2)] {
        let (width, height) = (grow * WIDTH / 2, grow * HEIGHT / 2);
        let ids = (0..width * height)
            .map(|i| ring(i % width / grow, i / width / grow))
            .collect();
        let map = LabelMap { width, height, ids };
        let maps: [LabelMap; 6] = std::array::from_fn(|_| map.clone());
        write(&maps, &dir.join(name));
    }
    let large = raw(dir, &options("large", 40));
    let small = || raw(dir, &options("small", 40));
    assert!(small() != large, "taken for maps of the scene");
    MapGeometry::Photos
        .write(&dir.join("small"))
        .expect("geometry");
    assert!(small() == large);
    // True labels and instances go the same way.
    edit(dir, |v| {
        let frame = &mut v["frames"][0];
        frame["label_path"] = json!("small/v0.png");
        frame["instance_path"] = json!("small/v0.png");
    });
    let views = load(dir, &options("small", 40)).expect("scene").views;
    for map in [&views[0].truth, &views[0].instances] {
        assert!(map.as_ref().expect("map").map() == large[0]);
    }
    // A file that says something else, and one of another shape.
    fs::write(dir.join("small/geometry.json"), r#"{"maps": "both"}"#).expect("write");
    let error = load(dir, &options("small", 40)).expect_err("neither");
    crate::support::assert_names(
        &error,
        &[
            "small/geometry.json",
            "line 1",
            "both",
            "undistorted",
            "photos",
            "correct the file there",
        ],
    );
    assert_eq!(
        check(dir, &options("small", 40)).problems[0].to_string(),
        error.to_string()
    );
    MapGeometry::Photos
        .write(&dir.join("small"))
        .expect("geometry");
    LabelMap {
        width: 32,
        height: 40,
        ids: vec![1; 32 * 40],
    }
    .write(&dir.join("small/v3.png"))
    .expect("map");
    crate::support::assert_names(
        &load(dir, &options("small", 40)).expect_err("across"),
        &["v3.png", "32x40", "80x64"],
    );
}

#[test]
fn associated_maps_come_back_as_they_were_written() {
    let folder = bent();
    let dir = folder.path();
    let ply = dir.join("plates.ply");
    for (max_side, width) in [("data.max_side=0", WIDTH), ("data.max_side=40", 40)] {
        let out = dir.join(format!("out {width}"));
        let arguments = [
            "associate",
            "--scene",
            utf8(&ply),
            "--data",
            utf8(dir),
            "--out",
            utf8(&out),
        ];
        let said = succeeds(&[&arguments[..], &["--set", max_side]].concat());
        assert!(said.contains("cameras.json"), "{said}");
        let text = fs::read_to_string(out.join("labels/geometry.json")).expect("geometry");
        assert_eq!(text, "{\"maps\":\"undistorted\"}\n");
        let labels = out.join("labels");
        let options = LoadOptions {
            association: Association::Gaussians,
            ..options(utf8(&labels), width)
        };
        let loaded = load(dir, &options).expect("scene");
        let cameras = load_cameras(&out.join("cameras.json"), None).expect("cameras");
        for (i, (view, camera)) in loaded.views.iter().zip(cameras).enumerate() {
            let written = LabelMap::read(&out.join(format!("labels/v{i}.png"))).expect("map");
            assert_eq!((written.width, view.camera.width), (width, width));
            assert!(
                view.raw.as_ref().expect("raw labels").map() == written,
                "view {i} of {width} pixels"
            );
            assert_eq!((camera.name, camera.split), (view.name.clone(), view.split));
            assert!(
                camera.camera.width == width && (camera.camera.fx - view.camera.fx).abs() < 1e-9
            );
            assert!((camera.camera.center - view.camera.center - loaded.origin).length() < 1e-6);
        }
    }
}

#[test]
fn maps_are_found_by_the_names_of_their_views() {
    let folder = colmap::scene(colmap::text, &colmap::pinhole());
    let dir = folder.path();
    for i in 0..colmap::VIEWS {
        let map = LabelMap {
            width: 16,
            height: 12,
            ids: vec![1 + (i % 2) as u16; 192],
        };
        map.write(&dir.join(format!("maps/{}", colmap::name(i).replace('/', "_"))))
            .expect("map");
        // A file of that stem alone may be of another camera.
        LabelMap {
            ids: vec![2; 192],
            ..map
        }
        .write(&dir.join(format!("maps/photo {i}.png")))
        .expect("map");
    }
    let options = LoadOptions {
        raw_labels: Some("maps".into()),
        ..LoadOptions::default()
    };
    for view in load(dir, &options).expect("scene").views {
        let id = 1 + u16::from(view.name.starts_with("cam1"));
        assert!(
            view.raw
                .expect("raw labels")
                .runs()
                .all(|(found, _)| found == id),
            "{}",
            view.name
        );
    }
}

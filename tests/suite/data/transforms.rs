//! `transforms.json` scenes: the real ones, and a small one.

use crate::support::small_scene::{HEIGHT, WIDTH, edit, scene};
use coseg::data::formats::transforms::load_cameras;
use coseg::data::{LabelMap, LoadOptions, Split, load};
use coseg::splat::camera::Camera;
use glam::DVec3;
use serde_json::json;
use std::fs;

#[test]
fn raw_labels_that_no_frame_names_lie_in_labels_raw() {
    let dir = scene();
    let options = LoadOptions::default();
    let named = load(dir.path(), &options).expect("scene");
    edit(&dir, |scene| {
        for frame in scene["frames"].as_array_mut().unwrap() {
            frame.as_object_mut().unwrap().remove("raw_label_path");
        }
    });
    let found = load(dir.path(), &options).expect("scene");
    for (named, found) in named.views.iter().zip(&found.views) {
        assert!(
            found.raw.is_some() && found.raw == named.raw,
            "{}",
            found.name
        );
    }
    // Photos without a file are unlabelled.
    fs::remove_file(dir.path().join("labels_raw/v1.png")).unwrap();
    let found = load(dir.path(), &options).expect("scene");
    let labelled: Vec<bool> = found.views.iter().map(|view| view.raw.is_some()).collect();
    assert_eq!(labelled, [true, false, true]);
}

#[test]
fn the_small_scene_loads_as_written() {
    let dir = scene();
    let scene = load(dir.path(), &LoadOptions::default()).expect("scene");
    assert_eq!(scene.origin, DVec3::new(1.0, 2.0, 1e6));
    assert_eq!(scene.up, DVec3::Y);
    let ids: Vec<_> = scene
        .classes
        .entries
        .iter()
        .map(|c| (c.id, c.name.as_str()))
        .collect();
    assert_eq!(ids, [(1, "wall"), (2, "floor"), (300, "lamp")]);
    assert_eq!(scene.classes.ignore, 0);
    assert_eq!(scene.points.positions, [[0.0, 0.0, 0.5], [1.5, 0.0, 0.0]]);
    assert_eq!(scene.points.colors, [[1.0, 0.0, 0.2], [0.0; 3]]);
    let names: Vec<_> = scene
        .views
        .iter()
        .map(|v| (v.name.as_str(), v.split))
        .collect();
    assert_eq!(
        names,
        [
            ("v0", Split::Test),
            ("v1", Split::Train),
            ("v2", Split::Train)
        ]
    );
    let view = &scene.views[2];
    let Camera {
        center,
        fx,
        fy,
        cx,
        cy,
        width,
        height,
        ..
    } = view.camera;
    assert_eq!(
        (center, fx, fy, cx, cy),
        (DVec3::new(1.0, 0.0, 0.0), 20.0, 21.0, 8.5, 6.25)
    );
    assert_eq!((width, height), (WIDTH as usize, HEIGHT as usize));
    assert_eq!(
        view.image.pixels().expect("photo").get_pixel(3, 4).0,
        [27, 28, 2]
    );
    assert_eq!(
        view.rgb().expect("photo")[(4 * WIDTH as usize + 3) * 3..][..3],
        [27.0 / 255.0, 28.0 / 255.0, 2.0 / 255.0]
    );
    assert_eq!(
        view.truth.as_ref().expect("truth").map().ids[..5],
        [0, 1, 2, 300, 0]
    );
    // Cameras look along -z with y up: straight ahead is the principal point, right is +u, up is -v.
    assert_eq!(
        view.camera.project(DVec3::new(1.0, 0.0, -2.0)),
        Some((8.5, 6.25, 2.0))
    );
    let (u, v, _) = view
        .camera
        .project(DVec3::new(1.2, 0.1, -2.0))
        .expect("in front");
    assert!(
        (u - 10.5).abs() < 1e-12 && (v - (6.25 - 1.05)).abs() < 1e-12,
        "{u} {v}"
    );
}

#[test]
fn options_and_fallbacks() {
    let dir = scene();
    // Raw labels from another folder.
    let map = LabelMap {
        width: 16,
        height: 12,
        ids: vec![2; 192],
    };
    for i in 0..3 {
        map.write(&dir.path().join(format!("labels_raw_corr/v{i}.png")))
            .expect("labels");
    }
    let options = LoadOptions {
        raw_labels: Some("labels_raw_corr".into()),
        ..LoadOptions::default()
    };
    let loaded = load(dir.path(), &options).expect("scene");
    assert_eq!(loaded.views[1].raw, Some(map.into()));
    // No split: every 8th, from the first. No sizes, one angle: sizes of the images, square pixels, central.
    edit(&dir, |v| {
        for f in v["frames"].as_array_mut().expect("frames") {
            f.as_object_mut().expect("frame").remove("split");
        }
        let file = v.as_object_mut().expect("file");
        for key in ["fl_x", "fl_y", "cx", "cy", "w", "h", "ply_file_path"] {
            file.remove(key);
        }
        file.insert("camera_angle_x".into(), json!(std::f64::consts::FRAC_PI_2));
        file.insert(
            "convention".into(),
            json!("OpenGL camera-to-world; world z up, metres"),
        );
    });
    let loaded = load(dir.path(), &LoadOptions::default()).expect("scene");
    assert!(loaded.points.is_empty());
    assert_eq!(loaded.up, DVec3::Z);
    let splits: Vec<_> = loaded.views.iter().map(|v| v.split).collect();
    assert_eq!(splits, [Split::Test, Split::Train, Split::Train]);
    let c = &loaded.views[0].camera;
    assert!(
        (c.fx - 8.0).abs() < 1e-12 && c.fx == c.fy && (c.cx, c.cy) == (8.0, 6.0),
        "{c:?}"
    );
    // A frame's own intrinsics come first; a frame without labels has none; an extension may be missing.
    edit(&dir, |v| {
        let frame = v["frames"][1].as_object_mut().expect("frame");
        frame.remove("label_path");
        frame.insert("fl_x".into(), json!(33.0));
        frame.insert("file_path".into(), json!("./images/v1"));
    });
    let loaded = load(dir.path(), &LoadOptions::default()).expect("scene");
    assert_eq!(loaded.views[1].camera.fx, 33.0);
    assert_eq!(loaded.views[0].camera.fx, 20.0);
    assert!(loaded.views[1].truth.is_none() && loaded.views[1].raw.is_some());
}

#[test]
fn cameras_alone_need_no_images() {
    let dir = scene();
    fs::remove_dir_all(dir.path().join("images")).expect("remove");
    let path = dir.path().join("transforms.json");
    let all = load_cameras(&path, None).expect("cameras");
    assert_eq!(all.len(), 3);
    assert_eq!(all[2].camera.center, DVec3::new(2.0, 2.0, 1e6));
    let test = load_cameras(&path, Some(Split::Test)).expect("cameras");
    assert_eq!(
        test.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(),
        ["v0"]
    );
    assert_eq!(test[0], all[0]);
    edit(&dir, |v| {
        v["frames"].as_array_mut().expect("frames").truncate(1)
    });
    let message = load_cameras(&path, Some(Split::Train))
        .expect_err("none")
        .to_string();
    assert!(message.contains("transforms.json: frames"), "{message}");
    edit(&dir, |v| {
        v.as_object_mut().expect("file").remove("w");
    });
    let message = load_cameras(&path, None).expect_err("no size").to_string();
    assert!(message.contains("frames[0] (images/v0.png).w"), "{message}");
    edit(&dir, |v| v["w"] = json!(4_000_000_000_u32));
    let message = load_cameras(&path, None)
        .expect_err("absurd size")
        .to_string();
    assert!(message.contains("exceeds the limit"), "{message}");
}

#[test]
fn real_scenes_load() {
    let Some(shared) = crate::support::shared_dir() else {
        return;
    };
    let cases = [
        ("fox", "transforms_4.json", 43, 7, (270, 480), 0, 15_019),
        (
            "tabletop_bin",
            "transforms.json",
            44,
            6,
            (640, 480),
            0,
            24_791,
        ),
        (
            "house_living",
            "transforms.json",
            80,
            22,
            (480, 360),
            18,
            35_000,
        ),
        (
            "house_kitchen",
            "transforms.json",
            80,
            22,
            (480, 360),
            17,
            35_000,
        ),
        ("studio", "transforms.json", 80, 22, (480, 360), 29, 35_000),
    ];
    for (name, transforms, train, test, size, classes, points) in cases {
        let dir = shared.join("data").join(name);
        let options = LoadOptions {
            transforms: transforms.into(),
            ..LoadOptions::default()
        };
        let scene = load(&dir, &options).expect("scene");
        let counts = [Split::Train, Split::Test].map(|s| scene.split(s).count());
        assert_eq!((scene.name.as_str(), counts), (name, [train, test]));
        assert_eq!(
            (scene.classes.len(), scene.points.len()),
            (classes, points),
            "{name}"
        );
        let mean =
            scene.views.iter().map(|v| v.camera.center).sum::<DVec3>() / scene.views.len() as f64;
        assert!(mean.length() < 1e-12, "{name}: {mean}");
        assert!(
            scene
                .views
                .iter()
                .all(|v| (v.camera.width, v.camera.height) == size)
        );
        assert!(
            scene
                .views
                .iter()
                .all(|v| v.truth.is_some() == (classes > 0) && v.raw.is_some() == (classes > 0))
        );
        // Poses, intrinsics and points agree: most points that fall into a photo have nearly its colour there (a wrong
        // axis or sign leaves no more than chance).
        let view = scene.split(Split::Train).nth(10).expect("view");
        let rgb = view.rgb().expect("photo");
        let mut seen = 0;
        let mut near = 0;
        for (p, c) in scene.points.positions.iter().zip(&scene.points.colors) {
            let Some((u, v, _)) = view.camera.project(DVec3::from(p.map(f64::from))) else {
                continue;
            };
            if u >= 0.0 && v >= 0.0 && u < size.0 as f64 && v < size.1 as f64 {
                let pixel = &rgb[(v as usize * size.0 + u as usize) * 3..][..3];
                seen += 1;
                near += usize::from(pixel.iter().zip(c).all(|(a, b)| (a - b).abs() < 0.1));
            }
        }
        eprintln!("{name}: {near} of {seen} points have the photo's colour");
        assert!(seen > 500 && near * 2 > seen, "{name}: {near} of {seen}");
        let cameras = load_cameras(&dir.join(transforms), Some(Split::Test)).expect("cameras");
        assert_eq!(cameras.len(), test);
        let first = scene.split(Split::Test).next().expect("view");
        assert!((cameras[0].camera.center - scene.origin - first.camera.center).length() < 1e-12);
    }
}

//! Replica in the two forms it is used in, written small.

use coseg::config::Layout;
use coseg::data::{LabelMap, LoadOptions, Split, load, locate};
use glam::DVec3;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const FRAMES: usize = 11;

/// Camera-to-world, OpenCV axes: at (i, 0, 0), looking along +y of a world with z up.
fn row(i: usize) -> String {
    format!("1 0 0 {i} 0.0e+00 0 1 0 0 -1 0 0 0 0 0 1\n")
}

fn photo(size: (u32, u32), i: usize, path: &Path) {
    image::RgbImage::from_pixel(size.0, size.1, image::Rgb([i as u8, 2, 3]))
        .save(path)
        .expect("photo");
}

fn semantic_nerf() -> TempDir {
    let dir = tempfile::tempdir().expect("folder");
    for folder in ["rgb", "semantic_class", "depth"] {
        fs::create_dir(dir.path().join(folder)).expect("folder");
    }
    for i in 0..FRAMES {
        photo((16, 12), i, &dir.path().join(format!("rgb/rgb_{i}.png")));
        // Floor and wall, some undefined.
        let ids = (0..192).map(|k| [0, 40, 93][k % 3]).collect();
        let map = LabelMap {
            width: 16,
            height: 12,
            ids,
        };
        map.write(
            &dir.path()
                .join(format!("semantic_class/semantic_class_{i}.png")),
        )
        .expect("labels");
        // Two metres, unknown in the upper half.
        let ids = (0..192).map(|k| if k < 96 { 0 } else { 2000 }).collect();
        let depth = LabelMap {
            width: 16,
            height: 12,
            ids,
        };
        depth
            .write(&dir.path().join(format!("depth/depth_{i}.png")))
            .expect("depth");
    }
    fs::write(
        dir.path().join("traj_w_c.txt"),
        (0..FRAMES).map(row).collect::<String>(),
    )
    .expect("poses");
    dir
}

fn nice_slam() -> (TempDir, PathBuf) {
    let dir = tempfile::tempdir().expect("folder");
    let scene = dir.path().join("room0");
    fs::create_dir_all(scene.join("results")).expect("folder");
    for i in 0..FRAMES {
        photo((60, 34), i, &scene.join(format!("results/frame{i:06}.jpg")));
        let depth = LabelMap {
            width: 60,
            height: 34,
            ids: vec![65_535; 60 * 34],
        };
        depth
            .write(&scene.join(format!("results/depth{i:06}.png")))
            .expect("depth");
    }
    fs::write(
        scene.join("traj.txt"),
        (0..FRAMES).map(row).collect::<String>(),
    )
    .expect("poses");
    let camera = r#"{"camera": {"w": 60, "h": 34, "fx": 30.0, "fy": 30.0, "cx": 29.5, "cy": 16.5, "scale": 6553.5}}"#;
    fs::write(dir.path().join("cam_params.json"), camera).expect("camera");
    (dir, scene)
}

#[track_caller]
fn expect_error(dir: &Path, parts: &[&str]) {
    crate::support::assert_names(
        &load(dir, &LoadOptions::default()).expect_err("an error"),
        parts,
    );
}

#[test]
fn replica_of_semantic_nerf_loads() {
    let dir = semantic_nerf();
    let options = LoadOptions::default();
    assert_eq!(
        locate(dir.path(), &options).expect("layout"),
        Layout::Replica
    );
    let scene = load(dir.path(), &options).expect("scene");
    let names: Vec<_> = scene.views.iter().map(|v| v.name.as_str()).collect();
    assert_eq!(
        names[..3],
        ["rgb_0", "rgb_1", "rgb_2"],
        "by number, not by name"
    );
    assert_eq!(names[10], "rgb_10");
    let tests: Vec<_> = scene.split(Split::Test).map(|v| v.name.as_str()).collect();
    assert_eq!(tests, ["rgb_0", "rgb_8"]);
    // 90 degrees across, the centre in the middle.
    let c = &scene.views[3].camera;
    assert_eq!((c.fx, c.fy, c.cx, c.cy), (8.0, 8.0, 8.0, 6.0));
    assert_eq!(c.center, DVec3::new(3.0 - 5.0, 0.0, 0.0));
    assert_eq!(
        c.project(DVec3::new(-2.0, 4.0, 1.0)),
        Some((8.0, 4.0, 4.0)),
        "looks along +y, z is up"
    );
    assert!((scene.up - DVec3::Z).length() < 1e-12);
    assert_eq!(
        scene.views[10]
            .image
            .pixels()
            .expect("photo")
            .get_pixel(0, 0)
            .0[0],
        10
    );
    // Of the dataset's 101 classes those that occur.
    let classes: Vec<_> = scene
        .classes
        .entries
        .iter()
        .map(|c| (c.id, c.name.as_str()))
        .collect();
    assert_eq!(
        (classes, scene.classes.ignore),
        (vec![(40, "floor"), (93, "wall")], 0)
    );
    assert_eq!(
        scene.views[0].truth.as_ref().expect("truth").map().ids[..4],
        [0, 40, 93, 0]
    );
    assert!(scene.views[0].raw.is_none());
    // The cloud: a wall two metres off, below the horizon, as seen by the nine training views.
    assert_eq!(scene.points.len(), 9 * 96);
    let p = scene.points.positions[0];
    assert!(
        (p[1] - 2.0).abs() < 1e-6 && p[2] < 0.0 && p[2] > -1.5,
        "{p:?}"
    );
    assert_eq!(
        scene.points.colors[0],
        [1.0 / 255.0, 2.0 / 255.0, 3.0 / 255.0]
    );
    // A table of the folder's own comes first.
    fs::write(
        dir.path().join("classes.json"),
        r#"{"40": "ground", "93": "wall", "5": "five"}"#,
    )
    .expect("write");
    assert_eq!(load(dir.path(), &options).expect("scene").classes.len(), 3);
}

#[test]
fn replica_of_nice_slam_loads() {
    let (dir, scene_dir) = nice_slam();
    let options = LoadOptions {
        stride: 3,
        ..LoadOptions::default()
    };
    let scene = load(&scene_dir, &options).expect("scene");
    let names: Vec<_> = scene.views.iter().map(|v| v.name.as_str()).collect();
    assert_eq!(
        names,
        ["frame000000", "frame000003", "frame000006", "frame000009"]
    );
    let c = &scene.views[1].camera;
    assert_eq!(
        (c.fx, c.cx, c.cy, c.width, c.height),
        (30.0, 30.0, 17.0, 60, 34),
        "half a pixel more than in the file"
    );
    assert!(scene.classes.is_empty());
    let far = scene
        .points
        .positions
        .iter()
        .all(|p| (p[1] - 10.0).abs() < 1e-5);
    assert!(
        far && scene.points.len() == 3 * 60 * 34,
        "{}",
        scene.points.len()
    );
    // The folder above holds scenes, not one.
    let message = locate(dir.path(), &options).expect_err("none").to_string();
    assert!(
        message.contains("a folder room0 of layout replica") && message.contains("give "),
        "{message}"
    );
    // Without the file of the camera the published one is taken, which these small photos do not fit.
    fs::remove_file(dir.path().join("cam_params.json")).expect("remove");
    expect_error(
        &scene_dir,
        &["frame000000.jpg", "60x34", "1200x680", "traj.txt"],
    );
}

#[test]
fn broken_replica_scenes_are_refused_by_name() {
    let (dir, scene) = nice_slam();
    let trajectory = scene.join("traj.txt");
    let whole = fs::read_to_string(&trajectory).expect("read");
    for (from, to, parts) in [
        (
            "1 0 0 2 ",
            "1 0 0 nan ",
            vec!["traj.txt", "line 3", "NaN", "row 0, column 3"],
        ),
        ("1 0 0 2 ", "1 0 0 ", vec!["line 3", "15 numbers"]),
        ("1 0 0 2 ", "1 0 0 2 9 ", vec!["line 3", "more than 16"]),
        ("1 0 0 2 ", "1 0 0 two ", vec!["line 3", "two"]),
        ("1 0 0 2 ", "2 0 0 2 ", vec!["line 3", "rotation", "2.0000"]),
        ("1 0 0 2 ", "-1 0 0 2 ", vec!["line 3", "determinant -1"]),
    ] {
        fs::write(&trajectory, whole.replacen(from, to, 1)).expect("write");
        expect_error(&scene, &parts);
    }
    fs::write(
        &trajectory,
        whole.lines().take(4).collect::<Vec<_>>().join("\n"),
    )
    .expect("write");
    expect_error(&scene, &["traj.txt", "4 rows", "frame000004.jpg"]);
    fs::write(&trajectory, &whole).expect("write");
    fs::write(dir.path().join("cam_params.json"), "{\"camera\": {}}").expect("write");
    expect_error(&scene, &["cam_params.json", "line 1", "missing field"]);
    let camera =
        r#"{"camera": {"w": 60, "h": 34, "fx": -30.0, "fy": 30.0, "cx": 29.5, "cy": 16.5}}"#;
    fs::write(dir.path().join("cam_params.json"), camera).expect("write");
    expect_error(&scene, &["cam_params.json", "-30"]);

    let dir = semantic_nerf();
    let map = dir.path().join("semantic_class/semantic_class_4.png");
    LabelMap {
        width: 16,
        height: 12,
        ids: vec![150; 192],
    }
    .write(&map)
    .expect("labels");
    expect_error(dir.path(), &["semantic_class_4.png", "label id 150"]);
    fs::remove_dir_all(dir.path().join("rgb")).expect("remove");
    fs::create_dir(dir.path().join("rgb")).expect("folder");
    expect_error(dir.path(), &["rgb", "no photos"]);
}

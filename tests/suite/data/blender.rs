//! Blender's scenes of NeRF: a file of cameras for each split, photos without extension and with transparent pixels.

use crate::support::blender::{SIZE, scene, write};
use crate::support::program::{fails, succeeds, utf8};
use coseg::config::{BuildingConfig, Config, Layout};
use coseg::data::{LoadOptions, NamedCamera, Scene, Split, check, load, load_cameras, locate};
use coseg::reconstruction::Trainer;
use std::fs;
use std::path::Path;

fn loaded(dir: &Path) -> Scene {
    load(dir, &LoadOptions::default()).unwrap()
}

fn names(scene: &Scene, split: Split) -> Vec<&str> {
    scene.split(split).map(|view| &*view.name).collect()
}

#[test]
fn train_and_test_are_read_together() {
    let folder = scene();
    let dir = folder.path();
    for layout in [Layout::Auto, Layout::Transforms] {
        let options = LoadOptions {
            layout,
            ..LoadOptions::default()
        };
        assert_eq!(locate(dir, &options).unwrap(), Layout::Transforms);
        let scene = load(dir, &options).unwrap();
        assert_eq!(
            names(&scene, Split::Train),
            [
                "train_r_0",
                "train_r_1",
                "train_r_2",
                "train_r_3",
                "train_r_4"
            ]
        );
        assert_eq!(
            names(&scene, Split::Test),
            ["test_r_0", "test_r_1", "test_r_2"]
        );
    }
    let checked = check(dir, &LoadOptions::default());
    assert!(
        checked.problems.is_empty() && checked.frames == 8,
        "{checked:?}"
    );
    let told = |notice: &String| {
        notice.contains("transforms_val.json is not read") && notice.contains("_test.json")
    };
    assert!(checked.notices.iter().any(told), "{checked:?}");
    // Each frame with the camera of its own file.
    let scene = loaded(dir);
    let cameras = load_cameras(dir, &LoadOptions::default(), None).unwrap();
    for (
        view,
        NamedCamera {
            name,
            split,
            camera,
        },
    ) in scene.views.iter().zip(&cameras)
    {
        assert_eq!((&view.name, view.split), (name, *split));
        assert!((view.camera.center + scene.origin - camera.center).length() < 1e-12);
        assert!((camera.center.length() - 4.0 * 1.25_f64.sqrt()).abs() < 1e-12);
    }
    // Each split is thinned by itself.
    let thin = load(
        dir,
        &LoadOptions {
            stride: 2,
            ..LoadOptions::default()
        },
    )
    .unwrap();
    assert_eq!(
        (names(&thin, Split::Train).len(), names(&thin, Split::Test)),
        (3, vec!["test_r_0", "test_r_2"])
    );
}

#[test]
fn transparent_pixels_show_the_background_and_no_random_one_lies_behind_them() {
    let folder = scene();
    let mut scene = loaded(folder.path());
    assert!(scene.views.iter().all(|view| view.image.is_transparent()));
    let camera = &scene.views[0].camera;
    let focal = 0.5 * f64::from(SIZE) / (std::f64::consts::FRAC_PI_6).tan();
    assert_eq!(
        (camera.width, camera.height, camera.cx, camera.cy),
        (40, 40, 20.0, 20.0)
    );
    assert!((camera.fx - focal).abs() < 1e-9 && camera.fx == camera.fy);
    let pixels = scene.views[6].image.pixels().unwrap();
    let [inside, rim, outside] = [20, 31, 35].map(|x| pixels.get_pixel(x, 20).0);
    assert_eq!(
        (inside, rim, outside),
        ([200, 80, 10], [100, 40, 5], [0, 0, 0]),
        "test_r_1"
    );
    // Over the colour that the scene is rendered over, so that nothing has to be there.
    let mut config = Config::default();
    config.raster.background = [1.0, 1.0, 0.2];
    let over = load(folder.path(), &LoadOptions::from(&config)).unwrap();
    let pixels = over.views[6].image.pixels().unwrap();
    let [inside, rim, outside] = [20, 31, 35].map(|x| pixels.get_pixel(x, 20).0);
    assert_eq!(
        (inside, rim, outside),
        ([200, 80, 10], [227, 167, 30], [255, 255, 51]),
        "test_r_1"
    );
    let steps = |scene: &Scene, random_background: bool| {
        let building = BuildingConfig {
            random_background,
            random_points: 200,
            iterations: 100,
            ..BuildingConfig::default()
        };
        let config = Config {
            building,
            ..Config::default()
        };
        let mut stage = Trainer::new(scene, &config, &crate::support::device()).unwrap();
        (0..6)
            .map(|_| stage.step().unwrap().loss)
            .collect::<Vec<f64>>()
    };
    assert_eq!(steps(&scene, true), steps(&scene, false));
    // The same pixels in photos that are opaque.
    scene
        .views
        .iter_mut()
        .for_each(|view| view.image = (*view.image.pixels().unwrap()).clone().into());
    assert_ne!(steps(&scene, true), steps(&scene, false));
}

#[test]
fn validation_stands_in_for_test() {
    let folder = scene();
    let dir = folder.path();
    fs::remove_file(dir.join("transforms_test.json")).unwrap();
    let scene = loaded(dir);
    assert_eq!(
        (
            names(&scene, Split::Train).len(),
            names(&scene, Split::Test)
        ),
        (5, vec!["val_r_0", "val_r_1"])
    );
    // One of them is not enough to say what is held out.
    fs::remove_file(dir.join("transforms_val.json")).unwrap();
    let error = load(dir, &LoadOptions::default()).unwrap_err();
    crate::support::assert_names(
        &error,
        &[
            "no such file, but transforms_train.json",
            "data.transforms=transforms_train.json",
        ],
    );
}

#[test]
fn a_file_that_is_named_is_read_alone() {
    let folder = scene();
    let dir = folder.path();
    let named = |name: &str| LoadOptions {
        transforms: name.into(),
        ..LoadOptions::default()
    };
    let scene = load(dir, &named("transforms_train.json")).unwrap();
    assert_eq!(names(&scene, Split::Test), ["r_0"], "every 8th");
    assert_eq!(names(&scene, Split::Train), ["r_1", "r_2", "r_3", "r_4"]);
    // The usual file comes first where it is there.
    fs::copy(dir.join("transforms_val.json"), dir.join("transforms.json")).unwrap();
    assert_eq!(loaded(dir).views.len(), 2);
    let message = load(dir, &named("transforms_all.json"))
        .unwrap_err()
        .to_string();
    assert!(message.contains("transforms_all.json"), "{message}");
}

#[test]
fn stems_name_the_views_where_no_two_are_alike() {
    let folder = scene();
    let dir = folder.path();
    let path = dir.join("transforms_test.json");
    let renamed = fs::read_to_string(&path)
        .unwrap()
        .replace("./test/r_", "./test/t_");
    fs::write(&path, &renamed).unwrap();
    (0..3).for_each(|i| {
        fs::rename(
            dir.join(format!("test/r_{i}.png")),
            dir.join(format!("test/t_{i}.png")),
        )
        .unwrap()
    });
    let scene = loaded(dir);
    assert_eq!(
        (
            names(&scene, Split::Train)[4],
            names(&scene, Split::Test)[0]
        ),
        ("r_4", "t_0")
    );
    // A photo that both files list, and one that is not there.
    fs::write(&path, renamed.replace("./test/t_1", "./train/r_3")).unwrap();
    let error = load(dir, &LoadOptions::default()).unwrap_err();
    crate::support::assert_names(
        &error,
        &[
            "transforms_test.json",
            "frames[1] (./train/r_3)",
            "which frames[3]",
            "train_r_3",
        ],
    );
    crate::support::assert_names(
        &error,
        &[
            "of transforms_train.json has too",
            "data.transforms=transforms_train.json",
        ],
    );
    fs::write(&path, renamed.replace("./test/t_1", "./test/t_9")).unwrap();
    let error = load(dir, &LoadOptions::default()).unwrap_err();
    crate::support::assert_names(
        &error,
        &[
            "transforms_test.json",
            "frames[1]",
            "test/t_9.png",
            "put the image there",
        ],
    );
}

#[test]
fn another_layout_comes_first() {
    // Tools write Blender's files beside what they were made from, too.
    let folder = crate::support::colmap::scene(
        crate::support::colmap::text,
        &crate::support::colmap::pinhole(),
    );
    let dir = folder.path();
    [("train", 5), ("test", 3)]
        .into_iter()
        .for_each(|(split, count)| write(dir, split, count));
    assert_eq!(
        locate(dir, &LoadOptions::default()).unwrap(),
        Layout::Colmap
    );
    let checked = check(dir, &LoadOptions::default());
    let told = |notice: &String| {
        notice.contains("transforms_train.json is not read") && notice.contains("data.layout")
    };
    assert!(
        checked.problems.is_empty() && checked.notices.iter().filter(|n| told(n)).count() == 1,
        "{checked:?}"
    );
    let named = LoadOptions {
        layout: Layout::Transforms,
        ..LoadOptions::default()
    };
    assert_eq!(load(dir, &named).unwrap().views.len(), 8);
    // The usual file makes it two scenes.
    fs::copy(
        dir.join("transforms_train.json"),
        dir.join("transforms.json"),
    )
    .unwrap();
    let error = locate(dir, &LoadOptions::default()).unwrap_err();
    crate::support::assert_names(
        &error,
        &["transforms.json (transforms) and sparse/0/cameras.txt (colmap)"],
    );
}

#[test]
fn outputs_of_a_run_have_names_of_their_own() {
    let folder = scene();
    let dir = folder.path();
    let run = dir.join("run");
    let sets = [
        "building.iterations=4",
        "building.random_points=300",
        "segmentation.rows=[]",
    ];
    let sets = sets.iter().flat_map(|set| ["--set", set]);
    succeeds(
        &["train", "--data", utf8(dir), "--out", utf8(&run)]
            .into_iter()
            .chain(sets)
            .collect::<Vec<_>>(),
    );
    assert!((0..3).all(|i| run.join(format!("renders/test_r_{i}.rgb.png")).is_file()));
    let cameras = fs::read_to_string(run.join("cameras.json")).unwrap();
    let listed = [
        "train_r_0.png",
        "train_r_4.png",
        "test_r_0.png",
        "test_r_2.png",
    ];
    assert!(
        listed.iter().all(|name| cameras.contains(name)),
        "{cameras}"
    );
    succeeds(&["train", "--resume", utf8(&run)]);
    assert!(succeeds(&["data", "info", utf8(dir)]).contains("5 train, 3 test"));
    let out = dir.join("out");
    let render = [
        "render",
        "--scene",
        utf8(&run),
        "--split",
        "test",
        "--out",
        utf8(&out),
    ];
    succeeds(&render);
    assert!(fs::read_dir(&out).unwrap().any(|file| {
        file.unwrap()
            .file_name()
            .to_string_lossy()
            .contains("test_r_2")
    }));
    // Faults name the files that are meant.
    fs::write(dir.join("transforms_test.json"), "{}").unwrap();
    assert!(fails(&["data", "check", utf8(dir)], 1).contains("transforms_test.json"));
}

//! `coseg train`: the run folder, and what is refused before anything is begun.

use crate::support::assert_names;
use crate::support::plates::scene;
use crate::support::program::{fails, read_json, succeeds, utf8, warnings};
use crate::support::short_runs::short_run;
use crate::support::transforms_json::edit;
use coseg::runs::RunOptions;
use std::path::Path;

#[test]
fn train_fills_the_run_folder_and_eval_agrees() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join("run");
    let said = short_run(folder.path(), &run);
    assert!(
        said.contains("held-out PSNR") && said.contains("per-Gaussian CE"),
        "{said}"
    );
    for file in [
        "scene.ply",
        "classes.json",
        "cameras.json",
        "config.toml",
        "metrics.json",
        "report.html",
        "identities.safetensors",
    ] {
        assert!(run.join(file).is_file(), "{file}");
    }
    for kind in ["rgb", "rgb_error", "label", "label_color", "label_error"] {
        assert!(
            run.join(format!("renders/v2.{kind}.png")).is_file(),
            "{kind}"
        );
    }
    // A view rendered from the run folder alone is the run's own picture.
    let scene = run.join("scene.ply");
    let cameras = run.join("cameras.json");
    let out = folder.path().join("again");
    succeeds(&[
        "render",
        "--scene",
        utf8(&scene),
        "--cameras",
        utf8(&cameras),
        "--out",
        utf8(&out),
        "--split",
        "test",
    ]);
    let [own, again] = [run.join("renders/v2.rgb.png"), out.join("v2.rgb.png")]
        .map(|p| image::open(p).unwrap().into_rgb8());
    assert_eq!(own.dimensions(), again.dimensions());
    assert!(
        own.iter()
            .zip(again.iter())
            .all(|(a, b)| a.abs_diff(*b) <= 1),
        "v2"
    );
    assert!(!out.join("v0.rgb.png").exists());
    let metrics = read_json(&run.join("metrics.json"));
    let labels = &metrics["test"]["labels"];
    assert_eq!(
        labels["raw"]["miou"], 1.0,
        "raw labels of the held-out views are right in this scene"
    );
    assert!(
        labels["vote"]["miou"].is_f64() && labels["per_gaussian"]["iterations"] == 20,
        "{labels}"
    );
    assert!(
        metrics["test"]["psnr"].as_f64().unwrap() > 12.0 && metrics["peak_memory_bytes"].is_u64()
    );

    let scores: serde_json::Value =
        serde_json::from_str(&succeeds(&["eval", utf8(&run), "--json"])).unwrap();
    let near = |a: &serde_json::Value, b: &serde_json::Value| {
        (a.as_f64().unwrap() - b.as_f64().unwrap()).abs() < 1e-4
    };
    // The same figures under the same names.
    let scores = &scores["test"];
    assert!(near(&scores["psnr"], &metrics["test"]["psnr"]), "{scores}");
    assert!(near(&scores["ssim"], &metrics["test"]["ssim"]), "{scores}");
    assert!(
        near(
            &scores["views"]["v2"]["psnr"],
            &metrics["test"]["views"]["v2"]["psnr"]
        ),
        "{scores}"
    );
    for score in ["miou", "miou_per_view", "accuracy"] {
        assert!(
            near(
                &scores["labels"]["per_gaussian"][score],
                &labels["per_gaussian"][score]
            ),
            "{score}: {scores} {labels}"
        );
    }
    assert_eq!(
        scores["labels"].as_object().unwrap().len(),
        1,
        "what the scene stores: {scores}"
    );
    assert!(near(
        &scores["labels"]["per_gaussian"]["class_iou"]["2"],
        &labels["per_gaussian"]["class_iou"]["2"]
    ));
    let classes = folder.path().join("classes.json");
    let own = std::fs::read_to_string(&classes).unwrap();
    std::fs::write(&classes, own.replace("green", "turquoise")).unwrap();
    let message = fails(&["eval", utf8(&run)], 1);
    assert!(
        message.contains("turquoise as class 2") && message.contains("green, as in the classes"),
        "{message}"
    );
    std::fs::write(&classes, own).unwrap();
    let plain = succeeds(&["eval", utf8(&run)]);
    assert!(
        plain.contains("PSNR") && plain.contains("IoU of 2 green"),
        "{plain}"
    );
}

#[test]
fn photos_of_another_place_are_noticed_when_a_run_is_scored_on_them() {
    let folder = tempfile::tempdir().unwrap();
    let [own, other] = ["own", "other"].map(|name| folder.path().join(name));
    let run = folder.path().join("run");
    scene(&own);
    scene(&other);
    short_run(&own, &run);
    for photo in std::fs::read_dir(other.join("images")).unwrap() {
        let path = photo.unwrap().path();
        let mut photo = image::open(&path).unwrap().into_rgb8();
        image::imageops::invert(&mut photo);
        photo.save(&path).unwrap();
    }
    let [moved, another] =
        [&own, &other].map(|data| warnings(&["eval", utf8(&run), "--data", utf8(data)]));
    assert!(another.contains("misplaced"), "{another}");
    assert!(!moved.contains("misplaced"), "{moved}");
    // So they are where photos to label are looked for.
    let suggest = ["data", "suggest", "--scene", utf8(&run), "--data"];
    let [moved, another] =
        [&own, &other].map(|data| warnings(&[&suggest[..], &[utf8(data)]].concat()));
    assert!(another.contains("misplaced"), "{another}");
    assert!(!moved.contains("misplaced"), "{moved}");
}

/// What `coseg train` says of stage two on the Gaussians of the scene in `dir`, which it leaves out.
#[track_caller]
fn without_stage_two(dir: &Path) -> String {
    let run = dir.with_extension("run");
    let [data, ply, out] = [dir, &dir.join("plates.ply"), &run].map(|path| utf8(path).to_owned());
    let train = ["train", "--data", &data, "--scene", &ply, "--out", &out];
    let rows = [
        "--set",
        "segmentation.rows=vote,per_gaussian",
        "--set",
        "segmentation.iterations=4",
    ];
    let said = warnings(&[&train[..], &rows].concat());
    assert!(said.contains("only the Gaussians are built"), "{said}");
    assert!(!run.join("identities.safetensors").exists(), "{said}");
    let metrics = read_json(&run.join("metrics.json"));
    assert_eq!(
        metrics["test"]["labels"],
        serde_json::json!({}),
        "{metrics}"
    );
    said
}

#[test]
fn labels_that_say_nothing_are_as_no_labels() {
    let folder = tempfile::tempdir().unwrap();
    let [void, jpeg] = ["void", "jpeg"].map(|name| folder.path().join(name));
    scene(&void);
    for i in 0..6 {
        let map = void.join(format!("raw/v{i}.png"));
        image::GrayImage::new(80, 64).save(map).unwrap();
    }
    let said = without_stage_two(&void);
    let parts = [
        "4 of 4 training frames are unlabelled in every pixel",
        "look at the ids",
        "classes.json",
    ];
    parts
        .iter()
        .for_each(|part| assert!(said.contains(part), "{part}: {said}"));
    // Nor are JPEG label maps.
    scene(&jpeg);
    edit(&jpeg, |scene| {
        for frame in scene["frames"].as_array_mut().unwrap() {
            _ = frame.as_object_mut().unwrap().remove("raw_label_path");
        }
    });
    std::fs::create_dir(jpeg.join("labels_raw")).unwrap();
    for i in 0..6 {
        let map = jpeg.join(format!("labels_raw/v{i}.jpg"));
        image::GrayImage::new(80, 64).save(map).unwrap();
    }
    let said = without_stage_two(&jpeg);
    let parts = [
        "labels_raw: raw labels: found 6 files",
        "none of which is a PNG",
        "no training view has raw labels",
    ];
    parts
        .iter()
        .for_each(|part| assert!(said.contains(part), "{part}: {said}"));
}

#[test]
fn folders_that_are_no_scenes_are_found_before_anything_is_begun() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("runs/a");
    let refused = |data: &Path| {
        let message = fails(&["train", "--data", utf8(data), "--out", utf8(&out)], 1);
        assert!(
            !message.contains(" -> "),
            "nothing is said to be running: {message}"
        );
        assert!(
            !folder.path().join("runs").exists(),
            "no folder is left behind"
        );
        message
    };
    let absent = folder.path().join("absent");
    let message = refused(&absent);
    assert!(
        message.contains(&format!(
            "error: no such folder: {}; give the scene folder",
            absent.display()
        )),
        "{message}"
    );
    let config = folder.path().join("run.toml");
    std::fs::write(&config, format!("[data]\ndir = {:?}\n", utf8(&absent))).unwrap();
    let message = fails(
        &["train", "--config", utf8(&config), "--out", utf8(&out)],
        1,
    );
    assert!(
        message.contains("no such folder") && !message.contains(" -> ") && !out.exists(),
        "{message}"
    );
    assert!(refused(&config).contains("a scene folder"));
    let message = fails(
        &[
            "vote",
            "--scene",
            "x.ply",
            "--data",
            utf8(&absent),
            "--out",
            utf8(&out),
        ],
        1,
    );
    assert!(message.contains("no such folder"), "{message}");

    let data = folder.path().join("data");
    std::fs::create_dir(&data).unwrap();
    let message = refused(&data);
    for word in [
        "transforms.json: found no such file",
        "expected cameras and frames",
        "docs/data.md",
    ] {
        assert!(message.contains(word), "{word}: {message}");
    }
    std::fs::write(data.join("transforms_4.json"), "{}").unwrap();
    let message = refused(&data);
    assert!(
        message.contains("--set data.transforms=transforms_4.json"),
        "{message}"
    );
    std::fs::create_dir_all(data.join("sparse/0")).unwrap();
    std::fs::write(data.join("sparse/0/cameras.bin"), [0; 8]).unwrap();
    let message = refused(&data);
    assert!(
        message.contains("sparse/0") && message.contains("images.bin or images.txt"),
        "{message}"
    );
    std::fs::write(data.join("transforms.json"), "{}").unwrap();
    let message = refused(&data);
    assert!(
        message.contains("transforms.json (transforms) and sparse/0/cameras.bin (colmap)"),
        "{message}"
    );
    assert!(
        message.contains("--set data.layout=transforms"),
        "{message}"
    );
}

#[test]
fn gaussians_without_photos_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let out = folder.path().join("run");
    let message = fails(&["train", "--scene", utf8(&scene), "--out", utf8(&out)], 1);
    assert!(
        message.contains("--scene") && message.contains("add --data DIR"),
        "{message}"
    );
    assert!(!out.exists());

    // Those of a run are no better, unless that run was on the built-in room.
    let config = scene.with_file_name("config.toml");
    let open = |content: &str| {
        std::fs::write(&config, content).unwrap();
        let options = RunOptions {
            scene: Some(scene.clone()),
            out: Some(out.clone()),
            ..RunOptions::default()
        };
        options.open().map(|(_, config)| config.data.dir)
    };
    let refused = open("seed = 3\n[data]\ndir = \"elsewhere\"\n").unwrap_err();
    assert_names(&refused, &["--scene", "add --data DIR"]);
    assert_eq!(open("seed = 3\n").unwrap(), None);
}

#[test]
fn a_run_is_not_resumed_with_other_settings() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join("run");
    let small = [
        "--set",
        "building.iterations=12",
        "--set",
        "building.random_points=200",
    ];
    let rows = [
        "--set",
        "segmentation.iterations=6",
        "--set",
        "segmentation.rows=per_gaussian",
    ];
    let train = ["train", "--data", utf8(folder.path()), "--out", utf8(&run)];
    succeeds(&[&train[..], &small, &rows].concat());
    let before = std::fs::read(run.join("config.toml")).unwrap();
    let resume = ["train", "--resume", utf8(&run)];
    for (set, then) in [
        ("building.iterations=20", "12"),
        ("segmentation.iterations=3", "6"),
        ("seed=4", "0"),
    ] {
        let message = fails(&[&resume[..], &["--set", set]].concat(), 1);
        let (key, now) = set.split_once('=').unwrap();
        for word in [key, &format!("found {now}"), &format!("expected {then}")] {
            assert!(message.contains(word), "{word}: {message}");
        }
        assert_eq!(
            std::fs::read(run.join("config.toml")).unwrap(),
            before,
            "the run keeps its settings"
        );
    }
    succeeds(&resume);
}

//! The program as a user runs it: exit codes, messages, and the files that it writes.

use crate::support::plates::{HEIGHT, WIDTH, camera, plates, scene};
use crate::support::program::{cpu_backend, fails, read_json, read_npy, succeeds, text, utf8};
use crate::support::short_runs::short_run;
use coseg::data::{Classes, Limits};
use coseg::raster::{Settings, render};
use coseg::splat::camera::Camera;
use coseg::splat::ply;
use glam::DVec3;
use std::ffi::OsString;
use std::path::Path;
use std::process::Command;

#[test]
fn help_names_every_command_and_shows_examples() {
    let help = succeeds(&["--help"]);
    for word in [
        "train",
        "label",
        "data",
        "eval",
        "render",
        "view",
        "vote",
        "associate",
        "objects",
        "edit",
        "bench",
        "compare",
        "Examples:",
        "Exit code",
    ] {
        assert!(help.contains(word), "{word}");
    }
    for command in [
        "train",
        "label",
        "data",
        "eval",
        "render",
        "vote",
        "associate",
        "objects",
        "edit",
        "bench",
    ] {
        let help = succeeds(&[command, "--help"]);
        assert!(help.contains("Example"), "{command}");
        let wide: Vec<&str> = help
            .lines()
            .filter(|line| line.chars().count() > 130)
            .collect();
        assert!(wide.is_empty(), "{wide:?}");
    }
    assert!(succeeds(&["--version"]).contains(env!("CARGO_PKG_VERSION")));
}

#[test]
fn mistakes_on_the_command_line_exit_with_2() {
    fails(&["train", "--bogus"], 2);
    fails(&["paint"], 2);
    fails(&["render", "--scene", "x.ply"], 2);
    fails(&["train", "--resume", "a", "--out", "b"], 2);
    let message = fails(&["train", "--backend", "abacus"], 2);
    assert!(message.contains("wgpu, flex or ndarray"), "{message}");
    let render = [
        "render",
        "--scene",
        "x.ply",
        "--cameras",
        "y.json",
        "--out",
        "z",
        "--background",
    ];
    for color in ["1,2,3", "0,0", "0,0,0,0", "a,b,c", "nan,0,0"] {
        let message = fails(&[&render[..], &[color]].concat(), 2);
        assert!(message.contains("three numbers from 0 to 1"), "{message}");
    }
}

#[test]
fn bad_settings_exit_with_2_and_touch_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let train = ["train", "--out", utf8(&out), "--set"];
    for (set, word) in [
        ("building.iteratons=5", "did you mean building.iterations?"),
        ("segmentation.lr=-1", "segmentation.lr"),
    ] {
        let message = fails(&[&train[..], &[set]].concat(), 2);
        assert!(message.contains(word), "{message}");
    }
    assert!(!out.exists());
}

#[test]
fn bad_input_exits_with_1_and_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let message = fails(
        &["train", "--out", utf8(&out), "--data", "no/such/scene"],
        1,
    );
    assert!(message.contains("no/such/scene"), "{message}");
    let message = fails(&["train", "--resume", utf8(folder.path())], 1);
    assert!(message.contains("config.toml"), "{message}");
    let message = fails(&["eval", utf8(folder.path())], 1);
    assert!(message.contains("a run folder"), "{message}");

    let scene = scene(folder.path());
    let cameras = folder.path().join("transforms.json");
    let render = [
        "render",
        "--scene",
        utf8(&scene),
        "--cameras",
        utf8(&cameras),
        "--out",
        utf8(&out),
    ];
    let message = fails(&[&render[..], &["--alpha-max", "1.5"]].concat(), 2);
    assert!(
        message.contains("--alpha-max") && message.contains("1.5"),
        "{message}"
    );
    let whole = std::fs::read(&scene).unwrap();
    std::fs::write(&scene, &whole[..whole.len() - 30]).unwrap();
    let message = fails(&render, 1);
    assert!(message.contains("plates.ply"), "{message}");
    let (gaussians, _) = plates();
    ply::write(&scene, &gaussians, DVec3::ZERO, None).unwrap();
    let message = fails(&[&render[..], &["--labels"]].concat(), 1);
    assert!(message.contains("column label"), "{message}");
    assert!(
        !out.exists(),
        "nothing is written before input is known to be good"
    );
}

#[test]
fn render_writes_arrays_labels_and_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (scene(folder.path()), folder.path().join("out"));
    let cameras = folder.path().join("transforms.json");
    let render_args = [
        "render",
        "--scene",
        utf8(&scene),
        "--cameras",
        utf8(&cameras),
        "--out",
        utf8(&out),
    ];
    let more = [
        "--format",
        "npy",
        "--labels",
        "--split",
        "test",
        "--background",
        "1,0.5,0",
        "--alpha-max",
        "0.9",
    ];
    let cpu = cpu_backend();
    succeeds(&[&render_args[..], &more, &["--backend", &cpu]].concat());
    let mut files: Vec<_> = std::fs::read_dir(&out)
        .unwrap()
        .map(|e| e.unwrap().file_name())
        .collect();
    files.sort();
    let of_view = |view: &str| {
        ["alpha.npy", "label.png", "label_color.png", "rgb.npy"]
            .map(|kind| OsString::from(format!("{view}.{kind}")))
    };
    let expected = [of_view("v2"), of_view("v5")].concat();
    assert_eq!(files, expected);

    let read = ply::read(&scene, &Limits::default()).unwrap();
    let camera = Camera {
        center: camera(5).center - read.origin,
        ..camera(5)
    };
    let settings = Settings {
        alpha_max: 0.9,
        ..Settings::default()
    };
    let expected = render(&read.gaussians, &camera, &settings, [1.0, 0.5, 0.0]).unwrap();
    let (shape, rgb) = read_npy(&out.join("v5.rgb.npy"));
    assert_eq!(shape, [HEIGHT as u64, WIDTH as u64, 3]);
    assert_eq!(rgb, expected.rgb);
    let (shape, alpha) = read_npy(&out.join("v5.alpha.npy"));
    assert_eq!(shape, [HEIGHT as u64, WIDTH as u64]);
    assert!(
        alpha
            .iter()
            .zip(&expected.transmittance)
            .all(|(a, t)| *a == 1.0 - t)
    );

    let labels = image::open(out.join("v5.label.png")).unwrap().into_luma8();
    assert_eq!(
        (labels.width() as usize, labels.height() as usize),
        (WIDTH, HEIGHT)
    );
    let mut seen: Vec<u8> = labels.as_raw().clone();
    for (id, a) in seen.iter().zip(&alpha) {
        assert_eq!(
            *id == 0,
            *a < 0.5,
            "no label exactly where the scene covers less than half"
        );
    }
    seen.sort_unstable();
    seen.dedup();
    assert!([1, 2, 3, 4].iter().all(|id| seen.contains(id)), "{seen:?}");
    #[cfg(feature = "wgpu")]
    if crate::support::gpu().is_some() {
        succeeds(&[&render_args[..], &more, &["--backend", "wgpu"]].concat());
        let (_, on_gpu) = read_npy(&out.join("v5.rgb.npy"));
        let differ = on_gpu
            .iter()
            .zip(&rgb)
            .filter(|(a, b)| (*a - *b).abs() > 1e-4)
            .count();
        assert!(
            on_gpu.len() == rgb.len() && differ * 1000 < rgb.len(),
            "{differ} of {}",
            rgb.len()
        );
        assert_eq!(
            image::open(out.join("v5.label.png")).unwrap().into_luma8(),
            labels
        );
    }

    succeeds(&[&render_args[..], &["--split", "train"]].concat());
    let picture = image::open(out.join("v0.rgb.png")).unwrap().into_rgb8();
    let photo = image::open(folder.path().join("images/v0.png"))
        .unwrap()
        .into_rgb8();
    let largest = picture
        .iter()
        .zip(photo.iter())
        .map(|(a, b)| a.abs_diff(*b))
        .max()
        .unwrap();
    assert!(
        largest <= 1,
        "a render of the scene that made the photo differs by {largest}"
    );
    assert!(out.join("v0.alpha.png").is_file() && !out.join("v0.label.png").exists());
}

#[test]
fn vote_outvotes_wrong_views() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (scene(folder.path()), folder.path().join("voted"));
    // Without the label column: labels come from the raw maps alone.
    let (gaussians, truth) = plates();
    ply::write(&scene, &gaussians, DVec3::ZERO, None).unwrap();
    let said = succeeds(&[
        "vote",
        "--scene",
        utf8(&scene),
        "--data",
        utf8(folder.path()),
        "--out",
        utf8(&out),
    ]);
    assert!(
        said.contains("mIoU") && said.contains("2 held-out views"),
        "{said}"
    );
    let voted = ply::read(&out.join("scene.ply"), &Limits::default()).unwrap();
    // Red is called green in one training view of four. The outermost Gaussians of a plate reach over its border.
    let labels = voted.labels.unwrap();
    let right = labels.iter().zip(&truth).filter(|(a, b)| a == b).count();
    assert!(
        right * 10 >= truth.len() * 9,
        "{right} of {}: {labels:?}",
        truth.len()
    );
    for middle in [12, 37, 62] {
        assert_eq!(labels[middle], truth[middle]);
    }
    assert_eq!(Classes::read(&out.join("classes.json")).unwrap().len(), 4);
}

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
    let (scene, cameras, out) = (
        run.join("scene.ply"),
        run.join("cameras.json"),
        folder.path().join("again"),
    );
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
        message.contains("--data") && message.contains("not those of the run"),
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

/// Where the loaders of Vulkan and OpenGL find no driver.
#[cfg(all(feature = "wgpu", target_os = "linux"))]
const WITHOUT_DRIVERS: [(&str, &str); 4] = [
    ("VK_ICD_FILENAMES", "/nonexistent"),
    ("VK_DRIVER_FILES", "/nonexistent"),
    ("__EGL_VENDOR_LIBRARY_FILENAMES", "/nonexistent"),
    ("XDG_RUNTIME_DIR", "/nonexistent"),
];

#[cfg(all(feature = "wgpu", target_os = "linux"))]
fn without_drivers(arguments: &[&str]) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_coseg"))
        .args(arguments)
        .envs(WITHOUT_DRIVERS)
        .output()
        .unwrap();
    let message = text(&output.stderr);
    assert!(
        !message.contains("panicked") && !message.contains("fault of its own"),
        "{message}"
    );
    (output.status.code(), message)
}

#[test]
#[cfg(all(feature = "wgpu", target_os = "linux"))]
fn a_missing_adapter_is_an_error_or_a_notice_and_no_panic() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join("run");
    let small = [
        "--set",
        "building.iterations=3",
        "--set",
        "building.random_points=100",
    ];
    let train = [
        "train",
        "--data",
        utf8(folder.path()),
        "--out",
        utf8(&run),
        "--set",
        "segmentation.rows=raw",
    ];
    let (code, message) = without_drivers(&[&train[..], &small, &["--backend", "wgpu"]].concat());
    assert_eq!(code, Some(1), "{message}");
    for word in [
        "error: device wgpu: no usable adapter",
        "driver",
        "another backend",
    ] {
        assert!(message.contains(word), "{word}: {message}");
    }
    assert!(!message.contains(" -> ") && !run.exists(), "{message}");

    let (code, message) = without_drivers(&[&train[..], &small].concat());
    assert_eq!(code, Some(0), "{message}");
    let next = if cfg!(feature = "flex") {
        "flex"
    } else {
        "ndarray"
    };
    assert_eq!(message.matches("no usable adapter").count(), 1, "{message}");
    assert!(
        message.contains(&format!("computing with {next} instead")),
        "{message}"
    );
    assert!(message.contains(&format!("({next} backend")), "{message}");
}

#[test]
#[cfg(all(feature = "wgpu", feature = "ndarray", target_os = "linux"))]
fn weights_of_features_are_read_on_the_device_of_the_run() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let (run, weights) = (
        folder.path().join("run"),
        folder.path().join("blur.safetensors"),
    );
    crate::support::mobilenet_weights::write_blur_weights(&weights);
    let source = format!("features.weights={}", utf8(&weights));
    let sets = [
        "building.iterations=3",
        "building.random_points=100",
        "segmentation.iterations=1",
        &source,
    ];
    let sets = sets.iter().flat_map(|set| ["--set", set]);
    let train = [
        "train",
        "--data",
        utf8(folder.path()),
        "--out",
        utf8(&run),
        "--backend",
        "ndarray",
    ];
    let arguments: Vec<&str> = train
        .into_iter()
        .chain(sets)
        .chain(["--set", "segmentation.rows=ours"])
        .collect();
    // Nothing else may be asked for: there is no adapter.
    let (code, message) = without_drivers(&arguments);
    assert_eq!(code, Some(0), "{message}");
    assert!(!message.contains("adapter"), "{message}");
    let features = &read_json(&run.join("metrics.json"))["features"];
    assert!(
        features.as_str().unwrap().starts_with("mobilenetv2"),
        "{features}"
    );
}

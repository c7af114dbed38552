//! A run folder that is resumed.

use crate::support::plates::{plates, scene};
use crate::support::program::{fails, read_json, succeeds, utf8, warnings};
use crate::support::short_runs::short_run;
use coseg::splat::ply;
use glam::DVec3;
use std::collections::BTreeMap;
use std::path::Path;

#[test]
fn a_finished_run_is_gone_on_with_and_keeps_what_it_knew() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join("run");
    short_run(folder.path(), &run);
    let metrics = read_json(&run.join("metrics.json"));
    let message = fails(
        &["train", "--data", utf8(folder.path()), "--out", utf8(&run)],
        1,
    );
    assert!(message.contains("--resume"), "{message}");
    let before = std::fs::read(run.join("scene.ply")).unwrap();
    succeeds(&["train", "--resume", utf8(&run)]);
    assert_eq!(std::fs::read(run.join("scene.ply")).unwrap(), before);
    let resumed = read_json(&run.join("metrics.json"));
    assert_eq!(
        (&resumed["test"], &resumed["curves"]),
        (&metrics["test"], &metrics["curves"])
    );
    // What it took stays known, and so does how it began.
    for stage in ["building", "segmentation"] {
        let trained = metrics["curves"]["building"]["loss"]
            .as_array()
            .map_or(0, Vec::len);
        assert!(
            trained > 0 && resumed["seconds"][stage].as_f64() > Some(0.0),
            "{stage}: {resumed}"
        );
    }
    let trained = resumed["test"]["labels"]["per_gaussian"]["seconds"]
        .as_f64()
        .unwrap();
    assert!(
        resumed["seconds"]["segmentation"].as_f64().unwrap() >= trained,
        "{resumed}"
    );
    let lines = |metrics: &serde_json::Value| -> Vec<String> {
        metrics["commands"]
            .as_array()
            .unwrap()
            .iter()
            .map(|c| c["line"].as_str().unwrap().to_owned())
            .collect()
    };
    let (first, both) = (lines(&metrics), lines(&resumed));
    assert_eq!((first.len(), &both[..1]), (1, &first[..]));
    assert!(
        first[0].contains("--seed 3") && both[1].contains("--resume"),
        "{both:?}"
    );
    let page = std::fs::read_to_string(run.join("report.html")).unwrap();
    assert!(page.contains("--seed 3") && page.contains("--resume"));
    // The scene may move meanwhile; it is found from any folder.
    let config = std::fs::read_to_string(run.join("config.toml")).unwrap();
    assert!(
        config.contains(&format!("dir = {:?}", utf8(folder.path()))),
        "{config}"
    );
    let moved = tempfile::tempdir().unwrap();
    for name in ["transforms.json", "classes.json", "images", "labels", "raw"] {
        std::fs::rename(folder.path().join(name), moved.path().join(name)).unwrap();
    }
    let message = fails(&["train", "--resume", utf8(&run)], 1);
    assert!(message.contains(utf8(folder.path())), "{message}");
    succeeds(&[
        "train",
        "--resume",
        utf8(&run),
        "--data",
        utf8(moved.path()),
    ]);
    assert_eq!(
        read_json(&run.join("metrics.json"))["test"],
        metrics["test"]
    );
}

#[test]
fn a_run_that_was_stopped_or_whose_scene_moved_is_named() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join("a run");
    short_run(folder.path(), &run);
    let eval = ["eval", utf8(&run)];
    assert!(!warnings(&eval).contains("--resume"));

    // The figures come last.
    std::fs::remove_file(run.join("metrics.json")).unwrap();
    let resume = format!("coseg train --resume '{}'", utf8(&run));
    let said = warnings(&eval);
    assert!(said.contains(&resume), "{said}");
    std::fs::remove_file(run.join("cameras.json")).unwrap();
    let out = folder.path().join("out");
    let message = fails(&["render", "--scene", utf8(&run), "--out", utf8(&out)], 1);
    assert!(message.contains(&resume), "{message}");
    let (gaussians, _) = plates();
    ply::write(&run.join("scene.ply"), &gaussians, DVec3::ZERO, None).unwrap();
    let message = fails(&["objects", "--scene", utf8(&run)], 1);
    assert!(message.contains(&resume), "{message}");

    let file = run.join("config.toml");
    let config = std::fs::read_to_string(&file).unwrap();
    let moved = config.replace(utf8(folder.path()), "/elsewhere");
    std::fs::write(&file, moved).unwrap();
    for command in [&eval[..], &["train", "--resume", utf8(&run)]] {
        let message = fails(command, 1);
        assert!(
            message.contains("/elsewhere") && message.contains("add --data DIR"),
            "{message}"
        );
    }
}

#[test]
fn the_gaussians_of_a_run_are_labelled_by_another() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let (run, again) = (folder.path().join("run"), folder.path().join("again"));
    let train = [
        "train",
        "--data",
        utf8(folder.path()),
        "--set",
        "segmentation.rows=vote",
    ];
    let small = [
        "--set",
        "building.iterations=40",
        "--set",
        "building.random_points=300",
    ];
    succeeds(&[&train[..], &small, &["--out", utf8(&run)]].concat());
    succeeds(&[&train[..], &["--scene", utf8(&run), "--out", utf8(&again)]].concat());
    let [first, second] = [&run, &again].map(|run| read_json(&run.join("metrics.json")));
    assert_eq!(first["gaussians"], second["gaussians"]);
    // The same Gaussians and votes, except for the rounding of the file's positions.
    for (pointer, tolerance) in [
        ("/test/psnr", 1e-3),
        ("/test/labels/vote/miou", 5e-3),
        ("/test/labels/vote/accuracy", 5e-3),
    ] {
        let [a, b] =
            [&first, &second].map(|metrics| metrics.pointer(pointer).unwrap().as_f64().unwrap());
        assert!((a - b).abs() < tolerance, "{pointer}: {a} {b}");
    }
    assert!(
        second["curves"]["building"]["loss"]
            .as_array()
            .unwrap()
            .is_empty(),
        "none were built"
    );
    let page = std::fs::read_to_string(again.join("report.html")).unwrap();
    assert!(page.contains("The Gaussians are those of a file"));
    // Those that are read are never written over.
    for command in ["vote", "associate"] {
        let before = std::fs::read(run.join("scene.ply")).unwrap();
        let message = fails(
            &[
                command,
                "--scene",
                utf8(&run),
                "--data",
                utf8(folder.path()),
                "--out",
                utf8(&run),
            ],
            1,
        );
        let refusals = ["written over", "which this command did not write"];
        assert!(refusals.iter().any(|r| message.contains(r)), "{message}");
        assert_eq!(std::fs::read(run.join("scene.ply")).unwrap(), before);
    }
}

/// What lies in a run folder, except checkpoints and lock.
fn contents(run: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = std::fs::read_dir(run)
        .unwrap()
        .flatten()
        .filter(|entry| entry.path().is_file());
    files
        // The lock names another process each time.
        .filter(|entry| entry.file_name() != ".coseg-lock")
        .map(|entry| {
            (
                entry.file_name().into_string().unwrap(),
                std::fs::read(entry.path()).unwrap(),
            )
        })
        .collect()
}

#[test]
fn a_refused_resume_leaves_the_run_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let (run, taken) = (folder.path().join("run"), folder.path().join("taken"));
    let train = [
        "train",
        "--data",
        utf8(folder.path()),
        "--set",
        "segmentation.iterations=20",
        "--out",
    ];
    let small = [
        "--set",
        "building.iterations=40",
        "--set",
        "building.random_points=300",
    ];
    let rows = ["--set", "segmentation.rows=vote,per_gaussian"];
    succeeds(&[&train[..], &[utf8(&run)], &small, &rows].concat());
    succeeds(&[&train[..], &[utf8(&taken), "--scene", utf8(&run)], &rows].concat());
    let other = folder.path().join("plates.ply");
    let cases: [(&Path, &[&str], &str); 5] = [
        (
            &run,
            &["segmentation.iterations=30"],
            "segmentation.iterations",
        ),
        (&run, &["building.iterations=50"], "building.iterations"),
        (
            &run,
            &[
                "building.iterations=0",
                &format!("building.gaussians={}", other.display()),
            ],
            "building.",
        ),
        (&taken, &["building.iterations=30"], "building.iterations"),
        (
            &taken,
            &[&format!("building.gaussians={}", other.display())],
            "building.gaussians",
        ),
    ];
    let written = |run: &Path| {
        std::fs::metadata(run.join("config.toml"))
            .unwrap()
            .modified()
            .unwrap()
    };
    for (run, sets, named) in cases {
        let before = contents(run);
        let since = written(run);
        let sets = sets.iter().flat_map(|set| ["--set", set]);
        let message = fails(
            &["train", "--resume", utf8(run)]
                .into_iter()
                .chain(sets)
                .collect::<Vec<_>>(),
            1,
        );
        assert!(message.contains(named), "{named}: {message}");
        assert!(
            before == contents(run),
            "{named}: a refusal touches nothing"
        );
        assert_eq!(
            written(run),
            since,
            "{named}: settings are not written before they are known to be taken"
        );
    }
    // Photos of what was taken from a file are looked at too.
    let photo = folder.path().join("images/v0.png");
    let mut pixels = image::open(&photo).unwrap().into_rgb8();
    pixels.put_pixel(0, 0, image::Rgb([255, 0, 255]));
    pixels.save(&photo).unwrap();
    for run in [&run, &taken] {
        let before = contents(run);
        assert!(
            fails(&["train", "--resume", utf8(run)], 1)
                .contains("photos, masks, cameras and points")
        );
        assert!(before == contents(run));
    }
}

#[test]
fn a_file_that_cannot_be_begun_with_leaves_the_folder_free() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let out = folder.path().join("out");
    let bad = folder.path().join("bad.ply");
    std::fs::write(
        &bad,
        "ply\nformat ascii 1.0\nelement vertex 1\nend_header\n",
    )
    .unwrap();
    let good = folder.path().join("plates.ply");
    let with = |scene: &Path| {
        let data = utf8(folder.path());
        [
            "train",
            "--data",
            data,
            "--set",
            "segmentation.rows=vote",
            "--out",
            utf8(&out),
            "--scene",
            utf8(scene),
        ]
        .map(str::to_owned)
    };
    let refused =
        |arguments: &[String]| fails(&arguments.iter().map(String::as_str).collect::<Vec<_>>(), 1);
    assert!(refused(&with(&bad)).contains("bad.ply") && !out.exists());
    // Nor does a run write over what it begins with.
    std::fs::create_dir(&out).unwrap();
    std::fs::copy(&good, out.join("scene.ply")).unwrap();
    let message = refused(&with(&out));
    assert!(
        message.contains("did not write") && contents(&out).len() == 1,
        "{message}"
    );
    // The last iteration in a model folder of graphdeco's.
    let model = folder.path().join("model");
    for (iteration, file) in [("iteration_7000", &bad), ("iteration_30000", &good)] {
        let at = model.join("point_cloud").join(iteration);
        std::fs::create_dir_all(&at).unwrap();
        std::fs::copy(file, at.join("point_cloud.ply")).unwrap();
    }
    std::fs::remove_dir_all(&out).unwrap();
    succeeds(&with(&model).iter().map(String::as_str).collect::<Vec<_>>());
}

#[test]
fn a_run_that_no_longer_has_labels_keeps_none() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join("run");
    short_run(folder.path(), &run);
    let labelled = [
        "identities.safetensors",
        "renders/v2.label.png",
        "renders/v2.label_color.png",
    ];
    let labelled = labelled
        .into_iter()
        .chain(["renders/v2.label_error.png"])
        .map(|file| run.join(file));
    let labelled: Vec<_> = labelled.collect();
    assert!(labelled.iter().all(|file| file.is_file()));
    for rows in ["[]", "raw"] {
        succeeds(&[
            "train",
            "--resume",
            utf8(&run),
            "--set",
            &format!("segmentation.rows={rows}"),
        ]);
        for file in &labelled {
            assert!(!file.exists(), "{rows}: {}", file.display());
        }
        let scores: serde_json::Value =
            serde_json::from_str(&succeeds(&["eval", utf8(&run), "--json"])).unwrap();
        assert_eq!(scores["test"]["labels"], serde_json::json!({}), "{rows}");
        assert!(!succeeds(&["eval", utf8(&run)]).contains("mIoU"), "{rows}");
        // And once there are labels again, so are their files.
        succeeds(&[
            "train",
            "--resume",
            utf8(&run),
            "--set",
            "segmentation.rows=vote",
        ]);
        assert!(labelled.iter().all(|file| file.is_file()), "{rows}");
    }
}

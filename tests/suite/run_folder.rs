//! A run folder that is gone on with.

use crate::cli::{fails, read_json, succeeds, utf8};
use crate::plates::scene;

#[test]
fn a_finished_run_is_gone_on_with_and_keeps_what_it_knew() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join("run");
    let small = ["--set", "building.iterations=40", "--set", "building.random_points=300"];
    let rows = ["--set", "segmentation.iterations=20", "--set", "segmentation.rows=raw,vote,per_gaussian"];
    let train = ["train", "--data", utf8(folder.path()), "--out", utf8(&run), "--seed", "3"];
    succeeds(&[&train[..], &small, &rows].concat());
    let metrics = read_json(&run.join("metrics.json"));
    let message = fails(&train, 1);
    assert!(message.contains("--resume"), "{message}");
    let before = std::fs::read(run.join("scene.ply")).unwrap();
    succeeds(&["train", "--resume", utf8(&run)]);
    assert_eq!(std::fs::read(run.join("scene.ply")).unwrap(), before);
    let resumed = read_json(&run.join("metrics.json"));
    assert_eq!((&resumed["test"], &resumed["curves"]), (&metrics["test"], &metrics["curves"]));
    // What it took stays known, and so does how it began.
    for stage in ["building", "segmentation"] {
        let trained = metrics["curves"]["building"]["loss"].as_array().map_or(0, Vec::len);
        assert!(trained > 0 && resumed["seconds"][stage].as_f64() > Some(0.0), "{stage}: {resumed}");
    }
    let trained = resumed["test"]["labels"]["per_gaussian"]["seconds"].as_f64().unwrap();
    assert!(resumed["seconds"]["segmentation"].as_f64().unwrap() >= trained, "{resumed}");
    let lines = |metrics: &serde_json::Value| -> Vec<String> {
        metrics["commands"].as_array().unwrap().iter().map(|c| c["line"].as_str().unwrap().to_owned()).collect()
    };
    let (first, both) = (lines(&metrics), lines(&resumed));
    assert_eq!((first.len(), &both[..1]), (1, &first[..]));
    assert!(first[0].contains("--seed 3") && both[1].contains("--resume"), "{both:?}");
    let page = std::fs::read_to_string(run.join("report.html")).unwrap();
    assert!(page.contains("--seed 3") && page.contains("--resume"));
    // The scene may move meanwhile; it is found from any folder.
    let config = std::fs::read_to_string(run.join("config.toml")).unwrap();
    assert!(config.contains(&format!("dir = {:?}", utf8(folder.path()))), "{config}");
    let moved = tempfile::tempdir().unwrap();
    for name in ["transforms.json", "classes.json", "images", "labels", "raw"] {
        std::fs::rename(folder.path().join(name), moved.path().join(name)).unwrap();
    }
    let message = fails(&["train", "--resume", utf8(&run)], 1);
    assert!(message.contains(utf8(folder.path())), "{message}");
    succeeds(&["train", "--resume", utf8(&run), "--data", utf8(moved.path())]);
    assert_eq!(read_json(&run.join("metrics.json"))["test"], metrics["test"]);
}

#[test]
fn the_gaussians_of_a_run_are_labelled_by_another() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let (run, again) = (folder.path().join("run"), folder.path().join("again"));
    let train = ["train", "--data", utf8(folder.path()), "--set", "segmentation.rows=vote"];
    let small = ["--set", "building.iterations=40", "--set", "building.random_points=300"];
    succeeds(&[&train[..], &small, &["--out", utf8(&run)]].concat());
    succeeds(&[&train[..], &["--scene", utf8(&run), "--out", utf8(&again)]].concat());
    let [first, second] = [&run, &again].map(|run| read_json(&run.join("metrics.json")));
    assert_eq!(first["gaussians"], second["gaussians"]);
    // The same Gaussians and votes, but for the rounding of the file's positions.
    for (pointer, tolerance) in
        [("/test/psnr", 1e-3), ("/test/labels/vote/miou", 5e-3), ("/test/labels/vote/accuracy", 5e-3)]
    {
        let [a, b] = [&first, &second].map(|metrics| metrics.pointer(pointer).unwrap().as_f64().unwrap());
        assert!((a - b).abs() < tolerance, "{pointer}: {a} {b}");
    }
    assert!(second["curves"]["building"]["loss"].as_array().unwrap().is_empty(), "none were built");
    let page = std::fs::read_to_string(again.join("report.html")).unwrap();
    assert!(page.contains("The Gaussians are those of a file"));
    // Those that are read are never written over.
    for command in ["vote", "associate"] {
        let before = std::fs::read(run.join("scene.ply")).unwrap();
        let message = fails(&[command, "--scene", utf8(&run), "--data", utf8(folder.path()), "--out", utf8(&run)], 1);
        assert!(message.contains("written over"), "{message}");
        assert_eq!(std::fs::read(run.join("scene.ply")).unwrap(), before);
    }
}

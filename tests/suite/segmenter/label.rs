//! `coseg label`: a folder of labels from photos, what loaders make of it, and what is never overwritten.

use crate::support::onnx::plates;
use crate::support::plates::{self, HEIGHT, WIDTH};
use crate::support::program::{fails, listed, succeeds, utf8};
use crate::support::snapshot::snapshot;
use coseg::config::Config;
use coseg::data::{Classes, LabelMap, LoadOptions, ScoreMap, View, load};
use coseg::objects::{vote, weighted_vote};
use coseg::provenance::Provenance;
use coseg::raster::Settings;
use glam::Vec3;
use std::path::{Path, PathBuf};

fn classes(folder: &Path) -> PathBuf {
    let file = folder.join("mine.toml");
    let text = "[classes]\nred = [\"crimson\"]\ngreen = [\"lime\"]\nblue = [\"navy\"]\nwall = [\"plaster\", \"nothing\"]\n";
    std::fs::write(&file, text).expect("classes");
    file
}

/// `coseg label` of the scene `dir` by `model`, into `out`.
pub(super) fn arguments<'a>(dir: &'a Path, model: &'a Path, out: &'a Path) -> [&'a str; 7] {
    let [dir, model, out] = [dir, model, out].map(utf8);
    ["label", "--data", dir, "--model", model, "--out", out]
}

/// Files whose names begin with a dot.
fn hidden(dir: &Path) -> Vec<String> {
    let names = std::fs::read_dir(dir)
        .expect("folder")
        .map(|entry| entry.expect("entry").file_name());
    let names = names.map(|name| name.to_string_lossy().into_owned());
    names.filter(|name| name.starts_with('.')).collect()
}

pub(super) fn views(dir: &Path, labels: &Path) -> (Vec<View>, Classes) {
    let options = LoadOptions {
        raw_labels: Some(utf8(labels).into()),
        ..LoadOptions::default()
    };
    let scene = load(dir, &options).expect("scene");
    (scene.views, scene.classes)
}

/// Share of pixels with true labels where the raw ones agree.
fn agreement(view: &View) -> f64 {
    let [truth, raw] = [&view.truth, &view.raw].map(|map| map.as_ref().expect("map").map().ids);
    let known: Vec<_> = truth
        .iter()
        .zip(&raw)
        .filter(|(truth, _)| **truth != 0)
        .collect();
    known.iter().filter(|(truth, raw)| truth == raw).count() as f64 / known.len() as f64
}

#[test]
fn photos_become_labels_with_scores_in_the_classes_of_the_scene() {
    let (folder, dir, model) = plates();
    let out = folder.path().join("labels");
    let mine = classes(folder.path());
    let label = [
        &arguments(&dir, &model, &out)[..],
        &["--classes", utf8(&mine)],
    ]
    .concat();
    let said = succeeds(&label);
    assert!(
        said.contains("6 photos, 0 labelled before; 4 classes"),
        "{said}"
    );
    let (views, table) = views(&dir, &out);
    let mut found = Vec::new();
    for view in &views {
        let agreement = agreement(view);
        assert!(agreement > 0.85, "{}: {agreement}", view.name);
        let scores = view
            .scores
            .as_ref()
            .expect("scores")
            .read(&table)
            .expect("read");
        let raw = view.raw.as_ref().expect("raw").map();
        let mut same = 0;
        for pixel in 0..WIDTH * HEIGHT {
            scores.at(pixel % WIDTH, pixel / WIDTH, &mut found);
            let sum: f32 = found.iter().map(|(_, p)| p).sum();
            assert!(
                (sum - 1.0).abs() < 1e-5 && found.is_sorted_by(|a, b| a.1 >= b.1),
                "{found:?}"
            );
            same += usize::from(table.entries[usize::from(found[0].0)].id == raw.ids[pixel]);
        }
        // Probabilities and logits blend differently between cells.
        assert!(same as f64 > 0.9 * (WIDTH * HEIGHT) as f64, "{same}");
    }
    // Again: nothing is computed, nothing is written.
    let written = |name: &str| {
        std::fs::metadata(out.join(name))
            .expect("file")
            .modified()
            .expect("time")
    };
    let before = ["v0.png", "scores/v3.scores", "classes.json"].map(written);
    let said = succeeds(&label);
    assert!(said.contains("6 photos, 6 labelled before"), "{said}");
    assert_eq!(
        before,
        ["v0.png", "scores/v3.scores", "classes.json"].map(written)
    );
    // A file that is missing is made again, and only that photo.
    std::fs::remove_file(out.join("scores/v3.scores")).expect("remove");
    assert!(succeeds(&label).contains("5 labelled before"));
    assert!(out.join("scores/v3.scores").is_file());
}

#[test]
fn without_a_list_the_classes_are_those_that_occur() {
    let (folder, dir, model) = plates();
    for name in ["classes.json", "transforms.json"] {
        let path = dir.join(name);
        let text = std::fs::read_to_string(&path).expect("read");
        std::fs::remove_file(&path).expect("remove");
        if name == "transforms.json" {
            std::fs::write(path, text.replace("label_path", "other_path")).expect("write");
        }
    }
    let out = folder.path().join("labels");
    succeeds(&arguments(&dir, &model, &out));
    let (views, table) = views(&dir, &out);
    let names: Vec<&str> = table
        .entries
        .iter()
        .map(|class| class.name.as_str())
        .collect();
    assert_eq!(
        names,
        ["crimson", "lime", "navy", "plaster"],
        "the table lies beside the maps"
    );
    assert!(
        views
            .iter()
            .all(|view| view.raw.is_some() && view.scores.is_some())
    );
}

#[test]
fn what_the_command_did_not_write_is_refused() {
    let (folder, dir, model) = plates();
    let refused = |out: &Path, parts: &[&str]| {
        let message = fails(&arguments(&dir, &model, out), 1);
        parts
            .iter()
            .for_each(|part| assert!(message.contains(part), "{part}: {message}"));
    };
    let before = snapshot(&dir);
    for inside in ["", "images", "labels", "raw"] {
        refused(&dir.join(inside), &["--out", "files of a scene"]);
    }
    assert!(snapshot(&dir) == before, "nothing in the scene changed");
    let used = folder.path().join("used");
    std::fs::create_dir(&used).expect("folder");
    std::fs::write(used.join("notes.txt"), "mine").expect("write");
    refused(&used, &["label.json", "notes.txt", "new folder"]);
    assert_eq!(hidden(&used), [""; 0], "the folder is as it was");
    // A map that somebody corrected.
    let out = folder.path().join("out");
    succeeds(&arguments(&dir, &model, &out));
    let map = out.join("v2.png");
    let mut ids = LabelMap::read(&map).expect("map");
    ids.ids[0] = 3;
    ids.write(&map).expect("write");
    let corrected = std::fs::read(&map).expect("read");
    refused(&out, &["v2.png", "changed since"]);
    assert!(std::fs::read(&map).expect("read") == corrected);
}

#[test]
fn labels_of_other_photos_from_other_classes_are_refused() {
    let (folder, dir, model) = plates();
    let out = folder.path().join("labels");
    let mine = classes(folder.path());
    let all = arguments(&dir, &model, &out);
    let own_classes = [&all[..], &["--classes", utf8(&mine)]].concat();
    succeeds(&own_classes);
    let two = ["--set", "data.max_frames=1"];
    succeeds(&[&own_classes[..], &two].concat());
    let maps = || ["v0.png", "v5.png", "classes.json"].map(|name| std::fs::read(out.join(name)));
    let before = maps().map(|file| file.expect("a file"));
    let message = fails(&[&all[..], &two].concat(), 1);
    for part in [
        "label.json",
        "not among the photos",
        "other classes",
        "new folder",
    ] {
        assert!(message.contains(part), "{part}: {message}");
    }
    assert!(maps().map(|file| file.expect("a file")) == before);
    // All photos get the other classes.
    succeeds(&all);
}

#[test]
fn features_of_the_segmenter_are_read_by_the_contract_of_its_labels() {
    let (folder, dir, model) = plates();
    // Neither beside the network nor shipped under its name.
    let contract = folder.path().join("elsewhere.toml");
    std::fs::rename(model.with_extension("toml"), &contract).expect("rename");
    let run = folder.path().join("run");
    let ply = dir.join("plates.ply");
    let weights = format!("features.weights={}", utf8(&model));
    let mine = classes(folder.path());
    succeeds(&[
        "train",
        "--data",
        utf8(&dir),
        "--scene",
        utf8(&ply),
        "--segmenter",
        utf8(&model),
        "--contract",
        utf8(&contract),
        "--classes",
        utf8(&mine),
        "--set",
        "features.source.segmenter=logits",
        "--set",
        &weights,
        "--set",
        "segmentation.iterations=4",
        "--set",
        "segmentation.rows=[\"ours\"]",
        "--backend",
        "ndarray",
        "--out",
        utf8(&run),
    ]);
    let config = std::fs::read_to_string(run.join("config.toml")).expect("config");
    assert!(config.contains("elsewhere.toml"), "{config}");
    succeeds(&["train", "--resume", utf8(&run)]);
}

#[test]
fn train_labels_the_photos_first_and_a_resumed_run_refuses_other_scores() {
    let (folder, dir, model) = plates();
    let mine = classes(folder.path());
    let run = folder.path().join("run");
    let ply = dir.join("plates.ply");
    let before = snapshot(&dir);
    let both = ["train", "--data", utf8(&dir), "--segmenter", utf8(&model)];
    let both = [
        &both[..],
        &["--set", "data.raw_labels=raw", "--out", utf8(&run)],
    ]
    .concat();
    let message = fails(&both, 2);
    for part in ["data.raw_labels", "--segmenter", "give one of the two"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    assert!(!run.exists());
    succeeds(&[
        "train",
        "--data",
        utf8(&dir),
        "--scene",
        utf8(&ply),
        "--segmenter",
        utf8(&model),
        "--classes",
        utf8(&mine),
        "--set",
        "segmentation.iterations=4",
        "--set",
        "segmentation.rows=[\"vote\",\"ours\"]",
        "--backend",
        "ndarray",
        "--out",
        utf8(&run),
    ]);
    assert!(snapshot(&dir) == before);
    let labels = run.join("labels");
    let scores = listed(&labels.join("scores"));
    assert_eq!(scores.len(), 6);
    let config = std::fs::read_to_string(run.join("config.toml")).expect("config");
    assert!(
        config.contains(utf8(&labels.canonicalize().expect("labels"))),
        "{config}"
    );
    succeeds(&["train", "--resume", utf8(&run)]);
    let metrics = std::fs::read_to_string(run.join("metrics.json")).expect("metrics");
    assert!(metrics.contains("\"ours\""), "{metrics}");

    // Each photo loses the least probable class of one place.
    for name in scores {
        let file = labels.join("scores").join(name);
        let mut scores = ScoreMap::read(&file).expect("scores");
        let last = scores.probabilities.iter_mut().rfind(|p| **p > 0);
        *last.expect("a probability") = 0;
        scores.write(&file).expect("write");
    }
    let message = fails(&["train", "--resume", utf8(&run)], 1);
    assert!(message.contains("raw labels"), "{message}");
}

#[test]
fn photos_alone_get_told_what_to_do() {
    let folder = tempfile::tempdir().expect("folder");
    let images = folder.path().join("images");
    std::fs::create_dir(&images).expect("folder");
    for name in ["a.jpg", "b.JPG", "c.png"] {
        std::fs::write(images.join(name), "photo").expect("write");
    }
    for dir in [folder.path(), &images] {
        let message = fails(&["train", "--data", utf8(dir)], 1);
        for part in [
            "3 photos without poses",
            "docs/from-photos.md",
            "--segmenter",
        ] {
            assert!(message.contains(part), "{part}: {message}");
        }
    }
}

#[test]
fn pixels_divide_their_vote_by_their_scores_and_distance_weighs_it() {
    let (folder, dir, model) = plates();
    let out = folder.path().join("labels");
    let mine = classes(folder.path());
    let label = ["label", "--data", utf8(&dir), "--model", utf8(&model)];
    let options = ["--classes", utf8(&mine), "--out", utf8(&out)];
    succeeds(&[&label[..], &options].concat());
    let options = LoadOptions {
        raw_labels: Some(utf8(&out).into()),
        ..LoadOptions::default()
    };
    let loaded = load(&dir, &options).expect("scene");
    let (mut gaussians, _) = plates::plates();
    for mean in &mut gaussians.means {
        *mean = (Vec3::from(*mean) - loaded.origin.as_vec3()).to_array();
    }
    let classes = &loaded.classes;
    let settings = Settings::default();
    let device = crate::support::device();
    let view = &loaded.views[0];
    let hard = View {
        scores: None,
        ..view.clone()
    };
    let labels = vote(&gaussians, [view].into_iter(), classes, &settings, &device).unwrap();
    let weighted = |view| {
        weighted_vote(
            &gaussians,
            [view].into_iter(),
            classes,
            true,
            &settings,
            &device,
        )
        .unwrap()
    };
    let (scores, weighted_labels) = (weighted(view), weighted(&hard));
    let rows = |votes: &coseg::objects::Votes| -> Vec<Vec<f32>> {
        let rows = votes.table.chunks_exact(classes.len());
        rows.map(<[f32]>::to_vec).collect()
    };
    let (labels, scores, weighted_labels) = (rows(&labels), rows(&scores), rows(&weighted_labels));
    let close = |a: f32, b: f32| (a - b).abs() <= 1e-4 * b.abs() + 1e-6;
    let mut divided = 0;
    for (i, mean) in gaussians.means.iter().enumerate() {
        let distance = (Vec3::from(*mean).as_dvec3() - view.camera.center).length() as f32;
        for (found, label) in weighted_labels[i].iter().zip(&labels[i]) {
            assert!(close(*found, distance * label), "{i}: {found} of {label}");
        }
        let [all, of_scores] = [&labels[i], &scores[i]].map(|row| row.iter().sum::<f32>());
        assert!(
            close(of_scores, distance * all),
            "{i}: {of_scores} of {all}"
        );
        let named = |row: &[f32]| row.iter().filter(|vote| **vote > 0.0).count();
        divided += usize::from(named(&scores[i]) > named(&labels[i]));
    }
    assert!(divided > 0, "no pixel divides its vote");
    // Without a file of scores it is not known what training would follow from.
    let known = || Provenance::stage_two(&Config::default(), &loaded, &gaussians, false);
    assert!(known().is_ok());
    std::fs::remove_file(view.scores.as_ref().expect("scores").file()).expect("removed");
    assert!(matches!(known(), Err(coseg::Error::Io { .. })));
}

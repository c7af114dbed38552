//! What no command writes into: folders of photos, and labels that others made. What is not read: labels that are not finished.

use super::label::arguments;
use crate::support::onnx::plates;
use crate::support::program::{fails, succeeds, utf8};
use crate::support::raw_labels::{options, refused};
use crate::support::snapshot::snapshot;

#[test]
fn no_command_writes_into_a_scene() {
    let (folder, dir, model) = plates();
    let ply = dir.join("plates.ply");
    let [data, ply, model] = [&dir, &ply, &model].map(|path| utf8(path).to_owned());
    // The labels of a COLMAP scene lie where `associate` puts its own.
    let outs = ["", "images", "labels", "raw", "images/../labels"]
        .map(|name| utf8(&dir.join(name)).to_owned());
    let before = snapshot(&dir);
    for out in &outs {
        let lines: [&[&str]; 5] = [
            &["associate", "--scene", &ply, "--data", &data],
            &["vote", "--scene", &ply, "--data", &data],
            &["render", "--scene", &ply, "--cameras", &data],
            &["train", "--data", &data],
            &["train", "--data", &data, "--segmenter", &model],
        ];
        for line in lines {
            let line = [line, &["--out", out]].concat();
            let message = fails(&line, 1);
            assert!(message.contains("--out"), "{line:?}: {message}");
            assert!(snapshot(&dir) == before, "{line:?}");
        }
    }
    // Nor a new file beside photos, with classes and cameras of its own.
    let file = utf8(&dir.join("new.ply")).to_owned();
    let [frame, pixel] = [["--frame", "v3"], ["--pixel", "40,30"]];
    let select = [
        &["--cameras", &data][..],
        &frame,
        &pixel,
        &["--name", "lamp"],
    ]
    .concat();
    for (command, more) in [
        ("edit", &["--paint"][..]),
        ("separate", &[]),
        ("select", &select),
        ("export", &[]),
    ] {
        let line = [command, "--scene", &ply, "--out", &file, "--force"];
        let message = fails(&[&line[..], more].concat(), 1);
        assert!(message.contains("holds files of a scene"), "{message}");
        assert!(snapshot(&dir) == before, "{command}");
    }
    std::fs::create_dir(dir.join("depth")).expect("folder");
    std::fs::write(dir.join("depth/v0.png"), "not read").expect("write");
    let before = snapshot(&dir);
    for file in [
        "images/v0.png",
        "transforms.json",
        "classes.json",
        "depth/v0.png",
    ] {
        let file = utf8(&dir.join(file)).to_owned();
        assert!(fails(&["data", "info", &data, "--sheet", &file], 1).contains("--sheet"));
        assert!(snapshot(&dir) == before, "{file}");
    }
    // Labels that others made stay where they are.
    let taken = folder.path().join("taken");
    std::fs::create_dir_all(taken.join("labels")).expect("folder");
    std::fs::write(taken.join("labels/v0.png"), "mine").expect("write");
    let message = fails(
        &[
            "associate",
            "--scene",
            &ply,
            "--data",
            &data,
            "--out",
            utf8(&taken),
        ],
        1,
    );
    assert!(message.contains("did not write"), "{message}");
}

#[test]
fn labels_that_are_not_finished_are_not_read() {
    let (folder, dir, model) = plates();
    let out = folder.path().join("labels");
    let options = options(utf8(&out));
    let mine = folder.path().join("mine.toml");
    let label = [
        &arguments(&dir, &model, &out)[..],
        &["--classes", utf8(&mine)],
    ]
    .concat();
    let classes = "[classes]\nred = [\"crimson\"]\n";
    std::fs::write(&mine, format!("{classes}green = [\"lime\"]\n")).expect("write");
    succeeds(&label);
    let table = out.join("classes.json");
    let parts = ["label.json", "labelling was stopped", "command again"];
    // The ids of the maps are then those of the scene's table, or of none.
    for scene_table in [true, false] {
        if !scene_table {
            std::fs::remove_file(dir.join("classes.json")).expect("removed");
            let file = dir.join("transforms.json");
            let text = std::fs::read_to_string(&file).expect("read");
            let text = text.replace("label_path", "other_path");
            std::fs::write(&file, text).expect("write");
        }
        let hidden = folder.path().join("hidden.json");
        std::fs::rename(&table, &hidden).expect("rename");
        refused(&dir, &options, &parts);
        std::fs::rename(&hidden, &table).expect("rename");
        coseg::data::load(&dir, &options).expect("a scene");
    }
    // Labelling in other classes, of which a photo cannot be read.
    std::fs::write(&mine, classes).expect("write");
    let photo = dir.join("images/v5.png");
    let bytes = std::fs::read(&photo).expect("read");
    std::fs::write(&photo, &bytes[..bytes.len() / 2]).expect("write");
    // As many photos are labelled side by side as there are processors.
    for _ in 0..2 {
        fails(&label, 1);
    }
    assert!(!table.exists(), "maps of both classes");
    std::fs::write(&photo, &bytes).expect("write");
    succeeds(&label);
    coseg::data::load(&dir, &options).expect("a scene");
}

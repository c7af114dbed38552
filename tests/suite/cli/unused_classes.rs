//! Classes that no label names cost a run nothing.

use crate::support::plates::scene;
use crate::support::program::{fails, read_json, succeeds, utf8};
use crate::support::short_runs::short_run;
use coseg::data::{Classes, LabelMap};
use serde_json::Value;
use std::path::Path;

/// The classes of the plates, and `unused` more.
fn write_classes(dir: &Path, unused: u16) {
    let plates = [(1, "red"), (2, "green"), (3, "blue"), (4, "wall")];
    let plates = plates.map(|(id, name)| (id, name.to_owned()));
    let more = (0..unused).map(|i| (10 + i, format!("unused {i}")));
    let classes = Classes::from_names(0, plates.into_iter().chain(more));
    classes.write(&dir.join("classes.json")).unwrap();
}

fn scores(run: &Path, data: &Path) -> Value {
    let said = succeeds(&["eval", utf8(run), "--data", utf8(data), "--json"]);
    let json: Value = serde_json::from_str(&said).unwrap();
    json["test"]["labels"]["per_gaussian"].clone()
}

#[test]
fn a_long_class_table_makes_the_same_run() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let [short, long] = ["short", "long"].map(|name| folder.path().join(name));
    short_run(folder.path(), &short);
    write_classes(folder.path(), 146);
    short_run(folder.path(), &long);
    for file in ["scene.ply", "identities.safetensors", "classes.json"] {
        let [a, b] = [&short, &long].map(|run| std::fs::read(run.join(file)).unwrap());
        assert!(a == b, "{file}");
    }
    let labels = |run: &Path| read_json(&run.join("metrics.json"))["test"]["labels"].clone();
    assert_eq!(
        labels(&short)["vote"]["miou"],
        labels(&long)["vote"]["miou"]
    );
    let voted = folder.path().join("voted");
    let of_run = short.join("scene.ply");
    let vote = ["vote", "--scene", utf8(&of_run), "--data"];
    succeeds(&[&vote[..], &[utf8(folder.path()), "--out", utf8(&voted)]].concat());
    let [a, b] = [&short, &voted].map(|dir| std::fs::read(dir.join("classes.json")).unwrap());
    assert!(a == b, "classes.json of a vote");
}

#[test]
fn a_class_that_a_run_does_not_know_counts_as_wrong() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    write_classes(folder.path(), 3);
    let run = folder.path().join("run");
    short_run(folder.path(), &run);
    let before = scores(&run, folder.path());
    // The lower half of a held-out view is truly something else.
    let truth = folder.path().join("labels/v2.png");
    let mut map = LabelMap::read(&truth).unwrap();
    let half = map.ids.len() / 2;
    map.ids[half..].fill(11);
    map.write(&truth).unwrap();
    let after = scores(&run, folder.path());
    assert_eq!(after["class_iou"]["11"], 0.0, "{after}");
    let accuracy = |scores: &Value| scores["accuracy"].as_f64().unwrap();
    assert!(
        accuracy(&after) < accuracy(&before) - 0.1,
        "{before} {after}"
    );
    // Without the class in its table, the map is an error.
    write_classes(folder.path(), 1);
    let message = fails(&["eval", utf8(&run), "--data", utf8(folder.path())], 1);
    assert!(message.contains("v2.png"), "{message}");
}

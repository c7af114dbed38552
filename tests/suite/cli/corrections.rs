//! `coseg train --corrections`: labels that a person corrected in the page of a run are taken as true.

use crate::support::plates::scene;
use crate::support::program::{fails, read_json, succeeds, utf8, warnings};
use coseg::data::{Classes, LabelMap};
use coseg::files::sha256;
use coseg::splat::ply;
use glam::Vec3;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const RED: u16 = 1;
const GREEN: u16 = 2;

/// A run of stage two on the plates in `folder`.
fn run_on_plates(folder: &Path) -> PathBuf {
    let out = folder.join("run");
    let plates = folder.join("plates.ply");
    succeeds(&[
        "train",
        "--data",
        utf8(folder),
        "--scene",
        utf8(&plates),
        "--out",
        utf8(&out),
        "--set",
        "segmentation.iterations=30",
        "--set",
        "segmentation.rows=vote,ours",
    ]);
    out
}

/// Positions and labels of the scene of `run`.
fn labelled(run: &Path) -> (Vec<[f32; 3]>, Option<Vec<u16>>) {
    let scene = ply::read(&run.join("scene.ply")).unwrap();
    let means = scene.gaussians.means.iter();
    let world = means.map(|mean| (Vec3::from(*mean) + scene.origin.as_vec3()).to_array());
    let world = world.collect();
    (world, scene.labels)
}

/// Rows of the red plate, of its left half first, and of the wall.
fn red_and_wall(run: &Path) -> [Vec<usize>; 2] {
    let (places, _) = labelled(run);
    let rows = |wanted: &dyn Fn(&[f32; 3]) -> bool| -> Vec<usize> {
        (0..places.len()).filter(|&i| wanted(&places[i])).collect()
    };
    let mut red = rows(&|p| p[2] > -1.0 && p[0] < -0.5);
    red.sort_by(|&a, &b| places[a][0].total_cmp(&places[b][0]));
    [red, rows(&|p| p[2] < -1.0)]
}

/// A file of edits of the scene of `run`.
fn edits(run: &Path, operations: &Value) -> PathBuf {
    let file = run.with_file_name("edits.json");
    let scene = sha256(&run.join("scene.ply")).unwrap();
    let edits = json!({"version": 1, "scene": scene, "operations": operations});
    std::fs::write(&file, edits.to_string()).unwrap();
    file
}

fn corrects<'a>(run: &'a Path, file: &'a Path) -> [&'a str; 5] {
    ["train", "--resume", utf8(run), "--corrections", utf8(file)]
}

#[test]
fn corrected_labels_stay_through_training_and_add_up() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    // A network that calls the red plate green in every photo.
    for i in 0..6 {
        let path = folder.path().join(format!("raw/v{i}.png"));
        let map = image::open(&path).unwrap().into_luma8();
        let ids = map.iter().map(|&id| match u16::from(id) {
            RED => GREEN,
            other => other,
        });
        let map = LabelMap {
            width: map.width() as usize,
            height: map.height() as usize,
            ids: ids.collect(),
        };
        map.write(&path).unwrap();
    }
    let run = run_on_plates(folder.path());
    let [red, wall] = red_and_wall(&run);
    assert_eq!((red.len(), wall.len()), (25, 36));
    let (_, labels) = labelled(&run);
    assert!(
        red.iter()
            .all(|&row| labels.as_ref().unwrap()[row] == GREEN)
    );

    // A person corrects two fifths of it, and makes a poster of a part of the wall.
    let operations = json!([
        {"op": "assign", "gaussians": red[..10], "object": RED},
        {"op": "assign", "gaussians": wall[..3], "object": 9, "new": {"name": "poster", "color": [1, 2, 3]}},
        {"op": "delete_gaussians", "gaussians": wall[30..31]},
    ]);
    let file = edits(&run, &operations);
    let said = warnings(&corrects(&run, &file));
    for part in [
        "Gaussians with corrected labels: 13",
        "deletions and moves are left out",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let (places, labels) = labelled(&run);
    let labels = labels.unwrap();
    assert_eq!(places.len(), 111);
    assert!(red[..10].iter().all(|&row| labels[row] == RED));
    assert!(wall[..3].iter().all(|&row| labels[row] == 9));
    let classes = Classes::read(&run.join("classes.json")).unwrap();
    assert_eq!((classes.name(9), classes.color(9)), ("poster", [1, 2, 3]));
    let report = std::fs::read_to_string(run.join("report.html")).unwrap();
    assert!(report.contains("Gaussians whose label a person set: 13"));
    succeeds(&["eval", utf8(&run)]);

    // They stay when the run is resumed, and others come to them. The old edits are of an earlier scene.
    succeeds(&["train", "--resume", utf8(&run)]);
    assert_eq!(labelled(&run).1.unwrap(), labels);
    let message = fails(&corrects(&run, &file), 1);
    assert!(message.contains("SHA-256"), "{message}");
    let file = edits(&run, &json!([{"op": "merge", "objects": [9], "into": 4}]));
    let said = warnings(&corrects(&run, &file));
    assert!(
        said.contains("Gaussians with corrected labels: 13"),
        "{said}"
    );
    let labels = labelled(&run).1.unwrap();
    assert!(wall[..3].iter().all(|&row| labels[row] == 4));
    assert!(red[..10].iter().all(|&row| labels[row] == RED));
}

#[test]
fn corrections_alone_label_a_scene_without_labels() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    std::fs::remove_file(folder.path().join("classes.json")).unwrap();
    let path = folder.path().join("transforms.json");
    let mut transforms = read_json(&path);
    for frame in transforms["frames"].as_array_mut().unwrap() {
        let frame = frame.as_object_mut().unwrap();
        frame.remove("label_path");
        frame.remove("raw_label_path");
    }
    std::fs::write(&path, transforms.to_string()).unwrap();
    let run = run_on_plates(folder.path());
    let [red, wall] = red_and_wall(&run);
    let new = |name: &str| json!({"name": name, "color": [200, 0, 0]});
    let plate = json!({"op": "assign", "gaussians": red, "object": 1, "new": new("plate")});
    let back = json!({"op": "assign", "gaussians": wall, "object": 2, "new": new("wall")});

    let file = edits(&run, &json!([plate]));
    let message = fails(&corrects(&run, &file), 1);
    assert!(message.contains("one thing alone, plate"), "{message}");
    // What was refused leaves nothing behind.
    succeeds(&["train", "--resume", utf8(&run)]);
    assert_eq!(labelled(&run).1, None);
    let file = edits(&run, &json!([plate, back]));
    succeeds(&corrects(&run, &file));
    let labels = labelled(&run).1.unwrap();
    assert!(red.iter().all(|&row| labels[row] == 1));
    assert!(wall.iter().all(|&row| labels[row] == 2));

    // They can be withdrawn.
    let all: Vec<_> = red.iter().chain(&wall).collect();
    let file = edits(
        &run,
        &json!([{"op": "assign", "gaussians": all, "object": 0}]),
    );
    let said = warnings(&corrects(&run, &file));
    assert!(
        said.contains("Gaussians with corrected labels: 0"),
        "{said}"
    );
    assert_eq!(labelled(&run).1, None);
}

#[test]
fn what_corrects_nothing_is_refused_and_the_run_stays() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = run_on_plates(folder.path());
    let before = labelled(&run);
    let rename = json!([{"op": "rename", "object": RED, "name": "door"}]);
    let file = edits(&run, &rename);
    let message = fails(&corrects(&run, &file), 1);
    for part in [
        "edits.json",
        "none that gives a Gaussian a label",
        "coseg edit",
    ] {
        assert!(message.contains(part), "{part}: {message}");
    }
    let assign = json!([{"op": "assign", "gaussians": [0], "object": RED}]);
    let file = edits(&run, &assign);
    fails(&["train", "--corrections", utf8(&file)], 2);
    let with_out = ["train", "--corrections", utf8(&file), "--out", utf8(&run)];
    let message = fails(&with_out, 2);
    assert!(message.contains("cannot be used with"), "{message}");
    let none = [
        &corrects(&run, &file)[..],
        &["--set", "segmentation.rows=[]"],
    ]
    .concat();
    let message = fails(&none, 1);
    assert!(message.contains("learns the corrected labels"), "{message}");
    assert_eq!(labelled(&run), before);
    succeeds(&corrects(&run, &file));
}

//! `coseg edit --edits`, and what `edit` and `separate` may write over.

use crate::support::plates::{plates, scene};
use crate::support::program::{fails, succeeds, utf8};
use coseg::data::Classes;
use coseg::files::sha256;
use coseg::splat::ply;
use glam::DVec3;
use serde_json::json;
use std::path::Path;

#[test]
fn the_command_applies_edits_to_their_scene_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = scene(folder.path());
    let file = folder.path().join("edits.json");
    let operations = json!([
        {"op": "assign", "gaussians": [80, 81], "object": 5, "new": {"name": "rug", "color": [1, 2, 3]}},
        {"op": "delete_objects", "objects": [1]},
    ]);
    let edits = json!({"version": 1, "scene": sha256(&path).unwrap(), "operations": operations});
    std::fs::write(&file, edits.to_string()).unwrap();
    let out = folder.path().join("edited");
    let edit = [
        "edit",
        "--scene",
        utf8(&path),
        "--out",
        utf8(&out),
        "--edits",
        utf8(&file),
    ];
    let said = succeeds(&edit);
    assert!(
        said.contains("86 of 111") && said.contains("edits: 2"),
        "{said}"
    );
    let read = |name: &str| ply::read(&out.join(name)).unwrap();
    let edited = read("scene.ply");
    let mut want = [vec![2; 25], vec![3; 25], vec![4; 36]].concat();
    want[55] = 5;
    want[56] = 5;
    assert_eq!(edited.labels.unwrap(), want);
    assert_eq!(
        Classes::read(&out.join("classes.json")).unwrap().name(5),
        "rug"
    );

    // Painted in the colours that the edits give.
    let said = succeeds(&[&edit[..], &["--paint"]].concat());
    assert!(said.contains("painted"), "{said}");
    let color = read("scene.ply").gaussians.base_colors()[55];
    let near = color
        .iter()
        .zip([1.0, 2.0, 3.0])
        .all(|(a, b)| (255.0 * a - b).abs() < 1e-3);
    assert!(near, "{color:?}");

    let other = out.join("scene.ply");
    let message = fails(
        &[
            "edit",
            "--scene",
            utf8(&other),
            "--out",
            utf8(&path),
            "--edits",
            utf8(&file),
        ],
        1,
    );
    let parts = [
        "edits.json",
        "scene",
        &sha256(&other).unwrap(),
        "coseg view",
    ];
    assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    fails(&[&edit[..], &["--remove", "red"]].concat(), 2);
}

#[test]
fn a_command_writes_over_its_own_output_and_over_others_by_force() {
    let folder = tempfile::tempdir().unwrap();
    let path = scene(folder.path());
    let out = folder.path().join("out/scene.ply");
    let names = out.with_file_name("classes.json");
    let separate = |scene, level, more: &[&str]| -> Vec<String> {
        let to = [
            "separate",
            "--scene",
            utf8(scene),
            "--out",
            utf8(&out),
            "--level",
            level,
        ];
        to.iter()
            .chain(more)
            .map(|word| (*word).to_owned())
            .collect()
    };
    let run = |words: &[String]| succeeds(&words.iter().map(String::as_str).collect::<Vec<_>>());
    let refused =
        |words: &[String]| fails(&words.iter().map(String::as_str).collect::<Vec<_>>(), 1);
    // Two classes of plates that do not touch, so that another level gives another table.
    let mut scene_ply = ply::read(&path).unwrap();
    for id in scene_ply.labels.as_mut().unwrap() {
        *id = (*id).min(2);
    }
    ply::write(
        &path,
        &scene_ply.gaussians,
        scene_ply.origin,
        scene_ply.labels.as_deref(),
    )
    .unwrap();
    run(&separate(&path, "0.001", &[]));
    let before = Classes::read(&names).unwrap();
    run(&separate(&path, "0.5", &[]));
    assert_ne!(Classes::read(&names).unwrap(), before, "its own table");

    // The table of another command, or of a person, stays.
    let edit = [
        "edit",
        "--scene",
        utf8(&path),
        "--out",
        utf8(&out),
        "--remove",
        "1",
    ];
    let message = fails(&edit, 1);
    assert!(
        message.contains("another class table") && message.contains("--force"),
        "{message}"
    );
    Classes::from_names(0, [(1, "door")]).write(&names).unwrap();
    let message = refused(&separate(&path, "0.5", &[]));
    assert!(message.contains("another class table"), "{message}");
    run(&separate(&path, "0.5", &["--force"]));
    assert!(Classes::read(&names).unwrap().entries.len() > 2);

    // The scene itself, and never into a folder with photos.
    let message = refused(&separate(&out, "0.9", &[]));
    assert!(
        message.contains("a file other than the scene") && message.contains("--force"),
        "{message}"
    );
    run(&separate(&out, "0.9", &["--force"]));
    let onto = folder.path().join("new.ply");
    let edit = [
        "edit",
        "--scene",
        utf8(&out),
        "--out",
        utf8(&onto),
        "--remove",
        "1",
        "--force",
    ];
    let message = fails(&edit, 1);
    assert!(message.contains("holds files of a scene"), "{message}");
}

#[test]
fn an_output_holds_nothing_of_the_scene_that_it_replaces() {
    let folder = tempfile::tempdir().unwrap();
    let named = folder.path().join("named/scene.ply");
    let (gaussians, labels) = plates();
    ply::write(&named, &gaussians, DVec3::ZERO, Some(&labels)).unwrap();
    Classes::from_names(0, [(1, "red"), (2, "green"), (3, "blue"), (4, "wall")])
        .write(&named.with_file_name("classes.json"))
        .unwrap();
    std::fs::write(named.with_file_name("cameras.json"), "[]").unwrap();
    let bare = folder.path().join("bare/scene.ply");
    ply::write(&bare, &gaussians, DVec3::ZERO, Some(&labels)).unwrap();
    let out = folder.path().join("out");
    let edit = |scene: &Path| {
        let words = ["edit", "--scene", utf8(scene), "--out", utf8(&out)];
        succeeds(&[&words[..], &["--remove", "1"]].concat())
    };
    let beside = || ["classes.json", "cameras.json"].map(|name| out.join(name).exists());
    edit(&named);
    assert_eq!(beside(), [true; 2]);
    edit(&bare);
    assert_eq!(beside(), [false; 2], "names and cameras of another scene");
    edit(&named);
    // What a person put there stays; the class table that the program wrote is removed.
    std::fs::write(out.join("cameras.json"), "[ ]").unwrap();
    edit(&bare);
    assert_eq!(beside(), [false, true]);
}

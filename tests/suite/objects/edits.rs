//! Files of edits: what they do to a scene, and what is refused.

use crate::support::assert_names;
use crate::support::damage::Damage;
use crate::support::plates::plates;
use coseg::Result;
use coseg::data::Classes;
use coseg::objects::{Edited, Editing, Edits};
use glam::DVec3;
use serde_json::{Value, json};

const SCENE: &str = "00ff";
const ORIGIN: DVec3 = DVec3::new(100.0, 0.0, -7.0);

fn names() -> Classes {
    Classes::from_names(
        0,
        [
            (1, "red"),
            (2, "green"),
            (3, "blue"),
            (4, "wall"),
            (9, "lamp"),
        ],
    )
}

fn applied_to(classes: Classes, text: &[u8]) -> Result<Edited> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("edits.json");
    std::fs::write(&file, text).unwrap();
    let (gaussians, labels) = plates();
    let mut editing = Editing::new(gaussians, labels, classes);
    Edits::read(&file)?.apply(&mut editing, SCENE, ORIGIN)?;
    editing.finish("--edits")
}

fn file_of(operations: &Value) -> String {
    json!({"version": 1, "scene": SCENE, "operations": operations}).to_string()
}

fn after(operations: &Value) -> Edited {
    applied_to(names(), file_of(operations).as_bytes()).unwrap()
}

/// Each operation once.
fn all() -> Value {
    json!([
        {"op": "rename", "object": 1, "name": "rug"},
        {"op": "recolor", "object": 2, "color": [1, 2, 3]},
        {"op": "assign", "gaussians": [75, 110, 0], "object": 10, "new": {"name": "door", "color": [9, 8, 7]}},
        {"op": "assign", "gaussians": [50], "object": 9},
        {"op": "merge", "objects": [1, 3], "into": 2},
        {"op": "delete_gaussians", "gaussians": [25, 26]},
        {"op": "move", "object": 10, "shift": [0, 0, 2],
            "turn": {"axis": [0, 0, 2], "degrees": 90, "pivot": [100, 0, -7]}},
        {"op": "delete_objects", "objects": [4]},
    ])
}

#[test]
fn operations_are_applied_in_order() {
    let (before, _) = plates();
    let edited = after(&all());
    let rows: Vec<u32> = [0]
        .into_iter()
        .chain(1..25)
        .chain(27..76)
        .chain([110])
        .collect();
    let label = |row: &u32| match row {
        0 | 75 | 110 => 10,
        50 => 9,
        _ => 2,
    };
    assert_eq!(edited.labels, rows.iter().map(label).collect::<Vec<_>>());
    let kept = before.select(&rows);
    for (i, (got, was)) in edited.gaussians.means.iter().zip(&kept.means).enumerate() {
        // A quarter about z through the zero of the Gaussians, then up.
        let want = if edited.labels[i] == 10 {
            [-was[1], was[0], was[2] + 2.0]
        } else {
            *was
        };
        let near = got.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-5);
        assert!(near, "{i}: {got:?}, expected {want:?}");
    }
    let entry = |id: u16| {
        let class = &edited.classes.entries[edited.classes.index(id).unwrap()];
        (class.name.as_str(), class.color)
    };
    assert_eq!(entry(1).0, "rug");
    assert_eq!(entry(2), ("green", [1, 2, 3]));
    assert_eq!(entry(10), ("door", [9, 8, 7]));
    assert_eq!((entry(4).0, entry(9).0), ("wall", "lamp"));
    let nothing = after(&json!([]));
    assert_eq!((nothing.gaussians, nothing.labels), plates());
    assert_eq!(nothing.classes, names());
}

#[test]
fn a_scene_without_names_gets_a_table_when_an_edit_names_one() {
    let labels = |operations: Value| {
        let edited = applied_to(Classes::default(), file_of(&operations).as_bytes()).unwrap();
        let named = edited.classes.entries.into_iter().map(|c| (c.id, c.name));
        named.collect::<Vec<_>>()
    };
    assert_eq!(
        labels(json!([{"op": "delete_objects", "objects": [1]}])),
        []
    );
    let named = [(1, "label 1"), (2, "rug"), (3, "label 3"), (4, "label 4")];
    let named = named.map(|(id, name)| (id, name.to_owned()));
    assert_eq!(
        labels(json!([{"op": "rename", "object": 2, "name": "rug"}])),
        named
    );
}

#[test]
fn what_does_not_fit_is_refused_by_its_field() {
    let refused = |file: Value, parts: &[&str]| {
        let error = applied_to(names(), file.to_string().as_bytes()).unwrap_err();
        assert_names(&error, parts);
        assert_names(&error, &["edits.json"]);
        assert!(matches!(error, coseg::Error::Input { .. }), "{error:?}");
    };
    let good = json!({"version": 1, "scene": SCENE, "operations": []});
    let with = |key: &str, value: Value| {
        let mut file = good.clone();
        file[key] = value;
        file
    };
    refused(
        with("version", json!(2)),
        &["version", "found 2", "expected 1"],
    );
    refused(with("version", json!("1")), &["version", "\"1\""]);
    refused(
        json!({"scene": SCENE, "operations": []}),
        &["version", "nothing"],
    );
    refused(json!([]), &["version"]);
    refused(
        with("scene", json!("11ff")),
        &["scene", "11ff", "00ff", "coseg view"],
    );
    refused(with("scene", json!("x".repeat(5000))), &["scene", ".."]);
    refused(with("scene", json!(3)), &["edits", "string"]);
    refused(with("more", json!(3)), &["edits", "more"]);
    refused(json!({"version": 1, "scene": SCENE}), &["operations"]);

    let rows = |rows: &str| {
        let text = format!("[{{\"op\": \"delete_gaussians\", \"gaussians\": {rows}}}]");
        serde_json::from_str::<Value>(&text).unwrap()
    };
    let door = |id: u32, name: &str| json!([{"op": "assign", "gaussians": [1], "object": id, "new": {"name": name, "color": [1, 2, 3]}}]);
    let turn = |axis: [f64; 3], pivot: [f64; 3]| json!([{"op": "move", "object": 1, "shift": [0, 0, 0], "turn": {"axis": axis, "degrees": 1, "pivot": pivot}}]);
    let faults: [(Value, &[&str]); 25] = [
        (json!([{}]), &["operations[0]", "op"]),
        (json!(["delete"]), &["operations[0]"]),
        (
            json!([{"op": "paint", "object": 1}]),
            &["operations[0]", "paint", "rename"],
        ),
        (
            json!([{"op": "rename", "object": 1}]),
            &["operations[0]", "name"],
        ),
        (
            json!([{"op": "rename", "object": 1, "name": "a", "colour": 1}]),
            &["operations[0]", "colour"],
        ),
        (
            json!([{"op": "rename", "object": 70000, "name": "a"}]),
            &["operations[0]", "70000"],
        ),
        (
            json!([{"op": "rename", "object": -1, "name": "a"}]),
            &["operations[0]", "-1"],
        ),
        (
            json!([{"op": "rename", "object": 5, "name": "a"}]),
            &["operations[0].object", "5"],
        ),
        (
            json!([{"op": "rename", "object": 0, "name": "a"}]),
            &["operations[0].object", "unlabelled"],
        ),
        (
            json!([{"op": "rename", "object": 1, "name": " "}]),
            &["operations[0].name"],
        ),
        (
            json!([{"op": "rename", "object": 1, "name": "a\nb"}]),
            &["operations[0].name", "\\n"],
        ),
        (
            json!([{"op": "recolor", "object": 1, "color": [1, 2, 256]}]),
            &["operations[0]", "256"],
        ),
        (
            json!([{"op": "recolor", "object": 1, "color": [1, 2]}]),
            &["operations[0]", "2"],
        ),
        (
            json!([{"op": "merge", "objects": [1, 8], "into": 2}]),
            &["operations[0].objects[1]", "8"],
        ),
        (
            json!([{"op": "merge", "objects": [1], "into": 8}]),
            &["operations[0].into", "8"],
        ),
        (
            rows("[3, 111]"),
            &["operations[0].gaussians[1]", "111", "0 to 110"],
        ),
        (rows("[-1]"), &["operations[0]", "-1"]),
        (rows("[1.5]"), &["operations[0]", "1.5"]),
        (
            json!([{"op": "delete_objects", "objects": [1]}, {"op": "assign", "gaussians": [30, 3], "object": 2}]),
            &[
                "operations[1].gaussians[1]",
                "3, which an earlier operation deletes",
            ],
        ),
        (door(9, "door"), &["operations[0].object", "9"]),
        (door(12, ""), &["operations[0].new.name"]),
        (
            json!([{"op": "assign", "gaussians": [1], "object": 12}]),
            &["operations[0].object", "12"],
        ),
        (
            json!([{"op": "move", "object": 1, "shift": [1e9, 0, 0]}]),
            &["operations[0].shift", "at most"],
        ),
        (
            turn([0.0; 3], [100.0, 0.0, 0.0]),
            &["operations[0].turn.axis", "direction"],
        ),
        (
            turn([0.0, 0.0, 1.0], [1e300, 0.0, 0.0]),
            &["operations[0].turn.pivot", "at most"],
        ),
    ];
    for (operations, parts) in faults {
        refused(with("operations", operations), parts);
    }
    let error = applied_to(names(), b"{\"version\": 1, \"scene\": ").unwrap_err();
    assert_names(&error, &["edits.json", "line 1"]);
    let all = json!([{"op": "delete_objects", "objects": [1, 2, 3, 4]}]);
    let error = applied_to(names(), file_of(&all).as_bytes()).unwrap_err();
    assert_names(&error, &["--edits", "no Gaussian left"]);
}

#[test]
fn damaged_files_of_edits_are_errors_or_edits() {
    let whole =
        serde_json::to_string_pretty(&json!({"version": 1, "scene": SCENE, "operations": all()}))
            .unwrap();
    for length in 0..whole.len() {
        applied_to(names(), &whole.as_bytes()[..length]).unwrap_err();
    }
    let mut refused = 0;
    for changes in 1..=4 {
        let mut damage = Damage::new(changes);
        for _ in 0..500 {
            let damaged = damage.of(whole.as_bytes());
            refused += usize::from(applied_to(names(), &damaged).is_err());
        }
    }
    assert!(refused > 1000, "{refused}");
}

//! `coseg compare` as a person runs it.

use crate::support::plates::scene;
use crate::support::program::{cpu_backend, fails, read_json, succeeds, utf8};

const PLAN: &str = r#"
title = "two rows"
scenes = ["plates"]
seeds = 1
[settings]
building.iterations = 3
building.random_points = 200
[[labels]]
name = "raw"
[[rows]]
name = "raw"
variant = "raw"
[[rows]]
name = "vote"
variant = "vote"
"#;

#[test]
fn a_table_is_made_in_parts() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    std::fs::create_dir_all(scenes.join("plates")).unwrap();
    scene(&scenes.join("plates"));
    let plan = folder.path().join("plan.toml");
    let out = folder.path().join("table");
    std::fs::write(&plan, PLAN).unwrap();
    let backend = cpu_backend();
    let command = [
        "compare",
        utf8(&plan),
        "--out",
        utf8(&out),
        "--data-root",
        utf8(&scenes),
        "--backend",
        &backend,
        "--commit",
    ];

    let first = ["first", "--only", "/vote/"];
    let said = succeeds(&[&command[..], &first].concat());
    assert!(said.contains("1 of 2 cells are empty"), "{said}");
    let message = fails(&[&command[..], &["second"]].concat(), 1);
    for part in ["vote/0.json", "--keep-cells"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    let second = ["second", "--keep-cells"];
    let said = succeeds(&[&command[..], &second].concat());
    for part in [
        "table.md",
        "compare.json",
        "iou_raw_plates.svg",
        "0 of 2 cells are empty",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let json = read_json(&out.join("compare.json"));
    assert_eq!(
        json["commits"],
        serde_json::json!({ "first": 1, "second": 1 })
    );
    let command = json["command"].as_str().unwrap();
    assert!(
        command.starts_with("coseg compare ") && command.contains("--keep-cells"),
        "{command}"
    );
}

#[test]
fn mistakes_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("plan.toml");
    std::fs::write(&plan, PLAN).unwrap();
    let out = folder.path().join("table");
    let command = ["compare", utf8(&plan), "--out", utf8(&out)];
    let message = fails(&command, 1);
    assert!(
        message.contains("no such folder") && message.contains("plates"),
        "{message}"
    );
    let message = fails(&[&command[..], &["--gaussians", "plates"]].concat(), 2);
    assert!(message.contains("studio=runs/studio"), "{message}");
    assert!(!out.exists());
}

//! Class tables, their colours, label maps on disk, atomic files.

use crate::support::plates::{HEIGHT, WIDTH};
use crate::support::raw_labels::{folder, options};
use coseg::data::{Classes, LabelMap, LoadOptions, check, info};
use coseg::files::atomic;
use std::fs;
use std::io::Write;

#[test]
fn tables_survive_their_file() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("sub/classes.json");
    let mut table = Classes::from_names(
        9,
        [
            (300, "lamp"),
            (1, "wall"),
            (9, "nothing"),
            (1, "again"),
            (0, "floor"),
        ],
    );
    assert_eq!(
        table.entries.iter().map(|c| c.id).collect::<Vec<_>>(),
        [0, 1, 300]
    );
    assert_eq!(
        (table.name(1), table.name(9), table.color(9)),
        ("wall", "void", [0; 3])
    );
    table.entries[1].color = [1, 2, 3];
    table.write(&path).expect("write");
    assert_eq!(Classes::read(&path).expect("read"), table);
    let value: serde_json::Value =
        serde_json::from_slice(&fs::read(&path).expect("read")).expect("json");
    assert_eq!(value["ignore"], 9);
    assert_eq!(
        value["classes"][1],
        serde_json::json!({"id": 1, "name": "wall", "color": [1, 2, 3]})
    );
}

#[test]
fn broken_tables_are_refused_by_name() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("classes.json");
    for (text, parts) in [
        (r#"{"1": "a", "65536": "b"}"#, ["65536", "0 to 65535"]),
        (r#"{"-1": "a"}"#, ["-1", "0 to 65535"]),
        (r#"{"wall": "1"}"#, ["wall", "0 to 65535"]),
        (r#"{"1": 5}"#, ["id 1", "found 5"]),
        (r#"{"1": "a", "1": "b"}"#, ["id 1", "two entries"]),
        (r#"{"1": "a", "01": "b"}"#, ["id 1", "two entries"]),
        (r#"{"0": "wall", "1": "b"}"#, ["id 0", "wall"]),
        ("{\"1\": \"a\",\n \"2\" \"b\"}", ["line 2", "expected `:`"]),
        (r#"["wall"]"#, ["line 1", "a JSON object"]),
        (
            r#"{"ignore": 0, "classes": [{"id": 70000, "name": "a"}]}"#,
            ["line 1", "70000"],
        ),
        (
            r#"{"ignore": 0, "classes": [{"id": 7, "name": "a"}, {"id": 7, "name": "b"}]}"#,
            ["id 7", "two entries"],
        ),
        (r#"{"classes": []}"#, ["line 1", "ignore"]),
    ] {
        fs::write(&path, text).expect("write");
        let message = Classes::read(&path).expect_err(text).to_string();
        for part in parts.iter().chain(&["classes.json"]) {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
    }
    fs::write(&path, r#"{"2": "b", "1": "a"}"#).expect("write");
    assert_eq!(Classes::read(&path).expect("no void entry needed").len(), 2);
}

#[test]
fn label_maps_survive_their_file_in_8_and_16_bits() {
    let dir = tempfile::tempdir().expect("folder");
    for (name, largest, bits) in [("a.png", 255, 8), ("b.png", 256, 16), ("c.png", 65_535, 16)] {
        let path = dir.path().join(name);
        let map = LabelMap {
            width: 3,
            height: 2,
            ids: vec![0, 1, 2, 3, largest, 7],
        };
        map.write(&path).expect("write");
        assert_eq!(fs::read(&path).expect("read")[24], bits);
        assert_eq!(LabelMap::read(&path).expect("read"), map);
    }
    let short = LabelMap {
        width: 3,
        height: 2,
        ids: vec![0],
    };
    assert!(short.write(&dir.path().join("d.png")).is_err());
    assert_eq!(
        fs::read_dir(dir.path()).expect("folder").count(),
        3,
        "nothing is left of the failed file"
    );
}

#[test]
fn a_failed_write_leaves_the_old_file() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("file");
    atomic::write_bytes(&path, b"old").expect("write");
    let failed = atomic::write(&path, |out| {
        out.write_all(&[7; 4_000_000])?;
        assert_eq!(
            fs::read(&path)?,
            b"old",
            "not touched while the new one is made"
        );
        Err(std::io::Error::other("the disk is full"))
    });
    let message = failed.expect_err("an error").to_string();
    assert!(
        message.contains("file: write failed: the disk is full"),
        "{message}"
    );
    assert_eq!(fs::read(&path).expect("read"), b"old");
    assert_eq!(fs::read_dir(dir.path()).expect("folder").count(), 1);
    atomic::write_bytes(&path, b"new").expect("write");
    assert_eq!(fs::read(&path).expect("read"), b"new");
    assert!(atomic::write_bytes(dir.path().join(".."), b"").is_err());
}

#[test]
fn classes_that_the_scene_lacks_are_told_with_their_shares() {
    let folder = folder();
    let dir = folder.path();
    let maps = dir.join("own");
    let names = [
        (1, "green"),
        (2, "lamp"),
        (3, "rug"),
        (4, "bed"),
        (5, "sink"),
        (6, "wall"),
    ];
    let table = Classes::from_names(0, names);
    table.write(&maps.join("classes.json")).expect("write");
    // Of four parts of a map one is rug; lamp has a tenth, bed a twentieth of all pixels.
    let id = |i: usize| match i % 20 {
        0..5 => 3,
        5..7 => 2,
        7 => 4,
        _ => 1,
    };
    let map = LabelMap {
        width: WIDTH,
        height: HEIGHT,
        ids: (0..WIDTH * HEIGHT).map(id).collect(),
    };
    for i in 0..6 {
        map.write(&maps.join(format!("v{i}.png"))).expect("write");
    }
    let shares = "2 of the 6 classes of";
    let listed = "pixels of the others (40.0 % of all) are unlabelled: rug 25.0 %, lamp 10.0 %, bed 5.0 % and 1 more; ";
    let one = |notices: &[String], help: &str| {
        let told = notices
            .iter()
            .filter(|n| n.contains(shares) && n.contains(listed));
        let told: Vec<_> = told.collect();
        assert!(told.len() == 1 && told[0].ends_with(help), "{notices:?}");
    };
    for (index, help) in [
        (false, "add them to classes.json"),
        (true, "with --classes FILE.toml (`coseg label`)"),
    ] {
        if index {
            fs::write(maps.join("label.json"), r#"{"made_from": {}}"#).expect("write");
        }
        let checked = check(dir, &options("own"));
        assert!(checked.problems.is_empty(), "{checked:?}");
        one(&checked.notices, help);
        one(&info(dir, &options("own")).expect("info").notices, help);
    }
}

#[test]
fn a_name_of_two_ids_is_told() {
    let folder = folder();
    let table = folder.path().join("classes.json");
    let told = || {
        let checked = check(folder.path(), &LoadOptions::default());
        assert!(checked.problems.is_empty(), "{checked:?}");
        checked.notices
    };
    assert_eq!(told(), [""; 0]);
    let names = [(1, "wall"), (2, "green"), (3, "blue"), (4, "Wall")];
    Classes::from_names(0, names).write(&table).expect("write");
    let notices = told();
    let parts = ["classes.json", "wall (1, 4)", "a name of its own"];
    assert!(
        notices.len() == 1 && parts.iter().all(|part| notices[0].contains(part)),
        "{notices:?}"
    );
}

//! `coseg objects` and `coseg edit` on plates far from the world's zero.

use crate::support::plates::{HEIGHT, WIDTH, plates, scene};
use crate::support::program::{fails, succeeds, utf8};
use coseg::data::{Classes, ObjectOf};
use coseg::splat::{Gaussians, ply};
use glam::DVec3;
use std::path::{Path, PathBuf};

fn read(path: &Path) -> (Gaussians, Vec<u16>) {
    let scene = ply::read(path).unwrap();
    (scene.gaussians, scene.labels.unwrap())
}

/// Where the world's zero is, seen from that of the Gaussians: floats of such coordinates are 0.06 apart.
const ORIGIN: DVec3 = DVec3::new(1e6, -2e6, 30.0);

/// The plates and their cameras far from the world's zero.
fn distant_scene(dir: &Path) -> PathBuf {
    let path = scene(dir);
    let (gaussians, labels) = plates();
    ply::write(&path, &gaussians, ORIGIN, Some(&labels)).unwrap();
    let file = dir.join("transforms.json");
    let mut transforms = crate::support::program::read_json(&file);
    for frame in transforms["frames"].as_array_mut().unwrap() {
        for (row, by) in ORIGIN.to_array().iter().enumerate() {
            let cell = &mut frame["transform_matrix"][row][3];
            *cell = (cell.as_f64().unwrap() + by).into();
        }
    }
    std::fs::write(&file, transforms.to_string()).unwrap();
    path
}

#[test]
fn the_program_lists_picks_and_edits() {
    let folder = tempfile::tempdir().unwrap();
    let path = distant_scene(folder.path());
    let json_of = |arguments: &[&str]| -> serde_json::Value {
        serde_json::from_str(&succeeds(&[arguments, &["--json"]].concat())).unwrap()
    };
    let near = |value: &serde_json::Value, want: DVec3, slack: f64| {
        let found = DVec3::from([0, 1, 2].map(|c| value[c].as_f64().unwrap()));
        assert!(
            (found - want).abs().max_element() <= slack,
            "{found}, expected {want}"
        );
    };
    let list = succeeds(&["objects", "--scene", utf8(&path)]);
    assert!(
        ["red", "green", "blue", "wall", "   36  ", "1000000.00"]
            .iter()
            .all(|word| list.contains(word)),
        "{list}"
    );
    let axes = ["centre x", " y ", " z ", "size x"];
    assert!(axes.iter().all(|axis| list.contains(axis)), "{list}");
    let json = json_of(&["objects", "--scene", utf8(&path)]);
    assert_eq!(
        (json[1]["name"].as_str(), json[1]["gaussians"].as_u64()),
        (Some("green"), Some(25))
    );
    near(&json[1]["low"], ORIGIN + DVec3::new(-0.3, 0.0, 0.0), 1e-6);
    near(&json[1]["high"], ORIGIN + DVec3::new(0.3, 0.6, 0.0), 1e-6);
    // The green plate is in the middle of view 3.
    let (x, y) = (WIDTH / 2, HEIGHT / 2 - 2);
    let cameras = folder.path().join("transforms.json");
    let pixel = format!("{x},{y}");
    let at = [
        "objects",
        "--scene",
        utf8(&path),
        "--cameras",
        utf8(&cameras),
        "--frame",
        "v3",
        "--pixel",
        &pixel,
    ];
    let said = succeeds(&at);
    assert!(
        said.contains("2 green") && said.contains("at x 10000"),
        "{said}"
    );
    let json = json_of(&at);
    assert_eq!(json["id"].as_u64(), Some(2));
    near(&json["point"], ORIGIN + DVec3::new(0.0, 0.3, 0.0), 0.31);

    let out = folder.path().join("edited/scene.ply");
    let edit = |more: &[&str]| {
        succeeds(&[&["edit", "--scene", utf8(&path), "--out", utf8(&out)], more].concat())
    };
    let (before, labels) = read(&path);
    let said = edit(&["--remove", "red, 4"]);
    assert!(said.contains("50 of 111"), "{said}");
    let (left, left_labels) = read(&out);
    assert_eq!(left_labels, [vec![2; 25], vec![3; 25]].concat());
    assert_eq!(left, before.select(&(25..75).collect::<Vec<u32>>()));
    assert_eq!(ply::read(&out).unwrap().origin, ORIGIN);
    assert!(out.with_file_name("classes.json").is_file());

    edit(&[
        "--keep",
        "green",
        "--turn",
        "green=z,90",
        "--move",
        "green=0,0,1",
    ]);
    let (moved, _) = read(&out);
    assert_eq!(moved.len(), 25);
    // Counter-clockwise about the middle, (0, 0.3): right becomes up, up becomes left.
    for (got, mean) in moved.means.iter().zip(&before.means[25..50]) {
        let want = [0.3 - mean[1], mean[0] + 0.3, mean[2] + 1.0];
        assert!(
            got.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-5),
            "{got:?}, expected {want:?}"
        );
    }
    // Forwards becomes down about x, right becomes backwards about y.
    type Turned = fn([f32; 3]) -> [f32; 3];
    let about_y: Turned = |[x, y, z]| [z, y, -x];
    // A direction has any length.
    let turns: [(&str, Turned); 4] = [
        ("x", |[x, y, z]| [x, -z, y]),
        ("y", about_y),
        ("0:2.5:0", about_y),
        ("1:1:1", |[x, y, z]| {
            // A quarter about the diagonal, by Rodrigues' formula.
            let along = (x + y + z) / 3.0;
            [
                along + (z - y) / 3_f32.sqrt(),
                along + (x - z) / 3_f32.sqrt(),
                along + (y - x) / 3_f32.sqrt(),
            ]
        }),
    ];
    for (axis, turned) in turns {
        edit(&["--keep", "blue", "--turn", &format!("blue={axis},90")]);
        let centre = [0.8, -0.3, 0.2];
        for (got, mean) in read(&out).0.means.iter().zip(&before.means[50..75]) {
            let offset = turned([0, 1, 2].map(|c| mean[c] - centre[c]));
            let near = (0..3).all(|c| (got[c] - centre[c] - offset[c]).abs() < 1e-5);
            assert!(near, "about {axis}: {got:?} for {mean:?}");
        }
    }
    edit(&["--keep", "red,green,blue,wall"]);
    assert_eq!(read(&out), (before, labels));

    let said = edit(&["--keep", "red,wall", "--paint"]);
    assert!(said.contains("painted"), "{said}");
    let (painted, left) = read(&out);
    let classes = Classes::read(&folder.path().join("classes.json")).unwrap();
    let want: Vec<[f32; 3]> = left
        .iter()
        .map(|&id| classes.color(id).map(|v| f32::from(v) / 255.0))
        .collect();
    assert_ne!(want[0], want[25]);
    let close = |(a, b): (&[f32; 3], &[f32; 3])| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
    assert!(painted.len() == 61 && painted.base_colors().iter().zip(&want).all(close));
    assert!(
        painted.sh_degree == 0
            || painted
                .sh
                .chunks_exact(48)
                .all(|row| row[3..].iter().all(|v| *v == 0.0))
    );
}

#[test]
fn a_number_is_an_id_first_and_a_class_names_all_its_objects() {
    let folder = tempfile::tempdir().unwrap();
    let path = scene(folder.path());
    let out = folder.path().join("out/scene.ply");
    let left = |remove: &str| {
        succeeds(&[
            "edit",
            "--scene",
            utf8(&path),
            "--out",
            utf8(&out),
            "--remove",
            remove,
        ]);
        let mut ids = read(&out).1;
        ids.dedup();
        std::fs::remove_dir_all(out.parent().unwrap()).unwrap();
        ids
    };
    let mut classes =
        Classes::from_names(0, [(1, "2"), (2, "chair 1"), (3, "chair 2"), (4, "chair")]);
    let write = |classes: &Classes| classes.write(&folder.path().join("classes.json")).unwrap();
    write(&classes);
    assert_eq!(left("2"), [1, 3, 4]);
    assert_eq!(left("chair"), [1, 2, 3]);
    for object in &mut classes.entries[1..3] {
        object.object_of = Some(ObjectOf {
            class: 9,
            thing: true,
        });
    }
    write(&classes);
    assert_eq!(left("chair"), [1]);
    // Without names there are ids, and a dash is none.
    std::fs::remove_file(folder.path().join("classes.json")).unwrap();
    assert_eq!(left("3"), [1, 2, 4]);
    let message = fails(
        &[
            "edit",
            "--scene",
            utf8(&path),
            "--out",
            utf8(&out),
            "--remove",
            "-",
        ],
        1,
    );
    assert!(message.contains("1, 2, 3, 4"), "{message}");
}

#[test]
fn mistakes_about_objects_say_what_there_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = scene(folder.path());
    let out = folder.path().join("out.ply");
    let edit = |more: &[&str], code| {
        fails(
            &[&["edit", "--scene", utf8(&path), "--out", utf8(&out)], more].concat(),
            code,
        )
    };
    let message = edit(&["--remove", "sofa"], 1);
    assert!(
        ["--remove", "sofa", "1 red", "4 wall"]
            .iter()
            .all(|word| message.contains(word)),
        "{message}"
    );
    let message = edit(&["--keep", "red", "--remove", "1"], 1);
    assert!(message.contains("no Gaussian left"), "{message}");
    let message = edit(&["--keep", "red", "--move", "wall=0,0,1"], 1);
    assert!(
        message.contains("--move") && message.contains("neither removed nor left out"),
        "{message}"
    );
    let message = edit(&["--move", "red=1e5,0,0"], 1);
    assert!(
        message.contains("--move") && message.contains("at most"),
        "{message}"
    );
    let message = edit(&[], 1);
    assert!(
        message.contains("no operation") && message.contains("--edits"),
        "{message}"
    );
    let onto = fails(
        &[
            "edit",
            "--scene",
            utf8(&path),
            "--out",
            utf8(&path),
            "--keep",
            "red",
        ],
        1,
    );
    assert!(
        onto.contains("--out") && onto.contains("a file other than the scene"),
        "{onto}"
    );
    for taken in [
        folder.path().join("classes.json"),
        folder.path().join("new/classes.json"),
    ] {
        let names = ["--classes", utf8(&folder.path().join("classes.json"))].map(str::to_owned);
        let arguments = [
            "edit",
            "--scene",
            utf8(&path),
            "--out",
            utf8(&taken),
            "--remove",
            "red",
            &names[0],
            &names[1],
        ];
        assert!(fails(&arguments, 1).contains("a file other than the scene"));
    }
    let moves = ["red=1,2", "red=1,2,inf"].map(|wrong| ["--move", wrong]);
    let turns = [
        "red=w,90",
        "red",
        "red=0:0:0,90",
        "red=0:1,90",
        "red=0:1:nan,90",
    ]
    .map(|wrong| ["--turn", wrong]);
    for wrong in moves.into_iter().chain(turns) {
        let message = edit(&wrong, 2);
        assert!(message.contains("for instance chair="), "{message}");
    }
    // The names of other labels beside the new file stay what they are.
    let other = folder.path().join("other/classes.json");
    Classes::from_names(0, [(1, "door")]).write(&other).unwrap();
    let message = fails(
        &[
            "edit",
            "--scene",
            utf8(&path),
            "--out",
            utf8(&other.with_file_name("a.ply")),
            "--keep",
            "red",
        ],
        1,
    );
    assert!(
        message.contains("classes.json") && message.contains("another class table"),
        "{message}"
    );
    assert_eq!(Classes::read(&other).unwrap().name(1), "door");
    assert!(!out.exists() && !other.with_file_name("a.ply").exists());
    let cameras = folder.path().join("transforms.json");
    let at = |frame, pixel| {
        fails(
            &[
                "objects",
                "--scene",
                utf8(&path),
                "--cameras",
                utf8(&cameras),
                "--frame",
                frame,
                "--pixel",
                pixel,
            ],
            1,
        )
    };
    assert!(
        at("v9", "1,1").contains("6 frames such as v0"),
        "{}",
        at("v9", "1,1")
    );
    assert!(
        at("v1", "80,0").contains("a column below 80 and a row below 64"),
        "{}",
        at("v1", "80,0")
    );
    fails(&["objects", "--scene", utf8(&path), "--frame", "v1"], 2);

    let (gaussians, _) = plates();
    ply::write(&path, &gaussians.select(&[]), DVec3::ZERO, Some(&[])).unwrap();
    let message = fails(&["objects", "--scene", utf8(&path)], 1);
    assert!(message.contains("no Gaussian"), "{message}");
    ply::write(&path, &gaussians, DVec3::ZERO, None).unwrap();
    let message = fails(&["objects", "--scene", utf8(&path)], 1);
    assert!(
        message.contains("column label") && message.contains("coseg vote"),
        "{message}"
    );
}

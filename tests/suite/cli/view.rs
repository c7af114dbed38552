//! `coseg view`: the page that it writes.

use crate::support::browser::inside;
#[cfg(feature = "serve")]
use crate::support::client::Client;
use crate::support::plates::scene as plates_scene;
use crate::support::program::{coseg_in, fails, listed, succeeds, utf8};
use coseg::data::formats::transforms::write_cameras;
use coseg::data::read_cameras;
#[cfg(feature = "serve")]
use {
    coseg::data::Classes,
    std::io::{BufRead, BufReader},
    std::process::{Command, Stdio},
};

#[test]
fn the_command_writes_a_page_beside_the_scene() {
    let dir = tempfile::tempdir().unwrap();
    let scene = plates_scene(dir.path());
    let said = succeeds(&[
        "view",
        "--scene",
        utf8(&scene),
        "--cameras",
        utf8(dir.path()),
    ]);
    let page = scene.with_file_name("viewer.html");
    assert!(said.contains("viewer.html"), "{said}");
    let html = std::fs::read_to_string(&page).unwrap();
    let header: serde_json::Value = serde_json::from_str(inside(&html, "header")).unwrap();
    assert_eq!(header["cameras"].as_array().unwrap().len(), 6);
    assert_eq!(header["path"], utf8(&scene));
    // A scene.ply has the name of its folder, also where it is given without one.
    let room = dir.path().join("room");
    std::fs::create_dir(&room).unwrap();
    std::fs::copy(&scene, room.join("scene.ply")).unwrap();
    let output = coseg_in(&room, &["view", "--scene", "scene.ply"]);
    assert!(output.status.success());
    let html = std::fs::read_to_string(room.join("viewer.html")).unwrap();
    let header: serde_json::Value = serde_json::from_str(inside(&html, "header")).unwrap();
    assert_eq!(header["title"], "room");
    let other = dir.path().join("page.htm");
    for (flag, value) in [("--alpha-max", "2"), ("--up", "0,0")] {
        let message = fails(&["view", "--scene", utf8(&scene), flag, value], 2);
        assert!(message.contains(flag), "{message}");
    }
    let message = fails(&["view", "--scene", utf8(&scene), "--out", utf8(&other)], 1);
    assert!(
        message.contains("--out") && message.contains(".html") && !other.exists(),
        "{message}"
    );
}

#[test]
fn a_model_folder_of_graphdeco_has_its_cameras_above_its_gaussians() {
    let dir = tempfile::tempdir().unwrap();
    let scene = plates_scene(dir.path());
    let model = dir.path().join("model");
    let iteration = model.join("point_cloud/iteration_30000");
    std::fs::create_dir_all(&iteration).unwrap();
    std::fs::copy(&scene, iteration.join("point_cloud.ply")).unwrap();
    write_cameras(
        &model.join("cameras.json"),
        &read_cameras(dir.path(), None).unwrap(),
    )
    .unwrap();
    succeeds(&["view", "--scene", utf8(&model)]);
    let page = std::fs::read_to_string(model.join("viewer.html")).unwrap();
    let header: serde_json::Value = serde_json::from_str(inside(&page, "header")).unwrap();
    assert_eq!(header["cameras"].as_array().unwrap().len(), 6);
    let out = dir.path().join("pictures");
    succeeds(&["render", "--scene", utf8(&model), "--out", utf8(&out)]);
    assert_eq!(listed(&out).len(), 12, "colour and coverage of six views");
}

#[cfg(feature = "serve")]
#[test]
fn a_served_page_saves_edits_beside_the_scene() {
    let dir = tempfile::tempdir().unwrap();
    let scene = plates_scene(dir.path());
    let arguments = ["view", "--serve", "--scene", utf8(&scene)];
    let mut program = Command::new(env!("CARGO_BIN_EXE_coseg"))
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(program.stdout.take().unwrap())
        .read_line(&mut line)
        .unwrap();
    let address = line.split(' ').nth(1).unwrap();
    let client = Client::at(address);
    let page = String::from_utf8(client.get("").1).unwrap();
    let header: serde_json::Value = serde_json::from_str(inside(&page, "header")).unwrap();
    assert_eq!(header["blocks"], 1);
    let edits = format!(
        r#"{{"version": 1, "scene": {}, "operations": [{{"op": "rename", "object": 1, "name": "rug"}}]}}"#,
        header["sha256"]
    );
    let saved = scene.with_file_name("edits.json");
    for saves in 0..3 {
        assert_eq!(client.post(&format!("edits/{saves}"), &edits, "").0, 200);
    }
    program.kill().unwrap();
    program.wait().unwrap();

    let edit = ["edit", "--scene", utf8(&scene), "--edits", utf8(&saved)];
    succeeds(&[&edit[..], &["--out", utf8(&dir.path().join("edited"))]].concat());
    let classes = Classes::read(&dir.path().join("edited/classes.json")).unwrap();
    assert_eq!(classes.known_name(1), Some("rug"));

    // Edits of another scene stay.
    let other = edits.replace(header["sha256"].as_str().unwrap(), &"0".repeat(64));
    std::fs::write(&saved, &other).unwrap();
    let message = fails(&arguments, 1);
    assert!(message.contains("edits of another scene"), "{message}");
    assert_eq!(std::fs::read_to_string(&saved).unwrap(), other);
    let both = [&arguments[..], &["--out", "page.html"]].concat();
    assert!(fails(&both, 2).contains("--out"));
}

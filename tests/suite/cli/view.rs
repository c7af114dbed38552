//! `coseg view`: the page that it writes.

use crate::support::browser::inside;
use crate::support::plates::scene as plates_scene;
use crate::support::program::{fails, listed, succeeds, utf8};
use coseg::data::formats::transforms::write_cameras;
use coseg::data::read_cameras;

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
    let text = std::fs::read_to_string(&page).unwrap();
    let header: serde_json::Value = serde_json::from_str(inside(&text, "header")).unwrap();
    assert_eq!(header["cameras"].as_array().unwrap().len(), 6);
    assert_eq!(header["path"], utf8(&scene));
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

//! Files of cameras that other tools write: read as they mean, and refused by name where they are broken.

use crate::support::damage::Damage;
use coseg::data::{NamedCamera, Split, read_cameras};
use coseg::splat::camera::Camera;
use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};
use std::fs;
use std::path::PathBuf;
use tempfile::TempDir;

fn rotation(i: usize) -> DMat3 {
    DMat3::from_quat(DQuat::from_euler(
        glam::EulerRot::XYZ,
        0.3 + i as f64,
        -0.8,
        2.0,
    ))
}

fn center(i: usize) -> DVec3 {
    DVec3::new(1e3 + i as f64, -2.5, 0.75)
}

/// As `camera_to_JSON` of graphdeco's 3DGS has it: rows of the camera-to-world rotation, OpenCV axes.
fn graphdeco() -> Value {
    let camera = |i: usize| {
        let rows = rotation(i).transpose().to_cols_array_2d();
        json!({
            "id": i, "img_name": format!("cam/{i}.JPG"), "width": 90, "height": 70, "position": center(i).to_array(),
            "rotation": rows, "fy": 101.5, "fx": 100.25,
        })
    };
    json!([camera(0), camera(1), camera(2)])
}

/// As nerfstudio's viewer has it: rows of the camera-to-world matrix, OpenGL axes.
fn nerfstudio() -> Value {
    let camera = |i: usize| {
        let m = rotation(i);
        let [x, y, z, c] = [m.x_axis, -m.y_axis, -m.z_axis, center(i)];
        let rows = [
            [x.x, y.x, z.x, c.x, x.y, y.y, z.y, c.y].to_vec(),
            [x.z, y.z, z.z, c.z, 0.0, 0.0, 0.0, 1.0].to_vec(),
        ];
        json!({"camera_to_world": rows.concat(), "fov": 50.0 + i as f64, "aspect": 2.0})
    };
    json!({
        "default_fov": 75, "keyframes": [{"matrix": "[1]"}], "camera_type": "perspective", "render_height": 100,
        "render_width": 160.0, "fps": 24, "seconds": 4, "is_cycle": false, "camera_path": [camera(0), camera(1)],
    })
}

fn write(value: &Value) -> (TempDir, PathBuf) {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("cameras.json");
    fs::write(&path, value.to_string()).expect("write");
    (dir, path)
}

fn assert_pose(camera: &Camera, i: usize) {
    assert!(camera.center.distance(center(i)) < 1e-9, "{camera:?}");
    assert!(
        camera.rotation.abs_diff_eq(rotation(i).transpose(), 1e-9),
        "{camera:?}"
    );
}

#[test]
fn cameras_of_graphdeco() {
    let (_dir, path) = write(&graphdeco());
    let cameras = read_cameras(&path, None).expect("cameras");
    assert_eq!(
        cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(),
        ["cam_0", "cam_1", "cam_2"]
    );
    for (i, NamedCamera { camera, split, .. }) in cameras.iter().enumerate() {
        assert_pose(camera, i);
        let Camera {
            fx,
            fy,
            cx,
            cy,
            width,
            height,
            ..
        } = *camera;
        assert_eq!(
            (fx, fy, cx, cy, width, height),
            (100.25, 101.5, 45.0, 35.0, 90, 70)
        );
        assert_eq!(*split, Split::Train);
    }
    assert_eq!(
        read_cameras(&path, Some(Split::Train)).expect("cameras"),
        cameras
    );
    crate::support::assert_names(
        &read_cameras(&path, Some(Split::Test)).expect_err("none"),
        &["cameras.json", "without splits"],
    );
    // A folder with it and no scene, as its model folders are; a name without an extension, and a number.
    assert_eq!(
        read_cameras(path.parent().expect("folder"), None).expect("cameras"),
        cameras
    );
    let mut named = graphdeco();
    named[0]["img_name"] = json!("a.b");
    named[1]["img_name"] = json!(7);
    let (_dir, path) = write(&named);
    let cameras = read_cameras(&path, None).expect("cameras");
    assert_eq!(
        (cameras[0].name.as_str(), cameras[1].name.as_str()),
        ("a.b", "7")
    );
}

#[test]
fn camera_paths_of_nerfstudio() {
    let (_dir, path) = write(&nerfstudio());
    let cameras = read_cameras(&path, None).expect("cameras");
    assert_eq!(
        cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(),
        ["path_0000", "path_0001"]
    );
    for (i, NamedCamera { camera, .. }) in cameras.iter().enumerate() {
        assert_pose(camera, i);
        assert_eq!(
            (camera.width, camera.height, camera.cx, camera.cy),
            (160, 100, 80.0, 50.0)
        );
        // The field of view is the vertical one: its half leads from the middle to the upper border.
        let half = (0.5 * (50.0 + i as f64)).to_radians();
        let upper = camera
            .to_opengl()
            .transform_vector3(DVec3::new(0.0, half.tan(), -1.0));
        let (u, v, _) = camera.project(camera.center + upper).expect("in front");
        assert!((u - 80.0).abs() < 1e-9 && v.abs() < 1e-9, "{u} {v}");
        assert_eq!(camera.fx, camera.fy);
    }
    let mut without = nerfstudio();
    without.as_object_mut().expect("file").remove("camera_type");
    let (_dir, path) = write(&without);
    assert_eq!(read_cameras(&path, None).expect("cameras"), cameras);
}

#[test]
fn a_transforms_file_and_a_scene_folder_are_read_as_ever() {
    let dir = tempfile::tempdir().expect("folder");
    crate::support::plates::scene(dir.path());
    let of_file =
        read_cameras(&dir.path().join("transforms.json"), Some(Split::Test)).expect("cameras");
    assert_eq!(
        of_file.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(),
        ["v2", "v5"]
    );
    assert_eq!(
        read_cameras(dir.path(), Some(Split::Test)).expect("cameras"),
        of_file
    );
    // The scene's own cameras come before a cameras.json in its folder.
    fs::write(dir.path().join("cameras.json"), graphdeco().to_string()).expect("write");
    assert_eq!(
        read_cameras(dir.path(), Some(Split::Test)).expect("cameras"),
        of_file
    );
}

#[test]
fn broken_files_are_refused_by_name() {
    type Change = fn(&mut Value);
    let of_graphdeco: [(Change, &[&str]); 21] = [
        (|v| *v = json!([]), &["cameras", "no cameras"]),
        (
            |v| *v = json!([1, 2]),
            &["cameras[0]", "integer `1`", "a camera with img_name"],
        ),
        (
            |v| {
                v[1].as_object_mut().expect("camera").remove("img_name");
            },
            &["cameras[1].img_name", "no name"],
        ),
        (
            |v| {
                v[1].as_object_mut().expect("camera").remove("fx");
            },
            &["cameras[1]", "missing field `fx`", "3DGS"],
        ),
        (
            |v| v[1]["img_name"] = json!(""),
            &["cameras[1].img_name", "no name"],
        ),
        (
            |v| v[1]["img_name"] = json!(".png"),
            &["cameras[1].img_name", "no name"],
        ),
        (
            |v| v[2]["img_name"] = json!("cam/1.png"),
            &["cameras[2].img_name", "cam_1", "cameras[1]", "rename"],
        ),
        (
            |v| v[1]["width"] = json!(0),
            &["cameras[1].width", "0", "at least 1"],
        ),
        (
            |v| v[1]["height"] = json!(7.5),
            &["cameras[1].height", "7.5", "whole number"],
        ),
        (|v| v[1]["height"] = json!(-4), &["cameras[1].height", "-4"]),
        (
            |v| v[1]["width"] = json!(1e30),
            &["cameras[1].width", "1e30"],
        ),
        (
            |v| v[1]["width"] = json!(4_000_000_000_u32),
            &["cameras[1]", "exceeds the limit"],
        ),
        (
            |v| v[1]["fx"] = json!(0),
            &["cameras[1].fx", "0.0 pixels", "focal length"],
        ),
        (
            |v| v[1]["fy"] = json!(-1e300),
            &["cameras[1].fy", "-1e300 pixels", "focal length"],
        ),
        (
            |v| v[1]["fy"] = Value::Null,
            &["cameras[1].fy", "null", "expected f64", "3DGS"],
        ),
        (
            |v| v[1]["position"] = json!([1, 2]),
            &["cameras[1].position", "length 2", "length 3"],
        ),
        (
            |v| v[1]["position"][2] = json!("far"),
            &["cameras[1].position[2]", "far", "f64"],
        ),
        (
            |v| v[1]["position"][0] = json!(1e300),
            &["cameras[1].position", "1e300 in row 0, column 3", "finite"],
        ),
        (
            |v| v[1]["rotation"] = json!([[1, 0, 0], [0, 1, 0]]),
            &["cameras[1].rotation", "length 2", "length 3"],
        ),
        (
            |v| v[1]["rotation"][0] = json!([2, 0, 0]),
            &[
                "cameras[1].position, rotation",
                "column lengths",
                "orthonormal",
            ],
        ),
        (
            |v| v[1]["rotation"] = json!([[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
            &[
                "cameras[1].position, rotation",
                "determinant -1",
                "mirroring",
            ],
        ),
    ];
    let of_nerfstudio: [(Change, &[&str]); 15] = [
        (
            |v| v["camera_path"] = json!([]),
            &["camera_path", "no cameras"],
        ),
        (
            |v| v["camera_path"] = json!({"a": 1}),
            &["camera_path", "map", "a sequence", "nerfstudio"],
        ),
        (
            |v| v["camera_type"] = json!("equirectangular"),
            &["camera_type", "equirectangular", "perspective"],
        ),
        (
            |v| v["render_width"] = Value::Null,
            &["render_width", "null", "f64", "nerfstudio"],
        ),
        (
            |v| v["render_height"] = json!(0),
            &["render_height", "at least 1"],
        ),
        (
            |v| v["render_height"] = json!(4_000_000_000_u32),
            &["exceeds the limit"],
        ),
        (
            |v| v["camera_path"][1]["fov"] = json!(0),
            &["camera_path[1].fov", "0.0", "above 0, below 180"],
        ),
        (
            |v| v["camera_path"][1]["fov"] = json!(180),
            &["camera_path[1].fov", "180"],
        ),
        (
            |v| v["camera_path"][1]["fov"] = json!(1e-30),
            &["camera_path[1].fov", "focal length"],
        ),
        (
            |v| v["camera_path"][1]["fov"] = json!("wide"),
            &["camera_path[1].fov", "wide"],
        ),
        (
            |v| v["camera_path"][1] = json!(null),
            &["camera_path[1]", "null", "a camera with camera_to_world"],
        ),
        (
            |v| {
                v.as_object_mut().expect("file").remove("render_height");
            },
            &["fields", "missing field `render_height`", "nerfstudio"],
        ),
        (
            |v| v["camera_path"][1]["camera_to_world"] = json!([1, 0, 0, 0]),
            &["camera_path[1].camera_to_world", "length 4", "length 16"],
        ),
        (
            |v| v["camera_path"][1]["camera_to_world"][12] = json!(3),
            &[
                "camera_path[1].camera_to_world",
                "last row [3.0, 0.0, 0.0, 1.0]",
                "by rows",
            ],
        ),
        (
            |v| v["camera_path"][1]["camera_to_world"][0] = json!(5),
            &["camera_path[1].camera_to_world", "column lengths"],
        ),
    ];
    let cases = of_graphdeco.into_iter().map(|case| (graphdeco(), case));
    let cases = cases.chain(of_nerfstudio.into_iter().map(|case| (nerfstudio(), case)));
    for (mut value, (change, parts)) in cases {
        change(&mut value);
        let (_dir, path) = write(&value);
        let error = read_cameras(&path, None).expect_err("broken");
        crate::support::assert_names(&error, parts);
        crate::support::assert_names(&error, &["cameras.json"]);
    }
}

#[test]
fn what_holds_no_cameras_says_what_it_is() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("cameras.json");
    let refused = |bytes: &[u8], parts: &[&str]| {
        fs::write(&path, bytes).expect("write");
        crate::support::assert_names(&read_cameras(&path, None).expect_err("no cameras"), parts);
    };
    let expected = ["cameras.json", "camera path of nerfstudio", "of a run"];
    refused(
        b"ply\nformat ascii 1.0\n",
        &[&expected[..], &["found a PLY file"]].concat(),
    );
    refused(
        b"\x89PNG\r\n\x1a\n",
        &[&expected[..], &["found a PNG image"]].concat(),
    );
    refused(
        b"\xFF\xD8\xFF\xE0",
        &[&expected[..], &["found a JPEG image"]].concat(),
    );
    refused(b"{}", &[&expected[..], &["frames: found nothing"]].concat());
    refused(b"3", &expected);
    refused(b"\xC3\x28", &[&expected[..], &["no text"]].concat());
    refused(b"", &["line 1", "EOF"]);
    refused(b"[{\"id\":\n 0,}]", &["line 2"]);
    refused("[".repeat(100_000).as_bytes(), &["recursion limit"]);
    let bare = graphdeco().to_string().replacen("100.25", "NaN", 1);
    refused(bare.as_bytes(), &["line 1: found NaN", "finite"]);
    let bare = nerfstudio().to_string().replacen("51.0", "-Infinity", 1);
    refused(bare.as_bytes(), &["line 1: found -Infinity", "finite"]);
    // Any part of a file, and any damage to it, is an error or a few cameras.
    for whole in [graphdeco().to_string(), nerfstudio().to_string()] {
        for length in 0..whole.len() {
            refused(&whole.as_bytes()[..length], &["cameras.json"]);
        }
        let mut damage = Damage::new(1);
        for _ in 0..500 {
            let damaged = damage.of(whole.as_bytes());
            fs::write(&path, &damaged).expect("write");
            for named in read_cameras(&path, None).unwrap_or_default() {
                assert!(
                    named.camera.center.is_finite()
                        && named.camera.fx > 0.0
                        && named.camera.width > 0
                );
            }
        }
    }
    fs::remove_file(&path).expect("remove");
    crate::support::assert_names(
        &read_cameras(&path, None).expect_err("absent"),
        &["read failed", "check the path"],
    );
}

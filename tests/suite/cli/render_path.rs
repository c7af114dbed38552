//! `coseg render --path`: views along a path and around the scene or an object.

use crate::support::plates::{HEIGHT, WIDTH, camera};
use crate::support::program::{fails, read_json, succeeds, utf8};
use crate::support::rendered_views::{render, run_folder, size};
use coseg::data::read_cameras;
use coseg::splat::camera::Camera;
use std::fs;
use std::path::Path;

#[test]
fn a_path_is_rendered_with_its_cameras() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_folder(folder.path());
    let out = folder.path().join("walk");
    let said = render(
        &run,
        &out,
        &[
            "--path",
            "interpolate",
            "--frames",
            "5",
            "--split",
            "train",
            "--size",
            "40,32",
        ],
    );
    assert!(said.contains("5 frames"), "{said}");
    let path = read_cameras(&out.join("cameras.json"), None).unwrap();
    let names: Vec<&str> = path.iter().map(|named| named.name.as_str()).collect();
    assert_eq!(
        names,
        [
            "path_0000",
            "path_0001",
            "path_0002",
            "path_0003",
            "path_0004"
        ]
    );
    let near = |a: &Camera, b: &Camera| {
        a.center.distance(b.center) < 1e-9 && a.rotation.abs_diff_eq(b.rotation, 1e-9)
    };
    // Of the split's cameras, which are 0, 1, 3 and 4.
    assert!(
        near(&path[0].camera, &camera(0)) && near(&path[4].camera, &camera(4)),
        "{path:?}"
    );
    assert_eq!(
        (
            path[2].camera.width,
            path[2].camera.height,
            path[2].camera.fx
        ),
        (40, 32, 40.0)
    );
    for name in names {
        assert_eq!(size(&out.join(format!("{name}.rgb.png"))), (40, 32));
    }
    // The file that was written shows the same again, and is known to `objects`.
    let again = folder.path().join("again");
    render(&run, &again, &["--cameras", utf8(&out)]);
    let file = "path_0002.rgb.png";
    assert_eq!(
        fs::read(out.join(file)).unwrap(),
        fs::read(again.join(file)).unwrap()
    );
    let at = [
        "--cameras",
        utf8(&out),
        "--frame",
        "path_0002",
        "--pixel",
        "20,15",
        "--json",
    ];
    succeeds(&[&["objects", "--scene", utf8(&run)], &at[..]].concat());
    // A path may be rendered into its folder again, not into one with other cameras.
    render(&run, &out, &["--path", "interpolate", "--frames", "5"]);
    let walk = [
        "render",
        "--scene",
        utf8(&run),
        "--out",
        utf8(&out),
        "--path",
        "interpolate",
    ];
    let message = fails(&[&walk[..], &["--frames", "4"]].concat(), 1);
    assert!(
        message.contains("path_0004") && message.contains("longer path"),
        "a film would end with it: {message}"
    );
    let message = fails(
        &[
            &walk[..],
            &[
                "--frames",
                "5",
                "--cameras",
                utf8(&out.join("cameras.json")),
            ],
        ]
        .concat(),
        1,
    );
    assert!(message.contains("--out"), "the path's own keys: {message}");
    let before = fs::read(run.join("cameras.json")).unwrap();
    let message = fails(
        &[
            "render",
            "--scene",
            utf8(&run),
            "--out",
            utf8(&run),
            "--path",
            "orbit",
        ],
        1,
    );
    assert!(
        message.contains("--out") && message.contains("cameras.json"),
        "{message}"
    );
    assert_eq!(fs::read(run.join("cameras.json")).unwrap(), before);
}

#[test]
fn an_orbit_shows_the_scene_or_one_object() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_folder(folder.path());
    let out = folder.path().join("all");
    let red = folder.path().join("red");
    render(&run, &out, &["--path", "orbit", "--frames", "4"]);
    let frames = read_json(&out.join("cameras.json"))["frames"]
        .as_array()
        .unwrap()
        .len();
    assert_eq!(frames, 4);
    // All cameras look at the origin from 4 away.
    for named in read_cameras(&out.join("cameras.json"), None).unwrap() {
        assert!(
            (named.camera.center.length() - 4.01).abs() < 0.05,
            "{named:?}"
        );
    }
    render(
        &run,
        &red,
        &[
            "--path", "orbit", "--frames", "3", "--object", "red", "--labels",
        ],
    );
    let labels = image::open(red.join("path_0000.label.png"))
        .unwrap()
        .into_luma8();
    assert_eq!(
        labels.get_pixel(WIDTH as u32 / 2, HEIGHT as u32 / 2).0,
        [1],
        "the object is in the middle"
    );
    let radius_of = |out: &Path| {
        let cameras = read_cameras(&out.join("cameras.json"), None).unwrap();
        cameras
            .iter()
            .map(|named| (named.camera.center.x + 0.9).hypot(named.camera.center.z - 0.1))
            .fold(0.0, f64::max)
    };
    assert!(radius_of(&red) < 3.0, "{}", radius_of(&red));
    render(
        &run,
        &red,
        &[
            "--path", "orbit", "--frames", "3", "--object", "1", "--radius", "5",
        ],
    );
    assert!((radius_of(&red) - 5.0).abs() < 0.01, "{}", radius_of(&red));

    let base = ["render", "--scene", utf8(&run), "--out", utf8(&out)];
    let message = fails(
        &[&base[..], &["--path", "orbit", "--object", "sofa"]].concat(),
        1,
    );
    assert!(
        message.contains("--object") && message.contains("1 red"),
        "{message}"
    );
    let message = fails(
        &[&base[..], &["--path", "interpolate", "--object", "red"]].concat(),
        1,
    );
    assert!(
        message.contains("--object") && message.contains("--path orbit"),
        "{message}"
    );
    for wrong in [
        ["--frames", "3"],
        ["--object", "red"],
        ["--radius", "1"],
        ["--path", "spiral"],
        ["--size", "0,4"],
    ] {
        fails(&[&base[..], &wrong].concat(), 2);
    }
    for wrong in [
        ["--frames", "0"],
        ["--radius", "-1"],
        ["--radius", "nan"],
        ["--size", "100000,100000"],
        ["--size", "9"],
    ] {
        fails(&[&base[..], &["--path", "orbit"], &wrong].concat(), 2);
    }
}

#[test]
fn a_path_sways_before_what_the_cameras_look_at_from_one_side() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_folder(folder.path());
    let out = folder.path().join("film");
    render(&run, &out, &["--path", "--frames", "8"]);
    let path = read_cameras(&out.join("cameras.json"), None).unwrap();
    let eyes = path.iter().map(|named| named.camera.center);
    let ahead = glam::DVec3::NEG_Z;
    // The photos are taken from 4 before the plates, up to 1.2 to either side.
    assert!(
        eyes.clone().all(|eye| eye.z > 3.7 && eye.x.abs() < 1.2),
        "{path:?}"
    );
    assert!(
        eyes.clone().any(|eye| eye.x > 0.5) && eyes.clone().any(|eye| eye.x < -0.5),
        "{path:?}"
    );
    for named in &path {
        let forward = named.camera.rotation.row(2);
        assert!(forward.dot(ahead) > 0.95, "{named:?}");
        let (u, v, _) = named.camera.project(glam::DVec3::ZERO).unwrap();
        assert!((u - 40.0).abs() < 2.0 && (v - 32.0).abs() < 2.0, "{u}, {v}");
    }
    let message = fails(
        &[
            "render",
            "--scene",
            utf8(&run),
            "--out",
            utf8(&out),
            "--path",
            "sway",
            "--object",
            "red",
        ],
        1,
    );
    assert!(
        message.contains("--object") && message.contains("--path orbit"),
        "{message}"
    );
}

#[test]
fn ordinary_frames_take_another_size() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_folder(folder.path());
    let out = folder.path().join("large");
    render(&run, &out, &["--split", "test", "--size", "200,128"]);
    assert_eq!(size(&out.join("v2.rgb.png")), (200, 128));
    // Twice as large, and 20 pixels more on either side: the middle is the photo.
    let [large, photo] = [out.join("v2.rgb.png"), folder.path().join("images/v2.png")]
        .map(|p| image::open(p).unwrap());
    let half = image::imageops::thumbnail(
        &large.crop_imm(20, 0, 160, 128).into_rgb8(),
        WIDTH as u32,
        HEIGHT as u32,
    );
    let differ: f64 = half
        .iter()
        .zip(photo.into_rgb8().iter())
        .map(|(a, b)| f64::from(a.abs_diff(*b)))
        .sum();
    let mean = differ / half.len() as f64;
    assert!(mean < 3.0, "{mean}");
}

//! New views by the program: run folders in place of files, and files that are not what they are given as.

use crate::support::plates::{HEIGHT, WIDTH};
use crate::support::program::{fails, succeeds, utf8};
use crate::support::rendered_views::{render, run_folder};
use coseg::backend::device::BackendName;
use coseg::splat::ply;
use std::fs;
use std::path::Path;

#[test]
fn the_version_names_the_backends() {
    let names: Vec<String> = BackendName::compiled()
        .iter()
        .map(|name| name.to_string())
        .collect();
    let want = format!("coseg {} ({}", env!("CARGO_PKG_VERSION"), names.join(", "));
    assert!(
        succeeds(&["--version"]).starts_with(&want),
        "{}",
        succeeds(&["--version"])
    );
}

#[test]
fn a_run_folder_stands_for_its_files() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_folder(folder.path());
    let (short, long) = (folder.path().join("short"), folder.path().join("long"));
    render(&run, &short, &["--split", "test", "--labels"]);
    render(
        &run.join("scene.ply"),
        &long,
        &["--cameras", utf8(&run), "--split", "test", "--labels"],
    );
    for file in ["v2.rgb.png", "v5.alpha.png", "v5.label_color.png"] {
        assert_eq!(
            fs::read(short.join(file)).unwrap(),
            fs::read(long.join(file)).unwrap(),
            "{file}"
        );
    }
    assert!(!short.join("cameras.json").exists() && !short.join("v0.rgb.png").exists());
    let listed = succeeds(&["objects", "--scene", utf8(&run)]);
    assert!(listed.contains("green"), "{listed}");
    let pixel = format!("{},{}", WIDTH / 2, HEIGHT / 2 - 2);
    for frame in ["v3", "v3.jpg", "images/v3.png"] {
        let said = succeeds(&[
            "objects",
            "--scene",
            utf8(&run),
            "--frame",
            frame,
            "--pixel",
            &pixel,
        ]);
        assert!(
            said.starts_with("v3 ") && said.contains("2 green"),
            "{said}"
        );
    }
    let edited = folder.path().join("edited/scene.ply");
    succeeds(&[
        "edit",
        "--scene",
        utf8(&run),
        "--out",
        utf8(&edited),
        "--remove",
        "wall",
    ]);
    assert_eq!(ply::read(&edited).unwrap().gaussians.len(), 75);
    render(
        &edited,
        &folder.path().join("of edited"),
        &["--split", "test"],
    );
    let voted = folder.path().join("voted");
    succeeds(&[
        "vote",
        "--scene",
        utf8(&run),
        "--data",
        utf8(folder.path()),
        "--out",
        utf8(&voted),
    ]);
    assert!(voted.join("scene.ply").is_file());
    // What is edited is not written over.
    let own = run.join("scene.ply");
    let message = fails(
        &[
            "edit",
            "--scene",
            utf8(&run),
            "--out",
            utf8(&own),
            "--remove",
            "wall",
        ],
        1,
    );
    assert!(message.contains("a file other than the scene"), "{message}");
}

#[test]
fn files_that_are_something_else_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_folder(folder.path());
    let out = folder.path().join("out");
    let refused = |scene: &Path, cameras: &[&str], parts: &[&str]| {
        let message = fails(
            &[
                &["render", "--scene", utf8(scene), "--out", utf8(&out)],
                cameras,
            ]
            .concat(),
            1,
        );
        for part in parts {
            assert!(message.contains(part), "{part}: {message}");
        }
        assert!(!out.exists());
    };
    let ply = run.join("scene.ply");
    let json = run.join("cameras.json");
    let photo = folder.path().join("images/v0.png");
    refused(
        &ply,
        &["--cameras", utf8(&ply)],
        &["scene.ply", "found a PLY file", "give a file of cameras"],
    );
    refused(
        &json,
        &["--cameras", utf8(&json)],
        &["cameras.json", "found JSON", "give the .ply file"],
    );
    refused(
        &photo,
        &["--cameras", utf8(&json)],
        &["v0.png", "found a PNG image", "give the .ply file"],
    );
    refused(
        &ply,
        &["--cameras", utf8(&photo)],
        &["v0.png", "found a PNG image", "give a file of cameras"],
    );
    refused(
        folder.path(),
        &[],
        &["scene.ply: found no such file", "coseg train"],
    );
    refused(
        &folder.path().join("images"),
        &[],
        &["scene.ply: found no such file", "a run folder"],
    );
    fs::rename(&ply, run.join("other.ply")).unwrap();
    refused(&run, &[], &["other.ply", "give", "run/other.ply"]);
    fs::remove_file(&json).unwrap();
    refused(
        &run.join("other.ply"),
        &[],
        &["--cameras", "nothing", "cameras.json does not exist"],
    );
    refused(
        &run.join("other.ply"),
        &["--cameras", utf8(&run)],
        &["no such file", "cameras and frames"],
    );
    let other = run.join("other.ply");
    for name in ["x.obj", "x.ply.gz"] {
        let target = out.join(name);
        let message = fails(
            &[
                "edit",
                "--scene",
                utf8(&other),
                "--out",
                utf8(&target),
                "--keep",
                "red",
            ],
            1,
        );
        assert!(
            message.contains("--out") && message.contains("a .ply file"),
            "{message}"
        );
        assert!(!target.exists());
    }
    let target = out.join("x.PLY");
    succeeds(&[
        "edit",
        "--scene",
        utf8(&other),
        "--out",
        utf8(&target),
        "--keep",
        "red",
    ]);
    let message = fails(
        &[
            "objects",
            "--scene",
            utf8(&other),
            "--frame",
            "v1",
            "--pixel",
            "1,1",
        ],
        1,
    );
    assert!(message.contains("--cameras"), "{message}");
}

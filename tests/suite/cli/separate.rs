//! `coseg separate` on plates of one class.

use crate::support::plates::plates;
use crate::support::program::{fails, succeeds, utf8};
use coseg::data::Classes;
use coseg::splat::ply;
use glam::DVec3;

#[test]
fn the_command_writes_objects_that_edit_knows() {
    let folder = tempfile::tempdir().unwrap();
    let (gaussians, labels) = plates();
    // Three plates of one class before a wall.
    let labels: Vec<u16> = labels
        .iter()
        .map(|&id| if id == 4 { 1 } else { 2 })
        .collect();
    let path = |name: &str| folder.path().join(name);
    ply::write(&path("scene.ply"), &gaussians, DVec3::ZERO, Some(&labels)).unwrap();
    let classes = Classes::from_names(0, [(1, "wall"), (2, "chair"), (7, "lamp")]);
    classes.write(&path("classes.json")).unwrap();
    let scene = path("scene.ply");
    let out = path("objects/scene.ply");
    // As far as a Gaussian is half opaque the plates do not touch.
    let level = ["--level", "0.5"];
    let said = succeeds(
        &[
            &[
                "separate",
                "--scene",
                utf8(folder.path()),
                "--out",
                utf8(&out),
            ],
            &level[..],
        ]
        .concat(),
    );
    assert!(
        said.contains("chair: 3 pieces") && said.contains("4 labels, 2 before"),
        "{said}"
    );
    let listed = succeeds(&["objects", "--scene", utf8(&path("objects"))]);
    assert!(
        ["chair 1", "chair 2", "chair 3", "wall"]
            .iter()
            .all(|name| listed.contains(name)),
        "{listed}"
    );
    for (what, left) in [("chair 2", 86), ("chair", 36)] {
        let edited = path(&format!("{left}/scene.ply"));
        succeeds(&[
            "edit",
            "--scene",
            utf8(&out),
            "--out",
            utf8(&edited),
            "--remove",
            what,
        ]);
        assert_eq!(ply::read(&edited).unwrap().gaussians.len(), left);
    }
    let whole = succeeds(&[
        "separate",
        "--scene",
        utf8(&scene),
        "--out",
        utf8(&path("wall/s.ply")),
        "--only",
        "wall",
    ]);
    assert!(whole.contains("2 labels, 2 before"), "{whole}");
    for (out, expected) in [
        (&scene, "a file other than the scene"),
        (&path("wall/s.obj"), ".ply"),
    ] {
        let message = fails(
            &["separate", "--scene", utf8(&scene), "--out", utf8(out)],
            1,
        );
        assert!(message.contains(expected), "{message}");
    }
    let level = fails(
        &[
            "separate",
            "--scene",
            utf8(&scene),
            "--out",
            utf8(&path("a.ply")),
            "--level",
            "1",
        ],
        1,
    );
    assert!(level.contains("level"), "{level}");
}

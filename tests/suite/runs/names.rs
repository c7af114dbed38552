//! What is meant by the names of objects and of frames that a user writes.

use crate::support::plates::{camera, plates};
use coseg::data::{Classes, NamedCamera, ObjectOf, Split};
use coseg::runs::{ObjectScene, frame_with_pixel, named_frame};
use coseg::splat::ply::PlyScene;
use glam::DVec3;

/// The plates with labels 1 to 4 of `classes`.
fn named(classes: Classes) -> ObjectScene {
    let (gaussians, labels) = plates();
    let ply = PlyScene {
        gaussians,
        origin: DVec3::ZERO,
        labels: None,
    };
    ObjectScene::with_labels("scene.ply".into(), ply, labels, classes)
}

fn ids(scene: &ObjectScene, what: &str) -> Vec<u16> {
    scene
        .ids(&[what.to_owned()], "--remove")
        .unwrap_or_else(|error| panic!("{error}"))
}

fn refusal(scene: &ObjectScene, what: &str) -> String {
    let found = scene.find(what, "--remove");
    found.expect_err("refused").to_string()
}

#[test]
fn capitals_of_an_object_do_not_matter_where_one_name_fits() {
    let names = [(1, "sofa"), (2, "Lamp"), (3, "lamp"), (4, "coffee-table")];
    let scene = named(Classes::from_names(0, names));
    assert_eq!(ids(&scene, "Sofa"), [1]);
    assert_eq!(ids(&scene, "Coffee table"), [4]);
    // As it is written comes first.
    assert_eq!(ids(&scene, "Lamp"), [2]);
    assert_eq!(ids(&scene, "lamp"), [3]);
    let message = refusal(&scene, "LAMP");
    assert!(
        message.contains("found LAMP, which may mean Lamp or lamp, expected an id or a name"),
        "{message}"
    );
    let mut classes =
        Classes::from_names(0, [(1, "chair 1"), (2, "chair 2"), (3, "x"), (4, "wall")]);
    for chair in &mut classes.entries[..2] {
        chair.object_of = Some(ObjectOf {
            class: 9,
            thing: true,
        });
    }
    let scene = named(classes);
    assert_eq!(ids(&scene, "Chair"), [1, 2]);
    assert_eq!(ids(&scene, "CHAIR 2"), [2]);
}

#[test]
fn a_class_without_gaussians_is_told_from_an_unknown_name() {
    let names = [(1, "red"), (2, "green"), (3, "blue"), (4, "wall")];
    let scene = named(Classes::from_names(
        0,
        names.into_iter().chain([(7, "chair")]),
    ));
    for what in ["chair", "Chair", "7"] {
        let message = refusal(&scene, what);
        let found = format!("found {what}, which no Gaussian has, expected an id or a name");
        assert!(
            message.contains(&found) && message.contains("4 wall"),
            "{message}"
        );
    }
    let message = refusal(&scene, "rug");
    assert!(message.contains("found rug, expected"), "{message}");
}

#[test]
fn a_frame_is_named_by_its_view_or_by_the_path_of_its_photo() {
    let names = ["photo_1", "cam0_photo_1", "cam1_photo_1", "night.v2"];
    let frames = names.map(|name| NamedCamera {
        name: name.to_owned(),
        split: Split::Train,
        camera: camera(0),
    });
    for (frame, name) in [
        ("cam0_photo_1", "cam0_photo_1"),
        ("cam0_photo_1.jpg", "cam0_photo_1"),
        ("cam0/photo_1.jpg", "cam0_photo_1"),
        ("cam1/photo_1", "cam1_photo_1"),
        ("./room/images/cam1/photo_1.png", "cam1_photo_1"),
        ("cam1\\photo_1.png", "cam1_photo_1"),
        ("images/photo_1.jpg", "photo_1"),
        ("photo_1", "photo_1"),
        ("images/night.v2", "night.v2"),
        ("images/night.v2.jpg", "night.v2"),
    ] {
        assert_eq!(named_frame(&frames, frame).unwrap().name, name, "{frame}");
    }
    let found = frame_with_pixel(&frames, "cam0/photo_1.jpg", [0, 0]).unwrap();
    assert_eq!(found.name, "cam0_photo_1");
    let message = named_frame(&frames, "cam0/photo_2.jpg").expect_err("none");
    let message = message.to_string();
    assert!(message.contains("4 frames such as photo_1"), "{message}");
}

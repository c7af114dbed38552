//! COLMAP models in pieces, and photos that no model has.

use crate::support::colmap::{VIEWS, binary, name, pinhole, scene, text};
use coseg::data::{LoadOptions, check, load, locate};
use std::fs;
use std::path::Path;

/// A text model of the first `count` images.
fn piece(dir: &Path, folder: &str, count: usize) {
    let folder = dir.join(folder);
    fs::create_dir_all(&folder).expect("folder");
    text(&folder, &pinhole());
    let images = fs::read_to_string(folder.join("images.txt")).expect("written");
    let lines: Vec<_> = images.lines().take(1 + 2 * count).collect();
    fs::write(folder.join("images.txt"), lines.join("\n") + "\n").expect("images");
}

fn notices(dir: &Path) -> Vec<String> {
    let checked = check(dir, &LoadOptions::default());
    assert!(checked.problems.is_empty(), "{checked:?}");
    checked.notices
}

#[test]
fn of_several_models_the_one_with_the_most_photos_is_read() {
    for (write, whole) in [(binary as fn(&Path, &_), "binary"), (text, "text")] {
        let dir = scene(write, &pinhole());
        let dir = dir.path();
        fs::rename(dir.join("sparse/0"), dir.join("sparse/2")).expect("rename");
        piece(dir, "sparse/0", 4);
        piece(dir, "sparse/10", 3);
        // Neither a number nor a model.
        fs::create_dir_all(dir.join("sparse/old")).expect("folder");
        fs::create_dir_all(dir.join("sparse/3")).expect("folder");
        assert_eq!(
            load(dir, &LoadOptions::default())
                .expect("scene")
                .views
                .len(),
            VIEWS,
            "{whole}"
        );
        let told = notices(dir);
        let told: Vec<_> = told
            .iter()
            .filter(|n| n.contains("could not join"))
            .collect();
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(told[0].starts_with(
            "sparse/2, a model of 9 photos, is read, and not sparse/0 of 4, sparse/10 of 3"
        ));
        // As the notice says; of equal ones the first.
        fs::remove_dir_all(dir.join("sparse/2")).expect("remove");
        piece(dir, "sparse/10", 4);
        assert_eq!(
            load(dir, &LoadOptions::default())
                .expect("scene")
                .views
                .len(),
            4
        );
        assert!(notices(dir).iter().any(|n| {
            n.starts_with("sparse/0, a model of 4 photos, is read, and not sparse/10 of 4")
        }));
    }
}

#[test]
fn a_model_that_is_not_called_0_is_found_and_damage_is_told_of() {
    let dir = scene(text, &pinhole());
    let dir = dir.path();
    fs::rename(dir.join("sparse/0"), dir.join("sparse/1")).expect("rename");
    assert_eq!(
        locate(dir, &LoadOptions::default())
            .expect("layout")
            .to_string(),
        "colmap"
    );
    assert!(notices(dir).iter().all(|n| !n.contains("could not join")));
    // A part of a model is not preferred, whatever it claims; without a whole model, the part is reported.
    fs::create_dir_all(dir.join("sparse/0")).expect("folder");
    binary(&dir.join("sparse/0"), &pinhole());
    fs::remove_file(dir.join("sparse/0/cameras.bin")).expect("remove");
    assert_eq!(
        load(dir, &LoadOptions::default())
            .expect("scene")
            .views
            .len(),
        VIEWS
    );
    assert!(notices(dir).iter().all(|n| !n.contains("could not join")));
    // A damaged one is, by name: the other may be a fragment.
    binary(&dir.join("sparse/0"), &pinhole());
    fs::write(dir.join("sparse/0/images.bin"), [255; 20]).expect("images");
    let error = load(dir, &LoadOptions::default()).expect_err("damaged");
    crate::support::assert_names(&error, &["sparse/0/images.bin", "number of images"]);
    fs::remove_dir_all(dir.join("sparse/1")).expect("remove");
    fs::remove_file(dir.join("sparse/0/cameras.bin")).expect("remove");
    crate::support::assert_names(
        &load(dir, &LoadOptions::default()).expect_err("a part"),
        &["sparse/0", "cameras", "no such file"],
    );
}

#[test]
fn photos_without_a_pose_are_told_of() {
    let dir = scene(text, &pinhole());
    let dir = dir.path();
    assert!(notices(dir).iter().all(|n| !n.contains("not in the model")));
    let photo = dir.join("images").join(name(0));
    for other in ["a.PNG", "b.jpg", "cam1/c.jpeg", "z.png"] {
        fs::copy(&photo, dir.join("images").join(other)).expect("copy");
    }
    fs::write(dir.join("images/notes.txt"), "no photo").expect("file");
    fs::copy(&photo, dir.join("images/._a.png")).expect("copy");
    let told = notices(dir);
    let told: Vec<_> = told
        .iter()
        .filter(|n| n.contains("not in the model"))
        .collect();
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(
        told[0].starts_with("4 of the 13 photos in ")
            && told[0].contains("(a.PNG, b.jpg, cam1/c.jpeg and 1 more)"),
        "{told:?}"
    );
    // Those of a split alone are in the model all the same.
    let one = LoadOptions {
        max_frames: 1,
        ..LoadOptions::default()
    };
    let told = check(dir, &one).notices;
    assert!(
        told.iter().any(|n| n.starts_with("4 of the 13 photos")),
        "{told:?}"
    );
}

//! `coseg select` on plates, most of them without labels.

use crate::support::plates::{HEIGHT, WIDTH, camera, plates, scene};
use crate::support::program::{fails, succeeds, utf8};
use coseg::data::formats::transforms::write_cameras;
use coseg::data::{Classes, read_cameras};
use coseg::features::FeatureColors;
use coseg::objects::pick;
use coseg::raster::{Projected, Settings};
use coseg::runs::{FEATURE_COLORS, features_beside};
use coseg::splat::ply;
use glam::DVec3;
use std::path::{Path, PathBuf};

/// The pixel of view `v2` that shows most of the plate `label`.
fn pixel_of(label: u16) -> String {
    let (gaussians, labels) = plates();
    let projected = Projected::new(&gaussians.splats(), &camera(2), &Settings::default()).unwrap();
    let pixels = (0..WIDTH * HEIGHT).map(|i| [i % WIDTH, i / WIDTH]);
    let shown = pixels.filter_map(|at| Some((pick(&projected, &gaussians, &labels, at)?, at)));
    let own = shown.filter(|(picked, _)| picked.id == label);
    let most = own.max_by(|(a, _), (b, _)| a.weight.total_cmp(&b.weight));
    let [x, y] = most.unwrap().1;
    format!("{x},{y}")
}

/// Plates without labels in a folder of their own, and the folder of their cameras.
struct Unlabelled {
    folder: tempfile::TempDir,
    scene: PathBuf,
}

impl Unlabelled {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        scene(&folder.path().join("photos"));
        let scene = folder.path().join("scene.ply");
        ply::write(&scene, &plates().0, DVec3::ZERO, None).unwrap();
        Self { folder, scene }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Arguments that select in `scene`, and write the folder `out`.
    fn arguments(&self, scene: &Path, out: &str, more: &[&str]) -> Vec<String> {
        let cameras = self.path("photos/transforms.json");
        let out = self.path(out);
        let first = [
            "select",
            "--scene",
            utf8(scene),
            "--cameras",
            utf8(&cameras),
            "--out",
            utf8(&out),
        ];
        first
            .iter()
            .chain(more)
            .map(|argument| (*argument).to_owned())
            .collect()
    }

    fn select(&self, scene: &Path, out: &str, more: &[&str]) -> String {
        let arguments = self.arguments(scene, out, more);
        succeeds(&arguments.iter().map(String::as_str).collect::<Vec<_>>())
    }

    fn refused(&self, code: i32, more: &[&str]) -> String {
        let arguments = self.arguments(&self.scene, "refused", more);
        let message = fails(
            &arguments.iter().map(String::as_str).collect::<Vec<_>>(),
            code,
        );
        assert!(!self.path("refused").exists());
        message
    }
}

fn labels(folder: &Path) -> Vec<u16> {
    ply::read(&folder.join("scene.ply"))
        .unwrap()
        .labels
        .unwrap()
}

#[test]
fn a_plate_without_labels_becomes_an_object() {
    let folder = Unlabelled::new();
    let [red, green] = [pixel_of(1), pixel_of(2)];
    let said = folder.select(
        &folder.scene,
        "a",
        &["--frame", "v2.png", "--pixel", &red, "--name", "red plate"],
    );
    assert!(
        said.contains("25 of 111 Gaussians are now red plate (label 1), 0 of them"),
        "{said}"
    );
    let a = folder.path("a");
    let expected = |id: fn(usize) -> u16| (0..111).map(id).collect::<Vec<_>>();
    assert_eq!(labels(&a), expected(|row| u16::from(row < 25)));
    assert_eq!(
        Classes::read(&a.join("classes.json"))
            .unwrap()
            .known_name(1),
        Some("red plate")
    );

    // The threshold that is printed gives the same selection.
    let (_, threshold) = said.trim_end().rsplit_once("threshold ").unwrap();
    let again = [
        "--frame",
        "v2",
        "--pixel",
        &red,
        "--name",
        "red plate",
        "--threshold",
        threshold,
    ];
    folder.select(&folder.scene, "again", &again);
    assert_eq!(labels(&folder.path("again")), labels(&a));

    // Another name is another label; the same name adds to it.
    folder.select(
        &a,
        "b",
        &["--frame", "v2", "--pixel", &green, "--name", "green"],
    );
    assert_eq!(
        labels(&folder.path("b")),
        expected(|row| [1, 2, 0][(row / 25).min(2)])
    );
    folder.select(
        &a,
        "c",
        &["--frame", "v2", "--pixel", &green, "--name", " red plate "],
    );
    assert_eq!(
        labels(&folder.path("c")),
        expected(|row| u16::from(row < 50))
    );
    let both = [
        "--frame", "v2", "--pixel", &red, "--frame", "v2", "--pixel", &green,
    ];
    folder.select(
        &folder.scene,
        "d",
        &[&both[..], &["--name", "plates", "--threshold", "0"]].concat(),
    );
    assert!(labels(&folder.path("d"))[..50].contains(&1));
}

#[test]
fn the_cameras_that_were_used_are_written() {
    let folder = Unlabelled::new();
    let red = ["--pixel", &pixel_of(1), "--name", "red"];
    let select = [&["--frame", "v2"], &red[..]].concat();
    // Cameras of another size lie beside the scene.
    let all = read_cameras(&folder.path("photos"), None).unwrap();
    let mut small = all.clone();
    for named in &mut small {
        named.camera = named.camera.with_size(40, 32);
    }
    write_cameras(&folder.path("cameras.json"), &small).unwrap();
    folder.select(&folder.scene, "a", &select);
    assert_eq!(read_cameras(&folder.path("a"), None).unwrap(), all);
    let out = folder.path("pictures");
    let render = ["render", "--scene", utf8(&folder.path("a")), "--out"].map(str::to_owned);
    let mut render: Vec<&str> = render.iter().map(String::as_str).collect();
    render.push(utf8(&out));
    succeeds(&render);
    // Cameras of somebody else are no longer those of the scene, but stay.
    std::fs::create_dir(folder.path("b")).unwrap();
    write_cameras(&folder.path("b/cameras.json"), &small).unwrap();
    let arguments = folder.arguments(&folder.scene, "b", &select);
    let mut arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let message = fails(&arguments, 1);
    assert!(
        message.contains("b/cameras.json, which this command did not write"),
        "{message}"
    );
    assert!(!folder.path("b/scene.ply").exists());
    arguments.push("--force");
    succeeds(&arguments);
    assert_eq!(read_cameras(&folder.path("b"), None).unwrap(), all);
}

#[test]
fn a_name_of_another_object_takes_gaussians_over() {
    let folder = Unlabelled::new();
    let labelled = folder.path("photos/plates.ply");
    let said = folder.select(
        &labelled,
        "a",
        &["--frame", "v2", "--pixel", &pixel_of(1), "--name", "wall"],
    );
    assert!(
        said.contains("now wall (label 4), 25 of them had another label"),
        "{said}"
    );
    let said = folder.select(
        &labelled,
        "b",
        &["--frame", "v2", "--pixel", &pixel_of(1), "--name", "chair"],
    );
    assert!(said.contains("now chair (label 5)"), "{said}");
}

#[test]
fn refusals_name_what_is_wrong() {
    let folder = Unlabelled::new();
    let green = pixel_of(2);
    let name = ["--name", "plate"];
    let one = |frame, pixel| {
        folder.refused(
            1,
            &[&["--frame", frame, "--pixel", pixel], &name[..]].concat(),
        )
    };
    assert!(one("v9", &green).contains("6 frames such as v0"));
    assert!(one("v2", "80,0").contains("a column below 80 and a row below 64"));
    let bare = Unlabelled::new();
    let without_wall = plates().0.select(&Vec::from_iter(0..75));
    ply::write(&bare.scene, &without_wall, DVec3::ZERO, None).unwrap();
    let corner = ["--frame", "v2", "--pixel", "0,0", name[0], name[1]];
    assert!(
        bare.refused(1, &corner)
            .contains("0,0 of v2, which shows the background")
    );
    let two = ["--frame", "v2", "--pixel", &green, "--pixel", &green];
    assert!(
        folder
            .refused(1, &[&two, &name[..]].concat())
            .contains("found 2 pixels, expected one for each --frame")
    );
    for (option, value, expected) in [
        ("--name", " ", "1 to 200 characters"),
        ("--threshold", "-1", "0 or more"),
        ("--threshold", "nan", "0 or more"),
        ("--threshold", "inf", "0 or more"),
        ("--pixel", "1", "a column and a row"),
    ] {
        let others = [["--frame", "v2"], ["--pixel", &green], name];
        let others = others.iter().filter(|pair| pair[0] != option);
        let mut given: Vec<&str> = others.flatten().copied().collect();
        let wrong = format!("{option}={value}");
        given.push(&wrong);
        let message = folder.refused(2, &given);
        assert!(message.contains(expected), "{message}");
    }
    let arguments = folder.arguments(
        &folder.scene,
        ".",
        &["--frame", "v2", "--pixel", &green, "--name", "plate"],
    );
    let message = fails(&arguments.iter().map(String::as_str).collect::<Vec<_>>(), 1);
    assert!(message.contains("a file other than the scene"), "{message}");
}

#[test]
fn image_features_beside_the_scene_go_along() {
    let folder = Unlabelled::new();
    let red = ["--frame", "v2", "--pixel", &pixel_of(1), "--name", "red"];
    folder.select(&folder.scene, "without", &red);
    let (_, ids) = plates();
    let rgb = ids.iter().map(|&label| [f32::from(label) / 4.0; 3]);
    let features = FeatureColors { rgb: rgb.collect() };
    features.write(&folder.path(FEATURE_COLORS)).unwrap();
    // The plate has one feature, so it stays as it is.
    folder.select(&folder.scene, "with", &red);
    assert_eq!(
        labels(&folder.path("with")),
        labels(&folder.path("without"))
    );
    assert!(!folder.path("without").join(FEATURE_COLORS).exists());
    let carried = folder.path("with").join(FEATURE_COLORS);
    assert_eq!(FeatureColors::read(&carried, 111).unwrap(), features);

    // Those of a run stay where another scene is written beside it.
    let [run, beside] = ["with", "with/beside.ply"].map(|name| folder.path(name));
    let edit = ["edit", "--scene", utf8(&run), "--out", utf8(&beside)];
    succeeds(&[&edit[..], &["--remove", "red"]].concat());
    assert_eq!(FeatureColors::read(&carried, 111).unwrap(), features);

    // A Gaussian less, and the rows no longer fit.
    let [scene, out] = ["with", "less"].map(|name| folder.path(name));
    let edit = [
        "edit",
        "--scene",
        utf8(&scene),
        "--out",
        utf8(&out),
        "--remove",
        "red",
    ];
    succeeds(&edit);
    assert!(!out.join(FEATURE_COLORS).exists());
    // Those of another scene are ignored.
    ply::write(
        &folder.scene,
        &plates().0.select(&[0, 1, 2]),
        DVec3::ZERO,
        None,
    )
    .unwrap();
    assert_eq!(features_beside(&folder.scene, 3), [[0.0; 3]; 0]);
    assert_eq!(
        features_beside(&folder.path("other.ply"), 111),
        [[0.0; 3]; 0]
    );
}

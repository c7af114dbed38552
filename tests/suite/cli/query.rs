//! `coseg query` on plates, with generated weights and feature maps that are made of text embeddings.

use crate::support::clip_weights::{Size, generated};
use crate::support::device;
use crate::support::dino_weights::write;
use crate::support::feature_maps::write_npy;
use crate::support::plates::{HEIGHT, WIDTH, scene};
use crate::support::program::{fails, listed, read_npy, succeeds, utf8};
use coseg::data::{Classes, LabelMap, read_cameras};
use coseg::features::Activation;
use coseg::features::clip::{TextEncoder, Tokenizer};
use coseg::splat::ply;
use std::fs;
use std::path::{Path, PathBuf};

const CHANNELS: usize = 24;
const TINY: Size = Size {
    vocabulary: 49408,
    width: 64,
    hidden: 16,
    blocks: 1,
    positions: 77,
    projection: CHANNELS,
};
/// Rows of the red and of the green plate.
const RED: std::ops::Range<usize> = 0..25;
const GREEN: std::ops::Range<usize> = 25..50;

/// A scene folder of plates with weights, and maps by which the first plate is red, the second one green, the rest things.
struct Plates {
    folder: tempfile::TempDir,
}

impl Plates {
    /// Maps of `scales` scales. At the coarser ones all is the same.
    fn new(scales: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let plates = Self { folder };
        scene(&plates.path("photos"));
        write(&plates.path("clip.safetensors"), &generated(TINY));
        let encoder = TextEncoder::load(&plates.path("clip.safetensors"), &device()).unwrap();
        let embedding = |text: &str| {
            let tokens = Tokenizer::new().tokens(text);
            encoder.embedding(&tokens, Activation::QuickGelu).unwrap()
        };
        let words = ["a red plate", "green", "things"].map(embedding);
        fs::create_dir(plates.path("maps")).unwrap();
        for view in 0..6 {
            let truth = plates.path(&format!("photos/labels/v{view}.png"));
            let ids = LabelMap::read(&truth).unwrap().ids;
            let word = |id: &u16| match id {
                1 => &words[0],
                2 => &words[1],
                _ => &words[2],
            };
            // Lengths say nothing.
            let scaled = |(cell, id): (usize, &u16)| {
                let length = 0.5 + (cell % 7) as f32;
                word(id).iter().map(move |v| length * v)
            };
            let fine: Vec<f32> = ids.iter().enumerate().flat_map(scaled).collect();
            plates.write_map(view, 1, [HEIGHT, WIDTH], &fine);
            for scale in 2..=scales {
                plates.write_map(view, scale, [1, 1], &words[2]);
            }
        }
        plates
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write_map(&self, view: usize, scale: usize, [height, width]: [usize; 2], values: &[f32]) {
        let path = self.path(&format!("maps/v{view}.{scale}.npy"));
        let channels = values.len() / height / width;
        let shape = [height, width, channels].map(|extent| extent as u64);
        write_npy(&path, &shape, values);
    }

    /// Arguments of a query of `scene`.
    fn arguments(&self, scene: &Path, more: &[&str]) -> Vec<String> {
        let weights = self.path("clip.safetensors");
        let out = self.path("found");
        let first = [
            "query",
            "--scene",
            utf8(scene),
            "--weights",
            utf8(&weights),
            "--out",
            utf8(&out),
        ];
        first.iter().chain(more).map(|a| (*a).to_owned()).collect()
    }

    /// A query of the plates themselves.
    fn query(&self, more: &[&str]) -> String {
        let [photos, maps] = ["photos", "maps"].map(|name| self.path(name));
        let places = ["--data", utf8(&photos), "--features", utf8(&maps)];
        let arguments = self.arguments(&photos.join("plates.ply"), &[&places[..], more].concat());
        succeeds(&arguments.iter().map(String::as_str).collect::<Vec<_>>())
    }

    fn refused(&self, code: i32, more: &[&str]) -> String {
        let arguments = self.arguments(&self.path("photos/plates.ply"), more);
        let message = fails(
            &arguments.iter().map(String::as_str).collect::<Vec<_>>(),
            code,
        );
        assert!(!self.path("found").exists(), "{message}");
        message
    }

    fn found(&self, name: &str) -> PathBuf {
        self.path("found").join(name)
    }

    /// Labels of what was written.
    fn labels(&self) -> Vec<u16> {
        let scene = ply::read(&self.found("scene.ply")).unwrap();
        scene.labels.unwrap()
    }
}

#[test]
fn a_text_finds_exactly_the_object_that_has_its_features() {
    let plates = Plates::new(1);
    let before: Vec<u16> = (0..111).map(|row| (row / 25).min(3) as u16 + 1).collect();
    let said = plates.query(&["--text", "a red plate"]);
    assert!(
        said.contains("25 of 111 Gaussians are now a red plate (label 5)"),
        "{said}"
    );
    let mut expected = before.clone();
    expected[RED].fill(5);
    assert_eq!(plates.labels(), expected);
    let cameras = read_cameras(&plates.path("found"), None).unwrap();
    assert_eq!(cameras.len(), 6, "those of --data");
    let classes = Classes::read(&plates.found("classes.json")).unwrap();
    assert_eq!(classes.known_name(5), Some("a red plate"));
    let (shape, relevancy) = read_npy(&plates.found("a_red_plate/relevancy.npy"));
    assert_eq!(shape, [111]);
    let (inside, outside) = relevancy.split_at(25);
    assert!(inside.iter().all(|v| (0.5..=1.0).contains(v)), "{inside:?}");
    assert!(
        outside.iter().all(|v| (0.0..0.5).contains(v)),
        "{outside:?}"
    );
    let drawn = ["relevancy.npy", "v2.relevancy.png", "v5.relevancy.png"];
    assert_eq!(listed(&plates.found("a_red_plate")), drawn);

    // What was lifted is read again, and its damage noticed. A name of the scene is joined; the more relevant text wins.
    let lifted = listed(&plates.found("lifted"));
    assert_eq!(lifted.len(), 1);
    let kept = plates.found("lifted").join(&lifted[0]);
    let time = |path: &Path| fs::metadata(path).unwrap().modified().unwrap();
    let first = time(&kept);
    let both = [
        "--text",
        "a red plate",
        "--text",
        "green",
        "--threshold",
        "0",
    ];
    let arrays = ["--frame", "v1.png", "--format", "npy"];
    let said = plates.query(&[&both[..], &arrays].concat());
    assert!(said.contains("Gaussians are now green (label 2)"), "{said}");
    assert_eq!(time(&kept), first);
    let labels = plates.labels();
    assert!(labels[RED].iter().all(|label| *label == 5), "{labels:?}");
    assert!(labels[GREEN].iter().all(|label| *label == 2), "{labels:?}");
    let of_blue = labels[50..75].iter();
    assert!(
        of_blue.copied().all(|label| [2, 5].contains(&label)),
        "{labels:?}"
    );
    let (shape, shown) = read_npy(&plates.found("a_red_plate/v1.relevancy.npy"));
    assert_eq!(shape, [HEIGHT as u64, WIDTH as u64]);
    let truth = plates.path("photos/labels/v1.png");
    let ids = LabelMap::read(&truth).unwrap().ids;
    let mean = |is_red: bool| {
        let pixels = shown
            .iter()
            .zip(&ids)
            .filter(|(_, id)| (**id == 1) == is_red);
        let (sum, count) = pixels.fold((0.0, 0.0), |(sum, count), (v, _)| (sum + v, count + 1.0));
        sum / count
    };
    assert!(
        mean(true) > 0.5 && mean(false) < 0.5,
        "{} {}",
        mean(true),
        mean(false)
    );
    let bytes = fs::read(&kept).unwrap();
    fs::write(&kept, &bytes[..bytes.len() - 5]).unwrap();
    plates.query(&["--text", "a red plate"]);
    assert_eq!(fs::read(&kept).unwrap(), bytes);
    assert_eq!(plates.labels(), expected);

    // A text is not compared with itself.
    let said = plates.query(&["--text", "object"]);
    assert!(!said.contains("largest relevancy 0.500"), "{said}");
    // Maps that changed are lifted again.
    plates.write_map(0, 1, [1, 1], &[1.0; CHANNELS]);
    plates.query(&["--text", "a red plate"]);
    assert_eq!(listed(&plates.found("lifted")).len(), 2);

    let [found, parts] = ["found", "parts"].map(|name| plates.path(name));
    let export = ["export", "--scene", utf8(&found), "--out", utf8(&parts)];
    succeeds(&[&export[..], &["--only", "a red plate"]].concat());
    let names = listed(&parts);
    let part = names.iter().find(|name| name.ends_with("a_red_plate.ply"));
    let part = ply::read(&parts.join(part.unwrap())).unwrap();
    assert!(part.gaussians.len() >= 20, "{}", part.gaussians.len());
}

#[test]
fn a_run_knows_its_photos_and_its_maps_and_the_best_scale_counts() {
    let plates = Plates::new(4);
    let [photos, maps, run] = ["photos", "maps", "run"].map(|name| plates.path(name));
    let import = format!("features.source.import={}", maps.display());
    let building = format!("building.gaussians={}", photos.join("plates.ply").display());
    let sets = [
        &import,
        &building,
        "building.iterations=0",
        "segmentation.iterations=2",
        "segmentation.rows=ours",
    ];
    let train = ["train", "--data", utf8(&photos), "--out", utf8(&run)];
    let sets = sets.iter().flat_map(|set| ["--set", set]);
    succeeds(&train.into_iter().chain(sets).collect::<Vec<_>>());
    let arguments = plates.arguments(&run, &["--text", "a red plate"]);
    let said = succeeds(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(
        said.contains("25 of 111 Gaussians are now a red plate"),
        "{said}"
    );
    // A run has its own order.
    let scene = ply::read(&plates.found("scene.ply")).unwrap();
    for (mean, label) in scene.gaussians.means.iter().zip(plates.labels()) {
        let x = f64::from(mean[0]) + scene.origin.x;
        let z = f64::from(mean[2]) + scene.origin.z;
        assert_eq!(label == 5, x < -0.5 && z > -1.0, "{x} {z}");
    }
}

#[test]
fn refusals_name_what_is_wrong() {
    let plates = Plates::new(1);
    let [photos, maps] = ["photos", "maps"].map(|name| plates.path(name));
    let text = ["--text", "a red plate"];
    let data = ["--data", utf8(&photos)];
    let places = [&data[..], &["--features", utf8(&maps)]].concat();
    let message = plates.refused(1, &text);
    assert!(message.contains("--data: found nothing"), "{message}");
    let message = plates.refused(1, &[&text[..], &data].concat());
    assert!(message.contains("--features: found nothing"), "{message}");
    let absent = ["--features", "nowhere"];
    let message = plates.refused(1, &[&text[..], &data, &absent].concat());
    assert!(message.contains("no such folder: nowhere"), "{message}");
    let twice = ["--text", "A red", "--text", "A red"];
    let message = plates.refused(1, &[&twice[..], &places].concat());
    assert!(
        message.contains("differ in the letters and digits"),
        "{message}"
    );
    let long = "a ".repeat(100);
    let message = plates.refused(1, &[&["--text", &long], &places[..]].concat());
    assert!(
        message.contains("102 tokens") && message.contains("a a a"),
        "{message}"
    );
    let message = plates.refused(1, &[&["--text", "Lifted"], &places[..]].concat());
    assert!(message.contains("none called lifted"), "{message}");
    let itself = ["--text", "Green", "--negative", "green"];
    let message = plates.refused(1, &[&itself[..], &places].concat());
    assert!(message.contains("Green, which is a --text"), "{message}");
    let arguments = plates.arguments(&photos.join("plates.ply"), &[&text[..], &places].concat());
    let mut arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let elsewhere = plates.path("elsewhere");
    fs::create_dir(&elsewhere).unwrap();
    fs::write(elsewhere.join("scene.ply"), "not ours").unwrap();
    arguments[6] = utf8(&elsewhere);
    let message = fails(&arguments, 1);
    assert!(
        message.contains("which this command did not write"),
        "{message}"
    );
    assert_eq!(listed(&elsewhere), ["scene.ply"]);
    let frame = ["--frame", "v9"];
    let message = plates.refused(1, &[&text[..], &places, &frame].concat());
    assert!(message.contains("6 frames such as"), "{message}");
    for (option, value, expected) in [
        ("--text", " ", "1 to 200 characters"),
        ("--threshold", "1.5", "a number from 0 to 1"),
        ("--threshold", "nan", "a number from 0 to 1"),
        ("--activation", "relu", "quick-gelu"),
    ] {
        let wrong = [option, value];
        let message = plates.refused(2, &[&text[..], &places, &wrong].concat());
        assert!(message.contains(expected), "{message}");
    }
    plates.write_map(1, 1, [2, 2], &[1.0; 4 * 5]);
    let wide = [1.0; 4 * CHANNELS];
    let message = plates.refused(1, &[&text[..], &places].concat());
    let channels = [
        "view v1, scale 1",
        "5 channels",
        "24, as the text embeddings have",
    ];
    assert!(
        channels.iter().all(|part| message.contains(part)),
        "{message}"
    );
    plates.write_map(1, 1, [2, 2], &wide);
    plates.write_map(1, 2, [2, 2], &wide);
    let message = plates.refused(1, &[&text[..], &places].concat());
    assert!(message.contains("2 scales"), "{message}");
    fs::remove_file(plates.path("maps/v1.2.npy")).unwrap();
    fs::remove_file(plates.path("maps/v1.1.npy")).unwrap();
    let message = plates.refused(1, &[&text[..], &places].concat());
    assert!(message.contains("v1.1.npy"), "{message}");
    let small = Size {
        vocabulary: 600,
        ..TINY
    };
    write(&plates.path("clip.safetensors"), &generated(small));
    let message = plates.refused(1, &[&text[..], &places].concat());
    assert!(
        message.contains("found 600") && message.contains("49408"),
        "{message}"
    );
}

//! Labels that a person corrected: kept in a file, tied to their Gaussians, put into scores and into the labels of views.

use crate::support::plates::{HEIGHT, WIDTH, loaded, training_views};
use coseg::config::SegmentationConfig;
use coseg::data::{LoadOptions, Scene, ScoreGrid, ScoreMap, View, load};
use coseg::objects::{Corrections, Editing, Identities};
use coseg::pipeline::train_decoder::{TrainingViews, ViewSample};
use coseg::raster::{Settings, SplatTensors};
use coseg::splat::Gaussians;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

const RED: u16 = 1;
const GREEN: u16 = 2;
const WALL: u16 = 4;

/// Corrections of the plates that call the red one, whose rows come first, a wall.
fn corrected(scene: &Scene, gaussians: &Gaussians, labels: &[u16]) -> Corrections {
    let mut editing = Editing::new(gaussians.clone(), labels.to_vec(), scene.classes.clone());
    let red = editing.rows(RED);
    editing.assign(&red, WALL);
    editing.remove(&red[..5]);
    // Unlabelled is not a correction.
    editing.assign(&[60], scene.classes.ignore);
    let mut corrections = Corrections::none(gaussians, &scene.classes);
    corrections.add(&editing);
    corrections
}

#[test]
fn a_file_keeps_them_and_other_gaussians_are_refused() {
    let (scene, gaussians, labels, folder) = loaded();
    let corrections = corrected(&scene, &gaussians, &labels);
    assert_eq!(corrections.count(), 20);
    let file = folder.path().join("corrections.safetensors");
    assert_eq!(Corrections::read(&file).unwrap(), None);
    corrections.write(&file).unwrap();
    assert_eq!(Corrections::read(&file).unwrap().unwrap(), corrections);
    let mut damaged = std::fs::read(&file).unwrap();
    *damaged.last_mut().unwrap() ^= 1;
    std::fs::write(&file, damaged).unwrap();
    assert!(Corrections::read(&file).is_err());

    corrections
        .check(&gaussians, &scene.classes, &file)
        .unwrap();
    let mut moved = gaussians.clone();
    moved.means[17][1] += 0.1;
    let fewer = gaussians.select(&[0, 1, 2]);
    for (other, part) in [(moved, "row 17"), (fewer, "111 Gaussians")] {
        let error = corrections.check(&other, &scene.classes, &file);
        let message = error.unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    }
    let mut renamed = scene.classes.clone();
    renamed.entries[2].name = "lamp".to_owned();
    let error = corrections.check(&gaussians, &renamed, &file);
    let message = error.unwrap_err().to_string();
    assert!(message.contains("the same names"), "{message}");
}

#[test]
fn scores_of_corrected_gaussians_are_for_their_labels() {
    let (scene, gaussians, labels, _folder) = loaded();
    let corrections = corrected(&scene, &gaussians, &labels);
    let classes = scene.classes.len();
    let wall = scene.classes.index(WALL).unwrap() as u16;
    let scores: Vec<f32> = (0..classes * labels.len())
        .map(|i| -1.0 - (i % 3) as f32)
        .collect();
    let mut fixed = Identities {
        scores: scores.clone(),
        classes,
    };
    corrections.fix(&mut fixed.scores, &scene.classes);
    let found = fixed.labels();
    assert!(found[5..25].iter().all(|class| *class == Some(wall)));
    assert_eq!(fixed.scores[..5 * classes], scores[..5 * classes]);
    assert_eq!(fixed.scores[25 * classes..], scores[25 * classes..]);
}

/// Corrects all views of `scene`.
fn correct(corrections: &Corrections, scene: &mut Scene, gaussians: &Gaussians) {
    let splats = SplatTensors::new(gaussians, &crate::support::device());
    let maps = corrections.maps(0.5);
    for view in &mut scene.views {
        let done = corrections.correct(view, &maps, &splats, &Settings::default());
        done.unwrap();
    }
}

/// The training views of `scene`.
fn training<'a>(scene: &'a Scene, gaussians: &'a Gaussians) -> TrainingViews<'a> {
    let config = SegmentationConfig::default();
    training_views(gaussians, scene, &config, &crate::support::device())
}

/// All labelled pixels of training view `index`.
fn pixels(views: &mut TrainingViews, index: usize) -> ViewSample {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    views.sample(index, Some(1.0), &mut rng).unwrap()
}

fn count(labels: &[u16], class: u16) -> usize {
    labels.iter().filter(|label| **label == class).count()
}

#[test]
fn pixels_that_show_corrected_gaussians_have_their_labels() {
    let (mut scene, gaussians, labels, _folder) = loaded();
    let corrections = corrected(&scene, &gaussians, &labels);
    let [red, green, wall] = [RED, GREEN, WALL].map(|id| scene.classes.index(id).unwrap() as u16);
    let old = pixels(&mut training(&scene, &gaussians), 0).pixels.labels;
    // The second training view has no labels at all.
    let second: &mut View = scene.views.iter_mut().find(|v| v.name == "v1").unwrap();
    second.raw = None;
    correct(&corrections, &mut scene, &gaussians);
    let mut views = training(&scene, &gaussians);
    let new = pixels(&mut views, 0).pixels.labels;
    // The first view keeps all labels but those of the plate, of which most pixels show corrected Gaussians.
    let (was, is) = (count(&old, red), count(&new, red));
    assert!(
        was > 100 && 4 * is < was,
        "{was} pixels of the plate were red, {is} are"
    );
    assert_eq!(count(&new, wall), count(&old, wall) + was - is);
    // The view without labels has those of the corrected Gaussians alone.
    let new = pixels(&mut views, 1).pixels.labels;
    assert!(!new.is_empty() && count(&new, wall) == new.len());
    // They go before the labels that identities give.
    let classes = scene.classes.len();
    let mut all_green = vec![0.0; classes * gaussians.len()];
    all_green
        .chunks_exact_mut(classes)
        .for_each(|row| row[usize::from(green)] = 1.0);
    let identities = Identities {
        scores: all_green,
        classes,
    };
    views.use_labels_of(&identities, &crate::support::device());
    let new = pixels(&mut views, 0).pixels.labels;
    assert_eq!(count(&new, wall), was - is);
    assert_eq!(count(&new, green), new.len() - (was - is));
}

#[test]
fn corrected_pixels_are_certain_beside_scores() {
    let (_, gaussians, labels, folder) = loaded();
    // A segmenter that is sure of green everywhere.
    let cells = [WIDTH / 8, HEIGHT / 8];
    let count = cells[0] * cells[1];
    let scores = ScoreMap {
        grid: ScoreGrid {
            photo: [WIDTH, HEIGHT],
            scale: [0.125; 2],
            offset: [-0.5; 2],
        },
        width: cells[0],
        height: cells[1],
        classes: 1,
        id_limit: 5,
        ids: vec![GREEN; count],
        probabilities: vec![255; count],
    };
    let path = folder.path().join("raw/scores/v0.scores");
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    scores.write(&path).unwrap();
    let options = LoadOptions {
        raw_labels: Some("raw".into()),
        ..LoadOptions::default()
    };
    let mut scene = load(folder.path(), &options).unwrap();
    let corrections = corrected(&scene, &gaussians, &labels);
    correct(&corrections, &mut scene, &gaussians);
    let sample = pixels(&mut training(&scene, &gaussians), 0);
    let rows = sample.pixels.distributions.expect("scores");
    let rows = rows.into_data().to_vec::<f32>().unwrap();
    let classes = scene.classes.len();
    let [green, wall] = [GREEN, WALL].map(|id| scene.classes.index(id).unwrap());
    let map = scene.views[0].corrected.as_ref().expect("corrected").map();
    let mut certain = 0;
    for (row, &number) in rows.chunks_exact(classes).zip(sample.numbers.iter()) {
        let is_corrected = map.ids[number as usize] == WALL;
        certain += usize::from(is_corrected);
        let class = if is_corrected { wall } else { green };
        assert_eq!(row[class], 1.0, "pixel {number}");
    }
    assert!(certain > 100 && certain < sample.numbers.len());
}

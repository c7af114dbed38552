//! Labels that a person corrected: kept in a file, tied to their Gaussians, put into scores and into the labels of views.

use crate::support::plates::loaded;
use coseg::config::SegmentationConfig;
use coseg::data::{Scene, Split};
use coseg::objects::{Corrections, Editing, Identities};
use coseg::pipeline::train_decoder::TrainingViews;
use coseg::raster::{Settings, SplatTensors};
use coseg::splat::Gaussians;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

const RED: u16 = 1;
const WALL: u16 = 4;

/// Corrections of the plates that call the red one, whose rows come first, a wall.
fn corrected(scene: &Scene, gaussians: &Gaussians, labels: &[u16]) -> Corrections {
    let mut editing = Editing::new(gaussians.clone(), labels.to_vec(), scene.classes.clone());
    let red = editing.rows(RED);
    editing.assign(&red, WALL);
    editing.remove(&red[..5]);
    // Unlabelled is no correction.
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
fn scores_and_pixels_of_corrected_gaussians_have_their_labels() {
    let (mut scene, gaussians, labels, _folder) = loaded();
    let corrections = corrected(&scene, &gaussians, &labels);
    let device = crate::support::device();
    let classes = scene.classes.len();
    let wall = scene.classes.index(WALL).unwrap();
    let scores: Vec<f32> = (0..classes * labels.len())
        .map(|i| -1.0 - (i % 3) as f32)
        .collect();
    let mut fixed = Identities {
        scores: scores.clone(),
        classes,
    };
    corrections.fix(&mut fixed.scores, &scene.classes);
    let found = fixed.labels();
    assert!(found[5..25].iter().all(|class| *class == Some(wall as u16)));
    assert_eq!(fixed.scores[..5 * classes], scores[..5 * classes]);
    assert_eq!(fixed.scores[25 * classes..], scores[25 * classes..]);

    let settings = Settings::default();
    let splats = SplatTensors::new(&gaussians, &device);
    let maps = corrections.maps(0.5);
    let before = scene.clone();
    // The second training view had no labels at all.
    let second = scene
        .views
        .iter()
        .position(|view| view.name == "v1")
        .unwrap();
    scene.views[second].raw = None;
    for view in &mut scene.views {
        corrections
            .correct(view, &maps, &splats, &settings)
            .unwrap();
    }
    let config = SegmentationConfig::default();
    let views = |scene: &Scene| {
        let train = scene.split(Split::Train);
        train.cloned().collect::<Vec<_>>()
    };
    let (old, new) = (views(&before), views(&scene));
    let training = |views: &[coseg::data::View]| -> Vec<Vec<u16>> {
        let mut training = TrainingViews::new(
            &gaussians,
            views.iter(),
            &scene.classes,
            settings,
            &config,
            &device,
        );
        let all = (0..views.len()).map(|i| {
            training
                .sample(i, 1.0, &mut ChaCha8Rng::seed_from_u64(0))
                .unwrap()
        });
        all.map(|sample| sample.pixels.labels.to_vec()).collect()
    };
    let (old, new) = (training(&old), training(&new));
    assert_eq!(old.len(), new.len());
    // The first view keeps all labels but those of the plate, of which most pixels show corrected Gaussians.
    let red = scene.classes.index(RED).unwrap() as u16;
    let count = |labels: &[u16], class: u16| labels.iter().filter(|label| **label == class).count();
    let (was, is) = (count(&old[0], red), count(&new[0], red));
    assert!(
        was > 100 && 4 * is < was,
        "{was} pixels of the plate were red, {is} are"
    );
    assert_eq!(
        count(&new[0], wall as u16),
        count(&old[0], wall as u16) + was - is
    );
    // The view without labels has those of the corrected Gaussians alone.
    assert!(!new[1].is_empty() && new[1].iter().all(|label| *label == wall as u16));
}

//! Scores beside label maps that are of other classes or of another photo.

use super::label::{arguments, views};
use crate::support::assert_names;
use crate::support::onnx::{Onnx, plates};
use crate::support::plates::{HEIGHT, WIDTH};
use crate::support::program::succeeds;
use coseg::data::{Classes, LabelMap, ScoreMap, View};
use std::path::PathBuf;

/// Labels of a network that never answers navy, and the view `v0` with them.
fn without_navy() -> (tempfile::TempDir, PathBuf, View, Classes) {
    let (folder, dir, model) = plates();
    std::fs::remove_file(dir.join("classes.json")).expect("remove");
    let transforms = dir.join("transforms.json");
    let text = std::fs::read_to_string(&transforms).expect("read");
    std::fs::write(&transforms, text.replace("label_path", "other_path")).expect("write");
    let onnx = Onnx {
        bias: [24.0, 0.0, 0.0, -99.0, 18.0],
        ..Onnx::new(WIDTH, HEIGHT)
    };
    std::fs::write(&model, onnx.bytes()).expect("write");
    let out = folder.path().join("labels");
    succeeds(&arguments(&dir, &model, &out));
    let (mut views, table) = views(&dir, &out);
    let names = table.entries.iter().map(|class| &*class.name);
    assert_eq!(names.collect::<Vec<_>>(), ["crimson", "lime", "plaster"]);
    (folder, out, views.remove(0), table)
}

#[test]
fn scores_of_unknown_classes_are_refused() {
    let (_folder, out, view, table) = without_navy();
    let file = out.join("scores/v0.scores");
    let scores = view.scores.expect("scores");
    let read_with = |id: u16| {
        let mut changed = ScoreMap::read(&file).expect("scores");
        changed.ids[0] = id;
        changed.id_limit = 1000;
        changed.write(&file).expect("write");
        scores.read(&table)
    };
    // Navy is in no map, but a class of the network all the same.
    read_with(3).expect("a class of the network");
    for id in [5, 999] {
        let error = read_with(id).expect_err("unknown");
        let named = format!("class id {id}");
        assert_names(&error, &["v0.scores", &named, "4 classes", "coseg label"]);
    }
    // Nothing is said by an id of probability 0.
    let mut changed = ScoreMap::read(&file).expect("scores");
    changed.ids[0] = 1;
    let last = changed.ids.len() - 1;
    (changed.ids[last], changed.probabilities[last]) = (999, 0);
    changed.write(&file).expect("write");
    scores.read(&table).expect("a meaningless id");
}

#[test]
fn scores_of_a_photo_of_another_size_are_refused() {
    let (_folder, out, view, table) = without_navy();
    let file = out.join("scores/v0.scores");
    let scores = view.scores.expect("scores");
    let sound = ScoreMap::read(&file).expect("scores");
    let write = |photo: [usize; 2], scale: f64| {
        let mut changed = sound.clone();
        changed.grid.photo = photo;
        changed.grid.scale = changed.grid.scale.map(|by| by * scale);
        changed.write(&file).expect("write");
    };
    let own = format!("{WIDTH}x{HEIGHT}");
    for [width, height] in [
        [WIDTH + 4, HEIGHT],
        [HEIGHT, WIDTH],
        [WIDTH / 2, HEIGHT / 2],
    ] {
        write([width, height], 1.0);
        let found = format!("{width}x{height}");
        assert_names(
            &scores.read(&table).expect_err("another photo"),
            &["v0.scores", &found, &own],
        );
    }
    // Beside the map of a smaller copy they are right.
    write([WIDTH / 2, HEIGHT / 2], 2.0);
    let map = LabelMap::read(&out.join("v0.png")).expect("map");
    let half = (0..map.ids.len()).filter(|i| (i / WIDTH).is_multiple_of(2) && i.is_multiple_of(2));
    let half = LabelMap {
        width: WIDTH / 2,
        height: HEIGHT / 2,
        ids: half.map(|i| map.ids[i]).collect(),
    };
    half.write(&out.join("v0.png")).expect("write");
    let small = scores.read(&table).expect("of the copy");
    write([WIDTH, HEIGHT], 1.0);
    let whole = scores.read(&table).expect("of the photo");
    let [mut a, mut b] = [vec![], vec![]];
    for pixel in (0..WIDTH * HEIGHT).step_by(7) {
        let (x, y) = (pixel % WIDTH, pixel / WIDTH);
        small.at(x, y, &mut a);
        whole.at(x, y, &mut b);
        assert_eq!(a, b, "{x} {y}");
    }
}

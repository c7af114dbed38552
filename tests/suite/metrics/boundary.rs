//! Boundary IoU against the values that scripts/reference_boundary_iou.py prints, and by hand.

use crate::support::generator::Generator;
use coseg::data::{Classes, LabelMap};
use coseg::metrics::{Void, boundary_iou};

const CELL: usize = 9;

fn classes() -> Classes {
    Classes::from_names(0, [(1, "a"), (2, "b"), (3, "c"), (4, "d"), (5, "e")])
}

/// The script's maps: square cells, and the same moved by two pixels, with noise.
fn maps([width, height]: [usize; 2], seed: u32) -> (LabelMap, LabelMap) {
    let mut numbers = Generator(seed);
    let columns = width / CELL + 2;
    let cells: Vec<u32> = (0..columns * (height / CELL + 2))
        .map(|_| numbers.below(6))
        .collect();
    let cell = |x: usize, y: usize| cells[y / CELL * columns + x / CELL] as u16;
    let pixels = || (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let truth = pixels().map(|(x, y)| cell(x, y)).collect();
    let mut noisy = |(x, y): (usize, usize)| match numbers.below(40) {
        0 => numbers.below(7) as u16,
        _ => cell(x + 2, y + 1),
    };
    let prediction = pixels().map(&mut noisy).collect();
    let map = |ids| LabelMap { width, height, ids };
    (map(truth), map(prediction))
}

#[track_caller]
fn is_near(views: &[(LabelMap, LabelMap)], wrong: f64, left_out: f64) {
    for (void, want) in [(Void::Wrong, wrong), (Void::LeftOut, left_out)] {
        let found = boundary_iou(&classes(), views.iter().cloned(), void).expect("a score");
        assert!((found - want).abs() < 1e-9, "{void:?}: {found}, not {want}");
    }
}

#[test]
fn boundary_iou_is_that_of_the_reference() {
    let views = [maps([45, 37], 1), maps([100, 75], 2), maps([160, 120], 3)];
    is_near(&views[..1], 0.164135282284, 0.286448657270);
    is_near(&views[1..2], 0.285310360428, 0.368319823622);
    is_near(&views[2..], 0.566375644271, 0.616772815825);
    is_near(&views, 0.479469379145, 0.540511323965);
}

#[test]
fn only_the_outline_counts() {
    // A square of 20 pixels in a frame of another class, 60x60: d = 2.
    let map = |inside: &dyn Fn(usize, usize) -> u16| LabelMap {
        width: 60,
        height: 60,
        ids: (0..3600).map(|i| inside(i % 60, i / 60)).collect(),
    };
    let in_square = |x: usize, y: usize| (20..40).contains(&x) && (20..40).contains(&y);
    let truth = map(&|x, y| if in_square(x, y) { 1 } else { 2 });
    let score = |prediction: LabelMap| {
        boundary_iou(&classes(), [(truth.clone(), prediction)], Void::Wrong).expect("a score")
    };
    assert_eq!(score(truth.clone()), 1.0);
    // A hole of one pixel in the middle adds an outline of 5x5 pixels less the hole itself, and one pixel to the other class.
    let hole = score(map(&|x, y| match (x, y) {
        (30, 30) => 2,
        _ => truth.ids[y * 60 + x],
    }));
    let square = 20.0 * 20.0 - 16.0 * 16.0;
    let frame = (60.0 * 60.0 - 56.0 * 56.0) + (24.0 * 24.0 - 20.0 * 20.0);
    let want = 0.5 * (square / (square + 24.0) + frame / (frame + 1.0));
    assert!((hole - want).abs() < 1e-12, "{hole}, not {want}");
}

#[test]
fn pixels_without_a_truth_do_not_count() {
    let map = |ids: Vec<u16>| LabelMap {
        width: 4,
        height: 3,
        ids,
    };
    let truth = map(vec![1, 1, 0, 0, 1, 1, 0, 0, 2, 2, 0, 0]);
    let prediction = map(vec![1, 1, 1, 2, 1, 1, 5, 2, 2, 2, 2, 9]);
    let score = |pair| boundary_iou(&classes(), [pair], Void::Wrong);
    assert_eq!(score((truth.clone(), prediction)), Some(1.0));
    let nothing = map(vec![0; 12]);
    assert_eq!(score((nothing, truth.clone())), None);
    // Maps of other sizes, and empty ones, add nothing.
    let narrow = LabelMap {
        width: 3,
        height: 4,
        ..truth.clone()
    };
    assert_eq!(score((truth, narrow)), None);
    let empty = LabelMap {
        width: 0,
        height: 0,
        ids: Vec::new(),
    };
    assert_eq!(score((empty.clone(), empty)), None);
}

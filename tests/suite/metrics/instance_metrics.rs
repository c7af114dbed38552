//! Scores of instance maps against values worked out by hand, and against panopticapi.

use crate::support::generator::Generator;
use coseg::metrics::{PanopticQuality, Quality, instance_scores};

fn runs(of: &[(u16, usize)]) -> Vec<u16> {
    of.iter().flat_map(|&(id, n)| vec![id; n]).collect()
}

/// Two instances of ten pixels, then ten without truth; three objects.
///
/// Object 5 has 8 pixels of the first and 2 without truth: IoU 8 / (10 + 10 - 8 - 2) = 0.8. Object 6 has 4 of the second
/// and 3 without truth: 4 / (10 + 7 - 4 - 3) = 0.4, no match and a false positive. Object 7 lies by 5 of its 6 pixels
/// if there is no truth: no false positive.
fn case() -> [Vec<u16>; 2] {
    let truth = runs(&[(1, 10), (2, 10), (0, 10)]);
    [
        truth,
        runs(&[
            (5, 8),
            (0, 2),
            (6, 4),
            (7, 1),
            (0, 5),
            (5, 2),
            (6, 3),
            (7, 5),
        ]),
    ]
}

#[track_caller]
fn near(found: Quality, want: [f64; 3]) {
    let found = [found.pq, found.sq, found.rq].map(|v| v.expect("value"));
    assert!(
        found.iter().zip(want).all(|(f, w)| (f - w).abs() < 1e-12),
        "{found:?} {want:?}"
    );
}

#[test]
fn panoptic_quality_by_hand() {
    let [truth, found] = case();
    let scores = instance_scores([(&truth[..], &found[..])]);
    near(scores.panoptic, [0.4, 0.8, 0.5]);
    near(scores.scene, [0.4, 0.8, 0.5]);
    assert_eq!((scores.instances, scores.objects), (2, 3));
    // Pixels matched: 8 of 10 and 4 of 10.
    assert!((scores.accuracy.expect("value") - 0.6).abs() < 1e-12);
    assert!((scores.miou.expect("value") - 0.6).abs() < 1e-12);
}

#[test]
fn panoptic_quality_is_a_mean_over_classes() {
    let [truth, found] = case();
    let quality = |of_five: u16| {
        let true_class = |id: u16| 10 + id;
        let found_class = |id: u16| if id == 5 { of_five } else { 12 };
        let mut quality = PanopticQuality::default();
        quality.add(&truth, &found, [&true_class, &found_class]);
        quality.quality()
    };
    // Class 11: one match of 0.8. Class 12: a miss and a false positive.
    near(quality(11), [0.4, 0.4, 0.5]);
    // Of another class it matches nothing: a miss in class 11, a miss and two false positives in class 12.
    near(quality(12), [0.0, 0.0, 0.0]);
    // Classes add up over images.
    let mut both = PanopticQuality::default();
    let one = |_: u16| 0;
    both.add(&truth, &found, [&one, &one]);
    both.add(&runs(&[(3, 6)]), &runs(&[(9, 6)]), [&one, &one]);
    near(both.quality(), [1.8 / 3.0, 0.9, 2.0 / 3.0]);
}

/// The maps of `scripts/reference_panoptic.py`: segments of square cells, and a prediction that is moved and joins some of them.
fn segments([width, height]: [usize; 2], seed: u32) -> [Vec<u16>; 2] {
    const CELL: usize = 9;
    const SEGMENTS: u32 = 12;
    let mut numbers = Generator(seed);
    let columns = width / CELL + 2;
    let count = columns * (height / CELL + 2);
    let cells: Vec<u32> = (0..count).map(|_| numbers.below(SEGMENTS + 1)).collect();
    let mut join = |i: u32| match numbers.below(4) {
        0 => numbers.below(SEGMENTS + 1),
        _ => i,
    };
    let joined: Vec<u32> = (0..=SEGMENTS).map(&mut join).collect();
    let cell = |x: usize, y: usize| cells[y / CELL * columns + x / CELL];
    let pixels = || (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let mut noisy = |(x, y): (usize, usize)| match numbers.below(40) {
        0 => numbers.below(SEGMENTS + 1) as u16,
        _ => joined[cell(x + 2, y + 1) as usize] as u16,
    };
    let truth = pixels().map(|(x, y)| cell(x, y) as u16).collect();
    [truth, pixels().map(&mut noisy).collect()]
}

#[test]
fn panoptic_quality_is_that_of_panopticapi() {
    let class = |id: u16| id % 3;
    let views = [([45, 37], 1), ([100, 75], 2), ([160, 120], 3)];
    let want = [
        [0.045_272_435_897, 0.181_089_743_590, 0.083_333_333_333],
        [0.406_847_456_860, 0.542_463_275_814, 0.75],
        [0.273_710_658_123, 0.547_421_316_246, 0.5],
    ];
    let mut all = PanopticQuality::default();
    for ((size, seed), want) in views.into_iter().zip(want) {
        let [truth, found] = segments(size, seed);
        let mut one = PanopticQuality::default();
        for quality in [&mut one, &mut all] {
            quality.add(&truth, &found, [&class, &class]);
        }
        near(one.quality(), want);
    }
    let want = [0.248_570_219_222, 0.544_852_694_726, 0.456_521_739_130];
    near(all.quality(), want);
}

#[test]
fn an_object_that_changes_its_id_is_two() {
    let truth = runs(&[(1, 4)]);
    let [a, b] = [runs(&[(3, 4)]), runs(&[(9, 4)])];
    let scores = instance_scores([(&truth[..], &a[..]), (&truth[..], &b[..])]);
    // Perfect in each view; of all views half the pixels, and an IoU of a half is not a match.
    near(scores.panoptic, [1.0, 1.0, 1.0]);
    near(scores.scene, [0.0, 0.0, 0.0]);
    assert_eq!((scores.accuracy, scores.miou), (Some(0.5), Some(0.5)));
    let scores = instance_scores([(&truth[..], &a[..]), (&truth[..], &a[..])]);
    assert_eq!(
        (scores.accuracy, scores.scene.pq, scores.objects),
        (Some(1.0), Some(1.0), 1)
    );
}

#[test]
fn matching_takes_the_largest_sum_and_not_the_largest_pair() {
    // Object 1 has 5 pixels of instance 1 and 4 of instance 2; object 2 has 4 of instance 1 and none of the other.
    let truth = runs(&[(1, 5), (1, 4), (2, 4)]);
    let found = runs(&[(1, 5), (2, 4), (1, 4)]);
    let scores = instance_scores([(&truth[..], &found[..])]);
    assert_eq!(scores.accuracy, Some(8.0 / 13.0));
}

#[test]
fn instance_scores_of_nothing_are_absent() {
    for views in [vec![], vec![(&[0_u16; 4][..], &[1_u16, 2, 0, 0][..])]] {
        let scores = instance_scores(views);
        assert_eq!(
            (scores.accuracy, scores.miou, scores.panoptic.pq),
            (None, None, None)
        );
    }
    let scores = instance_scores([(&[1_u16, 1][..], &[0_u16, 0][..])]);
    assert_eq!(
        (scores.accuracy, scores.miou, scores.panoptic.pq),
        (Some(0.0), Some(0.0), Some(0.0))
    );
}

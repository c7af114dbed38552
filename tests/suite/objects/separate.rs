//! Things of one label that do not touch.

use coseg::data::{Class, Classes, ObjectOf};
use coseg::objects::{Separated, Separation};
use coseg::splat::Gaussians;

/// Opacity logits of 0.95 and 0.04.
pub(super) const SOLID: f32 = 2.944;
const FAINT: f32 = -3.178;

/// Balls of this spread, at these places, with these opacity logits.
pub(super) fn balls(parts: &[([f32; 3], f32, f32)]) -> Gaussians {
    Gaussians {
        means: parts.iter().map(|p| p.0).collect(),
        log_scales: parts.iter().map(|p| [p.1.ln(); 3]).collect(),
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; parts.len()],
        opacity_logits: parts.iter().map(|p| p.2).collect(),
        sh: vec![0.0; 3 * parts.len()],
        sh_degree: 0,
    }
}

/// `count` balls side by side along x from `x` on, each touching the next.
pub(super) fn row(x: f32, count: usize) -> Vec<([f32; 3], f32, f32)> {
    (0..count)
        .map(|i| ([x + 0.1 * i as f32, 0.0, 0.0], 0.05, SOLID))
        .collect()
}

/// For things of a few Gaussians.
pub(super) const SMALL: Separation = Separation {
    level: 0.1,
    smallest: 0.01,
    fewest: 1,
    neighbours: 24,
};

pub(super) fn classes() -> Classes {
    Classes::from_names(0, [(1, "wall"), (2, "chair"), (7, "lamp")])
}

pub(super) fn separated(gaussians: &Gaussians, labels: &[u16]) -> Separated {
    SMALL
        .apply(gaussians, labels, &classes(), |_| true)
        .expect("pieces")
}

#[test]
fn things_that_do_not_touch_get_ids_and_names_of_their_own() {
    // The smaller chair comes first in the file; a wall stands between, and another label never bridges.
    let parts = [
        row(2.0, 5),
        row(0.0, 8),
        vec![([1.4, 0.0, 0.0], 0.4, SOLID)],
    ]
    .concat();
    let labels = [vec![2; 13], vec![1]].concat();
    let found = separated(&balls(&parts), &labels);
    assert_eq!(
        found.labels,
        [vec![8; 5], vec![2; 8], vec![1]].concat(),
        "the largest keeps the id"
    );
    assert_eq!(found.pieces, [(2, vec![2, 8])].into());
    let of = Some(ObjectOf {
        class: 2,
        thing: true,
    });
    let named = |id: u16| {
        found
            .classes
            .entries
            .iter()
            .find(|c| c.id == id)
            .map(|c| (c.name.as_str(), c.object_of))
    };
    assert_eq!(
        (named(2), named(8)),
        (Some(("chair 1", of)), Some(("chair 2", of)))
    );
    assert_eq!(
        (named(1), named(7)),
        (Some(("wall", None)), Some(("lamp", None))),
        "others stay as they are"
    );
}

#[test]
fn faint_gaussians_bridge_nothing_and_join_the_nearest_piece() {
    let ends = [row(0.0, 6), row(1.0, 6)].concat();
    let mut parts = ends.clone();
    // A solid ball of this width would touch both.
    parts.push(([0.7, 0.0, 0.0], 0.3, FAINT));
    let found = separated(&balls(&parts), &[2; 13]);
    assert_eq!(found.labels, [vec![2; 6], vec![8; 6], vec![2]].concat());
    parts[12].2 = SOLID;
    assert!(
        separated(&balls(&parts), &[2; 13]).pieces.is_empty(),
        "now all of it is one"
    );
}

#[test]
fn small_pieces_are_strays() {
    let mut parts = [row(0.0, 40), row(9.0, 40)].concat();
    parts.push(([5.0, 0.0, 0.0], 0.02, SOLID));
    let labels = vec![2; parts.len()];
    let found = separated(&balls(&parts), &labels);
    assert_eq!(found.pieces[&2].len(), 2);
    assert_eq!(
        found.labels[80], found.labels[0],
        "1.1 from the first row, 4 from the second"
    );
    // The stray has 0.0004 of 40 times 0.0025: 0.4 % of the area.
    let strict = Separation {
        smallest: 0.003,
        ..SMALL
    };
    let found = strict
        .apply(&balls(&parts), &labels, &classes(), |_| true)
        .unwrap();
    assert_eq!(found.pieces[&2].len(), 3);
    let fewer = Separation {
        fewest: 2,
        ..strict
    };
    let found = fewer
        .apply(&balls(&parts), &labels, &classes(), |_| true)
        .unwrap();
    assert_eq!(found.pieces[&2].len(), 2, "a single Gaussian");
    // The largest is one however few it has.
    let few = Separation {
        fewest: 100,
        ..SMALL
    }
    .apply(&balls(&parts), &labels, &classes(), |_| true)
    .unwrap();
    assert!(few.pieces.is_empty());
}

#[test]
fn long_gaussians_touch_along_their_axes_and_not_across() {
    let along = |rotation: [f32; 4], at: [f32; 3]| {
        let mut two = balls(&[([0.0; 3], 1.0, SOLID), (at, 1.0, SOLID)]);
        two.log_scales = vec![[1.0_f32.ln(), 0.01_f32.ln(), 0.01_f32.ln()]; 2];
        two.rotations = vec![rotation; 2];
        separated(&two, &[2, 2]).pieces.is_empty()
    };
    // At 0.95 the level of 0.1 is 2.12 standard deviations off.
    let quarter_about_z = [0.5_f32.sqrt(), 0.0, 0.0, 0.5_f32.sqrt()];
    assert!(
        along([1.0, 0.0, 0.0, 0.0], [4.2, 0.0, 0.0])
            && !along([1.0, 0.0, 0.0, 0.0], [4.3, 0.0, 0.0])
    );
    assert!(!along([1.0, 0.0, 0.0, 0.0], [0.0, 4.2, 0.0]), "across");
    assert!(
        along(quarter_about_z, [0.0, 4.2, 0.0]) && !along(quarter_about_z, [4.2, 0.0, 0.0]),
        "turned"
    );
    assert!(
        along([2.0, 0.0, 0.0, 0.0], [4.2, 0.0, 0.0]),
        "the length of a quaternion says nothing"
    );
}

#[test]
fn flat_gaussians_above_each_other_do_not_touch() {
    // Two discs of half-axes 2.12 and almost no thickness.
    let discs = |at: [f32; 3], rotation: [f32; 4]| {
        let mut two = balls(&[([0.0; 3], 1.0, SOLID), (at, 1.0, SOLID)]);
        two.log_scales = vec![[0.0, 0.0, -6.0]; 2];
        two.rotations[1] = rotation;
        separated(&two, &[2, 2]).pieces.is_empty()
    };
    let (level, upright) = (
        [1.0, 0.0, 0.0, 0.0],
        [0.5_f32.sqrt(), 0.5_f32.sqrt(), 0.0, 0.0],
    );
    assert!(
        discs([4.2, 0.0, 0.0], level) && !discs([4.3, 0.0, 0.0], level),
        "side by side"
    );
    assert!(!discs([1.0, 0.0, 0.5], level), "a shelf above another");
    assert!(
        discs([0.0, 1.5, 1.5], upright),
        "a wall that stands on a floor"
    );
    assert!(
        !discs([0.0, 1.5, 2.3], upright),
        "a wall that hangs above it"
    );
    assert!(!discs([0.0, 2.3, 1.5], upright), "a wall behind its rim");
}

#[test]
fn a_large_gaussian_touches_more_than_its_nearest() {
    // All of the 30 at 0.3 are nearer to the large one than those at -0.5, which are nearest to each other.
    let cluster = |x: f32| (0..30).map(move |i| ([x + 1e-3 * i as f32, 0.0, 0.0], 5e-3, SOLID));
    let parts: Vec<_> = [([0.0; 3], 0.5, SOLID)]
        .into_iter()
        .chain(cluster(0.3))
        .chain(cluster(-0.5))
        .collect();
    let all = Separation {
        smallest: 0.0,
        ..SMALL
    };
    let pieces = |parts: &[([f32; 3], f32, f32)]| {
        let labels = vec![2; parts.len()];
        all.apply(&balls(parts), &labels, &classes(), |_| true)
            .unwrap()
            .pieces
            .get(&2)
            .map_or(1, Vec::len)
    };
    assert_eq!((pieces(&parts), pieces(&parts[1..])), (1, 2));
}

#[test]
fn the_ignored_id_is_given_to_nothing() {
    let parts = balls(&[row(0.0, 8), row(2.0, 5)].concat());
    let table = Classes::from_names(9, [(7, "lamp"), (8, "chair")]);
    let found = SMALL.apply(&parts, &[8; 13], &table, |_| true).unwrap();
    assert_eq!(found.pieces, [(8, vec![8, 10])].into());
    // Pieces of what counted as stuff are things: there are several.
    let mut stuff = classes();
    stuff.entries[1].object_of = Some(ObjectOf {
        class: 2,
        thing: false,
    });
    let found = SMALL.apply(&parts, &[2; 13], &stuff, |_| true).unwrap();
    let of = |id: u16| found.classes.entries[found.classes.index(id).unwrap()].object_of;
    assert_eq!(
        (of(2), of(8)),
        (
            Some(ObjectOf {
                class: 2,
                thing: true
            }),
            of(2)
        )
    );
}

#[test]
fn the_order_of_the_file_changes_no_piece() {
    let parts = [row(0.0, 9), row(2.0, 7), row(4.0, 5)].concat();
    let gaussians = balls(&parts);
    let straight = separated(&gaussians, &[2; 21]).labels;
    let order: Vec<u32> = (0..21).map(|i| (i * 8) % 21).collect();
    let shuffled = separated(&gaussians.select(&order), &[2; 21]).labels;
    let expected: Vec<u16> = order.iter().map(|&i| straight[i as usize]).collect();
    assert_eq!(shuffled, expected);
    assert_eq!(
        straight,
        [vec![2; 9], vec![8; 7], vec![9; 5]].concat(),
        "from the largest on"
    );
}

#[test]
fn objects_are_numbered_on() {
    let parts = [row(0.0, 8), row(2.0, 5)].concat();
    let mut objects = Classes::from_names(0, [(1, "chair 1"), (2, "chair 2")]);
    let of = Some(ObjectOf {
        class: 30,
        thing: true,
    });
    objects
        .entries
        .iter_mut()
        .for_each(|c: &mut Class| c.object_of = of);
    let found = SMALL
        .apply(&balls(&parts), &[2; 13], &objects, |_| true)
        .unwrap();
    let names: Vec<_> = found
        .classes
        .entries
        .iter()
        .map(|c| (c.id, c.name.as_str(), c.object_of))
        .collect();
    assert_eq!(
        names,
        [(1, "chair 1", of), (2, "chair 2", of), (3, "chair 3", of)]
    );
    // Without a table the names are made.
    let found = SMALL
        .apply(&balls(&parts), &[4; 13], &Classes::default(), |_| true)
        .unwrap();
    let names: Vec<_> = found
        .classes
        .entries
        .iter()
        .map(|c| (c.id, c.name.as_str()))
        .collect();
    assert_eq!(names, [(4, "label 4 1"), (5, "label 4 2")]);
}

#[test]
fn what_is_not_asked_for_or_has_no_label_stays_whole() {
    let parts = [row(0.0, 8), row(2.0, 5), row(4.0, 4), row(6.0, 3)].concat();
    let labels = [vec![2; 13], vec![0; 7]].concat();
    assert_eq!(
        separated(&balls(&parts), &labels).labels[13..],
        [0; 7],
        "unlabelled"
    );
    let found = SMALL
        .apply(&balls(&parts), &labels, &classes(), |id| id == 7)
        .unwrap();
    assert_eq!(
        (found.labels, found.classes, found.pieces.len()),
        (labels, classes(), 0)
    );
    let one = separated(&balls(&parts[..1]), &[2]);
    assert!(one.pieces.is_empty() && separated(&balls(&[]), &[]).labels.is_empty());
    let all_faint: Vec<_> = parts.iter().map(|p| (p.0, p.1, FAINT)).collect();
    assert!(separated(&balls(&all_faint), &[2; 20]).pieces.is_empty());
}

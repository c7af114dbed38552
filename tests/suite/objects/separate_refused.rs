//! Rules, labels and Gaussians that cannot be separated, and ids that are taken.

use super::separate::{SMALL, SOLID, balls, classes, row, separated};
use coseg::error::Error;
use coseg::objects::Separation;
use coseg::splat::Gaussians;

#[test]
fn bad_input_is_an_error() {
    let gaussians = balls(&row(0.0, 3));
    let apply = |rules: Separation, gaussians: &Gaussians, labels: &[u16]| {
        rules
            .apply(gaussians, labels, &classes(), |_| true)
            .expect_err("an error")
    };
    let default = SMALL;
    for rules in [
        Separation {
            level: 0.0,
            ..default
        },
        Separation {
            level: f64::NAN,
            ..default
        },
        Separation {
            smallest: 1.5,
            ..default
        },
        Separation {
            neighbours: 0,
            ..default
        },
    ] {
        assert!(
            matches!(apply(rules, &gaussians, &[2; 3]), Error::Argument { .. }),
            "{rules:?}"
        );
    }
    assert!(
        matches!(apply(default, &gaussians, &[2; 2]), Error::Argument { .. }),
        "too few labels"
    );
    let mut broken = gaussians.clone();
    broken.means[1][2] = f32::NAN;
    assert!(matches!(
        apply(default, &broken, &[2; 3]),
        Error::NonFinite { row: 1, .. }
    ));
    // An id that the table lacks gets a name.
    let parts = balls(&[row(0.0, 3), row(2.0, 3)].concat());
    let found = separated(&parts, &[5; 6]);
    let names: Vec<_> = found
        .classes
        .entries
        .iter()
        .map(|c| (c.id, c.name.as_str()))
        .collect();
    assert_eq!(
        names,
        [
            (1, "wall"),
            (2, "chair"),
            (5, "label 5 1"),
            (7, "lamp"),
            (8, "label 5 2")
        ]
    );
    // Lower ids are taken where no higher one is left. Too many pieces are reported.
    let found = separated(&parts, &[65_535; 6]);
    assert_eq!(found.labels, [vec![65_535; 3], vec![3; 3]].concat());
    let lone: Vec<_> = (0..66_000)
        .map(|i| ([i as f32, 0.0, 0.0], 0.05, SOLID))
        .collect();
    let all = Separation {
        smallest: 0.0,
        ..default
    };
    assert!(matches!(
        apply(all, &balls(&lone), &vec![2; lone.len()]),
        Error::Limit { .. }
    ));
    // A Gaussian whose scale overflows f32 has no body, and is not an error.
    let mut huge = gaussians;
    huge.log_scales[0] = [1e4; 3];
    assert_eq!(separated(&huge, &[2; 3]).labels, [2; 3]);
}

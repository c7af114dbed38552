//! Properties of the scores: bounds, symmetries, and independence of the numbers of ids and of the order of rows.

use coseg::data::Classes;
use coseg::metrics::{
    Void, calinski_harabasz, davies_bouldin, instance_scores, label_scores, psnr, ssim,
};
use proptest::collection::vec;
use proptest::prelude::*;

const WIDTH: usize = 13;
const HEIGHT: usize = 12;

fn image() -> impl Strategy<Value = Vec<f32>> {
    vec(-0.2_f32..1.2, WIDTH * HEIGHT * 3)
}

/// Ids 0 to 4 of two views; 0 is unlabelled.
fn maps() -> impl Strategy<Value = Vec<(Vec<u16>, Vec<u16>)>> {
    let pixels = vec((0_u16..5, 0_u16..5), 1..60);
    vec(pixels.prop_map(|pixels| pixels.into_iter().unzip()), 1..3)
}

/// The ids 1 to 4 in another order; 0 stays.
fn order() -> impl Strategy<Value = Vec<u16>> {
    Just(vec![1_u16, 2, 3, 4])
        .prop_shuffle()
        .prop_map(|ids| [vec![0], ids].concat())
}

fn renamed(map: &[u16], ids: &[u16]) -> Vec<u16> {
    map.iter().map(|&id| ids[usize::from(id)]).collect()
}

fn near(a: Option<f64>, b: Option<f64>) -> bool {
    match (a, b) {
        (Some(a), Some(b)) => (a - b).abs() < 1e-9,
        (a, b) => a == b,
    }
}

fn is_share(value: Option<f64>) -> bool {
    value.is_none_or(|value| (0.0..=1.0).contains(&value))
}

proptest! {
    #[test]
    fn image_scores_are_symmetric_and_bounded(a in image(), b in image()) {
        let scores = |a, b| (psnr(a, b), ssim(a, b, [WIDTH, HEIGHT, 3], None));
        prop_assert_eq!(scores(&a, &b).0, scores(&b, &a).0);
        prop_assert!(near(scores(&a, &b).1, scores(&b, &a).1));
        prop_assert!(psnr(&a, &b) <= psnr(&a, &a));
        prop_assert!(scores(&a, &b).1.is_some_and(|ssim| ssim.abs() <= 1.0));
        prop_assert!(near(scores(&a, &a).1, Some(1.0)));
    }

    #[test]
    fn label_scores_do_not_depend_on_the_numbers_of_classes(views in maps(), ids in order()) {
        let classes = Classes::from_names(0, (1..5).map(|id| (id, id.to_string())));
        let others = views.iter().map(|(t, p)| (renamed(t, &ids), renamed(p, &ids)));
        let others: Vec<_> = others.collect();
        for void in [Void::Wrong, Void::LeftOut] {
            let a = label_scores(&classes, views.iter().map(|(t, p)| (t, p)), void).pixels;
            let b = label_scores(&classes, others.iter().map(|(t, p)| (t, p)), void).pixels;
            prop_assert!(near(a.miou, b.miou) && near(a.miou_per_view, b.miou_per_view));
            prop_assert!(near(a.accuracy, b.accuracy));
            prop_assert!(is_share(a.miou) && is_share(a.miou_per_view) && is_share(a.accuracy));
        }
        let own = label_scores(&classes, views.iter().map(|(t, _)| (t, t)), Void::Wrong).pixels;
        prop_assert!(own.accuracy.is_none_or(|accuracy| accuracy == 1.0));
    }

    #[test]
    fn instance_scores_do_not_depend_on_the_numbers_of_objects(
        views in maps(),
        true_ids in order(),
        ids in order(),
    ) {
        let others = views.iter().map(|(t, p)| (renamed(t, &true_ids), renamed(p, &ids)));
        let others: Vec<_> = others.collect();
        let a = instance_scores(views.iter().map(|(t, p)| (t, p)));
        let b = instance_scores(others.iter().map(|(t, p)| (t, p)));
        // Several pairings can have the same sum of pixels, so the IoU of the pairs may differ.
        prop_assert!(near(a.accuracy, b.accuracy));
        prop_assert!(near(a.panoptic.pq, b.panoptic.pq) && near(a.scene.pq, b.scene.pq));
        for quality in [a.panoptic, a.scene] {
            prop_assert!(is_share(quality.pq) && is_share(quality.sq) && is_share(quality.rq));
            let product = quality.sq.zip(quality.rq).map(|(sq, rq)| sq * rq);
            prop_assert!(near(quality.pq, product));
        }
        let own = instance_scores(views.iter().map(|(t, _)| (t, t)));
        prop_assert!(own.accuracy.is_none_or(|accuracy| accuracy == 1.0));
        prop_assert!(own.scene.pq.is_none_or(|pq| pq == 1.0));
    }

    #[test]
    fn cluster_indices_do_not_depend_on_order_scale_or_place(
        rows in vec((vec((-64_i16..64).prop_map(|x| f32::from(x) / 64.0), 3), 0_u16..5), 8..40),
        turn in 0_usize..8,
        ids in order(),
    ) {
        let scores = |rows: &[(Vec<f32>, u16)]| {
            let features = rows.iter().flat_map(|(row, _)| row.iter().copied());
            let features: Vec<f32> = features.collect();
            let labels: Vec<u16> = rows.iter().map(|(_, label)| *label).collect();
            [calinski_harabasz, davies_bouldin].map(|index| index(&features, 3, &labels))
        };
        let mut others: Vec<(Vec<f32>, u16)> = rows
            .iter()
            .map(|(row, label)| {
                let row = row.iter().map(|x| 4.0 * x + 8.0).collect();
                (row, 7 + ids[usize::from(*label)])
            })
            .collect();
        others.rotate_left(turn);
        for (a, b) in scores(&rows).into_iter().zip(scores(&others)) {
            let same = match (a, b) {
                (Some(a), Some(b)) => (a / b - 1.0).abs() < 1e-3,
                (a, b) => a == b,
            };
            prop_assert!(same, "{a:?} {b:?}");
            prop_assert!(a.is_none_or(|a| a >= 0.0));
        }
    }
}

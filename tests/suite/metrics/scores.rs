//! Scores against values computed by scikit-image 0.26 and scikit-learn 1.9 from the same formulas.

use coseg::data::Classes;
use coseg::data::{LoadOptions, Scene, Split, load};
use coseg::metrics::{
    Confusion, ImageScores, PSNR_CAP, Void, calinski_harabasz, davies_bouldin, label_scores, psnr,
    ssim,
};

/// v = 0.5 + 0.4 sin(0.31 x + 0.7 c + p) cos(0.23 y - 0.4 c) + 0.1 sin(1.7 x p + 2.3 y), rounded to f32.
fn image(height: usize, width: usize, p: f64) -> Vec<f32> {
    let mut out = Vec::new();
    for y in 0..height {
        for x in 0..width {
            for c in 0..3 {
                let (x, y, c) = (x as f64, y as f64, f64::from(c));
                let v = 0.5
                    + 0.4 * (0.31 * x + 0.7 * c + p).sin() * (0.23 * y - 0.4 * c).cos()
                    + 0.1 * (1.7 * x * p + 2.3 * y).sin();
                out.push(v as f32);
            }
        }
    }
    out
}

#[test]
fn psnr_and_ssim_match_scikit_image() {
    // structural_similarity(a, b, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, channel_axis=2,
    // data_range=1) and peak_signal_noise_ratio(b, a, data_range=1) on f64 copies clipped to 0..1.
    let cases = [
        (37, 53, 0.0, 0.2, 0.632176649947, 19.1922169354),
        (37, 53, 0.0, 1.5, 0.049923559133, 10.7113045480),
        (11, 11, 0.3, 0.4, 0.907883389565, 23.3363096894),
        (11, 64, 0.3, 2.9, -0.449899390777, 7.8829957142),
    ];
    for (height, width, p, q, want_ssim, want_psnr) in cases {
        let (a, b) = (image(height, width, p), image(height, width, q));
        let found_psnr = psnr(&a, &b).expect("psnr");
        let found_ssim = ssim(&a, &b, [width, height, 3], None).expect("ssim");
        assert!(
            (found_psnr - want_psnr).abs() < 1e-8,
            "{found_psnr} {want_psnr}"
        );
        assert!(
            (found_ssim - want_ssim).abs() < 1e-8,
            "{found_ssim} {want_ssim}"
        );
    }
}

#[test]
fn image_scores_of_empty_equal_and_broken_images() {
    let a = image(12, 13, 0.1);
    assert_eq!(psnr(&a, &a), Some(PSNR_CAP));
    assert!((ssim(&a, &a, [13, 12, 3], None).expect("value") - 1.0).abs() < 1e-12);
    // Values outside 0..1 are clamped, so these two images are one.
    let (over, one) = (vec![7.0_f32; 12 * 13 * 3], vec![1.0_f32; 12 * 13 * 3]);
    assert_eq!(psnr(&over, &one), Some(PSNR_CAP));
    assert_eq!(psnr(&[], &[]), None);
    assert_eq!(psnr(&a, &a[1..]), None);
    let mut broken = a.clone();
    broken[100] = f32::NAN;
    assert_eq!(psnr(&a, &broken), None);
    assert_eq!(psnr(&broken, &a), None);
    assert_eq!(ssim(&a, &broken, [13, 12, 3], None), None);
    assert_eq!(
        ssim(&a[..10 * 13 * 3], &a[..10 * 13 * 3], [13, 10, 3], None),
        None
    );
    assert_eq!(ssim(&a, &a, [13, 11, 3], None), None);
    assert_eq!(ssim(&a, &a, [usize::MAX, 12, 3], None), None);
    let mean = ImageScores::mean(&[
        ImageScores {
            psnr: Some(20.0),
            ssim: None,
        },
        ImageScores {
            psnr: Some(30.0),
            ssim: Some(0.5),
        },
        ImageScores::default(),
    ]);
    assert_eq!(
        mean,
        ImageScores {
            psnr: Some(25.0),
            ssim: Some(0.5)
        }
    );
    assert_eq!(ImageScores::mean(&[]), ImageScores::default());
}

#[test]
fn label_scores_of_a_hand_counted_case() {
    let classes = Classes::from_names(0, [(3, "wall"), (7, "floor"), (9, "lamp")]);
    // View 1: truth 3 3 3 7, one void; predicted 3 3 void 3. View 2: truth 7 7; predicted 7 9.
    let (t1, p1) = ([3, 3, 3, 7, 0], [3, 3, 0, 3, 3]);
    let (t2, p2) = ([7, 7], [7, 9]);
    let views = [(&t1[..], &p1[..]), (&t2[..], &p2[..])];
    let wrong = label_scores(&classes, views, Void::Wrong);
    // Class 3: TP 2, FP 1, FN 1; class 7: TP 1, FP 0, FN 2; lamp is not in the truth.
    assert_eq!(wrong.per_class, [(3, 0.5), (7, 1.0 / 3.0)]);
    assert_eq!(wrong.pixels.miou, Some((0.5 + 1.0 / 3.0) / 2.0));
    // View 1: 3 -> 2/4, 7 -> 0; view 2: 7 -> 1/2.
    assert_eq!(wrong.pixels.miou_per_view, Some((0.25 + 0.5) / 2.0));
    assert_eq!(wrong.pixels.accuracy, Some(0.5));
    let left_out = label_scores(&classes, views, Void::LeftOut);
    assert_eq!(left_out.per_class, [(3, 2.0 / 3.0), (7, 1.0 / 3.0)]);
    assert_eq!(left_out.pixels.miou, Some(0.5));
    assert_eq!(left_out.pixels.accuracy, Some(3.0 / 5.0));
}

#[test]
fn label_scores_of_nothing_are_absent() {
    let classes = Classes::from_names(0, [(1, "a"), (2, "b")]);
    let ignored = [0_u16; 4];
    let views = [(&ignored[..], &[1_u16, 2, 1, 2][..])];
    for void in [Void::Wrong, Void::LeftOut] {
        let scores = label_scores(&classes, views, void);
        assert_eq!(
            (
                scores.pixels.miou,
                scores.pixels.miou_per_view,
                scores.pixels.accuracy
            ),
            (None, None, None)
        );
        assert!(scores.per_class.is_empty());
    }
    assert_eq!(
        label_scores(&Classes::default(), views, Void::Wrong)
            .pixels
            .miou,
        None
    );
    // All predictions void: wrong everywhere, or nothing to score.
    let views = [(&[1_u16, 2][..], &[0_u16, 0][..])];
    assert_eq!(
        label_scores(&classes, views, Void::Wrong).pixels.miou,
        Some(0.0)
    );
    assert_eq!(
        label_scores(&classes, views, Void::LeftOut).pixels.miou,
        None
    );
    let mut a = Confusion::new(2);
    assert!(!a.merge(&Confusion::new(3)));
    a.add([0, 1, 5], [1, 9, 0]);
    assert_eq!((a.count(0, 1), a.count(1, 2), a.count(5, 0)), (1, 1, 0));
}

/// Raw labels of the test views of a shared scene.
fn raw_scores(scene: &Scene, void: Void) -> [f64; 3] {
    let views = scene
        .split(Split::Test)
        .filter_map(|v| Some((v.truth.as_ref()?.map(), v.raw.as_ref()?.map())));
    let s = label_scores(&scene.classes, views, void);
    [s.pixels.miou, s.pixels.miou_per_view, s.pixels.accuracy].map(|v| v.expect("scored"))
}

#[test]
fn raw_labels_of_a_real_scene_match_scikit_learn() {
    let Some(shared) = crate::support::shared_dir() else {
        return;
    };
    let dir = shared.join("data/house_living");
    // jaccard_score(truth, raw, labels=np.unique(truth), average="macro") pooled and per view, and mean(truth == raw),
    // over the test frames; pixels of truth 0 dropped, and for the second of each pair those of raw 0 as well.
    let cases = [
        (
            "labels_raw",
            Void::Wrong,
            [0.6129154057, 0.6364352929, 0.8330284082],
        ),
        (
            "labels_raw",
            Void::LeftOut,
            [0.6398163649, 0.6712913335, 0.8625213585],
        ),
        (
            "labels_raw_corr",
            Void::Wrong,
            [0.5377872963, 0.5069572732, 0.8044298050],
        ),
        (
            "labels_raw_corr",
            Void::LeftOut,
            [0.5634882859, 0.5335654771, 0.8523491894],
        ),
    ];
    for raw in ["labels_raw", "labels_raw_corr"] {
        let options = LoadOptions {
            raw_labels: Some(raw.into()),
            ..LoadOptions::default()
        };
        let scene = load(&dir, &options).expect("scene");
        for (_, void, want) in cases.iter().filter(|c| c.0 == raw) {
            let found = raw_scores(&scene, *void);
            for (f, w) in found.iter().zip(want) {
                assert!((f - w).abs() < 1e-9, "{raw} {void:?}: {found:?} {want:?}");
            }
        }
    }
}

/// X[i, b] = sin(0.9 i (b + 1)) + 1.5 cos(2 l + b) with l = i^2 mod 7 mod 4, plus `shift`; label ids with gaps.
fn clusters(shift: f32) -> (Vec<f32>, Vec<u16>) {
    let label = |i: usize| i * i % 7 % 4;
    let features = (0..60).flat_map(|i| {
        (0..5).map(move |b| {
            let (i, b, l) = (i as f64, f64::from(b), label(i) as f64);
            ((0.9 * i * (b + 1.0)).sin() + 1.5 * (2.0 * l + b).cos()) as f32 + shift
        })
    });
    (
        features.collect(),
        (0..60).map(|i| 5 + 40 * label(i) as u16).collect(),
    )
}

#[test]
fn cluster_indices_match_scikit_learn() {
    // calinski_harabasz_score and davies_bouldin_score on f64 copies.
    for (shift, ch, db) in [
        (0.0, 62.457587289679, 0.864080638821),
        (1000.0, 62.457509317051, 0.864081042359),
    ] {
        let (features, labels) = clusters(shift);
        let found = calinski_harabasz(&features, 5, &labels).expect("value");
        assert!((found / ch - 1.0).abs() < 1e-7, "{found} {ch}");
        let found = davies_bouldin(&features, 5, &labels).expect("value");
        assert!((found / db - 1.0).abs() < 1e-7, "{found} {db}");
    }
}

#[test]
fn cluster_indices_of_degenerate_cases_are_absent() {
    let (features, labels) = clusters(0.0);
    for index in [calinski_harabasz, davies_bouldin] {
        assert_eq!(index(&[], 5, &[]), None);
        assert_eq!(index(&features, 5, &[1; 60]), None, "one cluster");
        assert_eq!(
            index(&features, 5, &(0..60).collect::<Vec<u16>>()),
            None,
            "a cluster a row"
        );
        assert_eq!(index(&features, 4, &labels), None, "lengths disagree");
        assert_eq!(index(&features, 0, &labels), None);
        assert_eq!(index(&[1.0; 300], 5, &labels), None, "all rows equal");
        let mut broken = features.clone();
        broken[7] = f32::INFINITY;
        assert_eq!(index(&broken, 5, &labels), None);
    }
}

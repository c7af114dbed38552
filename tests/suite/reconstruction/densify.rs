//! Initialisation and adaptive density control.

use coseg::data::Points;
use coseg::random::{Purpose, stream};
use coseg::reconstruction::densify::{
    AdcRules, Densification, GradientStatistics, SizeLimit, adc, reset_opacity,
};
use coseg::reconstruction::initialization;
use coseg::splat::Gaussians;

fn cloud(positions: Vec<[f32; 3]>) -> Points {
    let colors = vec![[0.25, 0.5, 1.0]; positions.len()];
    Points { positions, colors }
}

fn scale(gaussians: &Gaussians, i: usize) -> f32 {
    gaussians.log_scales[i][0].exp()
}

#[test]
fn points_become_isotropic_gaussians_of_neighbour_distance() {
    // a brute-force reference on a jittered cloud
    let positions: Vec<[f32; 3]> = (0..300)
        .map(|i| {
            let t = i as f32;
            [
                (t * 0.71).sin() * 3.0,
                (t * 1.37).cos() * 2.0,
                (t * 0.113).sin(),
            ]
        })
        .collect();
    let g = initialization::from_points(&cloud(positions.clone()), 2, 1.0).expect("finite");
    for (i, p) in positions.iter().enumerate() {
        let mut squared: Vec<f64> = positions
            .iter()
            .enumerate()
            .filter(|&(j, _)| j != i)
            .map(|(_, q)| p.iter().zip(q).map(|(a, b)| f64::from(a - b).powi(2)).sum())
            .collect();
        squared.sort_by(f64::total_cmp);
        let want = (squared[..3].iter().sum::<f64>() / 3.0).sqrt();
        assert!(
            (f64::from(scale(&g, i)) / want - 1.0).abs() < 1e-5,
            "point {i}"
        );
    }
    assert_eq!((g.len(), g.sh.len(), g.sh_degree), (300, 300 * 27, 2));
    let opacity = 1.0 / (1.0 + (-g.opacity_logits[7]).exp());
    assert!((opacity - 0.1).abs() < 1e-6);
    for (c, want) in [0.25, 0.5, 1.0].into_iter().enumerate() {
        assert!((0.5 + coseg::splat::SH_0 * g.sh[7 * 27 + c] - want).abs() < 1e-6);
    }
    assert!(g.sh[7 * 27 + 3..8 * 27].iter().all(|&s| s == 0.0));
}

#[test]
fn degenerate_clouds_get_usable_scales() {
    // duplicates (also of -0), coplanar, collinear, two points, one point, none
    let twice = |p: &[[f32; 3]]| [p, p].concat();
    let square = [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [1.0, 1.0, 0.0],
    ];
    let rms = ((1.0 + 1.0 + 2.0_f32) / 3.0).sqrt();
    for (positions, want) in [
        (twice(&square), rms),
        (vec![[0.0; 3], [-0.0; 3], [2.0, 0.0, 0.0]], 2.0),
        (vec![[5.0; 3]; 400], 0.01 * 3.0),
        (vec![[0.0; 3]], 0.01 * 3.0),
        (vec![[0.0; 3], [0.0, 0.0, 4.0]], 4.0),
    ] {
        let g = initialization::from_points(&cloud(positions), 0, 3.0).expect("finite");
        for i in 0..g.len() {
            assert!(
                (scale(&g, i) / want - 1.0).abs() < 1e-5,
                "{} against {want}",
                scale(&g, i)
            );
        }
    }
    let line: Vec<[f32; 3]> = (0..5000).map(|i| [i as f32, 0.0, 0.0]).collect();
    let g = initialization::from_points(&cloud(line), 0, 1.0).expect("finite");
    assert!((scale(&g, 2500) - 2.0_f32.sqrt()).abs() < 1e-4);
    assert!(
        initialization::from_points(&cloud(Vec::new()), 3, 1.0)
            .expect("empty")
            .is_empty()
    );
}

#[test]
fn non_finite_points_are_named() {
    let mut points = cloud(vec![[0.0; 3]; 5]);
    points.positions[3][1] = f32::NAN;
    let message = initialization::from_points(&points, 0, 1.0)
        .expect_err("NaN")
        .to_string();
    assert!(
        message.contains("points.positions") && message.contains("row 3"),
        "{message}"
    );
    let mut points = cloud(vec![[0.0; 3]; 5]);
    points.colors[4][0] = f32::INFINITY;
    let message = initialization::from_points(&points, 0, 1.0)
        .expect_err("infinity")
        .to_string();
    assert!(
        message.contains("points.colors") && message.contains("row 4"),
        "{message}"
    );
}

/// Row i has mean (i, 0, 0), the given largest scale, opacity and mean gradient.
fn population(rows: &[(f32, f32, f32)]) -> (Gaussians, GradientStatistics) {
    let mut g = Gaussians {
        sh_degree: 1,
        ..Gaussians::default()
    };
    let mut stats = GradientStatistics::new(rows.len());
    for (i, &(scale, opacity, gradient)) in rows.iter().enumerate() {
        g.means.push([i as f32, 0.0, 0.0]);
        g.log_scales
            .push([(scale * 0.5).ln(), scale.ln(), (scale * 0.1).ln()]);
        g.rotations.push([1.0, 0.0, 0.0, 0.0]);
        g.opacity_logits.push(initialization::logit(opacity));
        g.sh.extend((0..12).map(|k| (i * 12 + k) as f32));
        stats.visible[i] = 4;
        stats.gradient[i] = 4.0 * gradient;
    }
    (g, stats)
}

fn rules() -> AdcRules {
    let prune_scale = SizeLimit {
        share: 0.05,
        extent: 20.0,
        center: Some([0.0; 3]),
    };
    AdcRules {
        threshold: 1.0,
        clone_below: 0.1,
        prune_opacity: 0.005,
        prune_scale,
        max_gaussians: usize::MAX,
    }
}

fn planned(
    g: &Gaussians,
    stats: &GradientStatistics,
    rules: &AdcRules,
    seed: u64,
) -> Densification {
    adc(
        g,
        stats,
        rules,
        &mut stream(seed, Purpose::Densification, 7),
    )
    .expect("matching statistics")
}

#[test]
fn small_are_cloned_large_are_split_useless_are_pruned() {
    let (g, stats) = population(&[
        (0.05, 0.5, 0.0),   // stays
        (0.05, 0.5, 2.0),   // cloned
        (0.5, 0.5, 2.0),    // split
        (0.05, 0.001, 2.0), // pruned: transparent
        (2.0, 0.5, 0.0),    // pruned: too large
        (1.5, 0.5, 2.0),    // too large, but its children are not
        (3.0, 0.5, 2.0),    // too large, and so are its children
    ]);
    let planned = |seed| planned(&g, &stats, &rules(), seed);
    let plan = planned(1);
    assert_eq!(plan.rows, [0, 1, 1, 2, 2, 5, 5]);
    assert_eq!(plan.is_new, [false, false, true, true, true, true, true]);
    let done = plan.done;
    assert_eq!((done.cloned, done.split, done.pruned), (1, 2, 3));

    let lengths = [plan.means.len(), plan.log_scales.len()];
    assert_eq!((lengths, plan.opacity_logits.len()), ([7; 2], 7));
    assert_eq!(plan.means[2], g.means[1]);
    assert_ne!(plan.means[3], plan.means[4], "children are two samples");
    assert!((plan.log_scales[3][1].exp() * 1.6 / 0.5 - 1.0).abs() < 1e-5);
    assert_eq!(plan, planned(1), "seeded");
    assert_ne!(plan, planned(2));
}

#[test]
fn what_is_far_from_the_cameras_may_be_large() {
    let (mut g, stats) = population(&[(2.0, 0.5, 0.0); 4]);
    g.means = vec![
        [0.0; 3],
        [0.0, 12.0, 16.1],
        [30.0, 40.0, 0.0],
        [-39.0, 0.0, 0.0],
    ];
    let kept = |center: Option<[f32; 3]>| {
        let rules = AdcRules {
            prune_scale: SizeLimit {
                share: 0.1,
                extent: 1.0,
                center,
            },
            ..rules()
        };
        planned(&g, &stats, &rules, 1).rows
    };
    // A scale of 2 is a tenth of 20 world units.
    assert_eq!(kept(Some([0.0; 3])), [1, 2, 3]);
    assert_eq!(
        kept(Some([-20.5, 0.0, 0.0])),
        [0, 1, 2],
        "distances are from the cameras"
    );
    let close = AdcRules {
        prune_scale: SizeLimit {
            share: 0.1,
            extent: 20.1,
            center: Some([0.0; 3]),
        },
        ..rules()
    };
    assert_eq!(
        planned(&g, &stats, &close, 1).rows.len(),
        4,
        "extents count where they are longer"
    );
    assert!(kept(None).is_empty(), "3DGS looks at the extent alone");
}

#[test]
fn budget_takes_the_highest_gradients() {
    let (g, stats) = population(&[
        (0.05, 0.5, 2.0),
        (0.05, 0.5, 5.0),
        (0.5, 0.5, 3.0),
        (0.05, 0.001, 9.0),
    ]);
    for (budget, want) in [(3, 3), (4, 4), (5, 5), (6, 6), (100, 6), (1, 3)] {
        let plan = planned(
            &g,
            &stats,
            &AdcRules {
                max_gaussians: budget,
                ..rules()
            },
            1,
        );
        assert_eq!(plan.rows.len(), want, "budget {budget}");
    }
    let plan = planned(
        &g,
        &stats,
        &AdcRules {
            max_gaussians: 4,
            ..rules()
        },
        1,
    );
    assert_eq!((plan.done.cloned, plan.done.split), (1, 0));
    assert_eq!((plan.rows[3], plan.is_new[3]), (1, true));
}

#[test]
fn children_follow_the_parents_distribution() {
    let n = 4000;
    let (mut g, stats) = population(&vec![(0.5, 0.5, 2.0); n]);
    let q = [0.5_f32.sqrt(), 0.0, 0.0, 0.5_f32.sqrt()]; // 90 degrees about z: local x becomes world y
    g.means.iter_mut().for_each(|m| *m = [1.0, 2.0, 3.0]);
    g.rotations.iter_mut().for_each(|r| *r = q.map(|v| 7.0 * v)); // unnormalised
    let new = planned(&g, &stats, &rules(), 3);
    assert_eq!(new.means.len(), 2 * n);
    for (axis, mean, deviation) in [(0, 1.0, 0.5), (1, 2.0, 0.25), (2, 3.0, 0.05)] {
        let values: Vec<f64> = new.means.iter().map(|m| f64::from(m[axis])).collect();
        let average = values.iter().sum::<f64>() / values.len() as f64;
        let spread = (values.iter().map(|v| (v - average).powi(2)).sum::<f64>()
            / values.len() as f64)
            .sqrt();
        assert!(
            (average - mean).abs() < 4.0 * deviation / (2.0 * n as f64).sqrt(),
            "axis {axis}: mean {average}"
        );
        assert!(
            (spread / deviation - 1.0).abs() < 0.04,
            "axis {axis}: deviation {spread}"
        );
    }
}

#[test]
fn statistics_count_visible_iterations_only() {
    let stats = GradientStatistics {
        gradient: vec![6.0, 0.0, 0.0],
        visible: vec![2, 0, 1],
    };
    assert_eq!(
        (stats.mean(0), stats.mean(1), stats.mean(2)),
        (3.0, 0.0, 0.0)
    );
    let (g, _) = population(&[(0.05, 0.5, 0.0)]);
    assert!(
        adc(
            &g,
            &stats,
            &rules(),
            &mut stream(1, Purpose::Densification, 7)
        )
        .is_err(),
        "statistics of other Gaussians"
    );
    let none = planned(
        &Gaussians::default(),
        &GradientStatistics::new(0),
        &rules(),
        1,
    );
    assert!(none.rows.is_empty());
}

#[test]
fn reset_only_lowers_opacity() {
    let mut logits = vec![
        initialization::logit(0.9),
        initialization::logit(0.001),
        initialization::logit(0.01),
    ];
    reset_opacity(&mut logits);
    assert_eq!(
        logits,
        [
            initialization::logit(0.01),
            initialization::logit(0.001),
            initialization::logit(0.01)
        ]
    );
}

//! Relocation of 3DGS-MCMC on host vectors: what replaces a Gaussian looks like it, and transparent ones go.

use crate::support::population::population;
use coseg::random::{Purpose, stream};
use coseg::raster::{Projected, Settings, Splats};
use coseg::reconstruction::densify::Densification;
use coseg::reconstruction::initialization;
use coseg::reconstruction::mcmc::{RelocationRules, relocate, shared};
use coseg::splat::Gaussians;
use coseg::splat::camera::Camera;
use glam::{DMat3, DVec3};

const NOWHERE: f32 = f32::NEG_INFINITY;
/// What the f32 of a logit or a log-scale (both below 16) may be off by, twice over.
const ROUNDING: f64 = 2e-6;

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// The cases: opacity as the f32 logit has it, that logit, and a number of copies.
fn cases() -> impl Iterator<Item = (f64, f32, u32)> {
    let opacities = [0.0051, 0.02, 0.3, 0.9, 0.999];
    opacities.into_iter().flat_map(|o| {
        [2, 3, 10].map(|n| {
            (
                sigmoid(f64::from(initialization::logit(o))),
                initialization::logit(o),
                n,
            )
        })
    })
}

/// What `n` Gaussians of opacity `o` and standard deviation `c` at one place cover at distance `r` from it.
fn covered(o: f64, c: f64, n: u32, r: f64) -> f64 {
    1.0 - (1.0 - o * (-0.5 * (r / c).powi(2)).exp()).powf(f64::from(n))
}

/// The integral of an even function by the trapezoidal rule, which for smooth ones is exact to rounding.
fn integral(f: impl Fn(f64) -> f64) -> f64 {
    const STEP: f64 = 0.01;
    STEP * (f(0.0) + 2.0 * (1..1200).map(|i| f(f64::from(i) * STEP)).sum::<f64>())
}

fn binomial(n: u32, k: u32) -> f64 {
    (0..k)
        .map(|i| f64::from(n - i) / f64::from(i + 1))
        .product()
}

#[test]
fn copies_cover_what_the_one_did() {
    let whole = std::f64::consts::TAU.sqrt();
    let more = [(0.999, 100), (0.999, 1000), (0.5, 1), (0.0051, 400)].map(|(o, n)| {
        let logit = initialization::logit(o);
        (sigmoid(f64::from(logit)), logit, n)
    });
    for (o, logit, n) in cases().chain(more) {
        let (new, wider) = shared(logit, n, NOWHERE);
        let (each, c) = (sigmoid(f64::from(new)), f64::from(wider).exp());
        let center = covered(each, c, n, 0.0);
        assert!(
            (center / o - 1.0).abs() < ROUNDING,
            "{o}, {n} copies: {center} at the centre"
        );
        let line = integral(|r| covered(each, c, n, r)) / (o * whole);
        assert!(
            (line - 1.0).abs() < ROUNDING,
            "{o}, {n} copies: {line} of the line integral"
        );
    }
    let (new, wider) = shared(0.25, 1, NOWHERE);
    assert!(
        (new - 0.25).abs() < 1e-6 && wider.abs() < 1e-6,
        "one copy is the Gaussian itself"
    );
}

#[test]
fn scales_are_those_of_the_papers_double_sum() {
    for (o, logit, n) in cases() {
        let (_, wider) = shared(logit, n, NOWHERE);
        let each = 1.0 - (1.0 - o).powf(1.0 / f64::from(n));
        let mut sum = 0.0;
        for i in 1..=n {
            for k in 0..i {
                let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
                sum +=
                    binomial(i - 1, k) * sign * each.powi(k as i32 + 1) / f64::from(k + 1).sqrt();
            }
        }
        assert!(
            (f64::from(wider).exp() * sum / o - 1.0).abs() < ROUNDING,
            "{o}, {n} copies: {wider}"
        );
    }
}

#[test]
fn extreme_opacities_stay_finite_and_the_floor_keeps_the_integral() {
    for logit in [-50.0, -5.3, 15.0, 50.0, f32::MAX, f32::MIN] {
        for n in [1, 2, 17, 100_000] {
            let (new, wider) = shared(logit, n, -5.2);
            assert!(
                new.is_finite() && (wider.is_finite() || logit == f32::MIN),
                "{logit}, {n}: {new}, {wider}"
            );
            assert!(new >= -5.2);
        }
    }
    // Three copies of 0.006 would have 0.002 each.
    let (floor, logit) = (initialization::logit(0.005), initialization::logit(0.006));
    let (new, wider) = shared(logit, 3, floor);
    assert_eq!(new, floor);
    let line = integral(|r| covered(sigmoid(f64::from(new)), f64::from(wider).exp(), 3, r));
    let want = sigmoid(f64::from(logit)) * std::f64::consts::TAU.sqrt();
    assert!(
        (line / want - 1.0).abs() < ROUNDING,
        "{line} against {want}"
    );
}

/// White Gaussians at one place, `[H, W]`, sharp (no low pass) and with no cut-off: standard deviation 4 pixels times `c`.
fn picture(logit: f64, c: f64, n: usize) -> Vec<f64> {
    let camera = Camera {
        rotation: DMat3::IDENTITY,
        center: DVec3::ZERO,
        fx: 64.0,
        fy: 64.0,
        cx: 32.5,
        cy: 32.5,
        width: 65,
        height: 65,
    };
    let settings = Settings {
        alpha_max: 1.0,
        alpha_min: 0.0,
        t_min: 0.0,
        near: 0.01,
        low_pass: 0.0,
    };
    let splats = Splats {
        means: &[0.0, 0.0, 2.0].repeat(n),
        log_scales: &vec![(0.125 * c).ln(); 3 * n],
        rotations: &[1.0, 0.0, 0.0, 0.0].repeat(n),
        opacity_logits: &vec![logit; n],
    };
    Projected::new(&splats, &camera, &settings)
        .expect("valid")
        .blend(&vec![1.0; n], 1)
        .image
}

#[test]
fn the_rendered_image_stays_within_the_papers_approximation() {
    for (o, logit, n) in cases() {
        let (new, wider) = shared(logit, n, NOWHERE);
        let (each, c) = (sigmoid(f64::from(new)), f64::from(wider).exp());
        let before = picture(f64::from(logit), 1.0, 1);
        let after = picture(f64::from(new), c, n as usize);
        let center = 32 * 65 + 32;
        assert!(
            (after[center] / before[center] - 1.0).abs() < ROUNDING,
            "{o}, {n} copies: the centre"
        );
        let row = |image: &[f64]| image[32 * 65..33 * 65].iter().sum::<f64>();
        assert!(
            (row(&after) / row(&before) - 1.0).abs() < ROUNDING,
            "{o}, {n} copies: the line through the centre"
        );

        // A plane has one dimension more than the line whose integral is kept. What that leaves is known:
        // the image's integral as a sum like that of the line's, with 1 / j instead of 1 / sqrt(j),
        let term = |j: u32| {
            binomial(n, j) * (-1.0_f64).powi(j as i32 - 1) * each.powi(j as i32) / f64::from(j)
        };
        let want = c * c * (1..=n).map(term).sum::<f64>() / o;
        let got = after.iter().sum::<f64>() / before.iter().sum::<f64>();
        assert!(
            (got - want).abs() < 4.0 * ROUNDING,
            "{o}, {n} copies: {got} of the image's integral, not {want}"
        );
        // and the largest difference of a pixel from the profiles themselves.
        let worst = |c: f64| {
            let radii = (0..6000).map(|i| f64::from(i) * 1e-3);
            radii
                .map(|r| (covered(each, c, n, r) - covered(o, 1.0, 1, r)).abs())
                .fold(0.0, f64::max)
        };
        let differences = after.iter().zip(&before).map(|(a, b)| (a - b).abs());
        let largest = differences.fold(0.0, f64::max);
        assert!(
            largest <= worst(c) + ROUNDING * o,
            "{o}, {n} copies: a pixel is {largest} off"
        );
        assert!(
            worst(c) < 0.5 * worst(1.0),
            "{o}, {n} copies: no better than copies of the old size"
        );
    }
}

fn rules(max_gaussians: usize) -> RelocationRules {
    RelocationRules {
        dead: 0.005,
        growth: 0.05,
        max_gaussians,
    }
}

fn planned(g: &Gaussians, rules: &RelocationRules, seed: u64) -> Densification {
    relocate(g, rules, &mut stream(seed, Purpose::Densification, 3))
}

/// New rows that are copies of each of the `n` old ones.
fn copies(plan: &Densification, n: usize) -> Vec<u32> {
    let mut copies = vec![0; n];
    plan.rows.iter().for_each(|&row| copies[row as usize] += 1);
    copies
}

#[test]
fn the_dead_are_gone_and_the_cap_holds() {
    // a third dead, some of them at the threshold itself; the rest from barely alive to opaque
    let opacities: Vec<f32> = (0..300)
        .map(|i| {
            if i % 3 == 0 {
                [0.005, 0.004, 1e-9][i / 3 % 3]
            } else {
                0.0051 + 0.003 * i as f32
            }
        })
        .collect();
    let g = population(&opacities);
    for (cap, count) in [(1000, 315), (310, 310), (300, 300), (10, 300)] {
        let plan = planned(&g, &rules(cap), 1);
        assert_eq!(
            (plan.done.relocated, plan.done.cloned, plan.rows.len()),
            (100, count - 300, count)
        );
        let new = plan.gaussians(&g);
        assert_eq!((new.len(), new.sh.len()), (count, 3 * count));
        assert!(
            new.opacity_logits
                .iter()
                .all(|&o| o > initialization::logit(0.005)),
            "none is dead"
        );
        assert_eq!(
            planned(&new, &rules(count), 2).done.relocated,
            0,
            "and none is found dead by the next"
        );
        let copies = copies(&plan, g.len());

        let moments: Vec<f32> = (0..600).map(|i| 1.0 + i as f32).collect();
        let kept = plan.moments(&moments, 2);
        for (i, &row) in plan.rows.iter().enumerate() {
            let (row, copies) = (row as usize, copies[row as usize]);
            assert!(opacities[row] > 0.005, "copies are of live ones");
            assert_eq!(
                (new.means[i], &new.sh[3 * i..3 * i + 3]),
                (g.means[row], &g.sh[3 * row..3 * row + 3])
            );
            if copies == 1 {
                assert_eq!(row, i, "what shares no place stays");
                assert_eq!(
                    (new.opacity_logits[i], new.log_scales[i]),
                    (g.opacity_logits[i], g.log_scales[i])
                );
            } else {
                let floor = initialization::logit(0.005).next_up();
                let (logit, wider) = shared(g.opacity_logits[row], copies, floor);
                assert_eq!(
                    (new.opacity_logits[i], new.log_scales[i]),
                    (logit, g.log_scales[row].map(|s| s + wider))
                );
            }
            // the copied keep theirs, or all that share a place would move as one
            let want = if row == i {
                [moments[2 * i], moments[2 * i + 1]]
            } else {
                [0.0; 2]
            };
            assert_eq!(kept[2 * i..2 * i + 2], want);
        }
        assert_eq!(plan, planned(&g, &rules(cap), 1), "seeded");
        assert_ne!(plan.rows, planned(&g, &rules(cap), 2).rows);
    }
}

#[test]
fn the_opaque_are_drawn_in_proportion() {
    let mut opacities = vec![0.001; 60_000];
    opacities.extend([0.1, 0.2, 0.3, 0.9]);
    let plan = planned(&population(&opacities), &rules(0), 5);
    let copies = copies(&plan, opacities.len());
    for (i, share) in [
        (60_000, 1.0 / 15.0),
        (60_001, 2.0 / 15.0),
        (60_002, 0.2),
        (60_003, 0.6),
    ] {
        let deviation = (60_000.0_f64 * share * (1.0 - share)).sqrt();
        let drawn = f64::from(copies[i] - 1);
        assert!(
            (drawn - 60_000.0 * share).abs() < 4.0 * deviation,
            "row {i}: {drawn}"
        );
    }
}

#[test]
fn without_live_gaussians_nothing_happens() {
    for opacities in [vec![], vec![0.001; 7]] {
        let g = population(&opacities);
        let plan = planned(&g, &rules(100), 1);
        assert_eq!((plan.done.relocated, plan.done.cloned), (0, 0));
        assert_eq!(plan.gaussians(&g), g);
        assert_eq!(
            plan.moments(&vec![1.0; 2 * g.len()], 2),
            vec![1.0; 2 * g.len()]
        );
    }
    assert_eq!(
        planned(&population(&[0.5; 3]), &rules(100), 1).done.cloned,
        1,
        "small sets grow too"
    );
}

//! Selection of a thing by its Gaussians, on squares and plates.

use crate::support::plates::{HEIGHT, WIDTH, camera, plates};
use crate::support::raster_reference::all_pixels;
use coseg::objects::{Growth, Regions, seed};
use coseg::raster::{Projected, Settings};
use coseg::splat::Gaussians;

/// Flat squares of 100 Gaussians 5 cm apart, side by side, `gap` between them, each of one grey.
fn squares(greys: &[f32], gap: f32) -> Gaussians {
    let (mut means, mut sh) = (Vec::new(), Vec::new());
    for (square, grey) in greys.iter().enumerate() {
        for i in 0..100 {
            let left = square as f32 * (0.5 + gap);
            means.push([left + 0.05 * (i % 10) as f32, 0.05 * (i / 10) as f32, 0.0]);
            sh.extend([(grey - 0.5) / 0.282_094_8; 3]);
        }
    }
    let n = means.len();
    Gaussians {
        means,
        log_scales: vec![[-4.0; 3]; n],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacity_logits: vec![2.0; n],
        sh,
        sh_degree: 0,
    }
}

fn grown(gaussians: &Gaussians, seeds: &[u32]) -> Growth {
    Growth::new(&Regions::new(gaussians, &[]).unwrap(), seeds)
}

fn range(from: u32, to: u32) -> Vec<u32> {
    (from..to).collect()
}

#[test]
fn what_is_like_the_seed_is_reached_first() {
    let growth = grown(&squares(&[0.2, 0.3, 0.9], 0.0), &[5]);
    assert_eq!(growth.rows(0.0), range(0, 100));
    let [own, like, unlike] = [5, 105, 205].map(|row: usize| growth.thresholds[row]);
    assert!(own == 0.0 && own < like && like < unlike, "{like} {unlike}");
    assert_eq!(growth.rows(like), range(0, 200));
    assert_eq!(growth.rows(unlike), range(0, 300));
}

#[test]
fn the_first_difference_is_wards() {
    // 100 and 100 Gaussians whose greys differ by 0.1, and which share all edges that leave the first.
    let growth = grown(&squares(&[0.2, 0.3], 0.0), &[0]);
    let ward = (50.0_f32 * 3.0 * 0.1 * 0.1).sqrt();
    assert!((growth.thresholds[150] - ward).abs() < 1e-5 * ward);
}

#[test]
fn image_features_count_too() {
    let gaussians = squares(&[0.2, 0.3], 0.0);
    let feature = |i: usize| [0.25, if i < 100 { 0.0 } else { 0.5 }, 1.0];
    let features: Vec<[f32; 3]> = (0..200).map(feature).collect();
    let regions = Regions::new(&gaussians, &features).unwrap();
    let ward = (50.0_f32 * (3.0 * 0.1 * 0.1 + 0.4 * 0.4)).sqrt();
    let found = Growth::new(&regions, &[0]).thresholds[150];
    assert!((found - ward).abs() < 1e-5 * ward, "{found} {ward}");
    let error = Regions::new(&gaussians, &features[1..]).unwrap_err();
    assert!(error.to_string().contains("200"), "{error}");
}

#[test]
fn two_seeds_are_joined_by_the_proposed_threshold() {
    let gaussians = squares(&[0.2, 0.3, 0.9, 0.95, 0.9], 0.0);
    let growth = grown(&gaussians, &[5, 105]);
    assert_eq!(growth.rows(growth.proposed), range(0, 200));
}

#[test]
fn nothing_leads_across_a_gap() {
    let gaussians = squares(&[0.2, 0.2, 0.2], 5.0);
    let growth = grown(&gaussians, &[105]);
    assert_eq!(growth.rows(f32::MAX), range(100, 200));
    assert!(growth.thresholds[0].is_infinite());
    let growth = grown(&gaussians, &[5, 105]);
    assert_eq!(growth.rows(growth.proposed), range(0, 200));
}

#[test]
fn one_superpoint_is_its_own_selection() {
    let growth = grown(&squares(&[0.5], 0.0), &[0]);
    assert_eq!((growth.thresholds, growth.proposed), (vec![0.0; 100], 0.0));
}

#[test]
fn parents_come_after_their_parts_and_are_as_high() {
    let gaussians = squares(&[0.2, 0.3, 0.9, 0.95, 0.9], 0.0);
    let regions = Regions::new(&gaussians, &[]).unwrap();
    assert_eq!(regions.parents.len(), 2 * regions.superpoints.count - 1);
    let (root, parts) = regions.parents.split_last().unwrap();
    assert_eq!(*root as usize, parts.len());
    for (region, &parent) in parts.iter().enumerate() {
        assert!(parent as usize > region);
        assert!(regions.heights[region] <= regions.heights[parent as usize]);
    }
    // More than half of the scene is not a thing.
    assert_eq!(regions.prominences[*root as usize], 0.0);
}

#[test]
fn a_centre_that_is_not_finite_is_refused() {
    let mut gaussians = squares(&[0.5], 0.0);
    gaussians.means[7][1] = f32::NAN;
    assert!(Regions::new(&gaussians, &[]).is_err());
}

#[test]
fn a_pixel_shows_the_gaussian_that_gives_most_of_it() {
    let (gaussians, labels) = plates();
    let projected = Projected::new(&gaussians.splats(), &camera(2), &Settings::default()).unwrap();
    let weights = projected.weights(&all_pixels([WIDTH, HEIGHT]));
    for pixel in (0..WIDTH * HEIGHT).step_by(7) {
        let (rows, values) = weights.row(pixel);
        let covered: f32 = values.iter().sum();
        let found = seed([pixel % WIDTH, pixel / WIDTH], &projected);
        assert_eq!(found.is_some(), covered >= 0.5);
        let Some(found) = found else { continue };
        let own = rows.iter().position(|&row| row == found).unwrap();
        assert!(values.iter().all(|value| *value <= values[own]));
        assert!(labels[found as usize] > 0);
    }
    let nothing = gaussians.select(&[]);
    let projected = Projected::new(&nothing.splats(), &camera(2), &Settings::default()).unwrap();
    assert_eq!(seed([0, 0], &projected), None);
}

//! Initial points for scenes without a point cloud: pixels pushed to the depth at which other photos agree best.

use crate::data::{Points, View};
use glam::{DMat3, DVec3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Depths tried for a pixel.
const DEPTHS: usize = 24;
/// Depths span this factor either way of the focus distance.
const REACH: f64 = 4.0;
/// Other views a depth is checked in, at most.
const WITNESSES: usize = 12;

/// `count` points in the frusta of `views`, coloured as the pixel they were drawn at.
///
/// Each lies on the ray of a random pixel of a random view. Of 24 depths, log-spaced with a random offset from a quarter
/// of to four times the focus distance, it takes the one at which the better half of the other views that see the point
/// show the most similar colour (mean absolute difference). The focus distance is the median depth of the point
/// nearest to all optical axes, or ten baselines where the axes are parallel.
///
/// Empty when there is no view with pixels.
pub fn points(views: &[&View], count: usize, rng: &mut ChaCha8Rng) -> Points {
    let views: Vec<&View> = views.iter().copied().filter(|v| v.camera.width > 0 && v.camera.height > 0).collect();
    if views.is_empty() {
        return Points::default();
    }
    let focus = focus_distance(&views);
    let witnesses: Vec<Vec<&View>> = (0..views.len()).map(|i| witnesses(&views, i)).collect();
    // drawn in order, judged in parallel
    let draws: Vec<(usize, u32, u32, f64)> = (0..count)
        .map(|_| {
            let i = rng.random_range(0..views.len());
            let camera = &views[i].camera;
            let (x, y) = (rng.random_range(0..camera.width), rng.random_range(0..camera.height));
            (i, x as u32, y as u32, rng.random())
        })
        .collect();
    let placed: Vec<([f32; 3], [f32; 3])> = draws
        .into_par_iter()
        .map(|(i, x, y, offset)| {
            let view = views[i];
            let color = view.image.get_pixel_checked(x, y).map_or([0; 3], |p| p.0);
            let ray = view.camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let at = |k: usize| {
                let share = 2.0 * (k as f64 + offset) / DEPTHS as f64 - 1.0;
                view.camera.center + ray * (focus * REACH.powf(share))
            };
            let judged = (0..DEPTHS).filter_map(|k| Some((disagreement(&witnesses[i], at(k), color)?, k)));
            // a pixel that no other view sees keeps a depth that is as random as its offset
            let chosen =
                judged.min_by(|a, b| a.0.total_cmp(&b.0)).map_or((offset * DEPTHS as f64) as usize, |(_, k)| k);
            (at(chosen).as_vec3().to_array(), color.map(|c| f32::from(c) / 255.0))
        })
        .collect();
    let (positions, colors) = placed.into_iter().unzip();
    Points { positions, colors }
}

/// Up to [`WITNESSES`] other views, spread over the nearer half of them.
fn witnesses<'a>(views: &[&'a View], index: usize) -> Vec<&'a View> {
    let center = views[index].camera.center;
    let mut others: Vec<usize> = (0..views.len()).filter(|&i| i != index).collect();
    others.sort_by(|&a, &b| {
        let distance = |i: usize| views[i].camera.center.distance_squared(center);
        distance(a).total_cmp(&distance(b)).then(a.cmp(&b))
    });
    let near = others.len().div_ceil(2).max(WITNESSES.min(others.len()));
    let stride = near.div_ceil(WITNESSES).max(1);
    others[..near].iter().step_by(stride).map(|&i| views[i]).collect()
}

/// Mean colour difference over the better half of the witnesses that see `position`; `None` when none does.
fn disagreement(witnesses: &[&View], position: DVec3, color: [u8; 3]) -> Option<f64> {
    let mut differences: Vec<u32> = witnesses
        .iter()
        .filter_map(|view| {
            let (u, v, _) = view.camera.project(position)?;
            if u < 0.0 || v < 0.0 {
                return None;
            }
            let pixel = view.image.get_pixel_checked(u as u32, v as u32)?;
            Some(pixel.0.iter().zip(color).map(|(&a, b)| u32::from(a.abs_diff(b))).sum())
        })
        .collect();
    differences.sort_unstable();
    let half = differences.len().div_ceil(2);
    (half > 0).then(|| f64::from(differences[..half].iter().sum::<u32>()) / half as f64)
}

/// Median depth of the point nearest to all optical axes, or ten baselines where that point is not in front.
fn focus_distance(views: &[&View]) -> f64 {
    let mean = views.iter().map(|v| v.camera.center).sum::<DVec3>() / views.len() as f64;
    let baseline = views.iter().map(|v| v.camera.center.distance(mean)).fold(0.0, f64::max);
    let fallback = if baseline > 0.0 { 10.0 * baseline } else { 1.0 };
    // normal equations of sum |(I - d d^T) (x - c)|^2
    let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
    for view in views {
        let d = view.camera.rotation.transpose().z_axis;
        let p = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        a += p;
        b += p * (view.camera.center - mean);
    }
    // parallel axes leave the depth undetermined
    if a.determinant() < 1e-4 * (views.len() as f64).powi(3) {
        return fallback;
    }
    let focus = a.inverse() * b + mean;
    let mut depths: Vec<f64> = views.iter().map(|v| v.camera.to_camera(focus).z).collect();
    depths.sort_by(f64::total_cmp);
    let median = depths[depths.len() / 2];
    if median.is_finite() && median > 0.1 * baseline { median } else { fallback }
}

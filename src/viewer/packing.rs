//! The numbers of a page, column by column, little endian: 83 bytes for each Gaussian of SH degree 3. A scene with labels has 4 more
//! for each, and 12 for each region.
//!
//! Centres are `f32`, superpoints and parents `u32`, heights and prominences `f32`. Lengths are logarithms in steps of 1/1024
//! (0.05 %), quaternions have steps of 1/32767, opacities of 1/65535, constant colour terms of 1/1024 (up to 32), view-dependent
//! ones of 1/127 of the largest of their Gaussian.

use crate::objects::Regions;
use crate::splat::{Gaussians, rotation};

const LOG_STEPS: f32 = 1024.0;
const BASE_STEPS: f32 = 1024.0;

/// Bytes of [`places`] and of the [`looks`] of all Gaussians, and of the superpoints of a scene with labels.
pub(super) fn bytes(gaussians: &Gaussians, has_labels: bool) -> usize {
    gaussians.len() * (35 + 3 * gaussians.sh_len() + if has_labels { 4 } else { 0 })
}

/// Superpoints, and the tree of regions.
pub(super) fn tree(regions: &Regions) -> Vec<u8> {
    let mut out = Vec::new();
    for column in [&regions.superpoints.of, &regions.parents] {
        out.extend(column.iter().flat_map(|v| v.to_le_bytes()));
    }
    for column in [&regions.heights, &regions.prominences] {
        out.extend(column.iter().flat_map(|v| v.to_le_bytes()));
    }
    out
}

/// Where Gaussians are: their centres, and the index of each one's object in the page's list.
pub(super) fn places(gaussians: &Gaussians, objects: &[u16]) -> Vec<u8> {
    let centers = gaussians.means.as_flattened().iter();
    let mut out: Vec<u8> = centers.flat_map(|v| v.to_le_bytes()).collect();
    out.extend(objects.iter().flat_map(|v| v.to_le_bytes()));
    out
}

/// What the Gaussians `rows` look like: shapes, opacities and colours.
pub(super) fn looks(gaussians: &Gaussians, rows: impl Iterator<Item = usize> + Clone) -> Vec<u8> {
    let width = 3 * gaussians.sh_len();
    let colours = || {
        let of = |row: usize| gaussians.sh[row * width..][..width].split_at(3);
        rows.clone().map(of)
    };
    let spread: Vec<i16> = colours()
        .map(|(_, rest)| steps(largest(rest).ln(), LOG_STEPS))
        .collect();

    let mut out = Vec::new();
    let scales = rows.clone().flat_map(|row| gaussians.log_scales[row]);
    out.extend(scales.flat_map(|v| steps(v, LOG_STEPS).to_le_bytes()));
    out.extend(
        colours()
            .flat_map(|(base, _)| base)
            .flat_map(|&v| steps(v, BASE_STEPS).to_le_bytes()),
    );
    let turns = rows.clone().flat_map(|row| {
        let q = rotation(&gaussians.rotations[row]);
        [q.w, q.x, q.y, q.z]
    });
    out.extend(turns.flat_map(|v| steps(v as f32, f32::from(i16::MAX)).to_le_bytes()));
    let opacities = rows
        .clone()
        .map(|row| 1.0 / (1.0 + (-gaussians.opacity_logits[row]).exp()));
    out.extend(opacities.flat_map(|v| ((v * f32::from(u16::MAX)).round() as u16).to_le_bytes()));
    out.extend(spread.iter().flat_map(|v| v.to_le_bytes()));
    for ((_, rest), &spread) in colours().zip(&spread) {
        // The scale that the page computes, with its rounding.
        let scale = 127.0 / (f32::from(spread) / LOG_STEPS).exp();
        out.extend(
            rest.iter()
                .map(|v| (v * scale).round().clamp(-127.0, 127.0) as i8 as u8),
        );
    }
    out
}

/// The nearest number of steps in range.
fn steps(value: f32, steps: f32) -> i16 {
    (value * steps).round() as i16
}

fn largest(values: &[f32]) -> f32 {
    values.iter().fold(0.0, |most, v| v.abs().max(most))
}

//! The objects of a labelled scene, and the object at a pixel.

use crate::raster::Projected;
use crate::splat::Gaussians;
use glam::DVec3;
use std::collections::BTreeMap;

/// Share of an object's Gaussians beyond its box on each side. Strays would make the box as large as the scene.
const CLIPPED_SHARE: f64 = 0.01;

/// The Gaussians of one label.
#[derive(Clone, Debug, PartialEq)]
pub struct Object {
    /// Label id.
    pub id: u16,
    /// Its Gaussians, ascending.
    pub rows: Vec<u32>,
    /// Lower corner of a box around the centres, in the coordinates of [`Gaussians::means`]. The box leaves out the outermost 1 %
    /// along each axis and side, at least one of three or more.
    pub low: DVec3,
    /// Upper corner.
    pub high: DVec3,
}

impl Object {
    /// Middle of the box.
    pub fn center(&self) -> DVec3 {
        0.5 * (self.low + self.high)
    }
}

/// The objects of a scene, ascending by id. Every id that occurs is an object.
///
/// # Panics
/// If `labels` does not have one id for each Gaussian.
pub fn inventory(gaussians: &Gaussians, labels: &[u16]) -> Vec<Object> {
    assert_eq!(labels.len(), gaussians.len(), "one label for each Gaussian");
    let object = |(id, rows): (u16, Vec<u32>)| {
        let beyond =
            ((CLIPPED_SHARE * rows.len() as f64).ceil() as usize).min((rows.len() - 1) / 2);
        let [x, y, z] = [0, 1, 2].map(|axis| {
            let mut along: Vec<f32> = rows
                .iter()
                .map(|&row| gaussians.means[row as usize][axis])
                .collect();
            along.sort_unstable_by(f32::total_cmp);
            [along[beyond], along[along.len() - 1 - beyond]].map(f64::from)
        });
        Object {
            id,
            rows,
            low: DVec3::new(x[0], y[0], z[0]),
            high: DVec3::new(x[1], y[1], z[1]),
        }
    };
    rows_by_label(labels).into_iter().map(object).collect()
}

/// The rows of each label, ascending.
pub(super) fn rows_by_label(labels: &[u16]) -> BTreeMap<u16, Vec<u32>> {
    let mut rows: BTreeMap<u16, Vec<u32>> = BTreeMap::new();
    for (row, &id) in (0..).zip(labels) {
        rows.entry(id).or_default().push(row);
    }
    rows
}

/// What a pixel shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Picked {
    /// The label whose Gaussians have the largest summed `alpha' T` there. Ties go to the lower id.
    pub id: u16,
    /// That sum, in (0, 1].
    pub weight: f64,
    /// Mean centre of its Gaussians by their weights, in the coordinates of [`Gaussians::means`].
    pub point: DVec3,
}

/// The Gaussians that a pixel (column, row) of the image of `projected` shows, and the `alpha' T` of each.
///
/// # Panics
/// If the pixel is outside the image.
pub(super) fn shares_of_pixel(projected: &Projected<f32>, [x, y]: [usize; 2]) -> Vec<(u32, f32)> {
    let [width, height] = projected.size();
    assert!(
        x < width && y < height,
        "pixel {x}, {y} of an image of {width} x {height}"
    );
    let weights = projected.weights(&[(y * width + x) as u32]);
    let (rows, values) = weights.row(0);
    rows.iter().copied().zip(values.iter().copied()).collect()
}

/// The object at a pixel (column, row) of the image of `projected`; `None` where no Gaussian contributes.
///
/// # Panics
/// If the pixel is outside the image, or `labels` does not have one id for each of `gaussians`, which `projected` shows.
pub fn pick(
    projected: &Projected<f32>,
    gaussians: &Gaussians,
    labels: &[u16],
    pixel: [usize; 2],
) -> Option<Picked> {
    assert!(
        labels.len() == gaussians.len() && labels.len() == projected.len(),
        "one label for each Gaussian"
    );
    let mut sums: BTreeMap<u16, (f64, DVec3)> = BTreeMap::new();
    for (row, weight) in shares_of_pixel(projected, pixel) {
        let weight = f64::from(weight);
        let sum = sums.entry(labels[row as usize]).or_default();
        sum.0 += weight;
        sum.1 += weight * DVec3::from(gaussians.means[row as usize].map(f64::from));
    }
    let best = sums
        .into_iter()
        .reduce(|best, other| if other.1.0 > best.1.0 { other } else { best });
    best.filter(|(_, (weight, _))| *weight > 0.0)
        .map(|(id, (weight, sum))| Picked {
            id,
            weight,
            point: sum / weight,
        })
}

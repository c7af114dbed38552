//! Principal components of feature vectors: centred, signs fixed, deterministic.
//!
//! Mean and scatter are accumulated in f64, block by block, and merged in a fixed order by the pairwise update of Chan,
//! Golub and LeVeque (1979), so the result does not depend on the number of threads and large means do not cancel.

use super::FeatureMap;
use crate::error::{Error, Result};
use nalgebra::{DMatrix, SymmetricEigen};
use rayon::prelude::*;

/// Rows accumulated as one block.
const BLOCK: usize = 512;

/// Mean and scatter matrix of rows seen so far.
#[derive(Clone, Debug)]
pub struct Moments {
    count: f64,
    mean: Vec<f64>,
    /// Sum of (x - mean)(x - mean)^T.
    scatter: DMatrix<f64>,
    largest: f64,
}

impl Moments {
    /// Of no rows yet, with `channels` columns.
    pub fn new(channels: usize) -> Self {
        Self {
            count: 0.0,
            mean: vec![0.0; channels],
            scatter: DMatrix::zeros(channels, channels),
            largest: 0.0,
        }
    }

    /// Adds rows, `[n, channels]` row-major; `what` names them in errors.
    ///
    /// # Errors
    /// [`Error::Argument`] when `channels` is not the number this was made for; [`Error::NonFinite`] with the first row that
    /// holds a NaN or an infinity.
    pub fn add(&mut self, rows: &[f32], what: &str, channels: usize) -> Result<()> {
        check_channels(what, channels, self.mean.len())?;
        if channels == 0 {
            return Ok(());
        }
        if let Some(at) = rows.iter().position(|x| !x.is_finite()) {
            return Err(Error::non_finite(what, at / channels));
        }
        // Blocks are independent; groups of them bound the memory, and merging follows the row order.
        for group in rows.chunks(BLOCK * channels * 16) {
            let parts: Vec<Self> = group
                .par_chunks(BLOCK * channels)
                .map(|b| Self::of_block(b, channels))
                .collect();
            for part in &parts {
                self.merge(part);
            }
        }
        Ok(())
    }

    fn of_block(rows: &[f32], channels: usize) -> Self {
        let n = rows.len() / channels;
        let mut mean = vec![0.0; channels];
        let mut largest = 0.0_f64;
        for row in rows.chunks_exact(channels) {
            for (m, &x) in mean.iter_mut().zip(row) {
                *m += f64::from(x);
                largest = largest.max(f64::from(x.abs()));
            }
        }
        mean.iter_mut().for_each(|m| *m /= n as f64);
        let centred = DMatrix::from_fn(channels, n, |c, r| {
            f64::from(rows[r * channels + c]) - mean[c]
        });
        let scatter = &centred * centred.transpose();
        Self {
            count: n as f64,
            mean,
            scatter,
            largest,
        }
    }

    fn merge(&mut self, other: &Self) {
        let total = self.count + other.count;
        if other.count == 0.0 {
            return;
        }
        let delta: Vec<f64> = other
            .mean
            .iter()
            .zip(&self.mean)
            .map(|(b, a)| b - a)
            .collect();
        let weight = self.count * other.count / total;
        for (j, column) in self
            .scatter
            .as_mut_slice()
            .chunks_exact_mut(delta.len().max(1))
            .enumerate()
        {
            let other = &other.scatter.as_slice()[j * delta.len()..][..delta.len()];
            for ((s, &o), &d) in column.iter_mut().zip(other).zip(&delta) {
                *s += o + weight * d * delta[j];
            }
        }
        for (m, d) in self.mean.iter_mut().zip(&delta) {
            *m += d * other.count / total;
        }
        self.count = total;
        self.largest = self.largest.max(other.largest);
    }
}

/// A fitted reduction from `channels` to `dimensions`.
#[derive(Clone, Debug, PartialEq)]
pub struct Pca {
    /// Columns in.
    pub channels: usize,
    /// Columns out; those past [`Pca::rank`] are zero.
    pub dimensions: usize,
    /// Components with variance: at most `min(channels, dimensions)`.
    pub rank: usize,
    /// Mean of the rows, `[channels]`.
    pub mean: Vec<f64>,
    /// Unit components as rows, descending by variance, `[rank, channels]`; of each, the entry of largest magnitude is
    /// positive.
    pub components: Vec<f64>,
    /// Variance along each component, `[rank]`, descending.
    pub variances: Vec<f64>,
    /// Share of the total variance that the components keep, 0..1; 1 when there is none.
    pub explained: f64,
    /// Projections no longer than this are rounding and become zero.
    pub floor: f64,
}

impl Pca {
    /// The leading `dimensions` components.
    ///
    /// Directions whose variance is within rounding of zero (1e-10 of the largest, or the square of f32 rounding of the
    /// largest value) are left out; the output has zeros in their place.
    pub fn fit(moments: &Moments, dimensions: usize) -> Self {
        let channels = moments.mean.len();
        if channels == 0 {
            let (mean, components, variances) = (vec![], vec![], vec![]);
            return Self {
                channels,
                dimensions,
                rank: 0,
                mean,
                components,
                variances,
                explained: 1.0,
                floor: 0.0,
            };
        }
        let covariance = &moments.scatter / moments.count.max(1.0);
        let total: f64 = covariance.diagonal().iter().sum();
        let eigen = SymmetricEigen::new(covariance);
        let mut order: Vec<usize> = (0..channels).collect();
        order.sort_by(|&a, &b| {
            eigen.eigenvalues[b]
                .total_cmp(&eigen.eigenvalues[a])
                .then(a.cmp(&b))
        });
        let first = order.first().map_or(0.0, |&i| eigen.eigenvalues[i]);
        let rounding = moments.largest * f64::from(f32::EPSILON);
        let floor = (first * 1e-10).max(rounding * rounding);
        order.retain(|&i| eigen.eigenvalues[i] > floor);
        order.truncate(dimensions);
        let mut components = Vec::with_capacity(order.len() * channels);
        for &i in &order {
            let v = eigen.eigenvectors.column(i);
            let peak = v
                .iter()
                .fold(0.0_f64, |a, &b| if b.abs() > a.abs() { b } else { a });
            components.extend(v.iter().map(|x| x * peak.signum()));
        }
        let variances: Vec<f64> = order.iter().map(|&i| eigen.eigenvalues[i]).collect();
        let kept: f64 = variances.iter().sum();
        let explained = if total > 0.0 {
            (kept / total).min(1.0)
        } else {
            1.0
        };
        let (mean, floor) = (moments.mean.clone(), floor.sqrt());
        Self {
            channels,
            dimensions,
            rank: order.len(),
            mean,
            components,
            variances,
            explained,
            floor,
        }
    }

    /// Each cell centred and projected, then divided by its Euclidean norm: `[h, w, dimensions]`. A cell that projects
    /// to zero within rounding is zero.
    /// `what` names the map in errors.
    ///
    /// # Errors
    /// [`Error::Argument`] when the map has another number of channels than the fit; [`Error::NonFinite`] on bad values.
    pub fn apply(&self, map: &FeatureMap, what: &str) -> Result<FeatureMap> {
        map.check(what)?;
        check_channels(what, map.channels, self.channels)?;
        let (c, d, rank) = (self.channels, self.dimensions, self.rank);
        let mut out = FeatureMap {
            steps: map.steps,
            ..FeatureMap::zeros(map.height, map.width, d)
        };
        // [channels, rank], so that the inner loop runs over outputs.
        let mut basis = vec![0.0_f64; c * rank];
        for (k, component) in self.components.chunks_exact(c.max(1)).enumerate() {
            for (i, &x) in component.iter().enumerate() {
                basis[i * rank + k] = x;
            }
        }
        if c == 0 || rank == 0 {
            return Ok(out);
        }
        out.data
            .par_chunks_exact_mut(d)
            .zip(map.data.par_chunks_exact(c))
            .with_min_len(256)
            .for_each_init(
                || vec![0.0_f64; rank],
                |sum, (out, cell)| {
                    sum.fill(0.0);
                    for ((&x, &m), basis) in
                        cell.iter().zip(&self.mean).zip(basis.chunks_exact(rank))
                    {
                        let x = f64::from(x) - m;
                        for (s, &b) in sum.iter_mut().zip(basis) {
                            *s += x * b;
                        }
                    }
                    let norm = sum.iter().map(|s| s * s).sum::<f64>().sqrt();
                    if norm > self.floor {
                        for (o, s) in out.iter_mut().zip(&*sum) {
                            *o = (s / norm) as f32;
                        }
                    }
                },
            );
        Ok(out)
    }
}

fn check_channels(what: &str, found: usize, expected: usize) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    Err(Error::argument(
        what,
        format!("{found} channels"),
        format!("{expected} channels, as in the first training view"),
        "make all maps of a scale alike",
    ))
}

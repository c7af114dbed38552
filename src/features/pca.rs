//! Principal components of feature vectors: centred, signs fixed, deterministic.
//!
//! Mean and scatter are accumulated in f64, block by block. The blocks are merged in a fixed order by the pairwise update of Chan,
//! Golub and LeVeque (1979). So the result does not depend on the number of threads, and large means do not cancel.

use super::FeatureMap;
use crate::backend::check_finite;
use crate::error::{Result, ensure};
use crate::ranks;
use nalgebra::{DMatrix, DVector, DVectorView, SymmetricEigen};
use rayon::prelude::*;

/// Rows accumulated as one block.
const BLOCK: usize = 512;

/// Mean and scatter matrix of rows seen so far.
#[derive(Clone, Debug)]
pub struct Moments {
    count: f64,
    mean: DVector<f64>,
    /// Sum of (x - mean)(x - mean)^T.
    scatter: DMatrix<f64>,
    largest: f64,
}

impl Moments {
    /// No rows yet, of `channels` columns.
    pub fn new(channels: usize) -> Self {
        Self {
            count: 0.0,
            mean: DVector::zeros(channels),
            scatter: DMatrix::zeros(channels, channels),
            largest: 0.0,
        }
    }

    /// Adds rows, `[n, channels]` row-major; `what` names them in errors.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] when `channels` is not the number this was made for; [`crate::Error::NonFinite`] with the first row that
    /// holds a NaN or an infinity.
    pub fn add(&mut self, rows: &[f32], what: &str, channels: usize) -> Result<()> {
        check_channels(what, channels, self.mean.len())?;
        check_finite(what, rows, channels)?;
        // Blocks are independent; groups of them bound the memory, and merging follows the row order.
        for group in rows.chunks((BLOCK * channels * 16).max(1)) {
            let blocks = group.par_chunks(BLOCK * channels);
            let parts: Vec<Self> = blocks
                .map(|block| Self::of_block(block, channels))
                .collect();
            parts.iter().for_each(|part| self.merge(part));
        }
        Ok(())
    }

    fn of_block(rows: &[f32], channels: usize) -> Self {
        let n = rows.len() / channels;
        let mut rows = columns(rows, channels);
        let largest = rows.amax();
        let mean = rows.column_mean();
        rows.column_iter_mut().for_each(|mut row| row -= &mean);
        Self {
            count: n as f64,
            mean,
            scatter: &rows * rows.transpose(),
            largest,
        }
    }

    /// Adds the rows of the other ranks.
    ///
    /// # Errors
    /// Those of [`ranks::gather`].
    pub fn add_other_ranks(&mut self) -> Result<()> {
        if ranks::count() == 1 {
            return Ok(());
        }
        let mut count = [self.count];
        ranks::sum(&mut count);
        let mut mean = &self.mean * (self.count / count[0]);
        ranks::sum(mean.as_mut_slice());
        let delta = &self.mean - &mean;
        self.scatter.ger(self.count, &delta, &delta, 1.0);
        ranks::sum(self.scatter.as_mut_slice());
        self.mean = mean;
        self.count = count[0];
        self.largest = ranks::gather(self.largest)?.into_iter().fold(0.0, f64::max);
        Ok(())
    }

    fn merge(&mut self, other: &Self) {
        let total = self.count + other.count;
        let delta = &other.mean - &self.mean;
        self.scatter += &other.scatter;
        self.scatter
            .ger(self.count * other.count / total, &delta, &delta, 1.0);
        self.mean.axpy(other.count / total, &delta, 1.0);
        self.count = total;
        self.largest = self.largest.max(other.largest);
    }
}

/// Cells `[n, channels]` as the columns of a matrix.
fn columns(cells: &[f32], channels: usize) -> DMatrix<f64> {
    let values = cells.iter().map(|&v| f64::from(v));
    DMatrix::from_iterator(channels, cells.len() / channels, values)
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
    /// Unit components as rows, descending by variance, `[rank, channels]`. The entry of largest magnitude of each is positive.
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
    /// Directions whose variance is zero within rounding (1e-10 of the largest, or the square of f32 rounding of the largest value)
    /// are left out. The output has zeros in their place.
    pub fn fit(moments: &Moments, dimensions: usize) -> Self {
        let channels = moments.mean.len();
        let covariance = &moments.scatter / moments.count.max(1.0);
        let total = covariance.trace();
        let eigen = match channels {
            0 => None,
            _ => Some(SymmetricEigen::new(covariance)),
        };
        let mut axes: Vec<(f64, &[f64])> = eigen.iter().flat_map(axes_of).collect();
        axes.sort_by(|a, b| b.0.total_cmp(&a.0));
        let first = axes.first().map_or(0.0, |(variance, _)| *variance);
        let rounding = moments.largest * f64::from(f32::EPSILON);
        let floor = (first * 1e-10).max(rounding * rounding);
        axes.retain(|(variance, _)| *variance > floor);
        axes.truncate(dimensions);
        let signed = |axis: &[f64]| {
            let peak = axis
                .iter()
                .fold(0.0_f64, |a, &b| if b.abs() > a.abs() { b } else { a });
            axis.iter().map(|x| x * peak.signum()).collect::<Vec<_>>()
        };
        let variances: Vec<f64> = axes.iter().map(|(variance, _)| *variance).collect();
        let kept: f64 = variances.iter().sum();
        Self {
            channels,
            dimensions,
            rank: axes.len(),
            mean: moments.mean.as_slice().to_vec(),
            components: axes.iter().flat_map(|(_, axis)| signed(axis)).collect(),
            variances,
            explained: if total > 0.0 {
                (kept / total).min(1.0)
            } else {
                1.0
            },
            floor: floor.sqrt(),
        }
    }

    /// Rows `[n, channels]` centred and projected, `[n, dimensions]`; `what` names them in errors.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] with the first row that holds a NaN or an infinity.
    pub fn project(&self, rows: &[f32], what: &str) -> Result<Vec<f32>> {
        check_finite(what, rows, self.channels)?;
        let mut out = vec![0.0; rows.len() / self.channels.max(1) * self.dimensions];
        self.each_projection(rows, &mut out, |projection, out| {
            let along = out.iter_mut().zip(projection);
            along.for_each(|(out, v)| *out = *v as f32);
        });
        Ok(out)
    }

    /// Calls `store` with the projection `[rank]` of each of the rows, centred, and with its row of `out` `[n, dimensions]`.
    fn each_projection(
        &self,
        rows: &[f32],
        out: &mut [f32],
        store: impl Fn(DVectorView<'_, f64>, &mut [f32]) + Sync,
    ) {
        if self.rank == 0 {
            return;
        }
        let components = DMatrix::from_row_slice(self.rank, self.channels, &self.components);
        let mean = DVector::from_column_slice(&self.mean);
        let blocks = out.par_chunks_mut(BLOCK * self.dimensions);
        let blocks = blocks.zip(rows.par_chunks(BLOCK * self.channels));
        blocks.for_each(|(out, rows)| {
            let mut rows = columns(rows, self.channels);
            rows.column_iter_mut().for_each(|mut row| row -= &mean);
            let projected = &components * rows;
            let places = out.chunks_exact_mut(self.dimensions);
            let places = projected.column_iter().zip(places);
            places.for_each(|(projection, out)| store(projection, out));
        });
    }

    /// Each cell centred and projected, then divided by its Euclidean norm: `[h, w, dimensions]`. A cell that projects
    /// to zero within rounding is zero.
    /// `what` names the map in errors.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] when the map has a different number of channels than the fit; [`crate::Error::NonFinite`] on
    /// bad values.
    pub fn apply(&self, map: &FeatureMap, what: &str) -> Result<FeatureMap> {
        map.check(what)?;
        check_channels(what, map.channels, self.channels)?;
        let mut out = FeatureMap {
            steps: map.steps,
            ..FeatureMap::zeros(map.height, map.width, self.dimensions)
        };
        self.each_projection(&map.data, &mut out.data, |projection, out| {
            let norm = projection.norm();
            if norm > self.floor {
                let along = out.iter_mut().zip(&projection);
                along.for_each(|(out, v)| *out = (v / norm) as f32);
            }
        });
        Ok(out)
    }
}

/// Variance and direction of each axis.
fn axes_of(eigen: &SymmetricEigen<f64, nalgebra::Dyn>) -> impl Iterator<Item = (f64, &[f64])> {
    let vectors = eigen.eigenvectors.as_slice();
    let axes = vectors.chunks_exact(eigen.eigenvalues.len());
    eigen.eigenvalues.iter().copied().zip(axes)
}

fn check_channels(what: &str, found: usize, expected: usize) -> Result<()> {
    ensure!(found == expected, argument "{what}"; found "{found} channels";
        expected "{expected} channels, as in the first training view";
        help "make all maps of a scale alike");
    Ok(())
}

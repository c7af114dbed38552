//! Compactness: how far neighbouring Gaussians disagree, and diffusion of identities over their neighbour graph.
//!
//! Diffusion is label spreading (Zhou et al. 2004, *Learning with Local and Global Consistency*), normalised by rows:
//! `x <- (1 - a) x0 + a D^-1 A x`. Gaussian i and its neighbour j have the affinity
//! `A_ij = exp(-|p_i - p_j|^2 / (2 h_i h_j)) exp(-(1 - cos(f_i, f_j)) / t)`, where h is the mean distance to the neighbours
//! (Zelnik-Manor and Perona 2004) and f are image features. Affinities are made row by row and never kept.

use super::Identities;
use crate::error::{Error, Result};
use crate::segmentation::neighbours::without_self;
use rayon::prelude::*;

/// How identities are diffused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Diffusion {
    /// Passes over the graph.
    pub steps: usize,
    /// a: how much a Gaussian takes from its neighbours in a pass, in (0, 1).
    pub strength: f64,
    /// t: difference of two features, 1 - cos, at which their affinity falls to 1/e; above 0.
    pub temperature: f64,
}

/// The K nearest neighbours of every Gaussian, with what affinities are made of.
pub struct NeighbourGraph<'a> {
    means: &'a [[f32; 3]],
    /// `[N, K]`, without the Gaussian itself.
    neighbours: Vec<u32>,
    k: usize,
    /// Mean distance to the neighbours.
    reach: Vec<f32>,
    /// `[N, D]`; empty: affinity by distance alone.
    features: &'a [f32],
    /// Length of each row of `features`.
    norms: Vec<f32>,
}

impl<'a> NeighbourGraph<'a> {
    /// The graph of `k` neighbours over Gaussians at `means`, with image features `[N, D]` or none.
    ///
    /// # Errors
    /// [`Error::NonFinite`] naming the first bad row; [`Error::Argument`] when `features` are of another number of Gaussians.
    pub fn new(means: &'a [[f32; 3]], features: &'a [f32], k: usize) -> Result<Self> {
        let n = means.len();
        if n == 0 || !features.len().is_multiple_of(n) {
            if !features.is_empty() {
                let (found, expected) = (
                    format!("{} numbers", features.len()),
                    format!("a multiple of {n}"),
                );
                return Err(Error::argument(
                    "features of the neighbour graph",
                    found,
                    expected,
                    "pass one row a Gaussian",
                ));
            }
            return Ok(Self {
                means,
                neighbours: Vec::new(),
                k,
                reach: Vec::new(),
                features,
                norms: Vec::new(),
            });
        }
        let d = features.len() / n;
        if let Some(at) = features.iter().position(|f| !f.is_finite()) {
            return Err(Error::non_finite(
                "features of the neighbour graph",
                at / d.max(1),
            ));
        }
        let neighbours = without_self(means, k)?;
        let mean_distance = |(i, row): (usize, &[u32])| {
            row.iter()
                .map(|&j| squared_distance(&means[i], &means[j as usize]).sqrt())
                .sum::<f32>()
                / k as f32
        };
        let reach = neighbours
            .chunks_exact(k.max(1))
            .enumerate()
            .map(mean_distance)
            .collect();
        let norms = match d {
            0 => Vec::new(),
            _ => features
                .chunks_exact(d)
                .map(|f| f.iter().map(|v| v * v).sum::<f32>().sqrt())
                .collect(),
        };
        Ok(Self {
            means,
            neighbours,
            k,
            reach,
            features,
            norms,
        })
    }

    /// Share of the pairs of a Gaussian and a neighbour, both of which have a label, whose labels differ; 0 without pairs.
    pub fn disagreement(&self, identities: &Identities) -> f64 {
        let labels = identities.labels();
        let rows = labels
            .iter()
            .zip(self.neighbours.chunks_exact(self.k.max(1)));
        let (mut pairs, mut differ) = (0_u64, 0_u64);
        for (own, row) in rows {
            let Some(own) = own else { continue };
            for other in row.iter().filter_map(|&j| labels[j as usize]) {
                pairs += 1;
                differ += u64::from(other != *own);
            }
        }
        differ as f64 / pairs.max(1) as f64
    }

    /// `identities` after `diffusion`. Scores must not be negative; rows are brought to the sum 1 first, and those without
    /// any score take what their neighbours have.
    ///
    /// # Errors
    /// [`Error::Argument`] for identities of another number of Gaussians; [`Error::NonFinite`] for a negative score or none.
    pub fn diffused(&self, identities: &Identities, diffusion: &Diffusion) -> Result<Identities> {
        let classes = identities.classes;
        if identities.scores.len() != self.means.len() * classes {
            let (found, expected) = (identities.scores.len() / classes.max(1), self.means.len());
            let help = "diffuse the identities of the graph's own Gaussians";
            return Err(Error::argument(
                "identities",
                format!("{found} rows"),
                format!("{expected}"),
                help,
            ));
        }
        if let Some(at) = identities
            .scores
            .iter()
            .position(|s| !(s.is_finite() && *s >= 0.0))
        {
            return Err(Error::non_finite("scores to diffuse", at / classes));
        }
        if classes == 0 || self.k == 0 {
            return Ok(identities.clone());
        }
        let mut start = identities.scores.clone();
        for row in start.chunks_exact_mut(classes) {
            let sum: f32 = row.iter().sum();
            row.iter_mut()
                .for_each(|v| *v /= sum.max(f32::MIN_POSITIVE));
        }
        let mut scores = start.clone();
        for _ in 0..diffusion.steps {
            scores = self.pass(&start, &scores, classes, diffusion);
        }
        Ok(Identities { scores, classes })
    }

    fn pass(
        &self,
        start: &[f32],
        scores: &[f32],
        classes: usize,
        diffusion: &Diffusion,
    ) -> Vec<f32> {
        let strength = diffusion.strength as f32;
        let mut out = vec![0.0; scores.len()];
        out.par_chunks_exact_mut(classes)
            .enumerate()
            .with_min_len(256)
            .for_each(|(i, out)| {
                let mut total = 0.0;
                for &j in &self.neighbours[i * self.k..][..self.k] {
                    let from = &scores[j as usize * classes..][..classes];
                    // A neighbour that knows nothing has no say.
                    if from.iter().all(|v| *v == 0.0) {
                        continue;
                    }
                    let affinity = self.affinity(i, j as usize, diffusion.temperature as f32);
                    total += affinity;
                    out.iter_mut()
                        .zip(from)
                        .for_each(|(o, v)| *o += affinity * v);
                }
                let own = &start[i * classes..][..classes];
                let unknown = own.iter().all(|v| *v == 0.0);
                let share = match (total > 0.0, unknown) {
                    (false, _) => 0.0,
                    (true, true) => 1.0,
                    (true, false) => strength,
                };
                let factor = if total > 0.0 { share / total } else { 0.0 };
                out.iter_mut()
                    .zip(own)
                    .for_each(|(o, v)| *o = *o * factor + (1.0 - share) * v);
            });
        out
    }

    fn affinity(&self, i: usize, j: usize, temperature: f32) -> f32 {
        // Gaussians at one place are as near as can be.
        let scale = (2.0 * self.reach[i] * self.reach[j]).max(f32::MIN_POSITIVE);
        let away = (squared_distance(&self.means[i], &self.means[j]) / scale).min(80.0);
        let apart = match self.norms.is_empty() {
            true => 0.0,
            false => {
                let d = self.features.len() / self.means.len();
                let row = |i: usize| &self.features[i * d..][..d];
                let dot: f32 = row(i).iter().zip(row(j)).map(|(a, b)| a * b).sum();
                let norms = self.norms[i] * self.norms[j];
                if norms > 0.0 {
                    ((1.0 - dot / norms).max(0.0) / temperature).min(80.0)
                } else {
                    0.0
                }
            }
        };
        (-away - apart).exp()
    }
}

fn squared_distance(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

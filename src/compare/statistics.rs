//! Means and spreads of cells, and which row is the best.

use crate::metrics::mean;
use serde::Serialize;

/// The mean of some cells and its spread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Statistic {
    /// Mean over scenes of each scene's mean over seeds.
    pub mean: f64,
    /// Standard deviation, over seeds, of the mean over scenes. `None` where fewer than two seeds have all scenes.
    pub spread: Option<f64>,
    /// Cells that have the figure.
    pub cells: usize,
}

impl Statistic {
    /// The statistic of `values` by scene and seed; `None` without values.
    pub fn of(values: &[Vec<Option<f64>>]) -> Option<Self> {
        let scenes = values.iter().map(|seeds| mean(seeds.iter().copied()));
        let seeds = values.iter().map(Vec::len).min().unwrap_or(0);
        let of_seed = |seed: usize| {
            let scenes: Option<Vec<f64>> = values.iter().map(|seeds| seeds[seed]).collect();
            mean(scenes?.into_iter().map(Some))
        };
        let means: Vec<f64> = (0..seeds).filter_map(of_seed).collect();
        Some(Self {
            mean: mean(scenes)?,
            spread: deviation(&means),
            cells: values.iter().flatten().flatten().count(),
        })
    }
}

/// Standard deviation of a sample.
fn deviation(values: &[f64]) -> Option<f64> {
    let mean = mean(values.iter().copied().map(Some)).filter(|_| values.len() > 1)?;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    Some((squares / (values.len() - 1) as f64).sqrt())
}

/// The row whose mean, times `sign`, is ahead of all others by more than the larger spread of the two first. `None` where a row
/// does not have `all` of its cells: it may be better than those that do.
pub(super) fn best(rows: &[Option<Statistic>], all: usize, sign: f64) -> Option<usize> {
    let complete = |row: &Option<Statistic>| row.filter(|row| row.cells == all);
    let rows: Option<Vec<Statistic>> = rows.iter().map(complete).collect();
    let mut order: Vec<(usize, Statistic)> = rows?.into_iter().enumerate().collect();
    order.sort_by(|a, b| (sign * b.1.mean).total_cmp(&(sign * a.1.mean)));
    let [(first, best), (_, next), ..] = order[..] else {
        return None;
    };
    let spread = best.spread?.max(next.spread?);
    (sign * (best.mean - next.mean) > spread).then_some(first)
}

//! How well features separate into given clusters, without truth.

use nalgebra::DVector;
use std::collections::BTreeMap;

/// A cluster of feature vectors.
struct Cluster {
    size: f64,
    centroid: DVector<f64>,
    /// Sum of squared distances to the centroid.
    squares: f64,
    /// Mean distance to the centroid.
    spread: f64,
}

impl Cluster {
    fn of(rows: &[&[f32]]) -> Self {
        let wide =
            |row: &&[f32]| DVector::from_iterator(row.len(), row.iter().map(|&v| f64::from(v)));
        let size = rows.len() as f64;
        let centroid = rows.iter().map(wide).sum::<DVector<f64>>() / size;
        let distances: Vec<f64> = rows
            .iter()
            .map(|row| wide(row).metric_distance(&centroid))
            .collect();
        Self {
            size,
            centroid,
            squares: distances.iter().map(|d| d * d).sum(),
            spread: distances.iter().sum::<f64>() / size,
        }
    }
}

/// The clusters of `features` `[N, dimensions]` under `labels` `[N]`. None unless the lengths agree, all values are finite, and
/// 2 <= clusters < N.
fn clusters(features: &[f32], dimensions: usize, labels: &[u16]) -> Option<Vec<Cluster>> {
    let n = labels.len();
    let fits = dimensions > 0 && features.len() == n.checked_mul(dimensions)?;
    if !fits || features.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let mut rows: BTreeMap<u16, Vec<&[f32]>> = BTreeMap::new();
    for (row, label) in features.chunks_exact(dimensions).zip(labels) {
        rows.entry(*label).or_default().push(row);
    }
    let clusters = rows.values().map(|rows| Cluster::of(rows));
    (2..n).contains(&rows.len()).then(|| clusters.collect())
}

/// Calinski-Harabasz index of `features` `[N, dimensions]` under `labels` `[N]` (1974): between-cluster over
/// within-cluster dispersion, each by its degrees of freedom. Higher is better separated.
///
/// `None` unless 2 <= clusters < N, all values are finite, the lengths agree and the clusters have any spread.
pub fn calinski_harabasz(features: &[f32], dimensions: usize, labels: &[u16]) -> Option<f64> {
    let clusters = clusters(features, dimensions, labels)?;
    let n = labels.len() as f64;
    let k = clusters.len() as f64;
    let sums = clusters.iter().map(|c| &c.centroid * c.size);
    let mean = sums.sum::<DVector<f64>>() / n;
    let between = clusters
        .iter()
        .map(|c| c.size * (&c.centroid - &mean).norm_squared())
        .sum::<f64>();
    let within: f64 = clusters.iter().map(|c| c.squares).sum();
    (within > 0.0).then(|| (between / (k - 1.0)) / (within / (n - k)))
}

/// Davies-Bouldin index of `features` `[N, dimensions]` under `labels` `[N]` (1979): the mean over clusters of the worst
/// ratio of spreads to centroid distance. Lower is better separated.
///
/// Clusters with one and the same centroid are not compared with each other, as in scikit-learn. `None` unless
/// 2 <= clusters < N, all values are finite, the lengths agree and two centroids differ.
pub fn davies_bouldin(features: &[f32], dimensions: usize, labels: &[u16]) -> Option<f64> {
    let clusters = clusters(features, dimensions, labels)?;
    let worst = |a: &Cluster| {
        let others = clusters.iter().filter_map(|b| {
            let distance = a.centroid.metric_distance(&b.centroid);
            (distance > 0.0).then(|| (a.spread + b.spread) / distance)
        });
        others.max_by(f64::total_cmp)
    };
    let ratios: Vec<Option<f64>> = clusters.iter().map(worst).collect();
    let sum: f64 = ratios.iter().flatten().sum();
    let is_compared = ratios.iter().any(Option::is_some);
    is_compared.then(|| sum / clusters.len() as f64)
}

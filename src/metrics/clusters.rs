//! How well features separate into given clusters, without truth.

/// Centroids, sizes and distances to the centroids of a clustering; f64 throughout.
struct Clusters {
    /// `[K, D]`.
    centroids: Vec<f64>,
    sizes: Vec<f64>,
    /// Sum of squared distances to the centroid, per cluster.
    squares: Vec<f64>,
    /// Mean distance to the centroid, per cluster.
    spread: Vec<f64>,
    /// Mean of all rows, `[D]`.
    mean: Vec<f64>,
}

impl Clusters {
    /// `None` unless the rows fit their labels, all are finite, and 2 <= clusters < rows.
    fn new(features: &[f32], dimensions: usize, labels: &[u16]) -> Option<Self> {
        let n = labels.len();
        if dimensions == 0
            || features.len() != n.checked_mul(dimensions)?
            || features.iter().any(|v| !v.is_finite())
        {
            return None;
        }
        let mut ids = labels.to_vec();
        ids.sort_unstable();
        ids.dedup();
        let k = ids.len();
        if k < 2 || k >= n {
            return None;
        }
        let cluster: Vec<usize> = labels
            .iter()
            .filter_map(|l| ids.binary_search(l).ok())
            .collect();
        let rows = || {
            features
                .chunks_exact(dimensions)
                .zip(cluster.iter().copied())
        };
        let (mut centroids, mut sizes) = (vec![0.0; k * dimensions], vec![0.0; k]);
        for (row, c) in rows() {
            sizes[c] += 1.0;
            add(
                &mut centroids[c * dimensions..][..dimensions],
                row.iter().map(|&v| f64::from(v)),
            );
        }
        let mut mean = vec![0.0; dimensions];
        for (centroid, &size) in centroids.chunks_exact_mut(dimensions).zip(&sizes) {
            add(&mut mean, centroid.iter().map(|v| v / n as f64));
            centroid.iter_mut().for_each(|v| *v /= size);
        }
        let (mut squares, mut spread) = (vec![0.0; k], vec![0.0; k]);
        for (row, c) in rows() {
            let centroid = &centroids[c * dimensions..][..dimensions];
            let square = squared_distance(row.iter().map(|&v| f64::from(v)), centroid);
            squares[c] += square;
            spread[c] += square.sqrt() / sizes[c];
        }
        Some(Self {
            centroids,
            sizes,
            squares,
            spread,
            mean,
        })
    }

    fn centroid(&self, c: usize) -> &[f64] {
        let d = self.mean.len();
        &self.centroids[c * d..][..d]
    }
}

fn add(to: &mut [f64], values: impl Iterator<Item = f64>) {
    to.iter_mut().zip(values).for_each(|(a, b)| *a += b);
}

fn squared_distance(a: impl Iterator<Item = f64>, b: &[f64]) -> f64 {
    a.zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// Calinski-Harabasz index of `features` `[N, dimensions]` under `labels` `[N]` (1974): between-cluster over
/// within-cluster dispersion, each by its degrees of freedom. Higher is better separated.
///
/// `None` unless 2 <= clusters < N, all values are finite, the lengths agree and the clusters have any spread.
pub fn calinski_harabasz(features: &[f32], dimensions: usize, labels: &[u16]) -> Option<f64> {
    let clusters = Clusters::new(features, dimensions, labels)?;
    let (k, n) = (clusters.sizes.len(), labels.len());
    let between: f64 = (0..k)
        .map(|c| {
            clusters.sizes[c]
                * squared_distance(clusters.centroid(c).iter().copied(), &clusters.mean)
        })
        .sum();
    let within: f64 = clusters.squares.iter().sum();
    (within > 0.0).then(|| (between / (k - 1) as f64) / (within / (n - k) as f64))
}

/// Davies-Bouldin index of `features` `[N, dimensions]` under `labels` `[N]` (1979): the mean over clusters of the worst
/// ratio of spreads to centroid distance. Lower is better separated.
///
/// Clusters with one and the same centroid are not compared with each other, as in scikit-learn. `None` unless
/// 2 <= clusters < N, all values are finite, the lengths agree and two centroids differ.
pub fn davies_bouldin(features: &[f32], dimensions: usize, labels: &[u16]) -> Option<f64> {
    let clusters = Clusters::new(features, dimensions, labels)?;
    let k = clusters.sizes.len();
    let mut compared = false;
    let mut worst = vec![0.0_f64; k];
    for i in 0..k {
        for j in i + 1..k {
            let distance =
                squared_distance(clusters.centroid(i).iter().copied(), clusters.centroid(j)).sqrt();
            if distance > 0.0 {
                let ratio = (clusters.spread[i] + clusters.spread[j]) / distance;
                worst[i] = worst[i].max(ratio);
                worst[j] = worst[j].max(ratio);
                compared = true;
            }
        }
    }
    compared.then(|| worst.iter().sum::<f64>() / k as f64)
}

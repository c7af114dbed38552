//! Exact nearest neighbours in 3D, the same at any thread count and for any input order of equal distances.

use crate::backend::check_finite;
use crate::error::{Error, Result, bail, invalid};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;

/// Two squared distances closer than this share of the larger are looked at again in our own arithmetic, because the
/// tree may round them differently.
const TIE_TOLERANCE: f64 = 1e-12;

/// Rows of `k` neighbours.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Neighbours {
    /// Neighbours a row.
    pub k: usize,
    /// `[N, k]` row-major indices of points.
    pub indices: Vec<u32>,
}

impl Neighbours {
    /// Number of rows.
    pub fn len(&self) -> usize {
        self.indices.len().checked_div(self.k).unwrap_or(0)
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.indices.is_empty()
    }

    /// Neighbours of row `i`.
    pub fn row(&self, i: usize) -> &[u32] {
        &self.indices[i * self.k..][..self.k]
    }
}

/// A point set that answers nearest-neighbour queries.
///
/// Points at the same position share one entry of the tree, so that a cloud of identical points costs no more than any
/// other. Ties are resolved by the smaller index.
pub struct PointIndex {
    /// All points, in f64 so that squared distances neither overflow nor lose bits.
    points: Vec<[f64; 3]>,
    /// Indices of points, grouped by position, ascending within a group.
    members: Vec<u32>,
    /// Start of each group in `members`; one more entry than groups.
    offsets: Vec<u32>,
    /// One entry a group; absent when there are no points.
    tree: Option<ImmutableKdTree<f64, 3>>,
}

impl PointIndex {
    /// Indexes `points` (`[N, 3]`, any unit).
    ///
    /// # Errors
    /// [`Error::NonFinite`] naming the first bad row; [`Error::Limit`] above 2^32 - 1 points.
    pub fn new(points: &[[f32; 3]]) -> Result<Self> {
        check_finite("points", points.as_flattened(), 3)?;
        if u32::try_from(points.len()).is_err() {
            return Err(too_many(points.len().to_string()));
        }
        let points: Vec<[f64; 3]> = points.iter().map(wide).collect();
        let mut members: Vec<u32> = (0..points.len() as u32).collect();
        members.par_sort_unstable_by(|&a, &b| {
            order(&points[a as usize], &points[b as usize]).then(a.cmp(&b))
        });
        let mut offsets = Vec::new();
        let mut unique = Vec::new();
        for (i, &m) in members.iter().enumerate() {
            if unique.last() != Some(&points[m as usize]) {
                offsets.push(i as u32);
                unique.push(points[m as usize]);
            }
        }
        offsets.push(members.len() as u32);
        let tree = if unique.is_empty() {
            None
        } else {
            let tree = ImmutableKdTree::new_from_slice(&unique);
            Some(tree.map_err(|e| too_many(e.to_string()))?)
        };
        Ok(Self {
            points,
            members,
            offsets,
            tree,
        })
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The `k` nearest points of every point: itself first, then by distance, ties by index.
    /// A set smaller than `k` repeats its members in that order.
    pub fn neighbours(&self, k: usize) -> Neighbours {
        let mut indices = vec![0; self.len() * k];
        if k > 0 {
            indices
                .par_chunks_mut(k)
                .enumerate()
                .for_each_init(Vec::new, |found, (i, row)| {
                    self.collect(&self.points[i], k, found);
                    row[0] = i as u32;
                    let others = found.iter().map(|&(_, j)| j).filter(|&j| j as usize != i);
                    fill(row, 1, others);
                });
        }
        Neighbours { k, indices }
    }

    /// The `k` nearest points of every query, by distance, ties by index, and their squared distances (`[Q, k]`).
    /// A set smaller than `k` repeats its members in that order; an empty one is an error.
    ///
    /// # Errors
    /// [`Error::NonFinite`] naming the first bad query; [`Error::Argument`] when there are no points to find.
    pub fn nearest(&self, queries: &[[f32; 3]], k: usize) -> Result<(Neighbours, Vec<f64>)> {
        check_finite("queries", queries.as_flattened(), 3)?;
        if self.is_empty() && k > 0 && !queries.is_empty() {
            bail!(argument "points"; found "none"; expected "at least one point";
                help "give the search a point to find");
        }
        let mut indices = vec![0; queries.len() * k];
        let mut distances = vec![0.0; queries.len() * k];
        if k > 0 {
            let rows = indices.par_chunks_mut(k).zip(distances.par_chunks_mut(k));
            rows.zip(queries)
                .for_each_init(Vec::new, |found, ((row, distance), query)| {
                    let query = wide(query);
                    self.collect(&query, k, found);
                    fill(row, 0, found.iter().map(|&(_, j)| j));
                    for (d, &j) in distance.iter_mut().zip(&*row) {
                        *d = squared_distance(&self.points[j as usize], &query);
                    }
                });
        }
        Ok((Neighbours { k, indices }, distances))
    }

    /// Root mean square distance of each point to its `k` nearest other positions, or to all if there are fewer. `None` where
    /// there is no other.
    pub fn rms_distances(&self, k: usize) -> Vec<Option<f64>> {
        let mut distances = vec![None; self.len()];
        let (Some(tree), Some(wanted)) = (&self.tree, NonZero::new(k + 1)) else {
            return distances;
        };
        for group in 0..self.offsets.len() - 1 {
            let members = self.group(group);
            let near = tree
                .query(&self.points[members[0] as usize])
                .nearest_n::<SquaredEuclidean<f64>>(wanted)
                .execute();
            // The position itself is the one hit at distance 0.
            let others = near.len() - 1;
            let sum: f64 = near.iter().map(|hit| hit.distance).sum();
            let rms = (others > 0).then(|| (sum / others as f64).sqrt());
            members.iter().for_each(|&i| distances[i as usize] = rms);
        }
        distances
    }

    /// The points within `radius` of `query`, in no order.
    pub fn within(&self, query: [f64; 3], radius: f64) -> impl Iterator<Item = u32> {
        let near = self.tree.as_ref().map(|tree| {
            let query = tree
                .query(&query)
                .within::<SquaredEuclidean<f64>>(radius * radius);
            query.unsorted().execute()
        });
        let groups = near.into_iter().flatten().map(|hit| hit.item as usize);
        groups.flat_map(|group| self.group(group).iter().copied())
    }

    /// The points of one position.
    fn group(&self, group: usize) -> &[u32] {
        &self.members[self.offsets[group] as usize..self.offsets[group + 1] as usize]
    }

    /// Puts the nearest `k` points (fewer in a small set) into `found` as (squared distance, index), ascending.
    fn collect(&self, query: &[f64; 3], k: usize, found: &mut Vec<(f64, u32)>) {
        found.clear();
        let Some(tree) = &self.tree else { return };
        let groups = self.offsets.len() - 1;
        // one more than asked for shows whether the cut falls between equal distances
        let Some(wanted) = NonZero::new((k + 1).min(groups)) else {
            return;
        };
        let near = tree
            .query(query)
            .nearest_n::<SquaredEuclidean<f64>>(wanted)
            .execute();
        let mut add = |group: u32| {
            let members = self.group(group as usize);
            let distance = squared_distance(&self.points[members[0] as usize], query);
            found.extend(members.iter().take(k + 1).map(|&m| (distance, m)));
        };
        let cut = (near.len() > k && k > 0).then(|| (near[k - 1].distance, near[k].distance));
        match cut {
            Some((inside, outside)) if outside <= inside * (1.0 + TIE_TOLERANCE) => {
                let radius = inside * (1.0 + TIE_TOLERANCE);
                for hit in tree
                    .query(query)
                    .within::<SquaredEuclidean<f64>>(radius)
                    .unsorted()
                    .execute()
                {
                    add(hit.item);
                }
            }
            _ => near.iter().for_each(|hit| add(hit.item)),
        }
        found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        // one spare, because a point's own row puts it first wherever it stands here
        found.truncate(k + 1);
    }
}

/// `[N, k]` nearest other points of every point; a set of k points or fewer repeats them, a single point itself.
///
/// # Errors
/// [`Error::NonFinite`] naming the first bad row.
pub fn without_self(points: &[[f32; 3]], k: usize) -> Result<Vec<u32>> {
    let near = PointIndex::new(points)?.neighbours((k + 1).min(points.len()));
    let others = |i| match near.row(i) {
        [own] => vec![*own; k],
        [_, others @ ..] => others.iter().copied().cycle().take(k).collect(),
        [] => Vec::new(),
    };
    Ok((0..points.len()).flat_map(others).collect())
}

/// Writes `found` into `row` from `first` on, and repeats the row's beginning when it runs out.
fn fill(row: &mut [u32], first: usize, found: impl Iterator<Item = u32>) {
    let mut end = first;
    for (slot, j) in row[first..].iter_mut().zip(found) {
        *slot = j;
        end += 1;
    }
    for i in end..row.len() {
        row[i] = row[i - end];
    }
}

fn too_many(found: String) -> Error {
    invalid!(limit "points in a neighbour search"; found "{found}"; expected "{}", u32::MAX; help "use fewer points")
}

fn wide(p: &[f32; 3]) -> [f64; 3] {
    p.map(|v| f64::from(v) + 0.0) // -0 becomes 0, so that equal positions have equal bits
}

fn order(a: &[f64; 3], b: &[f64; 3]) -> std::cmp::Ordering {
    a[0].total_cmp(&b[0])
        .then(a[1].total_cmp(&b[1]))
        .then(a[2].total_cmp(&b[2]))
}

fn squared_distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let d = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
}

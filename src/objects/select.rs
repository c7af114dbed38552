//! Selection of one thing by a few of its Gaussians.
//!
//! Superpoints merge into a tree of regions, always the two neighbours that are most alike. Two regions A and B differ by
//! sqrt(|A| |B| / (|A| + |B|)) |m_A - m_B| P / E: Ward's distance (*Hierarchical Grouping to Optimize an Objective Function*,
//! JASA 1963) of their mean colours and normals, times a factor for how little they touch. E counts the edges of the neighbour graph
//! between them, and P all edges that leave the one with fewer. So a part joins the thing that surrounds it before it joins
//! one that it only stands on.

use super::pooled_vote::{NEIGHBOURS, finest};
use super::superpoints::SurfaceGraph;
use crate::error::Result;
use crate::raster::Projected;
use crate::splat::Gaussians;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};
use std::f64::consts::SQRT_2;

/// Weight of the normals beside the colours.
const NORMALS: f64 = 0.3;
/// Numbers of an appearance: a colour (sRGB in 0..1), and n n^T of a normal n, which has no sense.
const WIDTH: usize = 9;
/// Lower heights count as this one where a threshold is proposed: parts of things stand out from these too.
const LEAST_HEIGHT: f64 = 4.0;
/// Least coverage of a pixel that shows a Gaussian.
const MIN_COVERAGE: f32 = 0.5;

/// How far a selection grows from its seeds.
#[derive(Clone, Debug, PartialEq)]
pub struct Growth {
    /// The smallest threshold at which each Gaussian belongs to the selection, `[N]`, 0 or more; infinity where nothing connects it
    /// with a seed.
    pub thresholds: Vec<f64>,
    /// The threshold that is proposed.
    pub proposed: f64,
}

impl Growth {
    /// Grows a selection from the Gaussians `seeds`, at least one.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] when a centre is not finite.
    ///
    /// # Panics
    /// If there is no seed, or one is not below N.
    pub fn new(gaussians: &Gaussians, seeds: &[u32]) -> Result<Self> {
        assert!(!seeds.is_empty(), "a selection grows from a seed");
        let graph = SurfaceGraph::new(gaussians, NEIGHBOURS)?;
        let superpoints = finest(&graph);
        let mut tree = Tree::new(gaussians, &graph, &superpoints.of, superpoints.count);
        tree.merge_all();
        let seeds: Vec<usize> = seeds
            .iter()
            .map(|&seed| superpoints.of[seed as usize] as usize)
            .collect();
        let reached = tree.reached(&seeds);
        let thresholds: Vec<f64> = superpoints
            .of
            .iter()
            .map(|&s| reached[s as usize])
            .collect();
        Ok(Self {
            proposed: tree.propose(&seeds),
            thresholds,
        })
    }

    /// The Gaussians that belong to the selection at `threshold`, ascending.
    pub fn rows(&self, threshold: f64) -> Vec<u32> {
        let rows = (0..).zip(&self.thresholds);
        let inside = rows.filter(|(_, needed)| needed.is_finite() && **needed <= threshold);
        inside.map(|(row, _)| row).collect()
    }
}

/// The Gaussian that gives most of the pixel (column, row) of the image of `projected`. None where the Gaussians cover less than
/// half of it.
///
/// # Panics
/// If the pixel is outside the image.
pub fn seed([x, y]: [usize; 2], projected: &Projected<f32>) -> Option<u32> {
    let [width, height] = projected.size();
    assert!(
        x < width && y < height,
        "seed: pixel {x}, {y} of an image of {width} x {height}"
    );
    let weights = projected.weights(&[(y * width + x) as u32]);
    let (rows, values) = weights.row(0);
    let covered: f32 = values.iter().sum();
    let most = rows
        .iter()
        .zip(values)
        .max_by(|a, b| a.1.total_cmp(b.1).then(b.0.cmp(a.0)));
    most.filter(|_| covered >= MIN_COVERAGE)
        .map(|(row, _)| *row)
}

/// Colour and normal of each Gaussian as they enter a mean.
fn appearances(gaussians: &Gaussians, graph: &SurfaceGraph) -> Vec<[f64; WIDTH]> {
    let of = |([r, g, b], n): ([f32; 3], &glam::DVec3)| {
        let [r, g, b] = [r, g, b].map(f64::from);
        let normal = [
            n.x * n.x,
            n.y * n.y,
            n.z * n.z,
            SQRT_2 * n.x * n.y,
            SQRT_2 * n.x * n.z,
            SQRT_2 * n.y * n.z,
        ];
        let [xx, yy, zz, xy, xz, yz] = normal.map(|v| NORMALS * v);
        [r, g, b, xx, yy, zz, xy, xz, yz]
    };
    let colors = gaussians.base_colors().into_iter();
    colors.zip(graph.normals()).map(of).collect()
}

/// A node of the tree.
#[derive(Clone, Debug, Default)]
struct Region {
    /// Gaussians.
    size: f64,
    /// Their mean appearance.
    mean: [f64; WIDTH],
    /// Edges to each neighbour. Moved into the parent when the region merges.
    beside: BTreeMap<usize, f64>,
    /// All of these edges.
    leaving: f64,
    /// The largest difference that was merged within it.
    height: f64,
    parent: Option<usize>,
}

/// Superpoints, numbered as they are, and then the regions that they merge into, each after its parts.
struct Tree {
    regions: Vec<Region>,
    leaves: usize,
    /// Pairs of neighbours by the bits of their difference, which sort as it does. Some have merged with others since.
    pairs: BinaryHeap<Reverse<(u64, usize, usize)>>,
}

impl Tree {
    fn new(gaussians: &Gaussians, graph: &SurfaceGraph, of: &[u32], count: usize) -> Self {
        let mut regions = vec![Region::default(); count];
        for (&superpoint, appearance) in of.iter().zip(appearances(gaussians, graph)) {
            let region = &mut regions[superpoint as usize];
            region.size += 1.0;
            for (sum, value) in region.mean.iter_mut().zip(appearance) {
                *sum += value;
            }
        }
        for region in &mut regions {
            region.mean = region.mean.map(|sum| sum / region.size);
        }
        for [a, b] in graph.ends() {
            let [a, b] = [a, b].map(|end| of[end as usize] as usize);
            if a != b {
                regions[a].touch(b, 1.0);
                regions[b].touch(a, 1.0);
            }
        }
        let mut tree = Self {
            leaves: count,
            pairs: BinaryHeap::new(),
            regions,
        };
        for region in 0..count {
            tree.queue(region);
        }
        tree
    }

    /// Queues the pairs of `region` and its neighbours.
    fn queue(&mut self, region: usize) {
        let a = &self.regions[region];
        for (&other, &edges) in &a.beside {
            let difference = a.difference(&self.regions[other], edges).to_bits();
            self.pairs.push(Reverse((difference, region, other)));
        }
    }

    /// Merges until no two regions are neighbours.
    fn merge_all(&mut self) {
        while let Some(Reverse((bits, a, b))) = self.pairs.pop() {
            if self.regions[a].parent.is_none() && self.regions[b].parent.is_none() {
                self.merge(a, b, f64::from_bits(bits));
            }
        }
    }

    fn merge(&mut self, a: usize, b: usize, difference: f64) {
        let merged = self.regions.len();
        let between = self.regions[a].beside[&b];
        let [mut more, mut fewer] = [a, b].map(|part| {
            let region = &mut self.regions[part];
            region.parent = Some(merged);
            (std::mem::take(&mut region.beside), region.leaving)
        });
        let (from, to) = (&self.regions[a], &self.regions[b]);
        let size = from.size + to.size;
        let mut region = Region {
            size,
            height: difference.max(from.height).max(to.height),
            ..Region::default()
        };
        for (mean, (x, y)) in region.mean.iter_mut().zip(from.mean.iter().zip(to.mean)) {
            *mean = (x * from.size + y * to.size) / size;
        }
        if more.0.len() < fewer.0.len() {
            std::mem::swap(&mut more, &mut fewer);
        }
        region.leaving = more.1 + fewer.1 - 2.0 * between;
        region.beside = more.0;
        for (other, edges) in fewer.0 {
            *region.beside.entry(other).or_default() += edges;
        }
        region.beside.remove(&a);
        region.beside.remove(&b);
        for (&other, &edges) in &region.beside {
            let beside = &mut self.regions[other].beside;
            beside.remove(&a);
            beside.remove(&b);
            beside.insert(merged, edges);
        }
        self.regions.push(region);
        self.queue(merged);
    }

    /// The regions that hold the leaf `leaf`, from itself up.
    fn around(&self, leaf: usize) -> impl Iterator<Item = usize> {
        std::iter::successors(Some(leaf), |&region| self.regions[region].parent)
    }

    /// The height at which each leaf is in one region with one of `seeds`.
    fn reached(&self, seeds: &[usize]) -> Vec<f64> {
        let mut reached = vec![f64::INFINITY; self.regions.len()];
        for &seed in seeds {
            for region in self.around(seed) {
                reached[region] = self.regions[region].height;
            }
        }
        // Parents come after their parts.
        for region in (0..reached.len()).rev() {
            if let Some(parent) = self.regions[region].parent {
                reached[region] = reached[region].min(reached[parent]);
            }
        }
        reached.truncate(self.leaves);
        reached
    }

    /// The height of the region that stands out most, of those that hold all `seeds` and at most half of the scene: it stays as it is
    /// until a threshold that is many times its height, and few edges leave it. Of seeds that nothing connects the largest height.
    fn propose(&self, seeds: &[usize]) -> f64 {
        let chains: Vec<BTreeSet<usize>> =
            seeds.iter().map(|&s| self.around(s).collect()).collect();
        let shared = chains[0].iter().copied();
        let shared: Vec<usize> = shared
            .filter(|region| chains.iter().all(|chain| chain.contains(region)))
            .collect();
        let Some(first) = shared.first() else {
            let alone = seeds.iter().map(|&seed| self.propose(&[seed]));
            return alone.fold(0.0, f64::max);
        };
        let all: f64 = self.regions[..self.leaves].iter().map(|r| r.size).sum();
        let candidates = shared
            .iter()
            .filter(|&&region| 2.0 * self.regions[region].size <= all);
        let best = candidates.max_by(|&&a, &&b| self.stands_out(a).total_cmp(&self.stands_out(b)));
        self.regions[*best.unwrap_or(first)].height
    }

    fn stands_out(&self, region: usize) -> f64 {
        let region = &self.regions[region];
        region.parent.map_or(f64::INFINITY, |parent| {
            self.regions[parent].height / (region.height.max(LEAST_HEIGHT) * region.leaving)
        })
    }
}

impl Region {
    fn touch(&mut self, other: usize, edges: f64) {
        *self.beside.entry(other).or_default() += edges;
        self.leaving += edges;
    }

    /// How much two regions with `edges` between them differ.
    fn difference(&self, other: &Self, edges: f64) -> f64 {
        let ward = self.size * other.size / (self.size + other.size);
        let apart = self
            .mean
            .iter()
            .zip(other.mean)
            .map(|(a, b)| (a - b) * (a - b));
        let apart: f64 = apart.sum();
        (ward * apart).sqrt() * self.leaving.min(other.leaving) / edges
    }
}

//! The tree of a scene's regions: superpoints merge, always the two neighbours that are most alike.
//!
//! Two regions A and B differ by sqrt(|A| |B| / (|A| + |B|)) |m_A - m_B| P / E: Ward's distance (*Hierarchical Grouping to Optimize
//! an Objective Function*, JASA 1963) of their mean colours, normals and image features, times a factor for how little they touch. E counts the
//! edges of the neighbour graph between them, and P all edges that leave the one with fewer. So a part joins the thing that
//! surrounds it before it joins one that it only stands on.

use super::superpoints::{NEIGHBOURS, Superpoints, SurfaceGraph};
use crate::error::{Result, ensure};
use crate::splat::Gaussians;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};
use std::f64::consts::SQRT_2;
use std::iter::repeat;

/// Weight of the normals beside the colours.
const NORMALS: f64 = 0.3;
/// Weight of the image features beside the colours.
const FEATURES: f64 = 0.8;
/// Numbers of an appearance: a colour (sRGB in 0..1), n n^T of a normal n, whose sign means nothing, and main components of image
/// features.
const WIDTH: usize = 12;
/// Lower heights count as this one where a region stands out: parts of things stand out from these too.
const LEAST_HEIGHT: f64 = 4.0;

/// The regions of a scene, each after its parts. The first are the superpoints, numbered as they are.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Regions {
    /// The leaves.
    pub superpoints: Superpoints,
    /// The region that each merges into, `[R]`; itself where it merges with no other.
    pub parents: Vec<u32>,
    /// The largest difference that was merged within each region, `[R]`; 0 for superpoints. A parent has at least that of its parts.
    pub heights: Vec<f32>,
    /// How much each region stands out, `[R]`: its parent's height by its own and by the edges that leave it. Infinity without a
    /// parent, and 0 of more than half of the scene.
    pub prominences: Vec<f32>,
}

impl Regions {
    /// The regions of `gaussians`. `features` has main components of the image features of each one, see
    /// [`crate::features::FeatureColors`], or nothing.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] when a centre is not finite; [`crate::Error::Argument`] for features of another number of Gaussians.
    pub fn new(gaussians: &Gaussians, features: &[[f32; 3]]) -> Result<Self> {
        ensure!(features.is_empty() || features.len() == gaussians.len(), argument "features"; found "{} of them", features.len();
            expected "one for each of {} Gaussians, or none", gaussians.len(); help "give those that were lifted onto these Gaussians");
        let graph = SurfaceGraph::new(gaussians, NEIGHBOURS)?;
        let superpoints = graph.fine();
        let appearances = appearances(gaussians, features, &graph);
        let mut merging = Merging::new(&appearances, &graph, &superpoints);
        merging.merge_all();
        let regions = &merging.regions;
        let half = gaussians.len() as f64 / 2.0;
        let parent = |(own, region): (usize, &Region)| region.parent.unwrap_or(own) as u32;
        Ok(Self {
            parents: regions.iter().enumerate().map(parent).collect(),
            heights: regions.iter().map(|region| region.height as f32).collect(),
            prominences: regions
                .iter()
                .map(|region| merging.prominence(region, half))
                .collect(),
            superpoints,
        })
    }
}

/// Colour, normal and features of each Gaussian as they enter a mean.
fn appearances(
    gaussians: &Gaussians,
    features: &[[f32; 3]],
    graph: &SurfaceGraph,
) -> Vec<[f64; WIDTH]> {
    let appearance = |(([r, g, b], n), features): (([f32; 3], &glam::DVec3), &[f32; 3])| {
        let [r, g, b] = [r, g, b].map(f64::from);
        let [u, v, w] = features.map(|value| FEATURES * f64::from(value));
        let normal = [
            n.x * n.x,
            n.y * n.y,
            n.z * n.z,
            SQRT_2 * n.x * n.y,
            SQRT_2 * n.x * n.z,
            SQRT_2 * n.y * n.z,
        ];
        let [xx, yy, zz, xy, xz, yz] = normal.map(|v| NORMALS * v);
        [r, g, b, xx, yy, zz, xy, xz, yz, u, v, w]
    };
    let colors = gaussians.base_colors().into_iter();
    let features = features.iter().chain(repeat(&[0.0; 3]));
    colors
        .zip(graph.normals())
        .zip(features)
        .map(appearance)
        .collect()
}

/// A region while the tree grows.
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

/// The tree as it grows.
struct Merging {
    regions: Vec<Region>,
    /// Pairs of neighbours by the bits of their difference, which sort as it does. Some have merged with others since.
    pairs: BinaryHeap<Reverse<(u64, usize, usize)>>,
}

impl Merging {
    fn new(appearances: &[[f64; WIDTH]], graph: &SurfaceGraph, superpoints: &Superpoints) -> Self {
        let Superpoints { of, count } = superpoints;
        let mut regions = vec![Region::default(); *count];
        for (&superpoint, appearance) in of.iter().zip(appearances) {
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
        let mut merging = Self {
            pairs: BinaryHeap::new(),
            regions,
        };
        for region in 0..*count {
            merging.queue(region);
        }
        merging
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

    /// See [`Regions::prominences`]; `most` is half of the scene's Gaussians.
    fn prominence(&self, region: &Region, most: f64) -> f32 {
        if region.size > most {
            return 0.0;
        }
        region.parent.map_or(f32::INFINITY, |parent| {
            let parent = &self.regions[parent];
            (parent.height / (region.height.max(LEAST_HEIGHT) * region.leaving)) as f32
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

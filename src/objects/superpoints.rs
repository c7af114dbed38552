//! Superpoints: groups of neighbouring Gaussians that lie on one surface and have one colour.
//!
//! The segmentation is that of Felzenszwalb and Huttenlocher, *Efficient Graph-Based Image Segmentation* (IJCV 2004), on the graph
//! of nearest neighbours of the Gaussians instead of the grid of pixels. Two components C merge over an edge whose weight is at
//! most Int(C) + k / |C| for both. Int(C) is the largest weight that merged C so far, and |C| is its size.

use crate::error::Result;
use crate::ops::SparseMatrix;
use crate::segmentation::neighbours::{Neighbours, PointIndex};
use crate::splat::Gaussians;
use glam::DVec3;
use nalgebra::{Matrix3, SymmetricEigen};
use rayon::prelude::*;
use union_find::{QuickUnionUf, UnionBySize, UnionFind};

/// Nearest neighbours of each Gaussian in the graph of a scene.
pub(super) const NEIGHBOURS: usize = 12;
/// Scales of fine, middle and coarse superpoints.
const SCALES: [f64; 3] = [0.1, 0.3, 1.0];
/// Least number of Gaussians of such a superpoint.
const LEAST: usize = 5;

/// The superpoint of each Gaussian.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Superpoints {
    /// Number of the superpoint of each Gaussian, `[N]`. They are numbered by their first Gaussian.
    pub of: Vec<u32>,
    /// Number of superpoints.
    pub count: usize,
}

/// An edge of the graph.
#[derive(Clone, Copy, Debug)]
struct Edge {
    weight: f32,
    ends: [u32; 2],
}

/// The graph of neighbouring Gaussians, its edges in ascending order of weight.
#[derive(Clone, Debug)]
pub struct SurfaceGraph {
    /// The normal at each Gaussian, `[N]`; either side may be its outer one.
    normals: Vec<DVec3>,
    edges: Vec<Edge>,
}

impl SurfaceGraph {
    /// Each of `gaussians` with its nearest `neighbours`. The weight of an edge is 1 - |n_a . n_b| of the normals plus the distance
    /// of the colours (sRGB in 0..1).
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] when a centre is not finite.
    pub fn new(gaussians: &Gaussians, neighbours: usize) -> Result<Self> {
        let near = PointIndex::new(&gaussians.means)?
            .neighbours(neighbours.saturating_add(1).min(gaussians.len()));
        let normals = normals(&gaussians.means, &near);
        let colors: Vec<_> = gaussians.base_colors().into_iter().map(vector).collect();
        let weight = |a: usize, b: usize| {
            let turn = 1.0 - normals[a].dot(normals[b]).abs();
            (turn + colors[a].distance(colors[b])) as f32
        };
        let edges = edges(&near, weight);
        Ok(Self::of_edges(normals, edges))
    }

    fn of_edges(normals: Vec<DVec3>, mut edges: Vec<Edge>) -> Self {
        edges.par_sort_unstable_by(|a, b| a.weight.total_cmp(&b.weight).then(a.ends.cmp(&b.ends)));
        Self { normals, edges }
    }

    /// The normal at each Gaussian, up to its sign.
    pub(super) fn normals(&self) -> &[DVec3] {
        &self.normals
    }

    /// The two Gaussians of each edge.
    pub(super) fn ends(&self) -> impl Iterator<Item = [u32; 2]> {
        self.edges.iter().map(|edge| edge.ends)
    }

    /// The affinity exp(-weight / `decay`) of the two Gaussians of each edge, `[N, N]`, symmetric.
    pub(super) fn affinities(&self, decay: f32) -> SparseMatrix {
        let mut rows = vec![Vec::new(); self.normals.len()];
        for edge in &self.edges {
            let [a, b] = edge.ends;
            let affinity = (-edge.weight / decay).exp();
            rows[a as usize].push((b, affinity));
            rows[b as usize].push((a, affinity));
        }
        let ends = rows.iter().scan(0, |end, row| {
            *end += row.len() as u32;
            Some(*end)
        });
        let offsets = [0].into_iter().chain(ends).collect();
        let (columns, values) = rows.iter().flatten().copied().unzip();
        SparseMatrix::new(rows.len(), offsets, columns, values)
    }

    /// Whether all neighbours of each Gaussian, and theirs, have its label.
    pub fn inside<T: PartialEq>(&self, labels: &[T]) -> Vec<bool> {
        let near = self.alike(labels);
        let mut inside = near.clone();
        for Edge { ends: [a, b], .. } in &self.edges {
            inside[*a as usize] &= near[*b as usize];
            inside[*b as usize] &= near[*a as usize];
        }
        inside
    }

    /// Whether all neighbours of each Gaussian have its label.
    fn alike<T: PartialEq>(&self, labels: &[T]) -> Vec<bool> {
        let mut alike = vec![true; self.normals.len()];
        for Edge { ends: [a, b], .. } in &self.edges {
            if labels[*a as usize] != labels[*b as usize] {
                alike[*a as usize] = false;
                alike[*b as usize] = false;
            }
        }
        alike
    }

    /// Fine, middle and coarse superpoints.
    pub(super) fn all_scales(&self) -> [Superpoints; 3] {
        SCALES.map(|scale| self.superpoints(scale, LEAST))
    }

    /// The fine superpoints alone.
    pub(super) fn fine(&self) -> Superpoints {
        self.superpoints(SCALES[0], LEAST)
    }

    /// The superpoints at `scale`: k of the paper, in edge weight times Gaussians. A larger one gives larger superpoints. Those of
    /// fewer than `least` Gaussians merge with the neighbour that is most alike.
    pub fn superpoints(&self, scale: f64, least: usize) -> Superpoints {
        let mut components = Components::new(self.normals.len());
        for edge in &self.edges {
            let fits = |(inside, size): (f64, usize)| {
                f64::from(edge.weight) <= inside + scale / size as f64
            };
            components.join_if(edge, |both| both.into_iter().all(fits));
        }
        for edge in &self.edges {
            components.join_if(edge, |[(_, a), (_, b)]| a.min(b) < least);
        }
        components.numbered()
    }
}

/// Components of the graph with what the merge rule reads.
struct Components {
    sets: QuickUnionUf<UnionBySize>,
    /// Int(C) and |C|, at the root of each set.
    inside: Vec<f64>,
    size: Vec<usize>,
}

impl Components {
    fn new(points: usize) -> Self {
        Self {
            sets: QuickUnionUf::new(points),
            inside: vec![0.0; points],
            size: vec![1; points],
        }
    }

    /// Joins the components at the ends of `edge` where `rule` holds for Int(C) and |C| of both.
    fn join_if(&mut self, edge: &Edge, rule: impl Fn([(f64, usize); 2]) -> bool) {
        let [a, b] = edge.ends.map(|end| self.sets.find(end as usize));
        if a == b || !rule([a, b].map(|root| (self.inside[root], self.size[root]))) {
            return;
        }
        let size = self.size[a] + self.size[b];
        self.sets.union(a, b);
        let root = self.sets.find(a);
        self.size[root] = size;
        // Edges come in ascending order.
        self.inside[root] = f64::from(edge.weight);
    }

    fn numbered(mut self) -> Superpoints {
        let points = self.size.len();
        let mut number = vec![u32::MAX; points];
        let mut count = 0;
        let mut of = Vec::with_capacity(points);
        for point in 0..points {
            let number = &mut number[self.sets.find(point)];
            if *number == u32::MAX {
                *number = count;
                count += 1;
            }
            of.push(*number);
        }
        Superpoints {
            of,
            count: count as usize,
        }
    }
}

/// One edge for each pair of neighbours.
fn edges(near: &Neighbours, weight: impl Fn(usize, usize) -> f32 + Sync) -> Vec<Edge> {
    let of_row = |a: usize| {
        let others = near.row(a).iter().map(|&b| b as usize);
        // A pair that lists each other has one edge, from the smaller number.
        let once = move |b: &usize| *b > a || *b < a && !near.row(*b).contains(&(a as u32));
        let weight = &weight;
        others.filter(once).map(move |b| Edge {
            weight: weight(a, b),
            ends: [a.min(b) as u32, a.max(b) as u32],
        })
    };
    (0..near.len())
        .into_par_iter()
        .flat_map_iter(of_row)
        .collect()
}

fn vector(p: [f32; 3]) -> DVec3 {
    DVec3::from_array(p.map(f64::from))
}

/// The normal of the surface at each centre: the direction in which its nearest neighbours spread least.
fn normals(centers: &[[f32; 3]], near: &Neighbours) -> Vec<DVec3> {
    let of_row = |row: usize| {
        let points = near.row(row).iter().map(|&i| vector(centers[i as usize]));
        let mean = points.clone().sum::<DVec3>() / near.k as f64;
        let spread = points.fold(Matrix3::<f64>::zeros(), |sum, point| {
            let from_mean = nalgebra::Vector3::from((point - mean).to_array());
            sum + from_mean * from_mean.transpose()
        });
        let eigen = SymmetricEigen::new(spread);
        let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin());
        DVec3::new(normal[0], normal[1], normal[2])
    };
    (0..near.len()).into_par_iter().map(of_row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const GREY: [f32; 3] = [0.5; 3];
    const RED: [f32; 3] = [0.9, 0.2, 0.2];

    /// A grid of `side` squared points with a spacing of 5 cm on the plane through `corner` along `u` and `v`.
    fn plane(corner: DVec3, u: DVec3, v: DVec3, side: usize) -> Vec<[f32; 3]> {
        let cells = (0..side * side).map(|i| ((i % side) as f64, (i / side) as f64));
        cells
            .map(|(x, y)| (corner + 0.05 * (x * u + y * v)).as_vec3().to_array())
            .collect()
    }

    fn scene(parts: &[(Vec<[f32; 3]>, [f32; 3])]) -> (Gaussians, Vec<usize>) {
        let mut means = Vec::new();
        let mut sh = Vec::new();
        let mut part = Vec::new();
        for (number, (points, color)) in parts.iter().enumerate() {
            for point in points {
                means.push(*point);
                sh.extend(color.map(|c| (c - 0.5) / crate::splat::SH_0));
                part.push(number);
            }
        }
        let n = means.len();
        let gaussians = Gaussians {
            means,
            log_scales: vec![[-4.0; 3]; n],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logits: vec![2.0; n],
            sh,
            sh_degree: 0,
        };
        (gaussians, part)
    }

    fn superpoints(gaussians: &Gaussians) -> Superpoints {
        SurfaceGraph::new(gaussians, 12)
            .unwrap()
            .superpoints(0.5, 5)
    }

    /// The share of Gaussians in superpoints whose majority is their own part.
    fn purity(superpoints: &Superpoints, part: &[usize]) -> f64 {
        let parts = part.iter().max().map_or(0, |p| p + 1);
        let mut table = vec![0_usize; superpoints.count * parts];
        for (&superpoint, &part) in superpoints.of.iter().zip(part) {
            table[superpoint as usize * parts + part] += 1;
        }
        let majority = table.chunks_exact(parts).map(|row| row.iter().max());
        majority.flatten().sum::<usize>() as f64 / part.len() as f64
    }

    #[test]
    fn planes_that_meet_are_apart() {
        let floor = plane(DVec3::ZERO, DVec3::X, DVec3::Y, 30);
        let wall = plane(DVec3::ZERO, DVec3::X, DVec3::Z, 30);
        let (gaussians, part) = scene(&[(floor, GREY), (wall, GREY)]);
        let superpoints = superpoints(&gaussians);
        assert!(purity(&superpoints, &part) > 0.95);
        assert!(superpoints.count <= 20, "{}", superpoints.count);
    }

    #[test]
    fn a_box_on_a_floor_is_apart() {
        let floor = plane(DVec3::ZERO, DVec3::X, DVec3::Y, 40);
        let corner = DVec3::new(0.7, 0.7, 0.05);
        let (far, top) = (DVec3::new(0.45, 0.45, 0.0), DVec3::new(0.0, 0.0, 0.45));
        let mut sides = plane(corner, DVec3::X, DVec3::Z, 10);
        sides.extend(plane(corner, DVec3::Y, DVec3::Z, 10));
        sides.extend(plane(corner + far, -DVec3::X, DVec3::Z, 10));
        sides.extend(plane(corner + far, -DVec3::Y, DVec3::Z, 10));
        sides.extend(plane(corner + top, DVec3::X, DVec3::Y, 10));
        let (gaussians, part) = scene(&[(floor, GREY), (sides, RED)]);
        let superpoints = superpoints(&gaussians);
        assert!(purity(&superpoints, &part) > 0.98);
        assert!(superpoints.count <= 30, "{}", superpoints.count);
    }

    #[test]
    fn a_colour_edge_on_a_plane_separates() {
        let left = plane(DVec3::ZERO, DVec3::X, DVec3::Y, 20);
        let right = plane(DVec3::X, DVec3::X, DVec3::Y, 20);
        let (gaussians, part) = scene(&[(left, GREY), (right, RED)]);
        let superpoints = superpoints(&gaussians);
        assert_eq!(purity(&superpoints, &part), 1.0);
        assert_eq!(superpoints.count, 2);
    }

    #[test]
    fn the_merge_rule_is_that_of_the_paper() {
        // A chain of four points: 0.1, 0.3, 0.1. With k = 0.35 the middle edge exceeds 0.1 + 0.35 / 2 of both pairs.
        let edge = |a, b, weight| Edge {
            weight,
            ends: [a, b],
        };
        let chain = vec![edge(0, 1, 0.1), edge(1, 2, 0.3), edge(2, 3, 0.1)];
        let of = |scale, least| {
            let graph = SurfaceGraph::of_edges(vec![DVec3::Z; 4], chain.clone());
            graph.superpoints(scale, least).of
        };
        assert_eq!(of(0.35, 1), [0, 0, 1, 1]);
        assert_eq!(of(0.45, 1), [0, 0, 0, 0]);
        assert_eq!(of(0.35, 3), [0, 0, 0, 0], "pairs are below the least size");
        assert_eq!(of(0.05, 1), [0, 1, 2, 3]);
    }

    #[test]
    fn what_lies_inside_is_two_edges_from_another_label() {
        let chain = (0..7).map(|a| Edge {
            weight: 0.1,
            ends: [a, a + 1],
        });
        let graph = SurfaceGraph::of_edges(vec![DVec3::Z; 8], chain.collect());
        let inside = graph.inside(&[1, 1, 1, 1, 2, 2, 2, 2]);
        assert_eq!(inside, [true, true, false, false, false, false, true, true]);
    }

    #[test]
    fn no_gaussians_have_no_superpoints() {
        let superpoints = superpoints(&Gaussians::default());
        assert_eq!(superpoints, Superpoints::default());
    }
}

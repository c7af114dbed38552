//! Things of one label that do not touch, told apart: `chair` becomes `chair 1` and `chair 2`.
//!
//! A Gaussian of opacity o is taken as the ellipsoid on which `o exp(-r^2 / 2)` has fallen to [`Separation::level`]. Two of one
//! label touch where their ellipsoids meet on the line between their centres. Chains of Gaussians that touch are pieces; pieces
//! of little area are strays, and belong with the piece nearest to them.

use crate::data::{Class, Classes, ObjectOf, class_color};
use crate::error::{Error, Result};
use crate::gaussians::{Gaussians, rotation};
use crate::segmentation::neighbours::PointIndex;
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, HashSet};

/// What counts as touching, and as a thing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Separation {
    /// Opacity at which a Gaussian ends, in (0, 1); a less opaque one touches nothing.
    pub level: f64,
    /// Pieces with less than this share of the area of their label's largest piece are strays, in [0, 1]. The area of a Gaussian is
    /// its opacity times its two larger standard deviations.
    pub smallest: f64,
    /// Nearest Gaussians of the same label that each may touch, at least 1.
    pub neighbours: usize,
}

/// Chosen on two trained rooms with true instances (docs/measured.md, "Things of one label").
impl Default for Separation {
    fn default() -> Self {
        Self { level: 0.1, smallest: 0.01, neighbours: 24 }
    }
}

/// Labels after separation.
#[derive(Clone, Debug, PartialEq)]
pub struct Separated {
    /// Label of each Gaussian.
    pub labels: Vec<u16>,
    /// What the labels are: those of the scene, with the new ones behind.
    pub classes: Classes,
    /// Labels that became several, each with its pieces from the largest on, the label itself first.
    pub pieces: BTreeMap<u16, Vec<u16>>,
}

impl Separation {
    /// Separates the things of each label that `wanted` says yes to. The largest piece keeps the label; others get ids above all
    /// those in use, and a name with the next free number.
    ///
    /// # Errors
    /// [`Error::Config`] for a rule out of its range; those of [`Gaussians::check`]; [`Error::Limit`] when ids run out.
    pub fn apply(
        &self,
        gaussians: &Gaussians,
        labels: &[u16],
        classes: &Classes,
        wanted: impl Fn(u16) -> bool,
    ) -> Result<Separated> {
        self.check()?;
        gaussians.check(Some(labels))?;
        let mut rows: BTreeMap<u16, Vec<u32>> = BTreeMap::new();
        for (row, &id) in (0..).zip(labels) {
            rows.entry(id).or_default().push(row);
        }
        let mut naming = Naming::new(labels, classes);
        let mut separated = Separated { labels: labels.to_vec(), classes: Classes::default(), pieces: BTreeMap::new() };
        for (id, rows) in rows {
            if id == naming.classes.ignore || !wanted(id) {
                continue;
            }
            let (pieces, of) = self.pieces(gaussians, &rows)?;
            if pieces < 2 {
                continue;
            }
            let ids = naming.divide(id, pieces)?;
            for (&row, piece) in rows.iter().zip(of) {
                separated.labels[row as usize] = ids[piece as usize];
            }
            separated.pieces.insert(id, ids);
        }
        // Without a table all labels are named, not the divided ones alone.
        let unnamed = separated.labels.iter().filter(|&&id| classes.is_empty() && id != naming.classes.ignore);
        for id in unnamed.copied().collect::<BTreeSet<u16>>() {
            naming.entry(id);
        }
        separated.classes = naming.classes;
        Ok(separated)
    }

    fn check(&self) -> Result<()> {
        let fault = |key: &str, found: String, expected: &str| {
            Err(Error::config(format!("separation {key}"), found, expected, "the default suits most scenes"))
        };
        if !(self.level > 0.0 && self.level < 1.0) {
            return fault("level", self.level.to_string(), "above 0 and below 1");
        }
        if !(0.0..=1.0).contains(&self.smallest) {
            return fault("smallest", self.smallest.to_string(), "0 to 1");
        }
        if self.neighbours == 0 {
            return fault("neighbours", "0".into(), "1 or more");
        }
        Ok(())
    }

    /// Number of pieces that `rows` fall into, and which of them each is in, from the largest on.
    fn pieces(&self, gaussians: &Gaussians, rows: &[u32]) -> Result<(usize, Vec<u32>)> {
        let bodies: Vec<Option<Body>> =
            rows.iter().map(|&row| Body::new(gaussians, row as usize, self.level)).collect();
        let solid: Vec<u32> = (0..).zip(&bodies).filter(|(_, body)| body.is_some()).map(|(i, _)| i).collect();
        if solid.len() < 2 {
            return Ok((1, vec![0; rows.len()]));
        }
        let at = |i: u32| gaussians.means[rows[i as usize] as usize];
        let points: Vec<[f32; 3]> = solid.iter().map(|&i| at(i)).collect();
        let near = PointIndex::new(&points)?.neighbours((self.neighbours + 1).min(points.len()));
        let body = |k: usize| bodies[solid[k] as usize].as_ref();
        let touching = |k: usize| -> Vec<(usize, usize)> {
            let others = near.row(k)[1..].iter().map(|&j| j as usize);
            others
                .filter(|&j| matches!((body(k), body(j)), (Some(a), Some(b)) if a.touches(b)))
                .map(|j| (k, j))
                .collect()
        };
        let mut chains = Chains::new(solid.len());
        for (a, b) in (0..solid.len()).into_par_iter().flat_map_iter(touching).collect::<Vec<_>>() {
            chains.join(a, b);
        }
        // Area by chain, the chain being named by its first member.
        let mut area: BTreeMap<usize, f64> = BTreeMap::new();
        for k in 0..solid.len() {
            *area.entry(chains.first(k)).or_default() += body(k).map_or(0.0, |body| body.area);
        }
        let mut order: Vec<(usize, f64)> = area.into_iter().collect();
        order.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let largest = order[0].1;
        order.retain(|(_, area)| *area >= self.smallest * largest);
        let place: BTreeMap<usize, u32> = order.iter().zip(0..).map(|((first, _), place)| (*first, place)).collect();
        let (mut of, mut known, mut kept) = (vec![u32::MAX; rows.len()], Vec::new(), Vec::new());
        for (k, &i) in solid.iter().enumerate() {
            if let Some(&piece) = place.get(&chains.first(k)) {
                of[i as usize] = piece;
                known.push(piece);
                kept.push(points[k]);
            }
        }
        let strays: Vec<u32> = (0..).zip(&of).filter(|(_, piece)| **piece == u32::MAX).map(|(i, _)| i).collect();
        let queries: Vec<[f32; 3]> = strays.iter().map(|&i| at(i)).collect();
        let (nearest, _) = PointIndex::new(&kept)?.nearest(&queries, 1)?;
        for (&i, &at) in strays.iter().zip(&nearest.indices) {
            of[i as usize] = known[at as usize];
        }
        Ok((order.len(), of))
    }
}

/// The ellipsoid that a Gaussian is taken for.
struct Body {
    center: DVec3,
    /// Rows are the axes, each as long as its half-axis.
    axes: DMat3,
    area: f64,
}

impl Body {
    /// `None` for a Gaussian less opaque than `level`.
    fn new(gaussians: &Gaussians, row: usize, level: f64) -> Option<Self> {
        let opacity = 1.0 / (1.0 + (-f64::from(gaussians.opacity_logits[row])).exp());
        let radius = (2.0 * (opacity / level).ln()).max(0.0).sqrt();
        let scales = gaussians.log_scales[row].map(|s| f64::from(s).exp());
        let turned = DMat3::from_quat(rotation(&gaussians.rotations[row]));
        let [x, y, z] = [0, 1, 2].map(|c| turned.col(c) * scales[c] * radius);
        let axes = DMat3::from_cols(x, y, z).transpose();
        let [a, b, c] = scales;
        let area = opacity * (a * b).max(b * c).max(a * c);
        let solid = opacity >= level && axes.is_finite() && area.is_finite();
        solid.then(|| Self { center: DVec3::from(gaussians.means[row].map(f64::from)), axes, area })
    }

    /// Half the width of the ellipsoid's shadow on a line along `direction`, of unit length: sqrt(d^T Sigma d).
    fn reach(&self, direction: DVec3) -> f64 {
        (self.axes * direction).length()
    }

    fn touches(&self, other: &Self) -> bool {
        let apart = other.center - self.center;
        let distance = apart.length();
        distance == 0.0 || distance <= self.reach(apart / distance) + other.reach(apart / distance)
    }
}

/// Disjoint sets, each named by its smallest member.
struct Chains(Vec<usize>);

impl Chains {
    fn new(n: usize) -> Self {
        Self((0..n).collect())
    }

    fn first(&mut self, mut i: usize) -> usize {
        while self.0[i] != i {
            self.0[i] = self.0[self.0[i]];
            i = self.0[i];
        }
        i
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.first(a), self.first(b));
        self.0[a.max(b)] = a.min(b);
    }
}

/// Ids and names for what a label is divided into.
struct Naming {
    classes: Classes,
    names: HashSet<String>,
    last: u16,
}

impl Naming {
    fn new(labels: &[u16], classes: &Classes) -> Self {
        // No table says which id stands for nothing: 0 is what every command writes.
        let mut classes = classes.clone();
        if classes.is_empty() {
            classes.ignore = 0;
        }
        let last = labels.iter().copied().chain(classes.entries.iter().map(|c| c.id)).max().unwrap_or(0);
        let names = classes.entries.iter().map(|c| c.name.clone()).collect();
        Self { classes, names, last }
    }

    /// Ids of the `pieces` of `id`, itself the first.
    fn divide(&mut self, id: u16, pieces: usize) -> Result<Vec<u16>> {
        let i = self.entry(id);
        let whole = self.classes.entries[i].clone();
        // What is an object already is numbered on: `chair 2` has the class name `chair`.
        let numbered = whole.object_of.and_then(|_| whole.name.rsplit_once(' '));
        let base = numbered.filter(|(_, number)| number.parse::<u32>().is_ok()).map_or(&*whole.name, |(base, _)| base);
        let of = whole.object_of.unwrap_or(ObjectOf { class: id, thing: true });
        let mut ids = vec![id];
        self.classes.entries[i].object_of = Some(of);
        if base == whole.name {
            self.classes.entries[i].name = self.next_name(base);
        }
        for _ in 1..pieces {
            let Some(next) = self.last.checked_add(1) else {
                return Err(Error::Limit {
                    what: "label ids".into(),
                    found: "more than 65535".into(),
                    limit: "65535".into(),
                    mend: "separate fewer labels, or call more pieces strays".into(),
                });
            };
            self.last = next;
            let name = self.next_name(base);
            self.classes.entries.push(Class { id: next, name, color: class_color(next), object_of: Some(of) });
            ids.push(next);
        }
        Ok(ids)
    }

    /// Where `id` stands in the table, which it is added to where it is missing.
    fn entry(&mut self, id: u16) -> usize {
        let i = self.classes.entries.partition_point(|c| c.id < id);
        if self.classes.entries.get(i).is_none_or(|c| c.id != id) {
            let name = format!("label {id}");
            self.classes.entries.insert(i, Class { id, name, color: class_color(id), object_of: None });
        }
        i
    }

    fn next_name(&mut self, base: &str) -> String {
        let mut number = 1;
        loop {
            let name = format!("{base} {number}");
            if self.names.insert(name.clone()) {
                return name;
            }
            number += 1;
        }
    }
}

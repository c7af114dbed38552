//! Things of one label that do not touch, told apart: `chair` becomes `chair 1` and `chair 2`.
//!
//! A Gaussian of opacity o is taken as the ellipsoid within which `o exp(-r^2 / 2)` exceeds [`Separation::level`]. Two of one label
//! touch where their ellipsoids overlap (Perram and Wertheim 1985). Chains of Gaussians that touch are pieces; pieces of little
//! area are strays, and belong with the piece nearest to them.

mod body;
mod chains;
mod naming;
mod regions;

use crate::data::Classes;
use crate::error::{Error, Result};
use crate::segmentation::neighbours::PointIndex;
use crate::splat::Gaussians;
use body::Body;
use chains::Chains;
use naming::Naming;
use std::collections::{BTreeMap, BTreeSet};

/// What counts as touching, and as a thing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Separation {
    /// Opacity at which a Gaussian ends, in (0, 1); a less opaque one touches nothing.
    pub level: f64,
    /// Pieces with less than this share of the area of their label's largest piece are strays, in [0, 1]. The area of a Gaussian is
    /// its opacity times its two larger standard deviations.
    pub smallest: f64,
    /// Pieces of fewer solid Gaussians than this are strays too, but for the largest piece of a label.
    pub fewest: usize,
    /// Nearest Gaussians of the same label that each is compared with, at least 1; a large one with all whose centres lie as near as
    /// its longest half-axis too.
    pub neighbours: usize,
}

/// Chosen on two trained rooms with true instances (docs/measured.md, "Things of one label").
impl Default for Separation {
    fn default() -> Self {
        Self {
            level: 0.1,
            smallest: 0.01,
            fewest: 10,
            neighbours: 24,
        }
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
    /// [`Error::Argument`] for a rule out of its range; those of [`Gaussians::check`]; [`Error::Limit`] when ids run out.
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
        let mut separated = Separated {
            labels: labels.to_vec(),
            classes: Classes::default(),
            pieces: BTreeMap::new(),
        };
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
        let unnamed = separated
            .labels
            .iter()
            .filter(|&&id| classes.is_empty() && id != naming.classes.ignore);
        for id in unnamed.copied().collect::<BTreeSet<u16>>() {
            naming.entry(id);
        }
        separated.classes = naming.classes;
        Ok(separated)
    }

    fn check(&self) -> Result<()> {
        let fault = |key: &str, found: String, expected: &str| {
            Err(Error::argument(
                format!("separation {key}"),
                found,
                expected,
                "the default suits most scenes",
            ))
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
        let bodies: Vec<Option<Body>> = rows
            .iter()
            .map(|&row| Body::new(gaussians, row as usize, self.level))
            .collect();
        let solid: Vec<u32> = (0..)
            .zip(&bodies)
            .filter(|(_, body)| body.is_some())
            .map(|(i, _)| i)
            .collect();
        if solid.len() < 2 {
            return Ok((1, vec![0; rows.len()]));
        }
        let at = |i: u32| gaussians.means[rows[i as usize] as usize];
        let points: Vec<[f32; 3]> = solid.iter().map(|&i| at(i)).collect();
        let bodies: Vec<Body> = bodies.into_iter().flatten().collect();
        let mut chains = Chains::of(&bodies, &points, self.neighbours)?;
        // Area by chain, the chain being named by its first member.
        let mut sizes: BTreeMap<u32, (f64, usize)> = BTreeMap::new();
        for (k, body) in (0..).zip(&bodies) {
            let (area, count) = sizes.entry(chains.first(k)).or_default();
            (*area, *count) = (*area + body.area, *count + 1);
        }
        let mut order: Vec<(u32, (f64, usize))> = sizes.into_iter().collect();
        order.sort_by(|(a, (large, _)), (b, (small, _))| small.total_cmp(large).then(a.cmp(b)));
        let (first, (largest, _)) = order[0];
        order.retain(|(of, (area, count))| {
            *of == first || (*area >= self.smallest * largest && *count >= self.fewest)
        });
        let place: BTreeMap<u32, u32> = order
            .iter()
            .zip(0..)
            .map(|((first, _), place)| (*first, place))
            .collect();
        let (mut of, mut known, mut kept) = (vec![u32::MAX; rows.len()], Vec::new(), Vec::new());
        for (k, &i) in solid.iter().enumerate() {
            if let Some(&piece) = place.get(&chains.first(k as u32)) {
                of[i as usize] = piece;
                known.push(piece);
                kept.push(points[k]);
            }
        }
        let strays: Vec<u32> = (0..)
            .zip(&of)
            .filter(|(_, piece)| **piece == u32::MAX)
            .map(|(i, _)| i)
            .collect();
        let queries: Vec<[f32; 3]> = strays.iter().map(|&i| at(i)).collect();
        let (nearest, _) = PointIndex::new(&kept)?.nearest(&queries, 1)?;
        for (&i, &at) in strays.iter().zip(&nearest.indices) {
            of[i as usize] = known[at as usize];
        }
        Ok((order.len(), of))
    }
}

//! Objects of one label that do not touch become labels of their own: `chair` becomes `chair 1` and `chair 2`.
//!
//! A Gaussian of opacity o stands for the ellipsoid within which `o exp(-r^2 / 2)` exceeds [`Separation::level`]. Two of one label
//! touch where their ellipsoids overlap (Perram and Wertheim 1985). Connected components are pieces. Pieces of little area are
//! strays, and go to the nearest piece.

mod components;
mod ellipsoid;
mod naming;

use super::color_apart;
use super::inventory::rows_by_label;
use crate::data::Classes;
use crate::error::{Result, ensure};
use crate::segmentation::neighbours::PointIndex;
use crate::splat::Gaussians;
use components::connected_components;
use ellipsoid::Ellipsoid;
use naming::Naming;
use smart_default::SmartDefault;
use std::collections::{BTreeMap, BTreeSet};

/// What counts as touching, and as an object. The defaults were chosen on two trained rooms with true instances (docs/measured-objects.md,
/// "Things of one label").
#[derive(Clone, Copy, Debug, PartialEq, SmartDefault)]
pub struct Separation {
    /// Opacity at which a Gaussian ends, in (0, 1); a less opaque one touches nothing.
    #[default(0.1)]
    pub level: f64,
    /// Pieces with less than this share of the area of their label's largest piece are strays, in [0, 1]. The area of a Gaussian is
    /// its opacity times its two larger standard deviations.
    #[default(0.01)]
    pub smallest: f64,
    /// Pieces of fewer solid Gaussians than this are strays too, except the largest piece of a label.
    #[default(10)]
    pub fewest: usize,
    /// Nearest Gaussians of the same label that each is compared with, at least 1. A large one is also compared with all whose
    /// centres lie within its longest half-axis.
    #[default(24)]
    pub neighbours: usize,
}

/// Labels after separation.
#[derive(Clone, Debug, PartialEq)]
pub struct Separated {
    /// Label of each Gaussian.
    pub labels: Vec<u16>,
    /// The class table of the scene and the new labels.
    pub classes: Classes,
    /// Labels that became several, each with its pieces, the largest first. That is the label itself.
    pub pieces: BTreeMap<u16, Vec<u16>>,
}

impl Separation {
    /// Separates the objects of each label that `wanted` accepts. The largest piece keeps the label. The others get ids above all
    /// those in use, and a name with the next free number.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] for a rule out of its range; those of [`Gaussians::check`]; [`crate::Error::Limit`] when ids run out.
    pub fn apply(
        &self,
        gaussians: &Gaussians,
        labels: &[u16],
        classes: &Classes,
        wanted: impl Fn(u16) -> bool,
    ) -> Result<Separated> {
        self.check()?;
        gaussians.check(Some(labels))?;
        let mut naming = Naming::new(labels, classes);
        let mut separated = Separated {
            labels: labels.to_vec(),
            classes: Classes::default(),
            pieces: BTreeMap::new(),
        };
        for (id, rows) in rows_by_label(labels) {
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
        // Without a class table all labels get names, not only the divided ones.
        let unnamed = separated
            .labels
            .iter()
            .filter(|&&id| classes.is_empty() && id != naming.classes.ignore);
        for id in unnamed.copied().collect::<BTreeSet<u16>>() {
            naming.classes.entry(id);
        }
        separated.classes = naming.classes;
        let made = separated.pieces.values().flat_map(|ids| &ids[1..]);
        let made: BTreeSet<u16> = made.copied().collect();
        color_apart(gaussians, &separated.labels, &mut separated.classes, &made)?;
        Ok(separated)
    }

    fn check(&self) -> Result<()> {
        const HELP: &str = "the default suits most scenes";
        ensure!(self.level > 0.0 && self.level < 1.0,
            argument "separation level"; found "{}", self.level; expected "above 0 and below 1"; help "{HELP}");
        ensure!((0.0..=1.0).contains(&self.smallest),
            argument "separation smallest"; found "{}", self.smallest; expected "0 to 1"; help "{HELP}");
        ensure!(self.neighbours > 0, argument "separation neighbours"; found "0"; expected "1 or more"; help "{HELP}");
        Ok(())
    }

    /// The number of pieces of the Gaussians `rows`, and the piece of each of them. The largest piece is 0.
    fn pieces(&self, gaussians: &Gaussians, rows: &[u32]) -> Result<(usize, Vec<u32>)> {
        let position = |i: usize| gaussians.means[rows[i] as usize];
        let mut solid = Vec::new();
        let mut ellipsoids = Vec::new();
        for (i, &row) in rows.iter().enumerate() {
            if let Some(ellipsoid) = Ellipsoid::new(gaussians, row as usize, self.level) {
                solid.push(i);
                ellipsoids.push(ellipsoid);
            }
        }
        if solid.len() < 2 {
            return Ok((1, vec![0; rows.len()]));
        }
        let points: Vec<[f32; 3]> = solid.iter().map(|&i| position(i)).collect();
        let components = connected_components(&ellipsoids, &points, self.neighbours)?;
        let places = self.ranked(&ellipsoids, &components);
        let mut pieces = vec![u32::MAX; rows.len()];
        let mut known = Vec::new();
        let mut kept = Vec::new();
        for (k, &i) in solid.iter().enumerate() {
            if let Some(&piece) = places.get(&components[k]) {
                pieces[i] = piece;
                known.push(piece);
                kept.push(points[k]);
            }
        }
        let strays: Vec<usize> = (0..rows.len()).filter(|&i| pieces[i] == u32::MAX).collect();
        let queries: Vec<[f32; 3]> = strays.iter().map(|&i| position(i)).collect();
        let (nearest, _) = PointIndex::new(&kept)?.nearest(&queries, 1)?;
        for (&i, &place) in strays.iter().zip(&nearest.indices) {
            pieces[i] = known[place as usize];
        }
        Ok((places.len(), pieces))
    }

    /// The components that are not strays with their ranks by area. A component is named by its first member.
    fn ranked(&self, ellipsoids: &[Ellipsoid], components: &[u32]) -> BTreeMap<u32, u32> {
        let mut sizes: BTreeMap<u32, Size> = BTreeMap::new();
        for (component, ellipsoid) in components.iter().zip(ellipsoids) {
            let size = sizes.entry(*component).or_default();
            size.area += ellipsoid.area;
            size.count += 1;
        }
        let mut order: Vec<(u32, Size)> = sizes.into_iter().collect();
        order.sort_by(|(a, large), (b, small)| small.area.total_cmp(&large.area).then(a.cmp(b)));
        let (first, Size { area: largest, .. }) = order[0];
        let is_piece = |&(component, ref size): &(u32, Size)| {
            let large = size.area >= self.smallest * largest && size.count >= self.fewest;
            component == first || large
        };
        let pieces = order.into_iter().filter(is_piece);
        pieces.map(|(component, _)| component).zip(0..).collect()
    }
}

/// Size of a component.
#[derive(Default)]
struct Size {
    area: f64,
    /// Solid Gaussians.
    count: usize,
}

//! A grid of blocks over the floor of a scene. Every point of space lies in one block.

use super::{AGAIN, Region};
use crate::error::{Result, ensure};
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Blocks along a side, at most.
const MAX_SIDE: usize = 64;
/// Training cameras that stand in each block, at least.
const MIN_CAMERAS: usize = 4;
/// A region is its core grown by this share of its size on each side.
const MARGIN: f64 = 0.2;
/// Unit vectors that are read from a file may be off by this.
const UNIT_TOLERANCE: f64 = 1e-6;

/// Blocks of space: columns along one horizontal axis, and rows in each column along the other. Outer blocks have no end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// Columns, and rows in each.
    pub counts: [usize; 2],
    /// The horizontal directions of both, unit vectors in the world.
    pub axes: [DVec3; 2],
    /// Lowest and highest coordinates of the training cameras along both, world units. Where the size of a block matters, outer
    /// blocks end there.
    pub extent: [[f64; 2]; 2],
    /// Borders between columns, ascending, world units.
    pub columns: Vec<f64>,
    /// Borders between the rows of each column.
    pub rows: Vec<Vec<f64>>,
}

impl Grid {
    /// A grid of `counts` columns and rows in which each block has about the same number of `cameras`, which are positions in the
    /// world.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] naming `--blocks`: no block, too many, fewer than four cameras in a block.
    pub fn new(counts: [usize; 2], cameras: &[DVec3], up: DVec3) -> Result<Self> {
        let [columns, rows] = counts;
        ensure!(counts.iter().all(|count| (1..=MAX_SIDE).contains(count)),
            argument "--blocks"; found "{columns}x{rows}"; expected "1 to {MAX_SIDE} columns and rows";
            help "3x2 makes six blocks");
        let blocks = columns * rows;
        let count = cameras.len();
        ensure!(count >= MIN_CAMERAS * blocks,
            argument "--blocks"; found "{blocks} blocks of {count} training cameras";
            expected "at least {MIN_CAMERAS} cameras for each block"; help "ask for fewer blocks");
        let axes = horizontal(up);
        let places = cameras
            .iter()
            .map(|camera| axes.map(|axis| axis.dot(*camera)));
        let places: Vec<[f64; 2]> = places.collect();
        let along = |axis: usize| places.iter().map(move |place| place[axis]);
        let mut grid = Self {
            counts,
            axes,
            extent: [0, 1].map(|axis| {
                let (low, high) = (f64::INFINITY, f64::NEG_INFINITY);
                [
                    along(axis).fold(low, f64::min),
                    along(axis).fold(high, f64::max),
                ]
            }),
            columns: quantiles(along(0).collect(), columns),
            rows: Vec::new(),
        };
        for column in 0..columns {
            let inside = places
                .iter()
                .filter(|place| grid.column(place[0]) == column);
            let inside: Vec<f64> = inside.map(|place| place[1]).collect();
            ensure!(inside.len() >= MIN_CAMERAS * rows,
                argument "--blocks"; found "{} training cameras in column {column}: many stand in one line", inside.len();
                expected "at least {MIN_CAMERAS} cameras for each block"; help "ask for fewer blocks, or for 1x{}", columns * rows);
            grid.rows.push(quantiles(inside, rows));
        }
        grid.check_cameras(cameras)?;
        Ok(grid)
    }

    /// Refuses blocks in which few cameras stand.
    fn check_cameras(&self, cameras: &[DVec3]) -> Result<()> {
        for index in self.indices() {
            let inside = cameras.iter().filter(|camera| self.cell(**camera) == index);
            let count = inside.count();
            ensure!(count >= MIN_CAMERAS,
                argument "--blocks"; found "{count} training cameras in block {}: many stand in one place", block_name(index);
                expected "at least {MIN_CAMERAS} cameras for each block"; help "ask for fewer blocks");
        }
        Ok(())
    }

    /// Refuses a malformed grid from `file`.
    pub(super) fn check(&self, file: &Path) -> Result<()> {
        let [columns, rows] = self.counts;
        ensure!(self.counts.iter().all(|count| (1..=MAX_SIDE).contains(count)), file, "grid.counts";
            found "{columns}, {rows}"; expected "1 to {MAX_SIDE} columns and rows"; help "{AGAIN}");
        let [x, y] = self.axes;
        let is_unit = |axis: DVec3| (axis.length() - 1.0).abs() < UNIT_TOLERANCE;
        ensure!(is_unit(x) && is_unit(y) && x.dot(y).abs() < UNIT_TOLERANCE, file, "grid.axes"; found "{x}, {y}";
            expected "two perpendicular unit vectors"; help "{AGAIN}");
        ensure!(self.extent.iter().all(|[low, high]| low <= high), file, "grid.extent"; found "{:?}", self.extent;
            expected "the lower end first"; help "{AGAIN}");
        let are_borders = |borders: &[f64], parts: usize| {
            borders.len() + 1 == parts && borders.is_sorted_by(|a, b| a < b)
        };
        ensure!(are_borders(&self.columns, columns), file, "grid.columns"; found "{:?}", self.columns;
            expected "{} ascending numbers", columns - 1; help "{AGAIN}");
        let are_rows = self.rows.iter().all(|column| are_borders(column, rows));
        ensure!(self.rows.len() == columns && are_rows, file, "grid.rows"; found "{:?}", self.rows;
            expected "{columns} lists of {} ascending numbers", rows - 1; help "{AGAIN}");
        Ok(())
    }

    /// Column and row of each block, column after column.
    pub fn indices(&self) -> impl Iterator<Item = [usize; 2]> + use<> {
        let [columns, rows] = self.counts;
        (0..columns).flat_map(move |column| (0..rows).map(move |row| [column, row]))
    }

    /// The block in whose core a world point lies.
    pub fn cell(&self, point: DVec3) -> [usize; 2] {
        let [x, y] = self.axes.map(|axis| axis.dot(point));
        let column = self.column(x);
        [column, part(&self.rows[column], y)]
    }

    fn column(&self, x: f64) -> usize {
        part(&self.columns, x)
    }

    /// The space that belongs to this block alone.
    pub fn core(&self, index: [usize; 2]) -> Region {
        let [column, row] = index;
        let [x, y] = [side(&self.columns, column), side(&self.rows[column], row)];
        Region {
            axes: self.axes,
            low: DVec2::new(x[0], y[0]),
            high: DVec2::new(x[1], y[1]),
        }
    }

    /// What the block is trained on: its core and a margin of a fifth of its size on each side.
    pub fn extended(&self, index: [usize; 2]) -> Region {
        let core = self.core(index);
        let [x, y] = self.extent;
        let low = core.low.max(DVec2::new(x[0], y[0]));
        let high = core.high.min(DVec2::new(x[1], y[1]));
        let margin = MARGIN * (high - low);
        Region {
            low: core.low - margin,
            high: core.high + margin,
            ..core
        }
    }
}

/// The name of the block at a column and a row, which its folder has.
pub fn block_name([column, row]: [usize; 2]) -> String {
    format!("{column}_{row}")
}

/// Two horizontal directions: the two world axes that are farthest from `up`, in their order, without their slope.
fn horizontal(up: DVec3) -> [DVec3; 2] {
    let slope = |axis: &usize| DVec3::AXES[*axis].dot(up).abs();
    let upright = (0..3).max_by(|a, b| slope(a).total_cmp(&slope(b)));
    let mut level = (0..3).filter(|axis| Some(*axis) != upright);
    let mut next = || DVec3::AXES[level.next().unwrap_or_default()];
    let [first, second] = [next(), next()];
    let x = first.reject_from(up).normalize();
    let y = up.cross(x).normalize();
    [x, y * second.dot(y).signum()]
}

/// Borders that cut `values` into `parts` of about equal numbers, halfway between neighbours.
fn quantiles(mut values: Vec<f64>, parts: usize) -> Vec<f64> {
    values.sort_by(f64::total_cmp);
    let cut = |k: usize| {
        let i = k * values.len() / parts;
        values[i - 1] + 0.5 * (values[i] - values[i - 1])
    };
    (1..parts).map(cut).collect()
}

/// The part between `borders` in which a value lies.
fn part(borders: &[f64], value: f64) -> usize {
    borders.partition_point(|border| *border <= value)
}

/// Both ends of a part between `borders`.
fn side(borders: &[f64], part: usize) -> [f64; 2] {
    let low = part
        .checked_sub(1)
        .map_or(f64::NEG_INFINITY, |i| borders[i]);
    let high = borders.get(part).copied().unwrap_or(f64::INFINITY);
    [low, high]
}

//! What a network says about a photo: a label map of its size, and the scores of the best classes.

use super::contract::Values;
use super::mapping::Mapping;
use super::model::Network;
use crate::backend::elementary::exp;
use crate::data::bilinear::beside;
use crate::data::{LabelMap, ScoreGrid, ScoreMap, first_largest};
use crate::error::Result;
use image::RgbImage;

/// Cells of scores on the longer side, at most: outputs that are finer are averaged over blocks.
const MAX_CELLS: usize = 192;
/// Probability of the listed classes below which a pixel is unlabelled: none of them would be stored.
const MIN_PROBABILITY: f32 = 0.5 / 255.0;

/// The output of a network for a photo, cut to the cells that the photo needs.
#[derive(Clone, Debug)]
pub struct Logits {
    /// Where the cells lie.
    pub grid: ScoreGrid,
    /// Cells across.
    pub width: usize,
    /// Cells down.
    pub height: usize,
    /// `[height, width, classes]`.
    pub values: Vec<f32>,
    /// What the values are.
    pub kind: Values,
}

/// Scores of the classes of the labels.
struct Mapped<'a> {
    /// Its values are logits or probabilities, `[height, width, channels]`.
    logits: Logits,
    /// Probabilities of the classes that are not dropped, `[height, width, channels]`. They add up to 1, or are all 0 where those
    /// of the listed classes are 0.
    probabilities: Vec<f32>,
    /// Probability of all classes that are not dropped, `[height, width]`.
    listed: Vec<f32>,
    mapping: &'a Mapping,
}

impl Network {
    /// Runs the network on a photo.
    ///
    /// # Errors
    /// [`crate::Error::Input`] where the network fails, and where its output is not what the contract calls it, logits or
    /// probabilities; [`crate::Error::NonFinite`].
    pub fn run(&self, photo: &RgbImage) -> Result<Logits> {
        let (input, area) = self.contract.prepare(photo);
        let values = self.output(&input)?;
        let mut grid = self.contract.grid(&area);
        let [down, across, classes] = self.map_shape();
        let needed = |a: usize, cells: usize| {
            let cell = |pixel: f64| grid.scale[a] * pixel + grid.offset[a];
            let first = (cell(0.5).max(0.0) as usize).min(cells - 1);
            let last =
                (cell(grid.photo[a] as f64 - 0.5).max(0.0).ceil() as usize).clamp(first, cells - 1);
            first..last + 1
        };
        let (columns, rows) = (needed(0, across), needed(1, down));
        let mut cut = Vec::with_capacity(rows.len() * columns.len() * classes);
        for row in rows.clone() {
            let first = (row * across + columns.start) * classes;
            cut.extend_from_slice(&values[first..][..columns.len() * classes]);
        }
        self.check_values(&cut)?;
        grid.offset[0] -= columns.start as f64;
        grid.offset[1] -= rows.start as f64;
        Ok(Logits {
            grid,
            width: columns.len(),
            height: rows.len(),
            values: cut,
            kind: self.contract.output.values,
        })
    }
}

impl Logits {
    /// The label map of the photo's size, and the `best` most probable classes of each cell.
    pub fn labels(&self, mapping: &Mapping, best: usize) -> (LabelMap, ScoreMap) {
        let mapped = self.mapped(mapping);
        (mapped.map(), mapped.scores(best))
    }

    /// The classes of the labels: the probability of a class is the sum of those that it consists of.
    fn mapped<'a>(&self, mapping: &'a Mapping) -> Mapped<'a> {
        let classes = mapping.channels.len();
        let channels = mapping.ids.len();
        let cells = self.width * self.height;
        let mut values = Vec::with_capacity(cells * channels);
        let mut probabilities = Vec::with_capacity(cells * channels);
        let mut listed = Vec::with_capacity(cells);
        let only_classes = mapping.only_classes();
        let mut sums = vec![0.0_f32; channels];
        for cell in self.values.chunks_exact(classes) {
            let most = cell.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let weights = weights(cell, most, self.kind);
            let all: f32 = weights.iter().sum();
            sums.fill(0.0);
            for (weight, channel) in weights.iter().zip(&mapping.channels) {
                if let Some(channel) = channel {
                    sums[*channel] += weight;
                }
            }
            let kept: f32 = sums.iter().sum();
            let share = if all > 0.0 { kept / all } else { 0.0 };
            listed.push(share);
            match self.kind {
                Values::Logits => {
                    let logit = |(only, sum): (&Option<usize>, &f32)| match only {
                        Some(class) => cell[*class],
                        None => most + sum.max(f32::MIN_POSITIVE).ln(),
                    };
                    values.extend(only_classes.iter().zip(&sums).map(logit));
                }
                Values::Probabilities => values.extend_from_slice(&sums),
            }
            let is_known = share >= MIN_PROBABILITY;
            let probability = |sum: &f32| if is_known { sum / kept } else { 0.0 };
            probabilities.extend(sums.iter().map(probability));
        }
        Mapped {
            logits: Logits { values, ..*self },
            probabilities,
            listed,
            mapping,
        }
    }
}

/// The two cells around a pixel on one axis, and the share of the second.
#[derive(Clone, Copy)]
struct Between {
    first: usize,
    second: usize,
    share: f32,
}

impl Between {
    /// For each pixel of an axis `a` with `cells` cells. Pixels outside take the border.
    fn axis(grid: &ScoreGrid, a: usize, cells: usize) -> Vec<Self> {
        let pixel = |pixel: usize| {
            let cell = grid.scale[a] * (pixel as f64 + 0.5) + grid.offset[a];
            let (first, second, share) = beside(cell, cells);
            let share = share as f32;
            Self {
                first,
                second,
                share,
            }
        };
        (0..grid.photo[a]).map(pixel).collect()
    }

    fn of(&self, first: f32, second: f32) -> f32 {
        first + self.share * (second - first)
    }
}

impl Mapped<'_> {
    /// The class of the highest value at each pixel of the photo, values bilinear between the cells.
    fn map(&self) -> LabelMap {
        let Logits { grid, values, .. } = &self.logits;
        let [width, height] = grid.photo;
        let channels = self.mapping.ids.len();
        let columns = Between::axis(grid, 0, self.logits.width);
        let mut ids = Vec::with_capacity(width * height);
        let mut row = Vec::new();
        let mut listed = Vec::new();
        let mut candidates = Vec::new();
        for down in Between::axis(grid, 1, self.logits.height) {
            self.blend_rows(down, values, channels, &mut row);
            self.blend_rows(down, &self.listed, 1, &mut listed);
            let mut interval = None;
            for across in &columns {
                let cells = [across.first, across.second];
                let [left, right] = cells.map(|cell| &row[cell * channels..][..channels]);
                if interval != Some(across.first) {
                    interval = Some(across.first);
                    find_candidates(left, right, &mut candidates);
                }
                let value = |&channel: &usize| across.of(left[channel], right[channel]);
                let best = first_largest(candidates.iter().map(value));
                let best = best.map(|place| candidates[place]);
                let [left, right] = cells.map(|cell| listed[cell]);
                let is_known = across.of(left, right) >= MIN_PROBABILITY;
                let id = best
                    .filter(|_| is_known)
                    .map_or(self.mapping.classes.ignore, |best| self.mapping.ids[best]);
                ids.push(id);
            }
        }
        LabelMap { width, height, ids }
    }

    /// A row of `values` with `channels` values a cell, between two rows of cells.
    fn blend_rows(&self, down: Between, values: &[f32], channels: usize, row: &mut Vec<f32>) {
        let length = self.logits.width * channels;
        let [upper, lower] = [down.first, down.second].map(|y| &values[y * length..][..length]);
        row.clear();
        row.extend(upper.iter().zip(lower).map(|(&a, &b)| down.of(a, b)));
    }

    /// The `best` most probable classes of each cell, or block of cells.
    fn scores(&self, best: usize) -> ScoreMap {
        let &Logits {
            grid,
            width,
            height,
            ..
        } = &self.logits;
        let block = width.max(height).div_ceil(MAX_CELLS);
        let [width, height] = [width, height].map(|n| n.div_ceil(block));
        let classes = best.clamp(1, self.mapping.ids.len());
        let mut ids = vec![0; classes * width * height];
        let mut probabilities = vec![0; classes * width * height];
        let mut sums = vec![0.0_f32; self.mapping.ids.len()];
        let mut order: Vec<usize> = Vec::new();
        for cell in 0..width * height {
            self.mean_probabilities([cell % width, cell / width], block, &mut sums);
            let is_stored = |channel: &usize| {
                sums[*channel] >= 1.0 / 255.0
                    && self.mapping.ids[*channel] != self.mapping.classes.ignore
            };
            order.clear();
            order.extend((0..sums.len()).filter(is_stored));
            order.sort_by(|&a, &b| sums[b].total_cmp(&sums[a]));
            for (n, &channel) in order.iter().take(classes).enumerate() {
                ids[n * width * height + cell] = self.mapping.ids[channel];
                // Rounded down, so that they never add up to more than 1.
                probabilities[n * width * height + cell] = (255.0 * sums[channel]) as u8;
            }
        }
        let largest = self.mapping.ids.iter().max();
        ScoreMap {
            grid: ScoreGrid {
                scale: grid.scale.map(|scale| scale / block as f64),
                offset: grid
                    .offset
                    .map(|offset| (offset + 0.5) / block as f64 - 0.5),
                ..grid
            },
            width,
            height,
            classes,
            id_limit: largest.map_or(1, |id| u32::from(*id) + 1),
            ids,
            probabilities,
        }
    }

    /// The probabilities of the channels, mean over a block of cells.
    fn mean_probabilities(&self, [column, row]: [usize; 2], block: usize, sums: &mut [f32]) {
        let &Logits { width, height, .. } = &self.logits;
        sums.fill(0.0);
        let mut cells = 0.0;
        for y in row * block..((row + 1) * block).min(height) {
            for x in column * block..((column + 1) * block).min(width) {
                cells += 1.0;
                let first = (y * width + x) * sums.len();
                let probabilities = &self.probabilities[first..];
                sums.iter_mut()
                    .zip(probabilities)
                    .for_each(|(sum, probability)| *sum += probability);
            }
        }
        sums.iter_mut().for_each(|sum| *sum /= cells);
    }
}

/// Probabilities up to a common factor; `most` is the largest of the values.
fn weights(values: &[f32], most: f32, kind: Values) -> Vec<f32> {
    let weight = |value: &f32| match kind {
        // In line: calls of the library for each value took as long as the network.
        Values::Logits => exp(f64::from(value - most)) as f32,
        Values::Probabilities => value.max(0.0),
    };
    values.iter().map(weight).collect()
}

/// The channels that can be the highest somewhere between two cells: those that reach the best lower end.
fn find_candidates(left: &[f32], right: &[f32], found: &mut Vec<usize>) {
    let ends = || left.iter().zip(right);
    let least = ends()
        .map(|(&a, &b)| a.min(b))
        .fold(f32::NEG_INFINITY, f32::max);
    found.clear();
    found.extend(
        ends()
            .enumerate()
            .filter(|(_, (a, b))| a.max(**b) >= least)
            .map(|(channel, _)| channel),
    );
}

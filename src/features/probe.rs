//! Linear probe: how much class information features hold that a linear map can read.
//!
//! A multinomial logistic regression from the features at a pixel to its true class is trained on training views and
//! scored on test views. It measures features; it is no part of the method, which never sees true labels.

use super::FeatureMap;
use crate::data::{Classes, LabelMap};
use crate::error::{Error, Result};
use crate::metrics::{Confusion, Void};
use crate::random::{self, Purpose};
use nalgebra::DMatrix;
use rand::seq::{SliceRandom, index};
use rayon::prelude::*;

/// One view: its true labels and any number of feature maps, read bilinearly and concatenated.
#[derive(Clone, Copy, Debug)]
pub struct ProbeView<'a> {
    /// True labels; pixels of classes outside the table are left out.
    pub truth: &'a LabelMap,
    /// Maps that cover the image.
    pub maps: &'a [FeatureMap],
}

/// How the regression is trained.
#[derive(Clone, Debug, PartialEq)]
pub struct ProbeSettings {
    /// Pixels drawn from each training view.
    pub pixels_per_view: usize,
    /// Every n-th pixel along both axes of the test views is scored.
    pub test_stride: usize,
    /// Passes over the drawn pixels, Adam with a cosine schedule.
    pub epochs: usize,
    /// Highest learning rate, on standardised features.
    pub lr: f32,
    /// Weight of half the squared weights.
    pub decay: f32,
    /// Seed of pixels and batches.
    pub seed: u64,
}

impl Default for ProbeSettings {
    fn default() -> Self {
        Self {
            pixels_per_view: 500,
            test_stride: 3,
            epochs: 30,
            lr: 1e-2,
            decay: 1e-4,
            seed: 0,
        }
    }
}

/// What the regression reaches on the test views.
#[derive(Clone, Debug, PartialEq)]
pub struct ProbeScore {
    /// Share of scored pixels with the right class, 0..1.
    pub accuracy: f64,
    /// Mean intersection over union over the classes present in the test truth, pooled over views, 0..1.
    pub miou: f64,
    /// Length of the feature vector.
    pub dimensions: usize,
    /// Training pixels and test pixels.
    pub pixels: [usize; 2],
}

/// Pixels in a batch.
const BATCH: usize = 1000;

/// Trains on `train`, scores on `test`; the same settings give the same bits.
///
/// # Errors
/// [`Error::Argument`] when there is no labelled pixel or a view's maps are not like the others'.
pub fn linear_probe(
    classes: &Classes,
    train: &[ProbeView],
    test: &[ProbeView],
    settings: &ProbeSettings,
) -> Result<ProbeScore> {
    let dimensions = train
        .first()
        .map_or(0, |v| v.maps.iter().map(|m| m.channels).sum());
    for view in train.iter().chain(test) {
        let found: usize = view.maps.iter().map(|m| m.channels).sum();
        if found != dimensions || dimensions == 0 {
            let (found, wanted) = (
                format!("{found} channels"),
                format!("{dimensions} (the first view's), not 0"),
            );
            return Err(Error::argument(
                "linear probe",
                found,
                wanted,
                "give every view the same maps",
            ));
        }
    }
    let mut drawn = gather(classes, train, dimensions, |view, truth| {
        let mut rng = random::stream(settings.seed, Purpose::ProbePixels, view as u64);
        let count = truth.ids.len();
        index::sample(&mut rng, count, settings.pixels_per_view.min(count)).into_vec()
    });
    let mut scored = gather(classes, test, dimensions, |_, truth| {
        let step = settings.test_stride.max(1);
        let rows = (step / 2..truth.height).step_by(step);
        rows.flat_map(|y| {
            (step / 2..truth.width)
                .step_by(step)
                .map(move |x| y * truth.width + x)
        })
        .collect()
    });
    if drawn.classes.is_empty() || scored.classes.is_empty() {
        return Err(Error::argument(
            "linear probe",
            "no labelled pixel",
            "some in both splits",
            "give views with truth",
        ));
    }
    let (mean, scale) = spread(&drawn.values, dimensions);
    drawn.standardise(&mean, &scale);
    scored.standardise(&mean, &scale);
    let weights = fit(&drawn, dimensions, classes.len(), settings);
    Ok(score(&scored, &weights, dimensions, drawn.classes.len()))
}

/// Feature vectors, each with a constant 1 appended, and class indices.
struct Samples {
    values: Vec<f32>,
    classes: Vec<usize>,
}

impl Samples {
    fn standardise(&mut self, mean: &[f32], scale: &[f32]) {
        let width = mean.len() + 1;
        self.values.par_chunks_exact_mut(width).for_each(|row| {
            for ((x, m), s) in row.iter_mut().zip(mean).zip(scale) {
                *x = (*x - m) * s;
            }
        });
    }

    fn batch(&self, rows: &[usize], width: usize) -> DMatrix<f32> {
        DMatrix::from_iterator(
            width,
            rows.len(),
            rows.iter()
                .flat_map(|&r| self.values[r * width..][..width].iter().copied()),
        )
    }
}

fn gather(
    classes: &Classes,
    views: &[ProbeView],
    dimensions: usize,
    choose: impl Fn(usize, &LabelMap) -> Vec<usize> + Sync,
) -> Samples {
    let parts: Vec<Samples> = views
        .par_iter()
        .enumerate()
        .map(|(n, view)| {
            let mut part = Samples {
                values: vec![],
                classes: vec![],
            };
            let (w, h) = (view.truth.width, view.truth.height);
            for pixel in choose(n, view.truth) {
                let Some(class) = classes.index(view.truth.ids[pixel]) else {
                    continue;
                };
                let (u, v) = ((pixel % w) as f64 + 0.5, (pixel / w) as f64 + 0.5);
                let start = part.values.len();
                part.values.resize(start + dimensions + 1, 0.0);
                let mut rest = &mut part.values[start..];
                for map in view.maps {
                    let (out, tail) = rest.split_at_mut(map.channels);
                    map.sample(u, v, w, h, out);
                    rest = tail;
                }
                rest[0] = 1.0;
                part.classes.push(class);
            }
            part
        })
        .collect();
    let mut all = Samples {
        values: vec![],
        classes: vec![],
    };
    for part in parts {
        all.values.extend(part.values);
        all.classes.extend(part.classes);
    }
    all
}

/// Mean and reciprocal standard deviation of each feature; 0 for constant ones.
fn spread(values: &[f32], dimensions: usize) -> (Vec<f32>, Vec<f32>) {
    let rows = values.chunks_exact(dimensions + 1);
    let n = rows.len() as f64;
    let (mut sum, mut squares) = (vec![0.0_f64; dimensions], vec![0.0_f64; dimensions]);
    for row in rows.clone() {
        row.iter()
            .zip(&mut sum)
            .for_each(|(&x, s)| *s += f64::from(x) / n);
    }
    for row in rows {
        for ((&x, m), s) in row.iter().zip(&sum).zip(&mut squares) {
            *s += (f64::from(x) - m).powi(2) / n;
        }
    }
    let scale = squares
        .iter()
        .map(|&v| {
            if v > 1e-14 {
                (1.0 / v.sqrt()) as f32
            } else {
                0.0
            }
        })
        .collect();
    (sum.iter().map(|&m| m as f32).collect(), scale)
}

/// Weights `[classes, dimensions + 1]`.
fn fit(
    samples: &Samples,
    dimensions: usize,
    classes: usize,
    settings: &ProbeSettings,
) -> DMatrix<f32> {
    let width = dimensions + 1;
    let mut weights = DMatrix::<f32>::zeros(classes, width);
    let (mut m, mut v) = (weights.clone(), weights.clone());
    let mut order: Vec<usize> = (0..samples.classes.len()).collect();
    let steps = settings.epochs * order.len().div_ceil(BATCH);
    let mut step = 0_i32;
    for epoch in 0..settings.epochs {
        order.shuffle(&mut random::stream(
            settings.seed,
            Purpose::ProbeOrder,
            epoch as u64,
        ));
        for rows in order.chunks(BATCH) {
            let x = samples.batch(rows, width);
            let mut residual = softmax(&weights * &x);
            for (mut column, &row) in residual.column_iter_mut().zip(rows) {
                column[samples.classes[row]] -= 1.0;
            }
            let gradient = residual * x.transpose() / rows.len() as f32 + &weights * settings.decay;
            step += 1;
            let lr = 0.5
                * settings.lr
                * (1.0 + (std::f32::consts::PI * step as f32 / steps as f32).cos());
            let (c1, c2) = (1.0 - 0.9_f32.powi(step), 1.0 - 0.999_f32.powi(step));
            for (((w, &g), m), v) in weights
                .iter_mut()
                .zip(gradient.iter())
                .zip(m.iter_mut())
                .zip(v.iter_mut())
            {
                *m = 0.9 * *m + 0.1 * g;
                *v = 0.999 * *v + 0.001 * g * g;
                *w -= lr * (*m / c1) / ((*v / c2).sqrt() + 1e-8);
            }
        }
    }
    weights
}

fn softmax(mut logits: DMatrix<f32>) -> DMatrix<f32> {
    for mut column in logits.column_iter_mut() {
        let peak = column.max();
        column.apply(|x| *x = (*x - peak).exp());
        let sum = column.sum();
        column /= sum;
    }
    logits
}

fn score(
    samples: &Samples,
    weights: &DMatrix<f32>,
    dimensions: usize,
    trained: usize,
) -> ProbeScore {
    let (classes, width) = (weights.nrows(), dimensions + 1);
    let rows: Vec<usize> = (0..samples.classes.len()).collect();
    let predicted: Vec<usize> = rows
        .par_chunks(BATCH)
        .flat_map_iter(|rows| {
            let logits = weights * samples.batch(rows, width);
            logits
                .column_iter()
                .map(|c| c.argmax().0)
                .collect::<Vec<_>>()
        })
        .collect();
    let mut confusion = Confusion::new(classes);
    confusion.add(samples.classes.iter().copied(), predicted);
    // Both are known: there is at least one scored pixel, and each has a class.
    ProbeScore {
        accuracy: confusion.accuracy(Void::Wrong).unwrap_or(0.0),
        miou: confusion.miou(Void::Wrong).unwrap_or(0.0),
        dimensions,
        pixels: [trained, rows.len()],
    }
}

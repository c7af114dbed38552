//! Linear probe: how much class information a linear map can read from features.
//!
//! A multinomial logistic regression from the features at a pixel to its true class, trained on training views and scored on
//! test views.

use coseg::data::{Classes, LabelMap};
use coseg::features::FeatureMap;
use coseg::metrics::{Confusion, Void};
use nalgebra::DMatrix;
use rand::SeedableRng;
use rand::seq::{SliceRandom, index};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// One view: its true labels and any number of feature maps, read bilinearly and concatenated.
#[derive(Clone, Copy, Debug)]
pub struct ProbeView<'a> {
    /// True labels; pixels of classes outside the table are left out.
    pub truth: &'a LabelMap,
    /// Maps that cover the image.
    pub maps: &'a [FeatureMap],
}

/// What the regression reaches on the test views.
#[derive(Clone, Debug, PartialEq)]
pub struct ProbeScore {
    /// Share of scored pixels with the right class, 0..1.
    pub accuracy: f64,
    /// Mean intersection over union over the classes present in the test truth, pooled over views, 0..1.
    pub miou: f64,
}

/// Pixels drawn from each training view.
const PIXELS_PER_VIEW: usize = 500;
/// Every n-th pixel along both axes of the test views is scored.
const TEST_STRIDE: usize = 3;
/// Passes over the drawn pixels: Adam with a cosine schedule.
const EPOCHS: usize = 30;
/// Highest learning rate, on standardised features.
const RATE: f32 = 1e-2;
/// Weight of half the squared weights.
const DECAY: f32 = 1e-4;
/// Pixels in a batch.
const BATCH: usize = 1000;

/// Trains on `train`, scores on `test`.
pub fn linear_probe(classes: &Classes, train: &[ProbeView], test: &[ProbeView]) -> ProbeScore {
    let dimensions = train[0].maps.iter().map(|m| m.channels).sum();
    let mut drawn = gather(classes, train, dimensions, |view, truth| {
        let mut rng = ChaCha8Rng::seed_from_u64(view as u64);
        let count = truth.ids.len();
        index::sample(&mut rng, count, PIXELS_PER_VIEW.min(count)).into_vec()
    });
    let mut scored = gather(classes, test, dimensions, |_, truth| {
        let along = |size: usize| (TEST_STRIDE / 2..size).step_by(TEST_STRIDE);
        let width = truth.width;
        along(truth.height)
            .flat_map(|y| along(width).map(move |x| y * width + x))
            .collect()
    });
    let (mean, scale) = spread(&drawn.values, dimensions);
    drawn.standardise(&mean, &scale);
    scored.standardise(&mean, &scale);
    score(&scored, &fit(&drawn, dimensions, classes.len()), dimensions)
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
fn fit(samples: &Samples, dimensions: usize, classes: usize) -> DMatrix<f32> {
    let width = dimensions + 1;
    let mut weights = DMatrix::<f32>::zeros(classes, width);
    let (mut m, mut v) = (weights.clone(), weights.clone());
    let mut order: Vec<usize> = (0..samples.classes.len()).collect();
    let steps = EPOCHS * order.len().div_ceil(BATCH);
    let mut step = 0_i32;
    for epoch in 0..EPOCHS {
        order.shuffle(&mut ChaCha8Rng::seed_from_u64(epoch as u64));
        for rows in order.chunks(BATCH) {
            let x = samples.batch(rows, width);
            let mut residual = softmax(&weights * &x);
            for (mut column, &row) in residual.column_iter_mut().zip(rows) {
                column[samples.classes[row]] -= 1.0;
            }
            let gradient = residual * x.transpose() / rows.len() as f32 + &weights * DECAY;
            step += 1;
            let lr = 0.5 * RATE * (1.0 + (std::f32::consts::PI * step as f32 / steps as f32).cos());
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

fn score(samples: &Samples, weights: &DMatrix<f32>, dimensions: usize) -> ProbeScore {
    let classes = weights.nrows();
    let width = dimensions + 1;
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
    ProbeScore {
        accuracy: confusion.accuracy(Void::Wrong).expect("labelled pixels"),
        miou: confusion.miou(Void::Wrong).expect("labelled pixels"),
    }
}

//! A linear probe: how much of the classes can be read off frozen spatial features by one linear map.

use super::rooms::{LabelledCloud, Scores};
use burn::module::{Module, Param};
use burn::nn::Linear;
use burn::optim::{AdamConfig, GradientsParams};
use burn::tensor::{Device, Tensor, TensorData};
use coseg::Result;
use coseg::metrics::Confusion;
use coseg::segmentation::encoder::{Cloud, Encoding, encode};
use coseg::segmentation::loss::{CoSegLoss, LabelLoss};
use coseg::segmentation::randla::RandlaEncoder;
use glam::DVec3;
use rand::SeedableRng;
use rand::seq::index;
use rand_chacha::ChaCha8Rng;

/// Points of each place that the probe is fitted to, at most.
const FITTED_POINTS: usize = 3_000;
const STEPS: usize = 400;
const BATCH: usize = 4_096;
const RATE: f64 = 1e-2;

/// Fits a linear map from standardised features of all scales (each upsampled to every point, f_e too) to the classes of
/// `train`, with cross-entropy, and scores it on `test`.
///
/// # Errors
/// Those of [`encode`].
pub fn linear_probe(
    encoder: &RandlaEncoder,
    train: &[LabelledCloud],
    test: &[LabelledCloud],
    classes: usize,
    seed: u64,
    device: &Device,
) -> Result<Scores> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut rows = Vec::new();
    let mut labels = Vec::new();
    let mut width = 1;
    for (i, cloud) in train.iter().enumerate() {
        let features = all_scales(encoder, cloud, seed ^ i as u64, device)?;
        width = features.len() / cloud.positions.len().max(1);
        let chosen = index::sample(
            &mut rng,
            cloud.positions.len(),
            FITTED_POINTS.min(cloud.positions.len()),
        );
        for p in chosen {
            rows.extend_from_slice(&features[p * width..][..width]);
            labels.push(cloud.labels[p]);
        }
    }
    let moments = Moments::of(&rows, width);
    moments.standardise(&mut rows);
    let map = fit(&rows, &labels, width, classes, &mut rng, device);
    let mut confusion = Confusion::new(classes);
    for (i, cloud) in test.iter().enumerate() {
        let mut features = all_scales(encoder, cloud, seed ^ i as u64, device)?;
        moments.standardise(&mut features);
        let logits = map.forward(tensor(
            features,
            [cloud.positions.len(), width],
            &device.clone().inner(),
        ));
        let truth = cloud.labels.iter().map(|&l| usize::from(l));
        confusion.add(truth, best(&host(logits), classes));
    }
    Ok(Scores::from(&confusion))
}

/// Index of the largest value of each row.
fn best(logits: &[f32], classes: usize) -> Vec<usize> {
    let rows = logits.chunks_exact(classes);
    rows.map(|row| {
        (0..classes)
            .max_by(|&a, &b| row[a].total_cmp(&row[b]).then(b.cmp(&a)))
            .unwrap_or(0)
    })
    .collect()
}

fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn host(tensor: Tensor<2>) -> Vec<f32> {
    tensor.into_data().into_vec().expect("f32")
}

/// Features of all scales at every point, `[N, sum of widths]`.
fn all_scales(
    encoder: &RandlaEncoder,
    cloud: &LabelledCloud,
    seed: u64,
    device: &Device,
) -> Result<Vec<f32>> {
    let points = Cloud {
        positions: &cloud.positions,
        colors: None,
        up: DVec3::Z,
        scale: 1.0,
    };
    let encoding: Encoding = encode(encoder, &points, seed, device)?;
    let sets = encoding
        .levels
        .iter()
        .chain([&encoding.coarsest])
        .enumerate();
    let scales: Vec<(usize, Vec<f32>)> = sets
        .map(|(n, level)| {
            let channels = level.features.dims()[1];
            let features = host(level.features.clone());
            (
                channels,
                encoding.upsample[..n]
                    .iter()
                    .rev()
                    .fold(features, |f, map| map.apply(&f, channels)),
            )
        })
        .collect();
    let width: usize = scales.iter().map(|s| s.0).sum();
    let mut rows = Vec::with_capacity(width * cloud.positions.len());
    for i in 0..cloud.positions.len() {
        scales
            .iter()
            .for_each(|(channels, f)| rows.extend_from_slice(&f[i * channels..][..*channels]));
    }
    Ok(rows)
}

/// Mean and standard deviation per channel.
struct Moments(Vec<(f32, f32)>);

impl Moments {
    fn of(rows: &[f32], width: usize) -> Self {
        let count = (rows.len() / width).max(1) as f64;
        let mut sums = vec![(0.0f64, 0.0f64); width];
        for row in rows.chunks_exact(width) {
            for (s, &v) in sums.iter_mut().zip(row) {
                s.0 += f64::from(v);
                s.1 += f64::from(v).powi(2);
            }
        }
        let moments = sums.into_iter().map(|(sum, squares)| {
            let mean = sum / count;
            (
                mean as f32,
                ((squares / count - mean * mean).max(0.0).sqrt() + 1e-6) as f32,
            )
        });
        Self(moments.collect())
    }

    fn standardise(&self, rows: &mut [f32]) {
        for row in rows.chunks_exact_mut(self.0.len()) {
            row.iter_mut()
                .zip(&self.0)
                .for_each(|(v, (mean, deviation))| *v = (*v - mean) / deviation);
        }
    }
}

fn fit(
    rows: &[f32],
    labels: &[u16],
    width: usize,
    classes: usize,
    rng: &mut ChaCha8Rng,
    device: &Device,
) -> Linear {
    let device = device.clone().inner().autodiff();
    let mut map = Linear {
        weight: Param::from_tensor(Tensor::zeros([width, classes], &device)),
        bias: Some(Param::from_tensor(Tensor::zeros([classes], &device))),
    };
    let mut adam = AdamConfig::new().with_epsilon(1e-8).init();
    for step in 0..STEPS {
        let chosen = index::sample(rng, labels.len(), BATCH.min(labels.len())).into_vec();
        let batch: Vec<f32> = chosen
            .iter()
            .flat_map(|&i| &rows[i * width..][..width])
            .copied()
            .collect();
        let batch_labels: Vec<u16> = chosen.iter().map(|&i| labels[i]).collect();
        let logits: Tensor<2> = map.forward(tensor(batch, [chosen.len(), width], &device));
        let loss = CoSegLoss::from(LabelLoss::Ce).of_logits(logits, &batch_labels);
        let gradients = GradientsParams::from_grads(loss.backward(), &map);
        map = adam.step(RATE * (1.0 - step as f64 / STEPS as f64), map, gradients);
    }
    map.valid()
}

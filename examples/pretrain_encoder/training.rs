//! Pretraining of the point encoder on procedural rooms, none of which is ever evaluated.
//!
//! The head is the decoder of Eq. 7 without image features, so the encoder learns to be useful where it will be used.

use super::rooms::{LabelledCloud, ROOMS_PER_SEED, Scores, room};
use burn::module::Module;
use burn::optim::{AdamConfig, GradientsParams};
use burn::tensor::{Device, Tensor, TensorData};
use coseg::data::builtin::classes;
use coseg::error::{Error, Result, ensure};
use coseg::metrics::Confusion;
use coseg::segmentation::decoder::{Decoder, DecoderConfig};
use coseg::segmentation::encoder::{Cloud, encode, random_weights};
use coseg::segmentation::loss::{CoSegLoss, LabelLoss};
use coseg::segmentation::pixels::NO_CLASS;
use coseg::segmentation::pyramid::{Level, Pyramid, Switches};
use coseg::segmentation::randla::RandlaEncoder;
use coseg::segmentation::sampling::{Hierarchy, LAYERS};
use coseg::weights::WeightFile;
use glam::DVec3;
use rand::seq::{SliceRandom, index};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Purpose of the random stream of one step.
const STEP_STREAM: u64 = 0x7072_6574;
/// What to train, and for how long.
#[derive(Clone, Debug, PartialEq)]
pub struct PretrainOptions {
    /// Seed of weights, rooms and every other choice.
    pub seed: u64,
    /// Rooms trained on.
    pub rooms: usize,
    /// Rooms the result is scored on.
    pub held_out: usize,
    /// Points made for each room.
    pub room_points: usize,
    /// Fewest and most points of a room that one step encodes; drawn log-uniformly, so that densities vary.
    pub points: [usize; 2],
    /// Optimiser steps, one room each.
    pub steps: usize,
    /// Largest learning rate (Adam; rises over 5 % of the run, then falls to 0 along a cosine).
    pub rate: f64,
}

impl Default for PretrainOptions {
    fn default() -> Self {
        let points = [4_000, 16_000];
        Self {
            seed: 0,
            rooms: 96,
            held_out: 16,
            room_points: 40_000,
            points,
            steps: 600,
            rate: 5e-3,
        }
    }
}

/// A pretrained encoder and how well its own head tells the classes of held-out rooms.
#[derive(Clone, Debug)]
pub struct TrainedEncoder {
    /// In the layout of the published checkpoints; its notes hold seed, sizes and scores.
    pub weights: WeightFile,
    /// Scores of encoder and head on the held-out rooms.
    pub held_out: Scores,
    /// Mean loss of each tenth of the run.
    pub curve: Vec<f32>,
}

/// What one optimiser step changes.
#[derive(Module, Debug)]
struct Student {
    encoder: RandlaEncoder,
    head: Decoder,
}

/// Trains an encoder from scratch. `progress` gets the number of steps that are done, and the loss of the last one.
///
/// # Errors
/// [`Error::Argument`] for sizes that are zero or out of order, [`Error::NonFinite`] when the loss leaves the numbers.
pub fn pretrain(
    options: &PretrainOptions,
    device: &Device,
    progress: &mut dyn FnMut(usize, f32),
) -> Result<TrainedEncoder> {
    check(options)?;
    let classes = classes().len();
    let rooms: Vec<LabelledCloud> = (0..options.rooms + options.held_out)
        .map(|i| room(options.seed, i as u64, options.room_points))
        .collect();
    let (train, held_out) = rooms.split_at(options.rooms);
    let device = device.clone().inner().autodiff();
    let encoder = RandlaEncoder::load(&random_weights(3, options.seed), &device)?;
    let spatial = encoder.widths();
    let top = encoder.widths().last().copied().unwrap_or_default();
    let head = DecoderConfig::new(spatial, top, classes).with_layer_norm(true);
    let mut student = Student {
        encoder,
        head: head.with_seed(options.seed).init(&device),
    };
    let mut adam = AdamConfig::new().with_epsilon(1e-8).init();
    let mut losses = Vec::with_capacity(options.steps);
    for step in 0..options.steps {
        let loss = student_loss(&student, train, step, options, &device)?;
        let value: f32 = loss.clone().inner().into_scalar();
        if !value.is_finite() {
            let context = format!(", step {step}");
            return Err(Error::NonFinite {
                tensor: "pretraining loss".into(),
                row: 0,
                context,
            });
        }
        let gradients = GradientsParams::from_grads(loss.backward(), &student);
        student = adam.step(rate(step, options), student, gradients);
        losses.push(value);
        progress(step + 1, value);
    }
    finish(student, held_out, &losses, options, &device)
}

fn check(options: &PretrainOptions) -> Result<()> {
    let [fewest, most] = options.points;
    let usable = options.rooms > 0
        && options.steps > 0
        && fewest > 0
        && fewest <= most
        && most <= options.room_points;
    let enough_rooms = options.rooms + options.held_out <= ROOMS_PER_SEED as usize;
    ensure!(usable && enough_rooms, argument "pretrain"; found "{options:?}";
        expected "rooms, steps, and 0 < fewest points <= most points <= points of a room"; help "correct the sizes");
    Ok(())
}

fn rate(step: usize, options: &PretrainOptions) -> f64 {
    let done = (step as f64 + 0.5) / options.steps as f64;
    let rise = (done / 0.05).min(1.0);
    options.rate * rise * 0.5 * (1.0 + (std::f64::consts::PI * done).cos())
}

/// Loss of one step: a random room, thinned, turned, mirrored, scaled, shaken, sometimes cut in two.
fn student_loss(
    student: &Student,
    rooms: &[LabelledCloud],
    step: usize,
    options: &PretrainOptions,
    device: &Device,
) -> Result<Tensor<1>> {
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    rng.set_stream(STEP_STREAM << 32 | step as u64);
    let room = &rooms[rng.random_range(0..rooms.len())];
    let cloud = augment(room, options.points, &mut rng);
    let positions = Cloud {
        positions: &cloud.positions,
        colors: None,
        up: DVec3::Z,
        scale: 1.0,
    }
    .oriented()?;
    let hierarchy = Hierarchy::build(&positions, LAYERS, rng.random())?;
    let flat = positions.as_flattened().to_vec();
    let input = Tensor::from_data(TensorData::new(flat, [positions.len(), 3]), device);
    let (features, top) = student.encoder.encode_levels(input, &hierarchy, false);
    let upsample = hierarchy.upsampling()?;
    let levels =
        hierarchy
            .levels
            .iter()
            .zip(features)
            .zip(upsample)
            .map(|((level, spatial), upsample)| Level {
                points: Arc::new(level.indices.clone()),
                features: spatial,
                upsample,
            });
    let pyramid = Pyramid {
        levels: levels.collect(),
        top,
    };
    let logits = student.head.classify(student.head.forward(&pyramid).hidden);
    let labels = balanced(&cloud.labels, &mut rng);
    Ok(CoSegLoss::from(LabelLoss::Ce).of_logits(logits, &labels))
}

fn augment(
    room: &LabelledCloud,
    [fewest, most]: [usize; 2],
    rng: &mut ChaCha8Rng,
) -> LabelledCloud {
    let count =
        (fewest as f64 * (most as f64 / fewest as f64).powf(rng.random::<f64>())).round() as usize;
    // a cut leaves between a third and all of a room, as a single view would
    let cut: Option<([f32; 2], f32)> = rng.random_bool(0.3).then(|| {
        let angle = rng.random_range(0.0..std::f32::consts::TAU);
        ([angle.cos(), angle.sin()], rng.random_range(-0.7f32..0.7))
    });
    let mut chosen =
        index::sample(rng, room.positions.len(), count.min(room.positions.len())).into_vec();
    if let Some((normal, offset)) = cut {
        let kept = |&i: &usize| {
            let p = room.positions[i];
            p[0] * normal[0] + p[1] * normal[1] > offset
        };
        let part: Vec<usize> = chosen.iter().copied().filter(kept).collect();
        if 3 * part.len() >= chosen.len() {
            chosen = part;
        }
    }
    let (sin, cos) = rng.random_range(0.0..std::f32::consts::TAU).sin_cos();
    let scale = rng.random_range(-0.25f32..0.25).exp();
    let mirror = if rng.random_bool(0.5) { -scale } else { scale };
    let shake = rng.random_range(0.0f32..0.01);
    let positions = chosen.iter().map(|&i| {
        let [x, y, z] = room.positions[i];
        let turned = [
            mirror * (cos * x - sin * y),
            scale * (sin * x + cos * y),
            scale * z,
        ];
        turned.map(|v| v + shake * rng.random_range(-1.0f32..1.0))
    });
    LabelledCloud {
        positions: positions.collect(),
        labels: chosen.iter().map(|&i| room.labels[i]).collect(),
    }
}

/// Labels with the excess of common classes left out at random: no class has more than twice an even share.
fn balanced(labels: &[u16], rng: &mut ChaCha8Rng) -> Vec<u16> {
    let classes = labels
        .iter()
        .filter(|&&l| l != NO_CLASS)
        .max()
        .map_or(0, |&l| usize::from(l) + 1);
    let share = (2 * labels.len()).div_ceil(classes.max(1));
    let mut order: Vec<usize> = (0..labels.len()).collect();
    order.shuffle(rng);
    let mut counts = vec![0; classes];
    let mut kept = vec![NO_CLASS; labels.len()];
    for i in order.into_iter().filter(|&i| labels[i] != NO_CLASS) {
        let count = &mut counts[usize::from(labels[i])];
        if *count < share {
            *count += 1;
            kept[i] = labels[i];
        }
    }
    kept
}

/// Index of the largest logit of each row.
fn best_classes(logits: Tensor<2>) -> Vec<usize> {
    let best = logits.argmax(1).into_data().convert::<i64>();
    let best: Vec<i64> = best.into_vec().unwrap_or_default();
    best.into_iter().map(|class| class as usize).collect()
}

/// Freezes the encoder, scores it as it will be used, and writes its notes.
fn finish(
    student: Student,
    held_out: &[LabelledCloud],
    losses: &[f32],
    options: &PretrainOptions,
    device: &Device,
) -> Result<TrainedEncoder> {
    let mut weights = student
        .encoder
        .to_weight_file("pretrained RandLA weights")?;
    let plain = device.clone().inner();
    let encoder = RandlaEncoder::load(&weights, &plain)?;
    let head = student.head.valid();
    let mut confusion = Confusion::new(classes().len());
    for (i, cloud) in held_out.iter().enumerate() {
        let points = Cloud {
            positions: &cloud.positions,
            colors: None,
            up: DVec3::Z,
            scale: 1.0,
        };
        let encoding = encode(&encoder, &points, options.seed ^ i as u64, &plain)?;
        let switches = Switches {
            image: false,
            ..Switches::default()
        };
        let no_image = |_, rows: &[u32]| Ok(Tensor::zeros([rows.len(), 0], &plain));
        let pyramid = Pyramid::new(&encoding, switches, no_image)?;
        let logits = head.classify(head.forward(&pyramid).hidden);
        let truth = cloud.labels.iter().map(|&l| usize::from(l));
        confusion.add(truth, best_classes(logits));
    }
    let scores = Scores::from(&confusion);
    let tenth = losses.len().div_ceil(10).max(1);
    for (key, value) in [
        (
            "command",
            format!("pretrain_encoder --seed {}", options.seed),
        ),
        ("spatial", "RandLA-Net, xyz, procedural rooms".to_owned()),
        ("options", format!("{options:?}")),
        ("held_out_accuracy", format!("{:.4}", scores.accuracy)),
        ("held_out_miou", format!("{:.4}", scores.miou)),
    ] {
        weights.metadata.insert(key.to_owned(), value);
    }
    let curve = losses
        .chunks(tenth)
        .map(|c| c.iter().sum::<f32>() / c.len() as f32)
        .collect();
    Ok(TrainedEncoder {
        weights,
        held_out: scores,
        curve,
    })
}

//! CoSeg loss (Eq. 8 to 10): noise-robust label loss on rendered logits, and closeness of neighbours in 3D.

use crate::config::{LabelLoss, SegmentationConfig};
use crate::error::{Error, Result};
use crate::ops::{SparseMatrix, UNLABELLED, sparse_apply};
use burn::tensor::activation::log_softmax;
use burn::tensor::{Int, Tensor, TensorData};
use rand::SeedableRng;
use rand::seq::index;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

pub use crate::ops::{Kind, label_loss};

/// Exponent of [`LabelLoss::Gce`].
const GCE_EXPONENT: f64 = 0.7;
/// Purpose of the random stream of [`sample_rows`].
const SAMPLE_STREAM: u64 = 0x6b6c_3364;

impl Kind {
    /// The loss that the settings ask for after the warm-up.
    ///
    /// # Errors
    /// [`Error::Config`] when `pi_rl` is not in (0, 1).
    pub fn from_config(config: &SegmentationConfig) -> Result<Self> {
        Ok(match config.loss {
            LabelLoss::Ce => Self::Ce,
            LabelLoss::Gce => Self::Gce { q: GCE_EXPONENT },
            LabelLoss::Mae => Self::Mae,
            LabelLoss::Js if config.pi_rl > 0.0 && config.pi_rl < 1.0 => Self::Js { pi_rl: config.pi_rl },
            LabelLoss::Js => {
                let mend = "0.99 is the default; use segmentation.loss = \"ce\" or \"mae\" for the limits 0 and 1";
                let found = config.pi_rl.to_string();
                return Err(Error::config("segmentation.pi_rl", found, "a number above 0 and below 1", mend));
            }
        })
    }
}

/// [`label_loss`] in plain tensors: the reference of its tests, by the direct sums of the two divergences.
///
/// Multiplies by reciprocals: burn's derivative of a division by a scalar rounds it to f32.
pub fn label_loss_plain(logits: Tensor<2>, labels: &[u16], kind: &Kind) -> Tensor<1> {
    let device = logits.device();
    let kept: Vec<(i64, i64)> =
        labels.iter().enumerate().filter(|&(_, &l)| l != UNLABELLED).map(|(i, &l)| (i as i64, i64::from(l))).collect();
    let count = kept.len();
    if count == 0 {
        return (logits * 0.0).sum();
    }
    let column = |values: Vec<i64>| Tensor::<1, Int>::from_data(TensorData::new(values, [count]), &device);
    let rows = column(kept.iter().map(|k| k.0).collect());
    let classes = column(kept.iter().map(|k| k.1).collect()).reshape([count, 1]);
    let log_p = log_softmax(logits.select(0, rows), 1);
    let log_py = log_p.clone().gather(1, classes.clone());
    let loss: Tensor<2> = match *kind {
        Kind::Ce => -log_py,
        Kind::Mae => -log_py.exp() + 1.0,
        Kind::Gce { q } => (-(log_py * q).exp() + 1.0) * (1.0 / q),
        Kind::Js { pi_rl } => {
            let p = log_p.clone().exp();
            let one_hot = p.zeros_like().scatter(1, classes, log_py.ones_like(), burn::tensor::IndexingUpdateOp::Add);
            let m = one_hot.clone() * pi_rl + p.clone() * (1.0 - pi_rl);
            let label = -(one_hot * m.clone().log()).sum_dim(1);
            let prediction = (p * (log_p - m.log())).sum_dim(1);
            let z = -(1.0 - pi_rl) * (1.0 - pi_rl).ln();
            (label * pi_rl + prediction * (1.0 - pi_rl)) * (1.0 / z)
        }
    };
    loss.mean()
}

/// Labels with pixels of coverage `1 - T` below `floor` set to [`UNLABELLED`]: they are scored, not trained on.
pub fn covered_labels(labels: &[u16], coverage: &[f32], floor: f32) -> Vec<u16> {
    labels.iter().zip(coverage).map(|(&l, &c)| if c >= floor { l } else { UNLABELLED }).collect()
}

/// Eq. 9 for one scale: the mean over M K pairs of D_KL(softmax f_j || softmax f_k).
///
/// `features` is `[N, D]`, fused features of the scale; `chosen` the M sampled rows; `neighbours` `[N, k]` the nearest
/// rows of each row, not itself. Only the M (K + 1) rows involved are read. No sample: zero.
///
/// # Panics
/// If an index is not below N.
pub fn neighbour_divergence(features: Tensor<2>, chosen: &[u32], neighbours: &[u32], k: usize) -> Tensor<1> {
    let [points, width] = features.dims();
    if chosen.is_empty() || k == 0 {
        return (features * 0.0).sum();
    }
    let pairs = chosen.len() * k;
    let rows: Vec<u32> = chosen.iter().flat_map(|&j| &neighbours[j as usize * k..][..k]).copied().collect();
    let own = log_softmax(pick(features.clone(), chosen.to_vec(), points), 1);
    let others = log_softmax(pick(features, rows, points), 1).reshape([chosen.len(), k, width]);
    // sum_k p_j (l_j - l_k) = p_j (K l_j - sum_k l_k)
    let others: Tensor<2> = others.sum_dim(1).reshape([chosen.len(), width]);
    (own.clone().exp() * (own * k as f64 - others)).sum() * (1.0 / pairs as f64)
}

fn pick(features: Tensor<2>, rows: Vec<u32>, columns: usize) -> Tensor<2> {
    assert!(rows.iter().all(|&r| (r as usize) < columns), "neighbour_divergence: a row is not below {columns}");
    let offsets = (0..=rows.len() as u32).collect();
    let matrix = SparseMatrix { columns, offsets, values: vec![1.0; rows.len()], indices: rows };
    sparse_apply(features, Arc::new(matrix))
}

/// `min(count, rows)` distinct rows, ascending, for one iteration of the 3D regularisation.
pub fn sample_rows(rows: usize, count: usize, seed: u64, iteration: u64) -> Vec<u32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ iteration.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    rng.set_stream(SAMPLE_STREAM);
    let mut chosen: Vec<u32> = index::sample(&mut rng, rows, count.min(rows)).iter().map(|i| i as u32).collect();
    chosen.sort_unstable();
    chosen
}

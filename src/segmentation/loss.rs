//! CoSeg loss (Eq. 8 to 10): noise-robust label loss on rendered logits, and closeness of neighbours in 3D.

use crate::config::{LabelLoss, SegmentationConfig};
use crate::error::Result;
use crate::ops::UNLABELLED;
use burn::tensor::activation::log_softmax;
use burn::tensor::{Int, Tensor, TensorData};

pub use crate::ops::{Kind, NeighbourPairs, label_loss, neighbour_divergence};

impl Kind {
    /// The loss that the settings ask for after the warm-up; of `"gjs"` the part that reads the label.
    ///
    /// # Errors
    /// [`Error::Config`] when a payload of the loss is out of range.
    pub fn from_config(config: &SegmentationConfig) -> Result<Self> {
        config.loss.check()?;
        Ok(match config.loss {
            LabelLoss::Ce => Self::Ce,
            LabelLoss::Gce { exponent: q, .. } => Self::Gce { q },
            LabelLoss::Mae => Self::Mae,
            LabelLoss::NceRce => Self::NceRce,
            LabelLoss::Js { pi_rl } | LabelLoss::Gjs { pi_rl } => Self::Js { pi_rl },
        })
    }
}

/// [`label_loss`] in plain tensors: the reference of its tests, by the direct sums of the two divergences.
///
/// Multiplies by reciprocals: burn's derivative of a division by a scalar rounds it to f32.
pub fn label_loss_plain(logits: Tensor<2>, labels: &[u16], kind: &Kind) -> Tensor<1> {
    let device = logits.device();
    let kept: Vec<(i64, i64)> = labels
        .iter()
        .enumerate()
        .filter(|&(_, &l)| l != UNLABELLED)
        .map(|(i, &l)| (i as i64, i64::from(l)))
        .collect();
    let count = kept.len();
    if count == 0 {
        return (logits * 0.0).sum();
    }
    let column =
        |values: Vec<i64>| Tensor::<1, Int>::from_data(TensorData::new(values, [count]), &device);
    let rows = column(kept.iter().map(|k| k.0).collect());
    let classes = column(kept.iter().map(|k| k.1).collect()).reshape([count, 1]);
    let log_p = log_softmax(logits.select(0, rows), 1);
    let log_py = log_p.clone().gather(1, classes.clone());
    let loss: Tensor<2> = match *kind {
        Kind::Ce => -log_py,
        Kind::Mae => -log_py.exp() + 1.0,
        Kind::Gce { q } => (-(log_py * q).exp() + 1.0) * (1.0 / q),
        Kind::NceRce => log_py.clone() / log_p.sum_dim(1) + (-log_py.exp() + 1.0) * 4.0,
        Kind::Js { pi_rl } => {
            let p = log_p.clone().exp();
            let one_hot = p.zeros_like().scatter(
                1,
                classes,
                log_py.ones_like(),
                burn::tensor::IndexingUpdateOp::Add,
            );
            let m = one_hot.clone() * pi_rl + p.clone() * (1.0 - pi_rl);
            let label = -(one_hot * m.clone().log()).sum_dim(1);
            let prediction = (p * (log_p - m.log())).sum_dim(1);
            let z = -(1.0 - pi_rl) * (1.0 - pi_rl).ln();
            (label * pi_rl + prediction * (1.0 - pi_rl)) * (1.0 / z)
        }
    };
    loss.mean()
}

//! CoSeg loss (Eq. 8 to 10): noise-robust label loss on rendered logits, and closeness of neighbours in 3D.

use crate::config::{GCE_EXPONENTS, LabelLoss, SegmentationConfig};
use crate::error::{Error, Result};
use crate::ops::UNLABELLED;
use burn::tensor::activation::log_softmax;
use burn::tensor::{Int, Tensor, TensorData};

pub use crate::ops::{Kind, NeighbourPairs, label_loss, neighbour_divergence};

impl Kind {
    /// The loss that the settings ask for after the warm-up; of `"gjs"` the part that reads the label.
    ///
    /// # Errors
    /// [`Error::Config`] when `pi_rl` is not in (0, 1), or `gce_exponent` not in [`GCE_EXPONENTS`], and the loss needs it.
    pub fn from_config(config: &SegmentationConfig) -> Result<Self> {
        Ok(match config.loss {
            LabelLoss::Ce => Self::Ce,
            LabelLoss::Gce
                if (GCE_EXPONENTS[0]..=GCE_EXPONENTS[1]).contains(&config.gce_exponent) =>
            {
                Self::Gce {
                    q: config.gce_exponent,
                }
            }
            LabelLoss::Gce => {
                let help = "0.7 is the default; segmentation.loss = \"ce\" is the limit 0";
                let found = config.gce_exponent.to_string();
                let expected =
                    format!("a number from {} to {}", GCE_EXPONENTS[0], GCE_EXPONENTS[1]);
                return Err(Error::config(
                    "segmentation.gce_exponent",
                    found,
                    expected,
                    help,
                ));
            }
            LabelLoss::Mae => Self::Mae,
            LabelLoss::NceRce => Self::NceRce,
            LabelLoss::Js | LabelLoss::Gjs if config.pi_rl > 0.0 && config.pi_rl < 1.0 => {
                Self::Js {
                    pi_rl: config.pi_rl,
                }
            }
            LabelLoss::Js | LabelLoss::Gjs => {
                let help = "0.99 is the default; use segmentation.loss = \"ce\" or \"mae\" for the limits 0 and 1";
                let found = config.pi_rl.to_string();
                return Err(Error::config(
                    "segmentation.pi_rl",
                    found,
                    "a number above 0 and below 1",
                    help,
                ));
            }
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

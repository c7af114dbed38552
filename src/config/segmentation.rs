//! Settings of stage two: variants, losses, and how labels are blended.

use super::Variant;
use super::range::{MAX_BATCH, Range, checked};
use crate::error::{Result, bail, ensure};
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;

/// Smallest and largest exponent of the GCE loss. At the smallest, the loss is cross-entropy to the precision of f32.
pub const GCE_EXPONENTS: [f64; 2] = [1e-6, 1.0];

/// Weight of the label loss in Eq. 10 (the paper's). No key sets it, because Adam follows the ratio of the weights alone.
pub const LAMBDA_PIX: f64 = 0.8;

/// Loss on rendered labels. A name alone stands for the variant with its defaults.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum LabelLoss {
    /// Cross-entropy.
    Ce,
    /// Jensen-Shannon with a one-hot label (Eq. 8): the paper.
    Js {
        /// Weight of the raw label, in (0, 1).
        #[serde(default = "default_pi_rl")]
        pi_rl: f64,
    },
    /// Generalised cross-entropy (Zhang and Sabuncu 2018), (1 - p^q) / q of the label.
    Gce {
        /// Exponent q, in [`GCE_EXPONENTS`]: cross-entropy towards 0, the absolute error at 1. Its authors take 0.7.
        #[serde(default = "default_gce_exponent")]
        exponent: f64,
        /// A class whose own labels get a smaller mean probability than this has a smaller exponent, so that training does
        /// not give it up (not in the paper). The further below, the nearer to cross-entropy. 0 turns it off.
        #[serde(default = "default_least_recall")]
        least_recall: f64,
    },
}

fn default_pi_rl() -> f64 {
    0.99
}

const fn default_gce_exponent() -> f64 {
    0.7
}

const fn default_least_recall() -> f64 {
    0.3
}

impl LabelLoss {
    /// Generalised cross-entropy with its defaults.
    pub const GCE: Self = Self::Gce {
        exponent: default_gce_exponent(),
        least_recall: default_least_recall(),
    };

    /// Checks the ranges of the payload.
    pub(crate) fn check(&self) -> Result<()> {
        match *self {
            Self::Ce => Ok(()),
            Self::Js { pi_rl } => Range::OpenUnit.check("segmentation.loss.js.pi_rl", pi_rl),
            Self::Gce {
                exponent,
                least_recall,
            } => {
                let [low, high] = GCE_EXPONENTS;
                Range::Within(low, high).check("segmentation.loss.gce.exponent", exponent)?;
                Range::Unit.check("segmentation.loss.gce.least_recall", least_recall)
            }
        }
    }
}

/// What is blended along a ray to give a pixel its classes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Blend {
    /// Logits, softmax after blending (Eq. 3 and 8 of the paper).
    Logits,
    /// Class probabilities of each Gaussian over the coverage 1 - T: a convex mixture, so one confident Gaussian cannot outvote
    /// those in front.
    Probabilities,
}

/// What the weights of the CoSeg loss multiply.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reduction {
    /// The mean label loss of pixels, and the mean divergence of neighbours.
    #[default]
    Mean,
    /// The sum over pixels (Eq. 8), and that over neighbours divided by M N (Eq. 9): the paper. It does not define N; here N is
    /// the number of scales.
    Sum,
}

/// What label maps are rendered from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LabelSource {
    /// One label per Gaussian, that of its largest score. The PLY stores it as `label`.
    Labels,
    /// The class scores, blended (Eq. 3): the paper.
    Scores,
}

/// What the decoder starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Prior {
    /// Nothing (the paper): the classes come from the features alone.
    None,
    /// The votes of each Gaussian's raw labels, the surer the more pixels vote: the decoder learns a correction. After training,
    /// scores are smoothed over surfaces where votes are few. Objects of association are not smoothed.
    Votes,
    /// The votes, refined, pooled over superpoints and calibrated. The decoder learns from what they say about the labelled pixels,
    /// instead of from the raw labels. Objects that association found take [`Prior::Votes`] instead.
    Pooled,
}

/// Stage two: segmentation identities. No key sets the fields marked `serde(skip)`; tests on small scenes change them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, SmartDefault)]
#[serde(default, deny_unknown_fields)]
pub struct SegmentationConfig {
    /// Views that each trained variant learns from, one for each optimiser step unless `batch` says otherwise.
    #[default(400)]
    pub iterations: usize,
    /// Views of an optimiser step, as `building.batch`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub batch: Option<usize>,
    /// Variants to train and score. The scene stores `ours` where present, else the last one. Absent: [`Variant::COMPARED`],
    /// or [`Variant::UNSCORED`] where no held-out view has a truth.
    pub rows: Option<Vec<Variant>>,
    /// Learning rate of the decoder.
    #[default(6e-3)]
    pub lr: f64,
    /// The learning rate falls along a half cosine to 1 % at the end (the paper keeps it constant).
    #[default(true)]
    pub lr_decay: bool,
    /// Frozen features are brought to mean 0 and spread 1 per channel before the decoder (not in the paper).
    #[default(true)]
    pub standardise: bool,
    /// What is blended, in training and in the stored identities.
    #[default(Blend::Probabilities)]
    pub blend: Blend,
    /// What the decoder's scores are added to; all but `none` need `blend = "probabilities"`.
    /// Absent: see [`SegmentationConfig::prior`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prior: Option<Prior>,
    /// Whether every Gaussian fine-tunes what the decoder gave it by the raw labels in its pixels. Absent: where the prior is pooled,
    /// unless errors of the raw labels repeat and prefer frequent classes. Never without a prior.
    pub fine_tune: Option<bool>,
    /// Loss of the variant `ours`. Absent: see [`SegmentationConfig::loss`].
    #[serde(
        deserialize_with = "super::by_name",
        skip_serializing_if = "Option::is_none"
    )]
    pub loss: Option<LabelLoss>,
    /// Weight of the 3D regularisation (Eq. 9) beside that of the label loss, [`LAMBDA_PIX`].
    #[default(0.2)]
    pub lambda_reg: f64,
    /// What both weights multiply.
    pub reduction: Reduction,
    /// Share of the run that trains with cross-entropy before any other loss.
    #[default(0.1)]
    pub warmup: f64,
    /// Identities come from the mean of the decoder's parameters over the steps after the warm-up (not in the paper).
    #[default(true)]
    pub average: bool,
    /// What label maps are rendered from.
    #[default(LabelSource::Labels)]
    pub render: LabelSource,
    /// Pixels whose coverage 1 - T is below this are not trained on and show no label.
    #[default(0.5)]
    pub min_coverage: f64,
    /// Share of the labelled pixels of a view that a step uses, in (0, 1]. Absent: a sixteenth, but no fewer than 4,096 pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pixel_share: Option<f64>,
    /// Iterations between held-out evaluations; 0 means ten in the run.
    pub eval_every: usize,
    /// Iterations between checkpoints; 0 means ten in the run.
    #[serde(skip)]
    pub checkpoint_every: usize,
    /// Sampled Gaussians of the 3D regularisation, at most.
    #[serde(skip)]
    #[default(1_000)]
    pub reg_samples: usize,
    /// Neighbours of each sample in the 3D regularisation.
    #[serde(skip)]
    #[default(5)]
    pub reg_neighbours: usize,
    /// Gaussians decoded together in a training step, which bounds the memory of the decoder's layers. Views that show more
    /// are decoded in parts, twice, for the same gradients. 0: all at once.
    #[serde(skip)]
    #[default(65_536)]
    pub decoder_chunk: usize,
}

impl SegmentationConfig {
    /// `rows`, or what its absence stands for if there is a truth.
    pub fn rows(&self) -> &[Variant] {
        self.rows.as_deref().unwrap_or(&Variant::COMPARED)
    }

    /// `loss`, or generalised cross-entropy, which withstands errors of a network. A run on labels made by hand sets
    /// cross-entropy where it is absent.
    pub fn loss(&self) -> LabelLoss {
        self.loss.unwrap_or(LabelLoss::GCE)
    }

    /// `prior`, or pooled votes, which correct errors of a network. A run on labels made by hand sets [`Prior::Votes`] where it is
    /// absent.
    pub fn prior(&self) -> Prior {
        self.prior.unwrap_or(Prior::Pooled)
    }

    /// `batch`, or what its absence stands for.
    pub fn batch(&self) -> usize {
        self.batch.unwrap_or(1)
    }

    pub(super) fn check(&self) -> Result<()> {
        Range::Within(1.0, MAX_BATCH).check("segmentation.batch", self.batch())?;
        checked!(self, "segmentation": {
            iterations: Positive,
            lr: AboveZero,
            lambda_reg: NotNegative,
            warmup: Unit,
            min_coverage: Unit,
        });
        self.loss().check()?;
        let rows = self.rows();
        if let Some(row) = (1..rows.len()).find(|&i| rows[..i].contains(&rows[i])) {
            bail!(setting "segmentation.rows"; found "{} twice", rows[row]; expected "each variant once";
                help "leave the second one out");
        }
        if let Some(share) = self.pixel_share {
            Range::Share.check("segmentation.pixel_share", share)?;
        }
        ensure!(self.prior() == Prior::None || self.blend != Blend::Logits,
            setting "segmentation.prior"; found "{}", self.prior(); expected "none where logits are blended";
            help "set segmentation.blend = \"probabilities\", or segmentation.prior = \"none\"");
        Ok(())
    }
}

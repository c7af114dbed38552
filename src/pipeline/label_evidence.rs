//! What raw labels say of the Gaussians before anything is trained: votes, and what decoders make of them.

use super::segmentation_inputs::SegmentationInputs;
use crate::config::{Association, Prior};
use crate::data::{Split, View};
use crate::error::Result;
use crate::objects::{PooledVote, Votes, pooled_vote, refined_vote, vote};
use std::cell::OnceCell;

/// Share added to every class of the pooled votes that a decoder starts from, and of what fine-tuning starts from. A larger one makes
/// confident votes uncertain, and the decoder learns to be certain again at the expense of rare classes.
pub(super) const VOTE_FLOOR: f32 = 0.002;

/// Votes, in pixels, that every class of a Gaussian has from the start (additive smoothing). A Gaussian that a hundredth of a pixel shows
/// is then less sure than one that a hundred pixels show. Chosen on house_living with six labelled photos.
const PSEUDO_VOTES: f32 = 0.3;

/// The votes of a scene, counted when they are first asked for.
pub(super) struct LabelEvidence<'a> {
    inputs: &'a SegmentationInputs<'a>,
    quarters: OnceCell<[Votes; 4]>,
    pooled: OnceCell<PooledVote>,
}

impl<'a> LabelEvidence<'a> {
    pub fn new(inputs: &'a SegmentationInputs<'a>) -> Self {
        Self {
            inputs,
            quarters: OnceCell::new(),
            pooled: OnceCell::new(),
        }
    }

    /// Whether raw labels fine-tune what decoders learn. Those whose errors repeat and prefer frequent classes would bring these back, and
    /// few labels made by hand say nothing of most Gaussians.
    pub fn wants_fine_tuning(&self) -> Result<bool> {
        let configured = self.inputs.config.segmentation.fine_tune;
        Ok(match self.prior_kind() {
            Prior::None => false,
            Prior::Votes => configured == Some(true),
            Prior::Pooled => match configured {
                Some(configured) => configured,
                None => self.pooled()?.exponent == 0.0,
            },
        })
    }

    /// Whether scores are smoothed over surfaces after training. Pooled votes have that in them, and two objects of association may lie on
    /// one surface.
    pub fn wants_smoothing(&self) -> bool {
        self.prior_kind() == Prior::Votes && !self.has_objects()
    }

    /// Whether raw labels are objects of association.
    fn has_objects(&self) -> bool {
        self.inputs.config.data.association == Association::Gaussians
    }

    /// What decoders start from. Votes for objects of association are not pooled: two of them may share a superpoint.
    pub fn prior_kind(&self) -> Prior {
        match self.inputs.config.segmentation.prior() {
            Prior::Pooled if self.has_objects() => Prior::Votes,
            prior => prior,
        }
    }

    /// The scores that a decoder starts from, `[N, C]`.
    pub fn prior(&self) -> Result<Option<Vec<f32>>> {
        match self.prior_kind() {
            Prior::None => Ok(None),
            Prior::Votes => Ok(Some(self.votes()?.logits(PSEUDO_VOTES))),
            Prior::Pooled => {
                let probabilities = self.pooled()?.identities.scores.iter();
                Ok(Some(probabilities.map(|p| (p + VOTE_FLOOR).ln()).collect()))
            }
        }
    }

    /// The votes of the training views.
    pub fn votes(&self) -> Result<Votes> {
        Ok(Votes::of_all(self.quarters()?.each_ref()))
    }

    /// The refined, pooled and calibrated votes, made once.
    pub fn pooled(&self) -> Result<&PooledVote> {
        once(&self.pooled, || pooled(self.inputs, self.quarters()?))
    }

    /// The votes of four quarters of the training views, counted once.
    fn quarters(&self) -> Result<&[Votes; 4]> {
        once(&self.quarters, || quarters(self.inputs))
    }
}

/// The votes of each quarter of the labelled training views: every fourth one from the first on, from the second on, and so on.
/// Neighbours on the path of a camera are in different quarters, so errors that last over neighbouring views are in all.
///
/// # Errors
/// Those of [`vote`].
pub(crate) fn quarters(inputs: &SegmentationInputs) -> Result<[Votes; 4]> {
    let train = inputs.scene.split(Split::Train);
    let labelled: Vec<&View> = train.filter(|view| view.raw.is_some()).collect();
    let quarter = |first: usize| {
        let views = labelled.iter().skip(first).step_by(4).copied();
        let classes = &inputs.scene.classes;
        vote(
            inputs.gaussians,
            views,
            classes,
            &inputs.settings,
            inputs.device,
        )
    };
    Ok([quarter(0)?, quarter(1)?, quarter(2)?, quarter(3)?])
}

/// The refined, pooled and calibrated votes; `quarters` are the plain ones.
///
/// # Errors
/// Those of [`refined_vote`] and [`pooled_vote`].
pub(crate) fn pooled(inputs: &SegmentationInputs, quarters: &[Votes; 4]) -> Result<PooledVote> {
    let scene = inputs.scene;
    let gaussians = inputs.gaussians;
    let settings = &inputs.settings;
    let train = scene.split(Split::Train);
    let pooling = &inputs.config.pooling;
    let mut refined = refined_vote(
        gaussians,
        train,
        &scene.classes,
        pooling.distance,
        settings,
        inputs.device,
    )?;
    // Corrected Gaussians vote for their labels, and so have a say in their superpoints.
    inputs.correct(&mut refined.table);
    pooled_vote(gaussians, quarters.each_ref(), &refined, pooling)
}

/// The value of `cell`, made where it has none yet.
pub(super) fn once<T>(cell: &OnceCell<T>, make: impl FnOnce() -> Result<T>) -> Result<&T> {
    if let Some(value) = cell.get() {
        return Ok(value);
    }
    let value = make()?;
    Ok(cell.get_or_init(|| value))
}

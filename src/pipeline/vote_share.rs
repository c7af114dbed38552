//! The share of the vote in trained identities.
//!
//! A decoder gives Gaussians with similar features the same label. That corrects wrong labels, but it loses details that only the
//! labels of a Gaussian itself show. Where labels are good, the vote is better. Raw labels that the vote has not seen tell which
//! case holds, unless the labels name frequent classes too often in all views: the vote does so too.

use super::encode::Inputs;
use crate::config::Blend;
use crate::data::View;
use crate::error::Result;
use crate::metrics::{Confusion, Void};
use crate::objects::{Identities, LabelMaps, LabelRule, Votes, first_largest, vote};
use crate::raster::SplatTensors;

/// Shares of the vote that are tried.
const SHARES: [f32; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
/// Runs of training views in file order that are left out of the vote one after the other. Whole runs, because an error often
/// lasts over neighbouring views.
const RUNS: usize = 6;
/// Views of a run whose raw labels are compared.
const VIEWS: usize = 4;
/// Keeps the logarithm of a probability finite.
const MIN_PROBABILITY: f32 = 1e-8;

/// `(1 - share) p + share votes` of the probabilities p of `trained`, where the votes of a Gaussian sum to 1. Gaussians without votes
/// keep the trained probabilities. Identities of logits give logits.
///
/// # Panics
/// If the votes are of another number of Gaussians or classes.
pub(super) fn mixed(trained: &Identities, votes: &Votes, share: f32, blend: Blend) -> Identities {
    assert_eq!(
        trained.scores.len(),
        votes.table.len(),
        "one row of votes for each Gaussian"
    );
    let classes = trained.classes;
    let mut mixed = match blend {
        Blend::Logits => trained.softmax(),
        Blend::Probabilities => trained.clone(),
    };
    let rows = mixed.scores.chunks_exact_mut(classes.max(1));
    for (row, votes) in rows.zip(votes.rows()) {
        let total: f32 = votes.iter().sum();
        let share = if total > 0.0 { share } else { 0.0 };
        for (p, vote) in row.iter_mut().zip(votes) {
            let voted = vote / total.max(f32::MIN_POSITIVE);
            *p = (1.0 - share) * *p + share * voted;
        }
    }
    if blend == Blend::Logits {
        let logits = mixed.scores.iter_mut();
        logits.for_each(|p| *p = (*p + MIN_PROBABILITY).ln());
    }
    mixed
}

/// The share of `votes` that gives the label maps closest to the raw labels, by mIoU over training views. For each view the votes of
/// its run are left out. The trained identities have seen all labels, which favours them. Returns the smallest of equal shares, and
/// 0 with fewer than two labelled views.
///
/// # Errors
/// Those of [`vote`] and of [`LabelMaps::of`].
pub(super) fn best_share(trained: &Identities, votes: &Votes, inputs: &Inputs) -> Result<f32> {
    let (scene, classes) = (inputs.scene, &inputs.scene.classes);
    let views: Vec<&View> = scene.labelled().collect();
    if views.len() < 2 {
        return Ok(0.0);
    }
    let splats = SplatTensors::new(inputs.gaussians, inputs.device);
    let rule = LabelRule::from(&inputs.config.segmentation);
    let mut confusions = SHARES.map(|_| Confusion::new(classes.len()));
    for run in views.chunks(views.len().div_ceil(RUNS)) {
        let own = vote(
            inputs.gaussians,
            run.iter().copied(),
            classes,
            &inputs.settings,
            inputs.device,
        )?;
        let others = without(votes, &own);
        for (share, confusion) in SHARES.into_iter().zip(&mut confusions) {
            let identities = mixed(trained, &others, share, inputs.config.segmentation.blend);
            let maps = LabelMaps::new(&identities, classes, rule);
            for view in run.iter().step_by(run.len().div_ceil(VIEWS)) {
                let Some(raw) = &view.raw else { continue };
                let found = maps.of(&splats.seen_by(&view.camera, &inputs.settings))?;
                confusion.add_ids(classes, &raw.map().ids, &found.ids);
            }
        }
    }
    let agreement = confusions
        .each_ref()
        .map(|confusion| confusion.miou(Void::Wrong).unwrap_or(0.0));
    let best = first_largest(agreement).unwrap_or(0);
    tracing::info!(
        "agreement with raw labels for shares {SHARES:?} of the vote: {agreement:.4?}; taken: {}",
        SHARES[best]
    );
    Ok(SHARES[best])
}

/// `votes` without those of a part of the views. Differences within rounding are no votes.
fn without(votes: &Votes, part: &Votes) -> Votes {
    let rest = |(all, part): (&f32, &f32)| {
        let rest = all - part;
        if rest > 1e-4 * all { rest } else { 0.0 }
    };
    Votes {
        table: votes.table.iter().zip(&part.table).map(rest).collect(),
        classes: votes.classes,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mixtures_are_means_of_probabilities() {
        let logits = Identities {
            scores: vec![1.0, 2.0, 3.0, -50.0, 0.0, 50.0],
            classes: 3,
        };
        let votes = Votes {
            table: vec![3.0, 1.0, 0.0, 0.0, 0.0, 0.0],
            classes: 3,
        };
        let probabilities = logits.softmax();
        let p = &probabilities.scores;
        let of_logits = mixed(&logits, &votes, 0.25, Blend::Logits).softmax();
        let of_probabilities = mixed(&probabilities, &votes, 0.25, Blend::Probabilities);
        for found in [of_logits.scores, of_probabilities.scores] {
            for (c, share) in [0.75, 0.25, 0.0].into_iter().enumerate() {
                assert!((found[c] - (0.75 * p[c] + 0.25 * share)).abs() < 1e-6);
                assert!((found[3 + c] - p[3 + c]).abs() < 1e-6, "no votes");
            }
        }
    }

    #[test]
    fn rounding_leaves_no_votes() {
        let all = Votes {
            table: vec![0.1 + 0.2, 2.0, 5.0],
            classes: 3,
        };
        let part = Votes {
            table: vec![0.299_999_97, 0.5, 0.0],
            classes: 3,
        };
        assert_eq!(without(&all, &part).table, [0.0, 1.5, 5.0]);
    }
}

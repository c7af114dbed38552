//! Settings that follow from the scene: who made the labels, the loss for such labels, and the variants to train.

use super::requirements::has_raw_labels;
use crate::config::{Config, LabelLoss, LabelsBy, Prior, Variant};
use crate::data::{Scene, Split, View};
use crate::objects::{Semantics, has_truth};

/// `config` with everything that follows from the scene: who made the labels, the loss for such labels, and the variants to train
/// where it names none. `has_corrections` says whether a person corrected labels.
pub(super) fn resolved(config: &Config, scene: &Scene, has_corrections: bool) -> Config {
    let mut config = config.clone();
    if has_raw_labels(scene) {
        trust_labels(&mut config, scene);
    } else if has_corrections {
        trust(&mut config);
    }
    if config.segmentation.rows.is_none() {
        // The semantics of stage two: association has yet to come.
        let semantics = Semantics::of(scene);
        let scored = |view: &View| has_truth(view, config.data.association, semantics.as_ref());
        let variants = if scene.split(Split::Test).any(scored) {
            Variant::COMPARED.to_vec()
        } else {
            Variant::UNSCORED.to_vec()
        };
        config.segmentation.rows = Some(variants);
    }
    config
}

/// If at most this share of the training photos has labels, they count as made by hand: a network labels all photos.
const MAX_HAND_LABELLED: f64 = 0.25;

/// Decides who made the labels. Where a person did, the loss and the prior that the settings leave open are cross-entropy and the votes
/// of each Gaussian: those for labels of a network withstand and correct errors that such labels do not have.
fn trust_labels(config: &mut Config, scene: &Scene) {
    if config.data.labels_by == LabelsBy::Auto {
        let views = || scene.split(Split::Train);
        let labelled = scene.labelled().count() as f64;
        let has_scores = views().any(|view| view.scores.is_some());
        let is_few = labelled <= MAX_HAND_LABELLED * views().count() as f64;
        config.data.labels_by = if scene.drawn || (is_few && !has_scores) {
            LabelsBy::Hand
        } else {
            LabelsBy::Network
        };
    }
    if config.data.labels_by == LabelsBy::Hand {
        trust(config);
    }
    let segmentation = &mut config.segmentation;
    segmentation.loss = Some(segmentation.loss());
    segmentation.prior = Some(segmentation.prior());
}

/// Trains on labels that a person made.
fn trust(config: &mut Config) {
    config.segmentation.loss.get_or_insert(LabelLoss::Ce);
    config.segmentation.prior.get_or_insert(Prior::Votes);
    tracing::info!(
        "labels made by hand: `ours` is trained under {:?} from the prior {:?} (data.labels_by)",
        config.segmentation.loss(),
        config.segmentation.prior()
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::builtin::{BuiltinOptions, scene_with};

    /// A scene in which `labelled` of eight training photos have raw labels.
    fn scene(labelled: usize) -> Scene {
        let options = BuiltinOptions {
            width: 32,
            height: 24,
            train_views: 8,
            test_views: 1,
            points: 100,
            ..BuiltinOptions::default()
        };
        let mut scene = scene_with(&options).expect("scene");
        let train = scene.views.iter_mut().filter(|v| v.split == Split::Train);
        train.skip(labelled).for_each(|view| view.raw = None);
        scene
    }

    fn decided(scene: &Scene, change: impl Fn(&mut Config)) -> (LabelsBy, LabelLoss, Prior) {
        let mut config = Config::default();
        change(&mut config);
        let resolved = resolved(&config, scene, false);
        (
            resolved.data.labels_by,
            resolved.segmentation.loss(),
            resolved.segmentation.prior(),
        )
    }

    #[test]
    fn labels_by_hand_are_trusted() {
        let hand = (LabelsBy::Hand, LabelLoss::Ce, Prior::Votes);
        let network = (LabelsBy::Network, LabelLoss::GCE, Prior::Pooled);
        assert_eq!(decided(&scene(2), |_| ()), hand);
        assert_eq!(decided(&scene(3), |_| ()), network);
        let mut drawn = scene(8);
        assert_eq!(decided(&drawn, |_| ()), network);
        assert_eq!(decided(&drawn, |c| c.data.labels_by = LabelsBy::Hand), hand);
        drawn.drawn = true;
        assert_eq!(decided(&drawn, |_| ()), hand);
        assert_eq!(
            decided(&drawn, |c| c.data.labels_by = LabelsBy::Network),
            network
        );
        // What the user chose stays.
        for (loss, prior) in [
            (LabelLoss::Js { pi_rl: 0.9 }, Prior::None),
            (LabelLoss::GCE, Prior::Pooled),
        ] {
            let chosen = decided(&drawn, |c| {
                c.segmentation.loss = Some(loss);
                c.segmentation.prior = Some(prior);
            });
            assert_eq!(chosen, (LabelsBy::Hand, loss, prior));
        }
        // Nothing is decided without labels.
        assert_eq!(decided(&scene(0), |_| ()).0, LabelsBy::Auto);
    }
}

//! Scores of label maps of the held-out views.

use crate::config::Association;
use crate::data::{LabelRuns, Split, View};
use crate::error::Result;
use crate::metrics::{
    InstanceScores, LabelScores, SemanticScores, Void, boundary_iou, instance_scores, label_scores,
};
use crate::objects::{Identities, LabelMaps, has_truth};
use crate::pipeline::segmentation_inputs::SegmentationInputs;
use crate::ranks;
use crate::raster::SplatTensors;

/// Test views with truth.
pub struct HeldOut<'a> {
    inputs: &'a SegmentationInputs<'a>,
    views: Vec<&'a View>,
    splats: SplatTensors,
}

/// Held-out scores of one variant, or of other label maps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HeldOutScores {
    /// Against true labels, void predictions counted as wrong.
    pub labels: LabelScores,
    /// Against true instances, where classes are objects that association found.
    pub instances: Option<InstanceScores>,
    /// Against true classes, where these objects have classes.
    pub semantic: Option<SemanticScores>,
}

impl HeldOutScores {
    /// The mIoU of a training curve.
    pub fn miou(&self) -> Option<f64> {
        let [instances, semantic] = [
            self.instances.as_ref().and_then(|s| s.miou),
            self.semantic.as_ref().and_then(|s| s.pixels.miou),
        ];
        self.labels.pixels.miou.or(instances).or(semantic)
    }
}

impl<'a> HeldOut<'a> {
    /// The held-out views of the scene of `inputs`.
    pub fn new(inputs: &'a SegmentationInputs<'a>) -> Self {
        let association = inputs.config.data.association;
        let semantics = inputs.semantics;
        let known = |view: &&View| has_truth(view, association, semantics);
        Self {
            inputs,
            views: inputs.scene.split(Split::Test).filter(known).collect(),
            splats: SplatTensors::new(inputs.gaussians, inputs.device),
        }
    }

    /// Whether classes are objects that association found: their ids are not those of a truth.
    fn has_objects(&self) -> bool {
        self.inputs.config.data.association != Association::None
    }

    /// Number of views.
    pub fn len(&self) -> usize {
        self.views.len()
    }

    /// Whether there are none: nothing can be scored.
    pub fn is_empty(&self) -> bool {
        self.views.is_empty()
    }

    /// Scores of these identities.
    ///
    /// # Errors
    /// As [`LabelMaps::of`].
    pub fn score(&self, identities: &Identities) -> Result<HeldOutScores> {
        if self.is_empty() {
            return Ok(HeldOutScores::default());
        }
        let inputs = self.inputs;
        let config = &inputs.config.segmentation;
        let source = config.render;
        let coverage = config.min_coverage as f32;
        let maps = LabelMaps::new(identities, &inputs.scene.classes, source, coverage);
        let map = |view: &&View| {
            let seen = self.splats.seen_by(&view.camera, &inputs.settings);
            Ok(LabelRuns::from(maps.of(&seen)?))
        };
        let found = ranks::divided(&self.views, map)?;
        let views = self.views.iter().copied();
        Ok(self.scores(&views.zip(found).collect::<Vec<_>>()))
    }

    /// Scores of the raw labels of the views, and those against true labels with void predictions left out.
    pub fn score_raw(&self) -> (HeldOutScores, Option<LabelScores>) {
        let raw = |&view: &&'a View| Some((view, view.raw.clone()?));
        let raw: Vec<_> = self.views.iter().filter_map(raw).collect();
        let void_left_out = (!self.has_objects()).then(|| self.labels(&raw, Void::LeftOut));
        (self.scores(&raw), void_left_out)
    }

    fn scores(&self, found: &[(&View, LabelRuns)]) -> HeldOutScores {
        let semantics = self.inputs.semantics;
        HeldOutScores {
            labels: self.labels(found, Void::Wrong),
            instances: self.instances(found),
            semantic: semantics.map(|s| s.score(&self.inputs.scene.classes, found)),
        }
    }

    /// Against true labels, if any.
    fn labels(&self, found: &[(&View, LabelRuns)], void: Void) -> LabelScores {
        let classes = &self.inputs.scene.classes;
        let pairs = || {
            found
                .iter()
                .filter_map(|(view, found)| Some((view.truth.as_ref()?.map(), found.map())))
        };
        LabelScores {
            boundary_iou: boundary_iou(classes, pairs(), void),
            ..label_scores(classes, pairs(), void)
        }
    }

    /// Against true instances, where classes are objects.
    fn instances(&self, found: &[(&View, LabelRuns)]) -> Option<InstanceScores> {
        let pairs = found
            .iter()
            .filter_map(|(view, found)| Some((view.instances.as_ref()?.map(), found.map())));
        let known = self.views.iter().any(|view| view.instances.is_some());
        (self.has_objects() && known).then(|| instance_scores(pairs))
    }
}

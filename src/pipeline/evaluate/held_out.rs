//! Label maps that are rendered again and again over Gaussians that stay as they are, and their scores.

use crate::config::Association;
use crate::data::{LabelRuns, Split, View};
use crate::error::Result;
use crate::metrics::{
    InstanceScores, LabelScores, SemanticScores, Void, instance_scores, label_scores,
};
use crate::objects::{Identities, LabelMaps, LabelRule, Semantics, has_truth};
use crate::pipeline::encode::Inputs;
use crate::raster::{SplatTensors, SplatView};

/// Bytes of projected test views that are kept; others are projected again at each use.
const PROJECTED_BYTES: usize = 1 << 29;

/// Views in which identities are rendered. Their projections are kept, as far as memory allows.
pub struct LabelledViews<'a> {
    views: Vec<(&'a View, Option<SplatView>)>,
    splats: SplatTensors,
}

impl<'a> LabelledViews<'a> {
    /// `views` of the Gaussians of `inputs`; keeps at most `bytes` of their projections.
    ///
    /// # Errors
    /// As [`SplatView::blend`].
    pub fn new(
        views: impl Iterator<Item = &'a View>,
        inputs: &Inputs,
        bytes: usize,
    ) -> Result<Self> {
        let splats = SplatTensors::new(inputs.gaussians, inputs.device);
        let mut left = bytes;
        let keep = |view: &'a View| {
            if left == 0 {
                return Ok((view, None));
            }
            let projected = splats.seen_by(&view.camera, &inputs.settings);
            let rest = left.checked_sub(projected.bytes()?);
            left = rest.unwrap_or(left);
            Ok((view, rest.map(|_| projected)))
        };
        Ok(Self {
            views: views.map(keep).collect::<Result<_>>()?,
            splats,
        })
    }

    /// What each view shows of `identities`.
    ///
    /// # Errors
    /// As [`LabelMaps::of`].
    pub fn maps(
        &self,
        identities: &Identities,
        inputs: &Inputs,
    ) -> Result<Vec<(&'a View, LabelRuns)>> {
        let rule = LabelRule::from(&inputs.config.segmentation);
        let maps = LabelMaps::new(identities, &inputs.scene.classes, rule);
        let map = |(view, kept): &(&'a View, Option<SplatView>)| {
            let map = match kept {
                Some(projected) => maps.of(projected)?,
                None => maps.of(&self.splats.seen_by(&view.camera, &inputs.settings))?,
            };
            Ok((*view, LabelRuns::from(map)))
        };
        self.views.iter().map(map).collect()
    }
}

/// Test views with truth.
pub struct HeldOut<'a> {
    views: LabelledViews<'a>,
    /// Classes are objects that association found: their ids are not those of a truth.
    objects: bool,
    /// The classes of these objects.
    semantics: Option<&'a Semantics>,
}

/// Held-out scores of one row.
#[derive(Clone, Debug, Default)]
pub struct Scores {
    /// Against true labels, void predictions counted as wrong.
    pub labels: LabelScores,
    /// Against true instances, where classes are objects that association found.
    pub instances: Option<InstanceScores>,
    /// Against true classes, where these objects have classes.
    pub semantic: Option<SemanticScores>,
}

impl Scores {
    /// The mIoU of a training curve.
    pub fn miou(&self) -> Option<f64> {
        let [instances, semantic] = [
            self.instances.as_ref().and_then(|s| s.miou),
            self.semantic.as_ref().and_then(|s| s.miou),
        ];
        self.labels.miou.or(instances).or(semantic)
    }
}

impl<'a> HeldOut<'a> {
    /// Those of the scene of `inputs`.
    ///
    /// # Errors
    /// As [`SplatView::blend`].
    pub fn new(inputs: &Inputs<'a>) -> Result<Self> {
        let (association, semantics) = (inputs.config.data.association, inputs.semantics);
        let known = |view: &&View| has_truth(view, association, semantics);
        let views = LabelledViews::new(
            inputs.scene.split(Split::Test).filter(known),
            inputs,
            PROJECTED_BYTES,
        )?;
        Ok(Self {
            views,
            objects: association != Association::None,
            semantics,
        })
    }

    /// Whether there are none: nothing can be scored.
    pub fn is_empty(&self) -> bool {
        self.views.views.is_empty()
    }

    /// Scores of these identities.
    ///
    /// # Errors
    /// As [`LabelledViews::maps`].
    pub fn score(&self, identities: &Identities, inputs: &Inputs) -> Result<Scores> {
        if self.is_empty() {
            return Ok(Scores::default());
        }
        Ok(self.scores(&self.views.maps(identities, inputs)?, inputs))
    }

    /// Scores of the raw labels of the views, and those against true labels with void predictions left out.
    pub fn score_raw(&self, inputs: &Inputs) -> (Scores, Option<LabelScores>) {
        let raw = |(view, _): &(&'a View, _)| Some((*view, view.raw.clone()?));
        let raw: Vec<_> = self.views.views.iter().filter_map(raw).collect();
        let void_left_out = (!self.objects).then(|| self.labels(&raw, inputs, Void::LeftOut));
        (self.scores(&raw, inputs), void_left_out)
    }

    fn scores(&self, found: &[(&View, LabelRuns)], inputs: &Inputs) -> Scores {
        Scores {
            labels: self.labels(found, inputs, Void::Wrong),
            instances: self.instances(found),
            semantic: self
                .semantics
                .map(|semantics| semantics.score(&inputs.scene.classes, found)),
        }
    }

    /// Against true labels, as far as there are any.
    fn labels(&self, found: &[(&View, LabelRuns)], inputs: &Inputs, void: Void) -> LabelScores {
        let pairs = found
            .iter()
            .filter_map(|(view, found)| Some((view.truth.as_ref()?.map(), found.map())));
        label_scores(&inputs.scene.classes, pairs, void)
    }

    /// Against true instances, where classes are objects.
    fn instances(&self, found: &[(&View, LabelRuns)]) -> Option<InstanceScores> {
        let pairs = found
            .iter()
            .filter_map(|(view, found)| Some((view.instances.as_ref()?.map(), found.map())));
        let known = self
            .views
            .views
            .iter()
            .any(|(view, _)| view.instances.is_some());
        (self.objects && known).then(|| instance_scores(pairs))
    }
}

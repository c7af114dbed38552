//! Scores of label maps on the held-out views.

use super::terminal;
use burn::tensor::Device;
use coseg::config::Config;
use coseg::data::{Classes, LabelMap, LabelRuns, Scene, Split, View};
use coseg::error::Result;
use coseg::metrics::{
    InstanceScores, LabelScores, SemanticScores, Void, instance_scores, label_scores,
};
use coseg::objects::{Identities, LabelMaps, LabelRule, Semantics};
use coseg::raster::{Settings, SplatTensors};
use coseg::splat::Gaussians;
use coseg::splat::camera::Camera;

/// The labels that the cameras of `views` see, by `map`.
pub fn rendered<'a>(
    views: impl Iterator<Item = &'a View>,
    map: impl Fn(&Camera) -> Result<LabelMap>,
) -> Result<Vec<(&'a View, LabelRuns)>> {
    views
        .map(|view| Ok((view, LabelRuns::from(map(&view.camera)?))))
        .collect()
}

/// What label maps are scored against.
pub enum Truth<'a> {
    /// The true labels of the views, of these classes.
    Labels(&'a Classes),
    /// True instances, and true classes where they are known. Ids of maps are objects of this table.
    Objects(&'a Classes, Option<&'a Semantics>),
}

impl Truth<'_> {
    /// Whether `view` can be scored.
    pub fn has(&self, view: &View) -> bool {
        match self {
            Self::Labels(_) => view.truth.is_some(),
            Self::Objects(_, semantics) => {
                view.instances.is_some() || semantics.is_some_and(|known| known.knows(view))
            }
        }
    }

    /// Scores what the held-out views of `scene` show of the identities of `gaussians`.
    pub fn score_identities(
        &self,
        identities: &Identities,
        gaussians: &Gaussians,
        scene: &Scene,
        config: &Config,
        device: &Device,
    ) -> Result<Scores> {
        let (Self::Labels(classes) | Self::Objects(classes, _)) = self;
        let settings = Settings::from(&config.raster);
        let maps = LabelMaps::new(identities, classes, LabelRule::from(&config.segmentation));
        let splats = SplatTensors::new(gaussians, device);
        let map = |camera: &Camera| maps.of(&splats.seen_by(camera, &settings));
        Ok(self.score(&rendered(scored_views(scene, self), map)?))
    }

    /// Scores `maps`; unlabelled pixels count as wrong.
    pub fn score(&self, maps: &[(&View, LabelRuns)]) -> Scores {
        match self {
            Self::Labels(classes) => {
                let pairs = maps
                    .iter()
                    .filter_map(|(view, map)| Some((view.truth.as_ref()?.map(), map.map())));
                Scores {
                    labels: label_scores(classes, pairs, Void::Wrong),
                    ..Scores::default()
                }
            }
            Self::Objects(objects, semantics) => {
                let pairs = maps
                    .iter()
                    .filter_map(|(view, map)| Some((view.instances.as_ref()?.map(), map.map())));
                Scores {
                    labels: LabelScores::default(),
                    instances: Some(instance_scores(pairs)),
                    semantic: semantics.map(|semantics| semantics.score(objects, maps)),
                }
            }
        }
    }
}

/// Scores of the views of a scene.
#[derive(Default)]
pub struct Scores {
    pub labels: LabelScores,
    pub instances: Option<InstanceScores>,
    pub semantic: Option<SemanticScores>,
}

impl Scores {
    /// Prints a line for each kind of score that is there, with `what` at its front.
    pub fn print(&self, what: &str) {
        let line = |kind: &str, figures: &[(&str, Option<f64>)]| {
            let figures: Vec<String> = figures
                .iter()
                .filter_map(|(name, value)| Some(format!("{name} {:.4}", (*value)?)))
                .collect();
            if !figures.is_empty() {
                terminal::say(&format!("{what}{kind}: {}", figures.join(", ")));
            }
        };
        let labels = &self.labels;
        line(
            "",
            &[
                ("mIoU", labels.miou),
                ("mIoU per view", labels.miou_per_view),
                ("accuracy", labels.accuracy),
            ],
        );
        if let Some(s) = &self.instances {
            line(
                "",
                &[
                    ("accuracy", s.accuracy),
                    ("mIoU", s.miou),
                    ("PQ", s.panoptic.pq),
                    ("SQ", s.panoptic.sq),
                    ("RQ", s.panoptic.rq),
                ],
            );
        }
        if let Some(s) = &self.semantic {
            let quality = s.panoptic.unwrap_or_default();
            line(
                ", by class",
                &[
                    ("mIoU", s.miou),
                    ("mIoU per view", s.miou_per_view),
                    ("accuracy", s.accuracy),
                    ("PQ", quality.all.pq),
                    ("PQ of things", quality.things.pq),
                    ("PQ of stuff", quality.stuff.pq),
                ],
            );
        }
    }

    /// Prints the IoU of each class.
    pub fn print_classes(&self, classes: &Classes) {
        let of_labels = self.labels.per_class.iter();
        let of_labels = of_labels.map(|(id, iou)| (*iou, *id, classes.name(*id)));
        let of_objects = self.semantic.iter().flat_map(|s| &s.per_class);
        let of_objects = of_objects.map(|class| (class.iou, class.id, class.name.as_str()));
        for (iou, id, name) in of_labels.chain(of_objects) {
            terminal::say(&format!("  {iou:.4}  IoU of {id} {name}"));
        }
    }
}

/// The held-out views with something to score against.
pub fn scored_views<'a>(scene: &'a Scene, truth: &Truth<'_>) -> impl Iterator<Item = &'a View> {
    scene.split(Split::Test).filter(|view| truth.has(view))
}

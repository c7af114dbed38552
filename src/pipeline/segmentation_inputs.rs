//! What stage two works on.

use super::lift::LiftedFeatures;
use super::train_decoder::TrainingViews;
use crate::config::Config;
use crate::data::{Scene, Split};
use crate::objects::{Corrections, Semantics};
use crate::raster::Settings;
use crate::splat::Gaussians;
use burn::tensor::Device;

/// The inputs of stage two.
pub struct SegmentationInputs<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its Gaussians, after attendance pruning.
    pub gaussians: &'a Gaussians,
    /// Lifted image features; absent where nothing reads them.
    pub lifted: Option<LiftedFeatures>,
    /// What the classes of objects are scored against, after association.
    pub semantics: Option<&'a Semantics>,
    /// Labels that a person corrected, if any.
    pub corrections: Option<&'a Corrections>,
    /// Whether feature fields are scored.
    pub scores_fields: bool,
    /// Settings of the run.
    pub config: &'a Config,
    /// Blending constants.
    pub settings: Settings,
    /// Device without autodiff.
    pub device: &'a Device,
}

impl<'a> SegmentationInputs<'a> {
    /// Inputs for `gaussians`, without lifted features, semantics, corrections and scores of feature fields.
    pub fn new(
        scene: &'a Scene,
        gaussians: &'a Gaussians,
        config: &'a Config,
        device: &'a Device,
    ) -> Self {
        Self {
            scene,
            gaussians,
            lifted: None,
            semantics: None,
            corrections: None,
            scores_fields: false,
            config,
            settings: Settings::from(&config.raster),
            device,
        }
    }

    /// Makes corrected labels those of `scores`, `[N, C]`.
    pub(super) fn correct(&self, scores: &mut [f32]) {
        if let Some(corrections) = self.corrections {
            corrections.fix(scores, &self.scene.classes);
        }
    }

    /// The labelled training views.
    pub fn training_views(&self) -> TrainingViews<'a> {
        TrainingViews::new(
            self.gaussians,
            self.scene.split(Split::Train),
            &self.scene.classes,
            self.settings,
            &self.config.segmentation,
            self.device,
        )
    }
}

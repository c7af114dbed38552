//! How well a feature field separates the true classes of held-out views.

use super::super::lift::LiftedFeatures;
use super::super::segmentation_inputs::SegmentationInputs;
use super::super::train_decoder::stratified_sample;
use crate::backend::device::{read, upload};
use crate::config::{Association, Blend};
use crate::data::{Split, View};
use crate::error::Result;
use crate::metrics::{calinski_harabasz, davies_bouldin};
use crate::random::{Purpose, stream};
use crate::segmentation::pixels::{FrozenGaussians, LabelledPixels, NO_CLASS};
use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};

/// Share of the pixels that are scored.
const SCORED_SHARE: f64 = 1.0 / 16.0;
/// Number of features that are scored, at most: 200 MB of them. Fewer pixels are drawn where there would be more.
const MAX_FEATURES: f64 = 5e7;

/// How well a feature field separates the true classes, and what it took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FieldScores {
    /// Calinski-Harabasz index, see [`calinski_harabasz`]; higher is better.
    pub calinski_harabasz: Option<f64>,
    /// Davies-Bouldin index, see [`davies_bouldin`]; lower is better.
    pub davies_bouldin: Option<f64>,
    /// Seconds of extracting 2D features, and of lifting or distilling them.
    pub seconds: f64,
    /// Bytes that the field learned; 0 for lifted features.
    pub learnable_bytes: u64,
}

impl FieldScores {
    /// The scores of the lifted features of `inputs`; `None` where none were lifted.
    ///
    /// # Errors
    /// As [`Self::of_field`].
    pub fn of_lifted(inputs: &SegmentationInputs) -> Result<Option<Self>> {
        let Some(lifted) = &inputs.lifted else {
            return Ok(None);
        };
        let channels = lifted.lifted.len() * lifted.dimensions;
        let scores = Self::of_field(inputs, channels, |visible, pixels| {
            blended(lifted, visible, pixels, inputs)
        })?;
        Ok(Some(Self {
            seconds: lifted.seconds.iter().sum(),
            ..scores
        }))
    }

    /// The scores of rendered features whose clusters are the true classes of their pixels, as in Table 2 of the paper. `features`
    /// returns the features at pixels, `[P, channels]`, in the units of the reduced 2D maps, from the Gaussians that the pixels
    /// show.
    ///
    /// Features are blended as in training: divided by the coverage unless `segmentation.blend` is `logits`. Pixels are a sixteenth
    /// of those with a class and enough coverage (`segmentation.min_coverage`), the same ones for every field and seed. Nothing is
    /// standardised: another scale of all features together changes neither index, another scale of single channels changes both.
    /// Calinski-Harabasz grows with the number of pixels. So fields compare only in the same views, where they approximate the same
    /// maps.
    ///
    /// There are no scores without held-out truth, nor of objects that association found.
    ///
    /// # Errors
    /// Those of `features`; [`crate::Error::NonFinite`] when a Gaussian's parameters are not finite.
    pub fn of_field(
        inputs: &SegmentationInputs,
        channels: usize,
        features: impl Fn(&[u32], &LabelledPixels) -> Result<Tensor<2>>,
    ) -> Result<Self> {
        let mut rows = Vec::new();
        let mut classes = Vec::new();
        let config = &inputs.config.segmentation;
        let over_coverage = config.blend == Blend::Probabilities;
        let gaussians = inputs.gaussians;
        let frozen = FrozenGaussians::new(gaussians, inputs.settings, over_coverage, inputs.device);
        for (view, drawn) in drawn_pixels(inputs, channels) {
            let coverage = config.min_coverage as f32;
            let camera = &view.camera;
            let shown = frozen.labelled_pixels(camera, &drawn, coverage)?;
            if shown.labels.is_empty() {
                continue;
            }
            let weights = frozen.weights(camera, &shown.visible, shown.numbers.clone())?;
            let pixels = LabelledPixels::new(weights, shown.labels.to_vec());
            let found = features(&shown.visible, &pixels)?;
            rows.extend(read("features of held-out pixels", found)?);
            classes.extend_from_slice(&shown.labels);
        }
        Ok(Self {
            calinski_harabasz: calinski_harabasz(&rows, channels, &classes),
            davies_bouldin: davies_bouldin(&rows, channels, &classes),
            ..Self::default()
        })
    }
}

/// The held-out views with true classes, and the class index of each drawn pixel that has one. Other
/// pixels are unlabelled.
fn drawn_pixels<'a>(
    inputs: &SegmentationInputs<'a>,
    channels: usize,
) -> impl Iterator<Item = (&'a View, Vec<u16>)> {
    // Truth has the ids of classes, not those of objects.
    let has_classes = inputs.config.data.association == Association::None;
    let views = inputs.scene.split(Split::Test);
    let views = views.filter(|view| has_classes && view.truth.is_some());
    let views: Vec<&View> = views.collect();
    let size = |view: &&View| view.camera.width * view.camera.height;
    let all: usize = views.iter().map(size).sum();
    let share = SCORED_SHARE.min(MAX_FEATURES / (all * channels).max(1) as f64);
    let lookup = inputs.scene.classes.lookup();
    (0..).zip(views).filter_map(move |(number, view)| {
        let ids = view.truth.as_ref()?.map().ids;
        let mut random = stream(0, Purpose::ScoredPixels, number);
        let mut classes = vec![NO_CLASS; ids.len()];
        for pixel in stratified_sample(ids.len(), share, &mut random) {
            let pixel = pixel as usize;
            classes[pixel] = lookup[usize::from(ids[pixel])];
        }
        Some((view, classes))
    })
}

/// Lifted features of all scales in `pixels`, which show the Gaussians `visible`.
fn blended(
    lifted: &LiftedFeatures,
    visible: &[u32],
    pixels: &LabelledPixels,
    inputs: &SegmentationInputs,
) -> Result<Tensor<2>> {
    // A GPU holds the channels of one scale for every pixel of the view.
    let of_scale = |scale: usize| {
        let size = [visible.len(), lifted.dimensions];
        pixels.blend(upload(lifted.rows(scale, visible), size, inputs.device))
    };
    let scales: Vec<_> = (0..lifted.lifted.len())
        .map(of_scale)
        .collect::<Result<_>>()?;
    Ok(Tensor::cat(scales, 1))
}

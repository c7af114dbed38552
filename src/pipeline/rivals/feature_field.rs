//! Feature 3DGS (Zhou et al. 2024): a feature for each Gaussian, distilled from 2D feature maps by rendering.

use super::super::evaluate::FieldScores;
use super::super::segmentation_inputs::SegmentationInputs;
use super::super::train_decoder::{
    Adam, DecodedScores, IdentityModel, TrainingViews, ViewSample, identities, parameter_gradients,
    view_at,
};
use super::initial_parameters;
use crate::backend::device::upload;
use crate::config::Config;
use crate::data::{Split, View};
use crate::error::Result;
use crate::features::{FeatureReduction, ViewFeatures};
use crate::objects::Identities;
use crate::ops::select;
use crate::progress::{Event, Progress, go_on};
use crate::random::{Purpose, stream, uniform};
use crate::reconstruction::optimizer::finite_loss;
use crate::segmentation::linear::linear;
use crate::segmentation::linear::parameter;
use crate::segmentation::pixels::{LabelledPixels, constant};
use burn::module::{Module, Param};
use burn::nn::Linear;
use burn::tensor::{Device, Tensor};
use std::time::Instant;

/// Channels of a Gaussian's feature.
const CHANNELS: usize = 64;
/// Initial features are uniform in +- this.
const INITIAL_RANGE: f32 = 0.1;
/// Learning rate of features and decoder.
const RATE: f64 = 1e-2;

/// A feature of 64 channels for each Gaussian, and the 1x1 convolution that maps blended features to those of the 2D maps.
#[derive(Module, Debug)]
pub struct FeatureField {
    features: Param<Tensor<2>>,
    decoder: Linear,
}

impl FeatureField {
    /// Random initial parameters, on an autodiff `device`.
    fn random(inputs: &SegmentationInputs, device: &Device) -> Self {
        let count = inputs.gaussians.len();
        let channels = map_channels(inputs.config);
        let mut rng = initial_parameters(inputs);
        let features = uniform(count * CHANNELS, INITIAL_RANGE, &mut rng);
        Self {
            features: parameter(features, [count, CHANNELS], device),
            decoder: linear(CHANNELS, channels, &mut rng, device),
        }
    }

    /// Decoded features of `pixels`, which show the Gaussians `visible`: `[P, map channels]`.
    pub fn at(&self, visible: &[u32], pixels: &LabelledPixels) -> Result<Tensor<2>> {
        let features = select(&self.features.val(), visible);
        Ok(self.decoder.forward(pixels.blend(features)?))
    }

    /// Bytes of everything that it learned.
    pub fn bytes(&self) -> usize {
        4 * self.num_params()
    }
}

/// A distilled field.
pub struct Distilled {
    /// The field.
    pub field: FeatureField,
    /// Seconds of feature extraction and training.
    pub seconds: f64,
}

impl Distilled {
    /// How well its decoded features separate the true classes of held-out views.
    ///
    /// # Errors
    /// As [`FieldScores::of_field`].
    pub fn scores(&self, inputs: &SegmentationInputs) -> Result<FieldScores> {
        let field = self.field.valid();
        let channels = map_channels(inputs.config);
        let features = |visible: &[u32], pixels: &_| field.at(visible, pixels);
        Ok(FieldScores {
            seconds: self.seconds,
            learnable_bytes: field.bytes() as u64,
            ..FieldScores::of_field(inputs, channels, features)?
        })
    }
}

/// Trains a feature field on the 2D features of all training photos: the mean absolute difference of decoded blended features and
/// the maps of all scales, read bilinearly at the drawn pixels.
///
/// Differences from the original: its maps have one scale, and it renders whole images.
///
/// # Errors
/// Those of [`FeatureReduction::fit`]; [`crate::Error::NonFinite`] for a loss or gradient that is not finite;
/// [`crate::Error::Stopped`].
pub fn distil(
    inputs: &SegmentationInputs,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<Distilled> {
    let clock = Instant::now();
    let targets = target_maps(inputs, progress)?;
    let mut views = TrainingViews::of_all_pixels(
        inputs.gaussians,
        targets.iter().map(|(view, _)| *view),
        inputs.settings,
        &inputs.config.segmentation,
        inputs.device,
    );
    let field = FeatureField::random(inputs, device);
    let field = train(field, &mut views, &targets, inputs, device, progress)?;
    Ok(Distilled {
        field,
        seconds: clock.elapsed().as_secs_f64(),
    })
}

/// Channels of a photo's 2D features, all scales together.
fn map_channels(config: &Config) -> usize {
    config.features.scale_count() * config.features.dimensions
}

/// The training views with their 2D features.
fn target_maps<'a>(
    inputs: &SegmentationInputs<'a>,
    progress: &mut dyn Progress,
) -> Result<Vec<(&'a View, ViewFeatures)>> {
    let features = &inputs.config.features;
    let seed = inputs.config.seed;
    let mut advance = || go_on(progress);
    let mut reduction =
        FeatureReduction::fit(inputs.scene, features, seed, inputs.device, &mut advance)?;
    let maps: Vec<ViewFeatures> = reduction.training_views().collect::<Result<_>>()?;
    Ok(inputs.scene.split(Split::Train).zip(maps).collect())
}

/// Trains `field`, each iteration on drawn pixels of one view.
fn train(
    mut field: FeatureField,
    views: &mut TrainingViews,
    targets: &[(&View, ViewFeatures)],
    inputs: &SegmentationInputs,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<FeatureField> {
    let config = inputs.config;
    let mut adam = Adam::new(RATE, 1, None);
    let iterations = config.segmentation.iterations;
    progress.event(&Event::Started {
        stage: "distillation",
        done: 0,
        iterations,
    });
    for iteration in 0..iterations {
        let view = view_at(config.seed, iteration, views.len());
        let mut rng = stream(config.seed, Purpose::Pixels, iteration as u64);
        let sample = views.sample(view, config.segmentation.pixel_share, &mut rng)?;
        let mut loss = 0.0;
        if !sample.pixels.is_empty() {
            let (view, maps) = &targets[view];
            let target = target_at(&sample, view, maps, inputs);
            let decoded = field.at(&sample.visible, &sample.pixels)?;
            let mean_difference = (decoded - constant(target, device)).abs().mean();
            let gradient = parameter_gradients(&field, &mut mean_difference.backward());
            let named = [("the parameters", &gradient)];
            let value = finite_loss("segmentation loss", mean_difference.inner(), &named)?;
            loss = f64::from(value);
            field = adam.step(field, gradient, 1.0);
        }
        progress.event(&Event::Step {
            iteration: iteration + 1,
            loss,
            gaussians: inputs.gaussians.len(),
        });
        go_on(progress)?;
    }
    progress.event(&Event::Finished);
    Ok(field)
}

/// The maps of all scales at the pixels of `sample`, `[P, map channels]`.
fn target_at(
    sample: &ViewSample,
    view: &View,
    maps: &ViewFeatures,
    inputs: &SegmentationInputs,
) -> Tensor<2> {
    let channels = map_channels(inputs.config);
    let dimensions = inputs.config.features.dimensions;
    let [width, height] = [view.camera.width, view.camera.height];
    let mut target = vec![0.0; sample.numbers.len() * channels];
    let rows = target.chunks_exact_mut(channels);
    for (row, &pixel) in rows.zip(sample.numbers.iter()) {
        let (x, y) = (pixel as usize % width, pixel as usize / width);
        let [u, v] = [x as f64 + 0.5, y as f64 + 0.5];
        for (out, map) in row.chunks_exact_mut(dimensions).zip(&maps.maps) {
            map.sample(u, v, width, height, out);
        }
    }
    let shape = [sample.numbers.len(), channels];
    upload(target, shape, inputs.device)
}

/// A linear classifier of the frozen features of a field, `[N, 64]` without autodiff, trained on labels. It commutes with blending.
pub struct LinearHead(Tensor<2>);

impl LinearHead {
    /// Over the features of `field`.
    pub fn new(field: &FeatureField) -> Self {
        Self(field.features.val().inner())
    }

    /// Random weights, on an autodiff `device`.
    pub fn random(inputs: &SegmentationInputs, device: &Device) -> Linear {
        let classes = inputs.scene.classes.len();
        linear(CHANNELS, classes, &mut initial_parameters(inputs), device)
    }
}

impl IdentityModel for LinearHead {
    type Module = Linear;

    fn decode(
        &mut self,
        head: &Linear,
        _view: usize,
        visible: &[u32],
        _iteration: usize,
    ) -> Result<DecodedScores> {
        let features = constant(select(&self.0, visible), &head.weight.device());
        Ok(head.forward(features).into())
    }

    fn identities(&self, head: Linear) -> Result<Identities> {
        identities(head.valid().forward(self.0.clone()))
    }
}

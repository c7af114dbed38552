//! Training of a variant: its loss, its schedule, its provenance, and its decoder before the first step.

use super::rivals::Grouping;
use super::segmentation_inputs::SegmentationInputs;
use super::train_decoder::{
    Adam, DecoderInput, DecoderModel, DecoderPlan, Training, TrainingPlan, TrainingSchedule,
};
use crate::config::{Blend, Reduction, SegmentationConfig, Variant};
use crate::error::Result;
use crate::provenance::Provenance;
use crate::segmentation::decoder::DecoderConfig;
use crate::segmentation::encoder::spatial_digest;
use crate::segmentation::loss::LabelLoss;
use std::path::Path;

/// How `variant` is trained.
pub(super) fn plan(variant: Variant, inputs: &SegmentationInputs) -> Result<TrainingPlan> {
    let config = &inputs.config.segmentation;
    let loss = if variant.uses_configured_loss() {
        LabelLoss::from_config(config)?
    } else {
        LabelLoss::Ce
    };
    let mut plan = TrainingPlan::new(config, loss, inputs.config.seed);
    match variant {
        Variant::Grouping => {
            plan.config.blend = Blend::Logits;
            plan.config.reduction = Reduction::Mean;
            // The original divides cross-entropy by its value for a uniform prediction.
            let uniform = (inputs.scene.classes.len().max(2) as f64).ln();
            plan.lambda = [1.0 / uniform, Grouping::LAMBDA_3D];
        }
        Variant::Distilled => plan.config.blend = Blend::Logits,
        Variant::PanopticLifting => plan.config.blend = Blend::Probabilities,
        _ => {}
    }
    Ok(plan)
}

/// When `variant` is evaluated and saved.
///
/// # Errors
/// [`crate::Error::Io`] when the file of the point encoder's weights cannot be read.
pub(super) fn schedule(
    variant: Variant,
    inputs: &SegmentationInputs,
    checkpoints: &Path,
) -> Result<TrainingSchedule> {
    let config = &inputs.config.segmentation;
    let or_a_tenth = |every: usize| match every {
        0 => config.iterations.div_ceil(10),
        every => every,
    };
    Ok(TrainingSchedule {
        variant: variant.key(),
        gaussians: inputs.gaussians.len(),
        eval_every: or_a_tenth(config.eval_every),
        checkpoint_every: or_a_tenth(config.checkpoint_every),
        checkpoint: Some(checkpoints.join(format!("{}.safetensors", variant.key()))),
        provenance: provenance(variant, inputs)?,
    })
}

/// What the training of `variant` follows from.
fn provenance(variant: Variant, inputs: &SegmentationInputs) -> Result<Provenance> {
    let decoder = variant.trains_decoder();
    let features = decoder || variant.reads_image_features();
    let mut provenance =
        Provenance::stage_two(inputs.config, inputs.scene, inputs.gaussians, features)?;
    if let Some(lifted) = &inputs.lifted
        && variant.reads_image_features()
    {
        provenance = provenance.with_image_features(&lifted.content);
    }
    if decoder
        && variant != Variant::NoSpatial
        && let Some(weights) = spatial_digest(&inputs.config.spatial)?
    {
        provenance = provenance.with_point_encoder(&weights);
    }
    Ok(provenance)
}

/// A decoder before its first step, over the frozen `input`. Its scores are added to `prior`, `[N, C]`. Where its
/// parameters are averaged, that begins after the share `segmentation.warmup` of the iterations of `plan`.
pub fn decoder_training<'a>(
    plan: &TrainingPlan,
    input: &'a DecoderInput,
    prior: Option<Vec<f32>>,
    inputs: &'a SegmentationInputs,
) -> Training<DecoderModel<'a>> {
    let config: &SegmentationConfig = &inputs.config.segmentation;
    let seed = inputs.config.seed;
    let classes = inputs.scene.classes.len();
    let device = inputs.device.clone().autodiff();
    let pyramid = &input.scene().pyramid;
    let mut decoder = DecoderConfig::for_pyramid(pyramid, classes)
        .with_seed(seed)
        .init(&device);
    let decoder_plan = DecoderPlan {
        config,
        regularised: config.lambda_reg > 0.0,
        size: [inputs.gaussians.len(), classes],
        seed,
    };
    let means = &inputs.gaussians.means;
    let mut model = DecoderModel::new(input, means, decoder_plan);
    if let Some(prior) = prior {
        model = model.with_prior(prior, &device);
        decoder = decoder.with_silent_start();
    }
    let adam = Adam::new(config.lr, config.batch(), average_from(&plan.config));
    Training::new(model, decoder, adam, classes)
}

/// The iteration from which parameters are averaged, if they are. Not `plan.warmup`: a variant under cross-entropy has no warm-up,
/// and is averaged over the same steps as the others.
pub(super) fn average_from(config: &SegmentationConfig) -> Option<usize> {
    let from = (config.warmup * config.iterations as f64) as usize;
    config.average.then_some(from)
}

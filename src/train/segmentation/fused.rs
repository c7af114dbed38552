//! The decoder rows: multi-scale fusion (Eq. 7) trained by the label loss and the 3D regularisation (Eq. 10).
//!
//! The last layer is linear, so hidden features are blended and the layer is applied per pixel: exact, and cheaper by
//! the ratio of classes to hidden width. Only what a view's visible Gaussians depend on is decoded in a step.

use super::optimiser::{self, ModuleAdam, NamedValues};
use super::views::ViewWeights;
use super::{Model, Prediction};
use crate::config::SegmentationConfig;
use crate::error::Result;
use crate::objects::Identities;
use crate::ops::{SparseMatrix, sparse_apply};
use crate::random::{Purpose, stream};
use crate::segmentation::decoder::{Decoder, DecoderInput};
use crate::segmentation::loss::neighbour_divergence;
use burn::module::Module;
use burn::tensor::{Device, Gradients, Tensor};
use std::sync::Arc;

/// Scales of the 3D regularisation (n = 3, 4), zero-based.
pub const REGULARISED: [usize; 2] = [2, 3];
/// Finest scales of which a step decodes only what its view depends on; the regularised ones stay whole.
const RESTRICTED: usize = REGULARISED[0];
/// Gaussians decoded at once when the stored identities are made.
const CHUNK: usize = 16_384;

/// A set of Gaussians with the decoder's frozen inputs.
#[derive(Clone, Debug)]
pub struct Encoded {
    /// Frozen inputs of all scales.
    pub input: DecoderInput,
    /// Scene index of each finest point, ascending.
    pub points: Vec<u32>,
    /// K nearest points of the same level for each point of the regularised scales, `[N_n, K]`; empty where a scale is
    /// not there.
    pub neighbours: [Vec<u32>; REGULARISED.len()],
}

/// Where the decoder's input comes from.
pub enum Source {
    /// The whole scene, encoded once; views use the part they see.
    Scene(Encoded),
    /// Each training view's visible Gaussians encoded alone (the paper), and the whole scene for those no view sees.
    Views {
        /// In the order of the training views.
        views: Vec<Encoded>,
        /// Summed alpha' T of each view's points, for the weighted mean of identities.
        weights: Vec<Vec<f32>>,
        /// The whole scene.
        scene: Encoded,
    },
}

impl Source {
    /// The encoding of the whole scene.
    pub fn scene(&self) -> &Encoded {
        match self {
            Self::Scene(scene) | Self::Views { scene, .. } => scene,
        }
    }

    fn view(&self, view: usize) -> &Encoded {
        match self {
            Self::Scene(scene) => scene,
            Self::Views { views, .. } => &views[view],
        }
    }
}

/// How a decoder row is trained.
#[derive(Clone, Copy, Debug)]
pub struct FusedPlan<'a> {
    /// Settings of stage two.
    pub config: &'a SegmentationConfig,
    /// Learning rate.
    pub rate: f64,
    /// Whether Eq. 9 is part of the loss.
    pub regularised: bool,
    /// Number of Gaussians and of classes.
    pub size: [usize; 2],
    /// Seed of the regularisation's samples.
    pub seed: u64,
}

/// A decoder in training.
pub struct Fused<'a> {
    decoder: Option<Decoder>,
    adam: ModuleAdam,
    source: &'a Source,
    plan: FusedPlan<'a>,
    /// Inputs restricted to what each view sees, made at its first use, while `budget` bytes last.
    restricted: Vec<Option<Arc<DecoderInput>>>,
    budget: usize,
    iteration: usize,
    device: Device,
}

impl<'a> Fused<'a> {
    /// A model around a fresh `decoder` on an autodiff `device`, for a scene of `views` training views.
    pub fn new(decoder: Decoder, source: &'a Source, views: usize, plan: FusedPlan<'a>, device: &Device) -> Self {
        Self {
            decoder: Some(decoder),
            adam: ModuleAdam::new(plan.rate),
            source,
            plan,
            restricted: vec![None; views],
            budget: plan.config.weight_cache_mb << 19,
            iteration: 0,
            device: device.clone(),
        }
    }

    fn restricted(&mut self, view: usize, visible: &[u32]) -> Arc<DecoderInput> {
        if let Some(input) = &self.restricted[view] {
            return input.clone();
        }
        let encoded = self.source.view(view);
        let rows: Vec<u32> = match self.source {
            Source::Scene(_) => visible.to_vec(),
            Source::Views { .. } => {
                visible.iter().filter_map(|g| encoded.points.binary_search(g).ok().map(|row| row as u32)).collect()
            }
        };
        let input = Arc::new(encoded.input.restrict(&rows, RESTRICTED));
        if let Some(left) = self.budget.checked_sub(input.bytes(RESTRICTED)) {
            self.budget = left;
            self.restricted[view] = Some(input.clone());
        }
        input
    }

    fn regularisation(&self, fused: &[Tensor<2>], view: usize) -> Option<Tensor<1>> {
        let k = self.plan.config.reg_neighbours;
        let mut sum: Option<Tensor<1>> = None;
        for (scale, table) in REGULARISED.into_iter().zip(&self.source.view(view).neighbours) {
            let Some(features) = fused.get(scale) else { continue };
            let points = features.dims()[0];
            if table.len() != points * k || points < 2 {
                continue;
            }
            let mut rng = stream(self.plan.seed, Purpose::Regularisation, (self.iteration * 4 + scale) as u64);
            let chosen = rand::seq::index::sample(&mut rng, points, self.plan.config.reg_samples.min(points));
            let chosen: Vec<u32> = chosen.iter().map(|i| i as u32).collect();
            let term = neighbour_divergence(features.clone(), &chosen, table, k);
            sum = Some(match sum {
                Some(sum) => sum + term,
                None => term,
            });
        }
        sum
    }

    /// Scores of the finest points, in chunks so that memory does not grow with the scene.
    fn decode(&self, decoder: &Decoder, encoded: &Encoded) -> Vec<f32> {
        let count = encoded.points.len() as u32;
        let mut scores = Vec::with_capacity(count as usize * self.plan.size[1]);
        for first in (0..count).step_by(CHUNK) {
            let rows: Vec<u32> = (first..(first + CHUNK as u32).min(count)).collect();
            let part = encoded.input.restrict(&rows, RESTRICTED);
            scores.extend(optimiser::values(decoder.classify(decoder.forward(&part).hidden)));
        }
        scores
    }
}

impl Model for Fused<'_> {
    fn predict(&mut self, view: usize, weights: &ViewWeights, sampled: SparseMatrix) -> Result<Prediction> {
        let input = self.restricted(view, &weights.visible);
        let Some(decoder) = &self.decoder else { return Ok(Prediction::empty(self.plan.size[1], &self.device)) };
        let decoded = decoder.forward(&input);
        let logits = decoder.classify(sparse_apply(decoded.hidden, Arc::new(sampled)));
        let regularisation = if self.plan.regularised { self.regularisation(&decoded.fused, view) } else { None };
        self.iteration += 1;
        Ok(Prediction { logits, regularisation })
    }

    fn step(&mut self, gradients: &mut Gradients) -> Result<()> {
        if let Some(decoder) = self.decoder.take() {
            self.decoder = Some(self.adam.step(decoder, gradients)?);
        }
        Ok(())
    }

    fn identities(&mut self) -> Result<Identities> {
        let Some(decoder) = self.decoder.as_ref().map(|d| d.valid()) else { return Ok(Identities::default()) };
        let [count, classes] = self.plan.size;
        let scores = match self.source {
            Source::Scene(scene) => self.decode(&decoder, scene),
            Source::Views { views, scene, weights } => {
                // s_i = sum_v w_iv s_iv / sum_v w_iv; the whole-scene encoding where no view sees i.
                let mut sums = vec![0.0_f32; count * classes];
                let mut totals = vec![0.0_f32; count];
                for (view, weights) in views.iter().zip(weights) {
                    let decoded = self.decode(&decoder, view);
                    let rows = decoded.chunks_exact(classes.max(1)).zip(&view.points);
                    for ((row, &i), &w) in rows.zip(weights) {
                        totals[i as usize] += w;
                        let sum = &mut sums[i as usize * classes..][..classes];
                        sum.iter_mut().zip(row).for_each(|(s, v)| *s += w * v);
                    }
                }
                let whole = self.decode(&decoder, scene);
                for (i, &total) in totals.iter().enumerate() {
                    let span = i * classes..(i + 1) * classes;
                    if total > 0.0 {
                        sums[span].iter_mut().for_each(|s| *s /= total);
                    } else {
                        sums[span.clone()].copy_from_slice(&whole[span]);
                    }
                }
                sums
            }
        };
        Ok(Identities { scores, classes })
    }

    fn learnable_bytes(&self) -> usize {
        self.decoder.as_ref().map_or(0, optimiser::parameter_bytes)
    }

    fn state(&self) -> NamedValues {
        let mut state = self.adam.state();
        state.extend(self.decoder.as_ref().map(optimiser::parameters).unwrap_or_default());
        state.push(("iteration".into(), vec![self.iteration as f32]));
        state
    }

    fn restore(&mut self, state: &dyn Fn(&str) -> Option<Vec<f32>>) -> Option<()> {
        self.iteration = *state("iteration")?.first()? as usize;
        self.adam = self.adam.clone().with_state(state, &self.device)?;
        self.decoder = Some(optimiser::with_parameters(self.decoder.take()?, state)?);
        Some(())
    }
}

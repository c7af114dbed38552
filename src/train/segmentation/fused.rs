//! The decoder rows: multi-scale fusion (Eq. 7) trained by the label loss and the 3D regularisation (Eq. 10).
//!
//! Where logits are blended, the linear last layer is applied per pixel, after blending the hidden features. Only what a
//! view's visible Gaussians depend on is decoded in a step.

use super::consistency::dropped_channels;
use super::optimiser::{self, ModuleAdam, NamedValues};
use super::views::Drawn;
use super::{Model, Prediction, Scores, stored};
use crate::config::{Blend, SegmentationConfig};
use crate::error::Result;
use crate::objects::Identities;
use crate::ops::sparse_apply;
use crate::random::{Purpose, stream};
use crate::segmentation::decoder::{Decoded, Decoder};
use crate::segmentation::loss::{NeighbourPairs, neighbour_divergence};
use crate::segmentation::neighbours::without_self;
use crate::segmentation::pyramid::{Pyramid, Restriction};
use burn::module::Module;
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use std::sync::Arc;

/// Scales of the 3D regularisation (n = 3, 4), zero-based.
const REGULARISED: [usize; 2] = [2, 3];
/// Gaussians decoded at once when the stored identities are made.
const CHUNK: usize = 16_384;

/// A set of Gaussians with the decoder's frozen inputs.
#[derive(Clone, Debug)]
pub struct Encoded {
    /// Frozen inputs of all scales; level 1 holds every point of the set.
    pub pyramid: Pyramid,
    /// Scene index of each point of the set, ascending.
    pub points: Vec<u32>,
}

/// What a step needs of a view besides its weights.
#[derive(Clone, Debug)]
struct Prepared {
    /// The part of the pyramid that the view's visible Gaussians depend on.
    kept: Restriction,
    /// K nearest points within that part for each point of the regularised scales, `[N_n, K]`; empty without them.
    neighbours: [Vec<u32>; REGULARISED.len()],
}

impl Prepared {
    fn bytes(&self) -> usize {
        self.kept.bytes() + 4 * self.neighbours.iter().map(Vec::len).sum::<usize>()
    }
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
    /// Step from which on the decoder is averaged; the average is what stores identities.
    pub average_from: Option<usize>,
    /// Share of the frozen channels that each of two predictions does without; absent: one prediction, of all channels.
    pub dropout: Option<f64>,
    /// Seed of the regularisation's samples, and of dropout.
    pub seed: u64,
}

/// A decoder in training.
pub struct Fused<'a> {
    decoder: Option<Decoder>,
    /// Added to the scores of each Gaussian, `[N, C]`; empty for nothing.
    prior: Arc<Vec<f32>>,
    adam: ModuleAdam,
    source: &'a Source,
    plan: FusedPlan<'a>,
    /// Centres of all Gaussians.
    means: &'a [[f32; 3]],
    /// Made at a view's first use and kept while `budget` bytes last.
    prepared: Vec<Option<Arc<Prepared>>>,
    budget: usize,
    iteration: usize,
    device: Device,
}

impl<'a> Fused<'a> {
    /// A model around a fresh `decoder` on an autodiff `device`, for a scene with Gaussians at `means` and `views`
    /// training views.
    pub fn new(
        decoder: Decoder,
        source: &'a Source,
        means: &'a [[f32; 3]],
        views: usize,
        plan: FusedPlan<'a>,
        device: &Device,
    ) -> Self {
        Self {
            decoder: Some(decoder),
            prior: Arc::default(),
            adam: match plan.average_from {
                Some(from) => ModuleAdam::new(plan.rate).averaging(from),
                None => ModuleAdam::new(plan.rate),
            },
            source,
            plan,
            means,
            prepared: vec![None; views],
            budget: plan.config.weight_cache_mb << 19,
            iteration: 0,
            device: device.clone(),
        }
    }

    /// Adds `prior` `[N, C]` to the scores of every Gaussian, and lets the decoder start from zero beside it.
    ///
    /// # Panics
    /// If `prior` does not hold one score for each Gaussian and class.
    #[must_use]
    pub fn with_prior(mut self, prior: Arc<Vec<f32>>) -> Self {
        assert_eq!(prior.len(), self.plan.size[0] * self.plan.size[1], "one prior score a Gaussian and class");
        self.decoder = self.decoder.map(Decoder::with_silent_start);
        self.prior = prior;
        self
    }

    /// Scores `[rows, C]` of hidden features of the scene's Gaussians `points`.
    fn scores(&self, decoder: &Decoder, hidden: Tensor<2>, points: &[u32]) -> Tensor<2> {
        let classes = self.plan.size[1];
        let scores = decoder.classify(hidden);
        if self.prior.is_empty() {
            return scores;
        }
        let rows: Vec<f32> =
            points.iter().flat_map(|&i| &self.prior[i as usize * classes..][..classes]).copied().collect();
        let prior = TensorData::new(rows, [points.len(), classes]);
        scores.clone() + Tensor::from_data(prior, &scores.device())
    }

    fn prepare(&mut self, view: usize, visible: &[u32]) -> Result<Arc<Prepared>> {
        if let Some(prepared) = &self.prepared[view] {
            return Ok(prepared.clone());
        }
        let encoded = self.source.view(view);
        let row = |g: &u32| encoded.points.binary_search(g).ok().map(|row| row as u32);
        let rows: Vec<u32> = visible.iter().filter_map(row).collect();
        let kept = Restriction::new(&encoded.pyramid, Arc::new(rows));
        let mut neighbours = REGULARISED.map(|_| Vec::new());
        for (table, scale) in neighbours.iter_mut().zip(REGULARISED) {
            if let (true, Some(level)) = (self.plan.regularised, encoded.pyramid.levels.get(scale)) {
                let at = |&r: &u32| self.means[encoded.points[level.points[r as usize] as usize] as usize];
                let cloud: Vec<[f32; 3]> = kept.rows(scale).into_iter().flat_map(|rows| rows.iter()).map(at).collect();
                *table = without_self(&cloud, self.plan.config.reg_neighbours)?;
            }
        }
        let prepared = Arc::new(Prepared { kept, neighbours });
        if let Some(left) = self.budget.checked_sub(prepared.bytes()) {
            self.budget = left;
            self.prepared[view] = Some(prepared.clone());
        }
        Ok(prepared)
    }

    fn regularisation(&self, fused: &[Tensor<2>], prepared: &Prepared) -> Option<Tensor<1>> {
        let k = self.plan.config.reg_neighbours;
        let mut sum: Option<Tensor<1>> = None;
        for (scale, table) in REGULARISED.into_iter().zip(&prepared.neighbours) {
            let Some(features) = fused.get(scale) else { continue };
            let points = features.dims()[0];
            if table.len() != points * k || points < 2 {
                continue;
            }
            let mut rng = stream(self.plan.seed, Purpose::Regularisation, (self.iteration * 4 + scale) as u64);
            let chosen = rand::seq::index::sample(&mut rng, points, self.plan.config.reg_samples.min(points));
            let chosen: Vec<u32> = chosen.iter().map(|i| i as u32).collect();
            let term = neighbour_divergence(features.clone(), NeighbourPairs::new(chosen, table, k));
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
            let rows = Arc::new((first..(first + CHUNK as u32).min(count)).collect::<Vec<_>>());
            let points = &encoded.points[first as usize..][..rows.len()];
            let kept = Restriction::new(&encoded.pyramid, rows);
            let part = self.scores(decoder, decoder.forward(&encoded.pyramid, &kept).hidden, points);
            scores.extend(optimiser::values(stored(part, self.plan.config.blend)));
        }
        scores
    }
}

impl Model for Fused<'_> {
    fn predict(&mut self, view: usize, drawn: &Drawn) -> Result<Prediction> {
        let prepared = self.prepare(view, &drawn.visible)?;
        let Some(decoder) = &self.decoder else { return Ok(Prediction::empty(self.plan.size[1], &self.device)) };
        let pyramid = &self.source.view(view).pyramid;
        let predicted = |factors: &[Vec<f32>]| {
            let Decoded { hidden, fused } = decoder.forward_scaled(pyramid, &prepared.kept, factors);
            let scores = match self.plan.config.blend {
                // The last layer is linear: hidden features are blended and it is applied per pixel.
                Blend::Logits if self.prior.is_empty() => {
                    Scores::Pixels(decoder.classify(sparse_apply(hidden, Arc::new(drawn.pixels.chosen()))))
                }
                blend => Scores::blended(self.scores(decoder, hidden, &drawn.visible), &drawn.pixels, blend),
            };
            (scores, fused)
        };
        let (scores, fused) = match self.plan.dropout {
            None => predicted(&[]),
            Some(rate) => {
                let factors =
                    |which: usize| dropped_channels(pyramid, rate, self.plan.seed, 2 * self.iteration + which);
                let ((one, fused), (other, _)) = (predicted(&factors(0)), predicted(&factors(1)));
                (Scores::Pair(Box::new([one, other])), fused)
            }
        };
        let regularisation = if self.plan.regularised { self.regularisation(&fused, &prepared) } else { None };
        self.iteration += 1;
        Ok(Prediction { scores, regularisation })
    }

    fn step(&mut self, gradients: &mut Gradients, factor: f64) -> Result<()> {
        if let Some(decoder) = self.decoder.take() {
            self.decoder = Some(self.adam.step(decoder, gradients, factor)?);
        }
        Ok(())
    }

    fn identities(&mut self) -> Result<Identities> {
        let Some(decoder) = self.decoder.as_ref().map(|d| self.adam.averaged(d.valid())) else {
            return Ok(Identities::default());
        };
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

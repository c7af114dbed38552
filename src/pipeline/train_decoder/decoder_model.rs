//! The decoder variants: multi-scale fusion (Eq. 7) trained by the label loss and the 3D regularisation (Eq. 10).
//!
//! A step decodes only what the view's visible Gaussians depend on. Where logits are blended, the linear last layer is
//! applied to pixels, after blending the hidden features. Views that see more Gaussians than `segmentation.decoder_chunk`
//! are decoded in parts, see [`super::in_parts`].

use super::in_parts::{self, PendingScores};
use super::optimiser::{self, ModuleAdam, NamedValues};
use super::view_input::{Part, REGULARISED, ViewInput};
use super::views::ViewSample;
use super::{IdentityModel, Prediction, stored};
use crate::config::{Blend, SegmentationConfig};
use crate::error::Result;
use crate::objects::Identities;
use crate::ops::SparseMatrix;
use crate::random::{Purpose, stream};
use crate::segmentation::decoder::Decoder;
use crate::segmentation::loss::{NeighbourPairs, Scores, neighbour_divergence};
use crate::segmentation::pixels::constant;
use crate::segmentation::pyramid::{Dependencies, Pyramid, select};
use burn::module::Module;
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use rand::Rng;
use std::sync::Arc;

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

/// The decoder's frozen input.
pub enum DecoderInput {
    /// The whole scene, encoded once; each view uses the part it sees.
    Scene(Encoded),
    /// The visible Gaussians of each training view, encoded alone (the paper), and the whole scene for Gaussians that no
    /// view sees.
    Views {
        /// In the order of the training views.
        views: Vec<Encoded>,
        /// Summed alpha' T of each view's points, for the weighted mean of identities.
        weights: Vec<Vec<f32>>,
        /// The whole scene.
        scene: Encoded,
    },
}

impl DecoderInput {
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

/// How a decoder variant is trained.
#[derive(Clone, Copy, Debug)]
pub struct DecoderPlan<'a> {
    /// Settings of stage two.
    pub config: &'a SegmentationConfig,
    /// Learning rate.
    pub rate: f64,
    /// Whether Eq. 9 is part of the loss.
    pub regularised: bool,
    /// Number of Gaussians and of classes.
    pub size: [usize; 2],
    /// Step after which the parameters are averaged; the averages then make the stored identities.
    pub average_from: Option<usize>,
    /// Share of the frozen channels that each of two predictions does without; absent for one prediction of all channels.
    pub dropout: Option<f64>,
    /// Seed of the regularisation's samples, and of dropout.
    pub seed: u64,
}

/// Factors of the frozen channels of each scale for prediction `index` of a run with `seed`: 0 for a random `rate` of
/// them, 1 / (1 - rate) for the others.
pub fn dropped_channels(pyramid: &Pyramid, rate: f64, seed: u64, index: usize) -> Vec<Vec<f32>> {
    let mut rng = stream(seed, Purpose::Dropout, index as u64);
    let kept = (1.0 - rate).recip() as f32;
    let mut factor = || if rng.random_bool(rate) { 0.0 } else { kept };
    let levels = pyramid.levels.iter();
    levels
        .map(|level| (0..level.features.dims()[1]).map(|_| factor()).collect())
        .collect()
}

/// The decoder's input for `part` of `pyramid`, its channels multiplied by `factors` where there are any.
pub(super) fn input(part: &Part, pyramid: &Pyramid, factors: &[Vec<f32>]) -> Pyramid {
    part.pyramid(pyramid).scaled(factors)
}

/// A decoder in training.
pub struct DecoderModel<'a> {
    /// Absent only within a step.
    decoder: Option<Decoder>,
    /// Added to the scores of each Gaussian, `[N, C]`, without autodiff.
    prior: Option<Tensor<2>>,
    adam: ModuleAdam,
    input: &'a DecoderInput,
    plan: DecoderPlan<'a>,
    /// Centres of all Gaussians.
    means: &'a [[f32; 3]],
    /// Made at a view's first use and kept while `budget` bytes last.
    views: Vec<Option<Arc<ViewInput>>>,
    budget: usize,
    /// Most bytes of gathered features for a view.
    gathered: usize,
    /// Present between the prediction and the step of a view in parts.
    pending: Option<PendingScores>,
    iteration: usize,
    device: Device,
}

impl<'a> DecoderModel<'a> {
    /// A model around a fresh `decoder` on an autodiff `device`, for a scene with Gaussians at `means` and `views`
    /// training views.
    pub fn new(
        decoder: Decoder,
        input: &'a DecoderInput,
        means: &'a [[f32; 3]],
        views: usize,
        plan: DecoderPlan<'a>,
        device: &Device,
    ) -> Self {
        let adam = ModuleAdam::new(plan.rate);
        let budget = plan.config.weight_cache_mb << 19;
        Self {
            decoder: Some(decoder),
            prior: None,
            adam: match plan.average_from {
                Some(from) => adam.averaging(from),
                None => adam,
            },
            input,
            plan,
            means,
            views: vec![None; views],
            budget,
            gathered: budget / (2 * views.max(1)),
            pending: None,
            iteration: 0,
            device: device.clone(),
        }
    }

    /// Adds `prior` `[N, C]` to the scores of every Gaussian. The decoder's own scores start at zero then.
    ///
    /// # Panics
    /// If `prior` does not hold one score for each Gaussian and class.
    #[must_use]
    pub fn with_prior(mut self, prior: Vec<f32>) -> Self {
        let size = self.plan.size;
        assert_eq!(
            prior.len(),
            size[0] * size[1],
            "one prior score for each Gaussian and class"
        );
        self.decoder = self.decoder.map(Decoder::with_silent_start);
        let prior = TensorData::new(prior, size);
        self.prior = Some(Tensor::from_data(prior, &self.device.clone().inner()));
        self
    }

    /// Scores `[rows, C]` of hidden features of the scene's Gaussians `points`.
    fn scores(&self, decoder: &Decoder, hidden: Tensor<2>, points: &[u32]) -> Tensor<2> {
        let scores = decoder.classify(hidden);
        match &self.prior {
            Some(prior) => {
                let prior = constant(select(prior, points), &scores.device());
                scores + prior
            }
            None => scores,
        }
    }

    fn view_input(&mut self, view: usize, visible: &[u32]) -> Result<Arc<ViewInput>> {
        if let Some(input) = &self.views[view] {
            return Ok(input.clone());
        }
        let encoded = self.input.view(view);
        let mut input = ViewInput::new(encoded, visible, self.means, &self.plan)?;
        let copies = SparseMatrix::copies(&self.device);
        let kept = self.budget.checked_sub(copies * input.bytes());
        if let Some(left) = kept {
            input.gather(&encoded.pyramid, left.min(self.gathered));
            self.budget = self.budget.saturating_sub(copies * input.bytes());
        }
        let input = Arc::new(input);
        if kept.is_some() {
            self.views[view] = Some(input.clone());
        }
        Ok(input)
    }

    /// The sample of this iteration at each regularised scale.
    fn samples(&self, input: &ViewInput) -> Vec<Option<NeighbourPairs>> {
        let clouds = input.clouds.iter().zip(REGULARISED);
        clouds
            .map(|(cloud, scale)| cloud.sample(&self.plan, scale, self.iteration))
            .collect()
    }

    /// Predicts all visible Gaussians at once, once for each of `factors`. The loss's graph reaches the parameters.
    fn predict_whole(
        &self,
        decoder: &Decoder,
        pyramid: &Pyramid,
        view: &ViewInput,
        sample: &ViewSample,
        factors: &[Vec<Vec<f32>>],
    ) -> Result<Prediction> {
        let part = &view.parts[0];
        let mut regularisation = None;
        let mut scores = Vec::with_capacity(factors.len());
        for factors in factors {
            let decoded = decoder.forward(&input(part, pyramid, factors));
            if scores.is_empty() {
                let samples = self.samples(view).into_iter().zip(REGULARISED);
                let terms = samples.filter_map(|(pairs, scale)| {
                    let fused = decoded.fused.get(scale)?.clone();
                    Some(neighbour_divergence(fused, &pairs?))
                });
                regularisation = terms.reduce(|sum, term| sum + term);
            }
            scores.push(match self.plan.config.blend {
                // The last layer is linear: hidden features are blended, and it is applied to pixels.
                Blend::Logits if self.prior.is_none() => {
                    Scores::Pixels(decoder.classify(sample.pixels.blend(decoded.hidden)?))
                }
                blend => {
                    let scores = self.scores(decoder, decoded.hidden, &part.gaussians);
                    sample.blended(scores, blend)?
                }
            });
        }
        Ok(Prediction {
            scores: one_or_pair(scores),
            regularisation,
        })
    }

    /// Predicts part by part. The loss's graph ends at the scores; [`IdentityModel::step`] carries their gradient on.
    fn predict_in_parts(
        &self,
        decoder: &Decoder,
        view: usize,
        input: Arc<ViewInput>,
        sample: &ViewSample,
        factors: Vec<Vec<Vec<f32>>>,
    ) -> Result<(Prediction, PendingScores)> {
        let pyramid = &self.input.view(view).pyramid;
        let frozen = decoder.valid();
        let regularisation = in_parts::regularisation(
            decoder,
            pyramid,
            &factors[0],
            &input.clouds,
            self.samples(&input),
        );
        let mut leaves = Vec::with_capacity(factors.len());
        let mut scores = Vec::with_capacity(factors.len());
        for factors in factors {
            let parts = input.parts.iter().map(|part| {
                let decoded = frozen.forward(&self::input(part, pyramid, &factors));
                self.scores(&frozen, decoded.hidden, &part.gaussians)
            });
            let leaf = Tensor::from_inner(Tensor::cat(parts.collect(), 0)).require_grad();
            scores.push(sample.blended(leaf.clone(), self.plan.config.blend)?);
            leaves.push((leaf, factors));
        }
        let prediction = Prediction {
            scores: one_or_pair(scores),
            regularisation,
        };
        let pending = PendingScores {
            view,
            input,
            scores: leaves,
        };
        Ok((prediction, pending))
    }

    /// Scores of the finest points, in chunks so that memory beside them does not grow with the scene.
    fn decode(&self, decoder: &Decoder, encoded: &Encoded) -> Vec<f32> {
        let count = encoded.points.len();
        let mut scores = Vec::with_capacity(count * self.plan.size[1]);
        for first in (0..count).step_by(CHUNK) {
            let rows = first..(first + CHUNK).min(count);
            let points = &encoded.points[rows.clone()];
            let finest = rows.map(|row| row as u32).collect();
            let part = Dependencies::new(&encoded.pyramid, finest);
            let decoded = decoder.forward(&encoded.pyramid.part(&part));
            let part = self.scores(decoder, decoded.hidden, points);
            scores.extend(optimiser::values(stored(part, self.plan.config.blend)));
        }
        scores
    }

    /// s_i = sum_v w_iv s_iv / sum_v w_iv over the encodings of views, and the whole-scene encoding where no view sees i.
    fn mean_over_views(
        &self,
        decoder: &Decoder,
        views: &[Encoded],
        weights: &[Vec<f32>],
        scene: &Encoded,
    ) -> Vec<f32> {
        let [count, classes] = self.plan.size;
        let mut sums = vec![0.0_f32; count * classes];
        let mut totals = vec![0.0_f32; count];
        for (view, weights) in views.iter().zip(weights) {
            let decoded = self.decode(decoder, view);
            let rows = decoded.chunks_exact(classes.max(1)).zip(&view.points);
            for ((row, &i), &w) in rows.zip(weights) {
                totals[i as usize] += w;
                let sum = &mut sums[i as usize * classes..][..classes];
                sum.iter_mut().zip(row).for_each(|(s, v)| *s += w * v);
            }
        }
        let whole = self.decode(decoder, scene);
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
}

fn one_or_pair(mut scores: Vec<Scores>) -> Scores {
    let last = scores.pop().expect("at least one prediction");
    match scores.pop() {
        Some(first) => Scores::Pair(Box::new([first, last])),
        None => last,
    }
}

impl IdentityModel for DecoderModel<'_> {
    fn predict(&mut self, view: usize, sample: &ViewSample) -> Result<Prediction> {
        let input = self.view_input(view, &sample.visible)?;
        let decoder = self.decoder.as_ref().expect("present between steps");
        let pyramid = &self.input.view(view).pyramid;
        // Factors of the channels of each prediction.
        let factors = match self.plan.dropout {
            None => vec![Vec::new()],
            Some(rate) => [2 * self.iteration, 2 * self.iteration + 1]
                .map(|index| dropped_channels(pyramid, rate, self.plan.seed, index))
                .into(),
        };
        let prediction = if input.parts.len() == 1 {
            self.pending = None;
            self.predict_whole(decoder, pyramid, &input, sample, &factors)?
        } else {
            let (prediction, pending) =
                self.predict_in_parts(decoder, view, input, sample, factors)?;
            self.pending = Some(pending);
            prediction
        };
        self.iteration += 1;
        Ok(prediction)
    }

    fn step(&mut self, loss: Tensor<1>, gradients: &mut Gradients, factor: f64) -> Result<f32> {
        let decoder = self.decoder.as_ref().expect("present between steps");
        if let Some(pending) = self.pending.take() {
            let pyramid = &self.input.view(pending.view).pyramid;
            pending.add_gradients(decoder, pyramid, gradients);
        }
        let value = ModuleAdam::check(decoder, loss, gradients)?;
        // Taken, not cloned: buffers with one owner are updated in place.
        let decoder = self.decoder.take();
        self.decoder = decoder.map(|decoder| self.adam.step(decoder, gradients, factor));
        Ok(value)
    }

    fn identities(&mut self) -> Result<Identities> {
        let decoder = self.decoder.as_ref().expect("present between steps");
        let decoder = self.adam.averaged(decoder.valid());
        let scores = match self.input {
            DecoderInput::Scene(scene) => self.decode(&decoder, scene),
            DecoderInput::Views {
                views,
                scene,
                weights,
            } => self.mean_over_views(&decoder, views, weights, scene),
        };
        let classes = self.plan.size[1];
        Ok(Identities { scores, classes })
    }

    fn learnable_bytes(&self) -> usize {
        self.decoder.as_ref().map_or(0, Decoder::bytes)
    }

    fn state(&self) -> NamedValues {
        let mut state = self.adam.state();
        if let Some(decoder) = &self.decoder {
            state.extend(optimiser::parameters(decoder));
        }
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

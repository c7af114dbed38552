//! The decoder rows: multi-scale fusion (Eq. 7) trained by the label loss and the 3D regularisation (Eq. 10).
//!
//! Only what a view's visible Gaussians depend on is decoded in a step. Where logits are blended, the linear last layer is
//! applied per pixel, after blending the hidden features. Views that see more Gaussians than `segmentation.decoder_chunk` are
//! decoded in parts, see [`super::chunked`].

use super::chunked::{self, Waiting};
use super::consistency::dropped_channels;
use super::optimiser::{self, ModuleAdam, NamedValues};
use super::prepared::{Part, Prepared, REGULARISED, Sampled};
use super::views::Drawn;
use super::{Model, Prediction, Scores, stored};
use crate::backend::device::in_host_memory;
use crate::config::{Blend, SegmentationConfig};
use crate::error::Result;
use crate::objects::Identities;
use crate::ops::gather_rows;
use crate::segmentation::decoder::Decoder;
use crate::segmentation::loss::neighbour_divergence;
use crate::segmentation::pyramid::{Pyramid, Restriction, Rows};
use burn::module::Module;
use burn::tensor::{Device, Gradients, Tensor, TensorData};
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
    /// Added to the scores of each Gaussian, `[N, C]`, without autodiff.
    prior: Option<Tensor<2>>,
    adam: ModuleAdam,
    source: &'a Source,
    plan: FusedPlan<'a>,
    /// Centres of all Gaussians.
    means: &'a [[f32; 3]],
    /// Made at a view's first use and kept while `budget` bytes last.
    prepared: Vec<Option<Arc<Prepared>>>,
    budget: usize,
    /// What the next step carries on, after a view in parts.
    waiting: Option<Waiting>,
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
            prior: None,
            adam: match plan.average_from {
                Some(from) => ModuleAdam::new(plan.rate).averaging(from),
                None => ModuleAdam::new(plan.rate),
            },
            source,
            plan,
            means,
            prepared: vec![None; views],
            budget: plan.config.weight_cache_mb << 19,
            waiting: None,
            iteration: 0,
            device: device.clone(),
        }
    }

    /// Adds `prior` `[N, C]` to the scores of every Gaussian, and lets the decoder start from zero beside it.
    ///
    /// # Panics
    /// If `prior` does not hold one score for each Gaussian and class.
    #[must_use]
    pub fn with_prior(mut self, prior: Vec<f32>) -> Self {
        let [count, classes] = self.plan.size;
        assert_eq!(
            prior.len(),
            count * classes,
            "one prior score a Gaussian and class"
        );
        self.decoder = self.decoder.map(Decoder::with_silent_start);
        let device = self.device.clone().inner();
        self.prior = Some(Tensor::from_data(
            TensorData::new(prior, [count, classes]),
            &device,
        ));
        self
    }

    /// Scores `[rows, C]` of hidden features of the scene's Gaussians `points`.
    fn scores(&self, decoder: &Decoder, hidden: Tensor<2>, points: &Rows) -> Tensor<2> {
        let scores = decoder.classify(hidden);
        let Some(prior) = &self.prior else {
            return scores;
        };
        let prior = gather_rows(prior.clone(), points);
        scores.clone()
            + if scores.device().is_autodiff() {
                Tensor::from_inner(prior)
            } else {
                prior
            }
    }

    fn prepare(&mut self, view: usize, visible: &[u32]) -> Result<Arc<Prepared>> {
        if let Some(prepared) = &self.prepared[view] {
            return Ok(prepared.clone());
        }
        let prepared = Arc::new(Prepared::new(
            self.source.view(view),
            visible,
            self.means,
            &self.plan,
        )?);
        // A GPU holds the maps between levels twice, by rows and by columns.
        let copies = if in_host_memory(&self.device) { 1 } else { 3 };
        if let Some(left) = self.budget.checked_sub(copies * prepared.bytes()) {
            self.budget = left;
            self.prepared[view] = Some(prepared.clone());
        }
        Ok(prepared)
    }

    /// What this iteration samples of each regularised scale.
    fn sampled(&self, prepared: &Prepared) -> Sampled {
        let clouds = prepared.clouds.iter().zip(REGULARISED);
        clouds
            .map(|(cloud, scale)| cloud.sample(&self.plan, scale, self.iteration))
            .collect()
    }

    /// All visible Gaussians at once, a prediction for each of `factors`: the loss's graph reaches down to the parameters.
    fn predict_whole(
        &self,
        decoder: &Decoder,
        view: usize,
        part: &Part,
        drawn: &Drawn,
        factors: &[Vec<Vec<f32>>],
        sampled: Sampled,
    ) -> Result<Prediction> {
        let pyramid = &self.source.view(view).pyramid;
        let decoded: Vec<_> = factors
            .iter()
            .map(|f| decoder.forward_scaled(pyramid, &part.kept, f))
            .collect();
        let terms = REGULARISED
            .into_iter()
            .zip(sampled)
            .filter_map(|(scale, pairs)| {
                Some(neighbour_divergence(
                    decoded.first()?.fused.get(scale)?.clone(),
                    pairs?,
                ))
            });
        let regularisation = terms.reduce(|sum, term| sum + term);
        let scores = decoded
            .into_iter()
            .map(|decoded| match self.plan.config.blend {
                // The last layer is linear: hidden features are blended and it is applied per pixel.
                Blend::Logits if self.prior.is_none() => Ok(Scores::Pixels(
                    decoder.classify(drawn.pixels.blend(decoded.hidden)?),
                )),
                blend => Scores::blended(
                    self.scores(decoder, decoded.hidden, &part.gaussians),
                    &drawn.pixels,
                    blend,
                ),
            });
        let scores: Vec<Scores> = scores.collect::<Result<_>>()?;
        Ok(self.prediction(scores, regularisation))
    }

    /// One set of scores, or two.
    fn prediction(&self, scores: Vec<Scores>, regularisation: Option<Tensor<1>>) -> Prediction {
        match scores.into_iter().reduce(Scores::and) {
            Some(scores) => Prediction {
                scores,
                regularisation,
            },
            None => Prediction::empty(self.plan.size[1], &self.device),
        }
    }

    /// Part by part: the loss's graph ends at the scores, whose gradient [`Model::step`] carries on.
    fn predict_in_parts(
        &self,
        decoder: &Decoder,
        view: usize,
        prepared: Arc<Prepared>,
        drawn: &Drawn,
        factors: Vec<Vec<Vec<f32>>>,
    ) -> Result<(Prediction, Waiting)> {
        let pyramid = &self.source.view(view).pyramid;
        let frozen = decoder.valid();
        let sampled = self.sampled(&prepared);
        let first = factors.first().map_or(&[][..], |factors| factors);
        let regularisation =
            chunked::regularisation(decoder, pyramid, first, &prepared.clouds, sampled);
        let leaf = |factors: Vec<Vec<f32>>| {
            let parts = prepared.parts.iter().map(|part| {
                let hidden = frozen.forward_scaled(pyramid, &part.kept, &factors).hidden;
                self.scores(&frozen, hidden, &part.gaussians)
            });
            (
                Tensor::from_inner(Tensor::cat(parts.collect(), 0)).require_grad(),
                factors,
            )
        };
        let scores: Vec<_> = factors.into_iter().map(leaf).collect();
        let blended = scores.iter().map(|(scores, _)| {
            Scores::blended(scores.clone(), &drawn.pixels, self.plan.config.blend)
        });
        let blended: Vec<Scores> = blended.collect::<Result<_>>()?;
        Ok((
            self.prediction(blended, regularisation),
            Waiting {
                view,
                prepared,
                scores,
            },
        ))
    }

    /// Scores of the finest points, in chunks so that memory beside them does not grow with the scene.
    fn decode(&self, decoder: &Decoder, encoded: &Encoded) -> Vec<f32> {
        let count = encoded.points.len() as u32;
        let mut scores = Vec::with_capacity(count as usize * self.plan.size[1]);
        for first in (0..count).step_by(CHUNK) {
            let rows = (first..(first + CHUNK as u32).min(count)).collect::<Vec<_>>();
            let points = Arc::new(
                encoded.points[first as usize..][..rows.len()]
                    .to_vec()
                    .into(),
            );
            let kept = Restriction::new(&encoded.pyramid, Arc::new(rows.into()));
            let part = self.scores(
                decoder,
                decoder.forward(&encoded.pyramid, &kept).hidden,
                &points,
            );
            scores.extend(optimiser::values(stored(part, self.plan.config.blend)));
        }
        scores
    }
}

impl Model for Fused<'_> {
    fn predict(&mut self, view: usize, drawn: &Drawn) -> Result<Prediction> {
        let prepared = self.prepare(view, &drawn.visible)?;
        let Some(decoder) = &self.decoder else {
            return Ok(Prediction::empty(self.plan.size[1], &self.device));
        };
        // Factors of the channels of each prediction.
        let factors = match self.plan.dropout {
            None => vec![Vec::new()],
            Some(rate) => {
                let pyramid = &self.source.view(view).pyramid;
                let which = [2 * self.iteration, 2 * self.iteration + 1];
                which
                    .map(|index| dropped_channels(pyramid, rate, self.plan.seed, index))
                    .into()
            }
        };
        let (prediction, waiting) = match &prepared.parts[..] {
            [part] => (
                self.predict_whole(
                    decoder,
                    view,
                    part,
                    drawn,
                    &factors,
                    self.sampled(&prepared),
                )?,
                None,
            ),
            _ => {
                let (prediction, waiting) =
                    self.predict_in_parts(decoder, view, prepared, drawn, factors)?;
                (prediction, Some(waiting))
            }
        };
        self.waiting = waiting;
        self.iteration += 1;
        Ok(prediction)
    }

    fn step(&mut self, loss: Tensor<1>, gradients: &mut Gradients, factor: f64) -> Result<f32> {
        let mut value = f32::NAN;
        if let Some(decoder) = &self.decoder {
            if let Some(waiting) = self.waiting.take() {
                waiting.add_gradients(decoder, &self.source.view(waiting.view).pyramid, gradients);
            }
            value = ModuleAdam::check(decoder, loss, gradients)?;
        }
        // taken, not cloned: buffers that nobody else holds are updated in place
        self.decoder = self
            .decoder
            .take()
            .map(|decoder| self.adam.step(decoder, gradients, factor));
        Ok(value)
    }

    fn identities(&mut self) -> Result<Identities> {
        let Some(decoder) = self.decoder.as_ref().map(|d| self.adam.averaged(d.valid())) else {
            return Ok(Identities::default());
        };
        let [count, classes] = self.plan.size;
        let scores = match self.source {
            Source::Scene(scene) => self.decode(&decoder, scene),
            Source::Views {
                views,
                scene,
                weights,
            } => {
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
        state.extend(
            self.decoder
                .as_ref()
                .map(optimiser::parameters)
                .unwrap_or_default(),
        );
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

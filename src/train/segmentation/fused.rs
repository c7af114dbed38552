//! The decoder rows: multi-scale fusion (Eq. 7) trained by the label loss and the 3D regularisation (Eq. 10).
//!
//! The last layer is linear, so hidden features are blended and the layer is applied per pixel: exact, and cheaper by
//! the ratio of classes to hidden width. Only what a view's visible Gaussians depend on is decoded in a step.

use super::optimiser::{self, ModuleAdam, NamedValues};
use super::views::ViewWeights;
use crate::random::{Purpose, stream};
use super::{Model, Prediction};
use crate::config::SegmentationConfig;
use crate::error::Result;
use crate::objects::Identities;
use crate::ops::{SparseMatrix, sparse_apply};
use crate::segmentation::decoder::Decoder;
use crate::segmentation::loss::neighbour_divergence;
use crate::segmentation::neighbours;
use crate::segmentation::pyramid::{Pyramid, Restriction};
use burn::tensor::{Device, Gradients, Tensor};
use std::sync::Arc;

/// Scales of the 3D regularisation, zero-based (n = 3, 4).
const REGULARISED: [usize; 2] = [2, 3];
/// Gaussians decoded at once when the stored identities are made.
const CHUNK: usize = 16_384;

/// Where the decoder's input comes from.
pub enum Source {
    /// The whole scene, encoded once; views use the part they see.
    Scene(Pyramid),
    /// One pyramid per training view over the Gaussians visible there (the paper), and one of the whole scene for
    /// Gaussians that no view sees.
    Views {
        /// In the order of the training views.
        views: Vec<Pyramid>,
        /// The whole scene.
        scene: Pyramid,
        /// Summed alpha' T of each view's finest points, for the weighted mean of identities.
        weights: Vec<Vec<f32>>,
    },
}

/// What a step of one view needs besides its weights; made at the view's first use.
#[derive(Clone)]
struct Prepared {
    restriction: Arc<Restriction>,
    /// K neighbours within the restricted points of each regularised scale, `[N_n, K]`.
    neighbours: [Arc<Vec<u32>>; REGULARISED.len()],
}

/// A decoder in training.
pub struct Fused<'a> {
    decoder: Option<Decoder>,
    adam: ModuleAdam,
    source: &'a Source,
    positions: &'a [[f32; 3]],
    prepared: Vec<Option<Prepared>>,
    config: &'a SegmentationConfig,
    regularised: bool,
    seed: u64,
    iteration: usize,
    classes: usize,
    device: Device,
}

impl<'a> Fused<'a> {
    /// A model around a fresh `decoder` on an autodiff `device`; `regularised` switches Eq. 9 on.
    #[expect(clippy::too_many_arguments, reason = "built in one place")]
    pub fn new(
        decoder: Decoder,
        source: &'a Source,
        positions: &'a [[f32; 3]],
        views: usize,
        classes: usize,
        rate: f64,
        config: &'a SegmentationConfig,
        regularised: bool,
        seed: u64,
        device: &Device,
    ) -> Self {
        Self {
            decoder: Some(decoder),
            adam: ModuleAdam::new(rate),
            source,
            positions,
            prepared: vec![None; views],
            config,
            regularised,
            seed,
            iteration: 0,
            classes,
            device: device.clone(),
        }
    }

    fn pyramid(&self, view: usize) -> &Pyramid {
        match self.source {
            Source::Scene(pyramid) => pyramid,
            Source::Views { views, .. } => &views[view],
        }
    }

    fn prepare(&mut self, view: usize, visible: &[u32]) -> Result<Prepared> {
        if let Some(prepared) = &self.prepared[view] {
            return Ok(prepared.clone());
        }
        let pyramid = self.pyramid(view);
        let finest: Vec<u32> = match self.source {
            Source::Scene(_) => visible.to_vec(),
            Source::Views { .. } => {
                let points = &pyramid.levels[0].points;
                visible.iter().filter_map(|g| points.binary_search(g).ok().map(|row| row as u32)).collect()
            }
        };
        let restriction = Restriction::new(pyramid, Arc::new(finest));
        let mut tables = [Arc::new(Vec::new()), Arc::new(Vec::new())];
        if self.regularised {
            for (table, scale) in tables.iter_mut().zip(REGULARISED) {
                let points = &pyramid.levels[scale].points;
                let rows = restriction.rows(scale);
                let cloud: Vec<[f32; 3]> =
                    rows.iter().map(|&r| self.positions[points[r as usize] as usize]).collect();
                *table = Arc::new(neighbours::without_self(&cloud, self.config.reg_neighbours)?);
            }
        }
        let prepared = Prepared { restriction: Arc::new(restriction), neighbours: tables };
        self.prepared[view] = Some(prepared.clone());
        Ok(prepared)
    }

    fn regularisation(&self, fused: &[Tensor<2>], prepared: &Prepared) -> Option<Tensor<1>> {
        let mut sum: Option<Tensor<1>> = None;
        for (scale, table) in REGULARISED.into_iter().zip(&prepared.neighbours) {
            let Some(features) = fused.get(scale) else { continue };
            if table.is_empty() || features.dims()[0] < 2 {
                continue;
            }
            let mut rng = stream(self.seed, Purpose::Regularisation, (self.iteration * 8 + scale) as u64);
            let samples = self.config.reg_samples.min(features.dims()[0]);
            let chosen = rand::seq::index::sample(&mut rng, features.dims()[0], samples);
            let chosen: Vec<u32> = chosen.iter().map(|i| i as u32).collect();
            let term = neighbour_divergence(features.clone(), &chosen, table, self.config.reg_neighbours);
            sum = Some(match sum {
                Some(sum) => sum + term,
                None => term,
            });
        }
        sum
    }

    /// Scores of the finest points of `pyramid`, in chunks so that memory does not grow with the scene.
    fn decode(&self, decoder: &Decoder, pyramid: &Pyramid) -> Vec<f32> {
        let count = pyramid.levels[0].points.len() as u32;
        let mut scores = Vec::with_capacity(count as usize * self.classes);
        for first in (0..count).step_by(CHUNK) {
            let rows = Arc::new((first..(first + CHUNK as u32).min(count)).collect::<Vec<_>>());
            let part = pyramid.restrict(&Restriction::new(pyramid, rows));
            scores.extend(optimiser::values(decoder.classify(decoder.forward(&part).hidden)));
        }
        scores
    }
}

impl Model for Fused<'_> {
    fn predict(&mut self, view: usize, weights: &ViewWeights, sampled: SparseMatrix) -> Result<Prediction> {
        let prepared = self.prepare(view, &weights.visible)?;
        let pyramid = self.pyramid(view).restrict(&prepared.restriction);
        let Some(decoder) = &self.decoder else { return Ok(Prediction::empty(self.classes, &self.device)) };
        let decoded = decoder.forward(&pyramid);
        let logits = decoder.classify(sparse_apply(decoded.hidden, Arc::new(sampled)));
        let regularisation = if self.regularised { self.regularisation(&decoded.fused, &prepared) } else { None };
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
        use burn::module::AutodiffModule;
        let Some(decoder) = self.decoder.as_ref().map(|d| d.valid()) else { return Ok(Identities::default()) };
        let classes = self.classes;
        let scores = match self.source {
            Source::Scene(pyramid) => self.decode(&decoder, pyramid),
            Source::Views { views, scene, weights } => {
                // s_i = sum_v w_iv s_iv / sum_v w_iv; the whole-scene encoding where no view sees i.
                let mut sums = vec![0.0_f32; self.positions.len() * classes];
                let mut totals = vec![0.0_f32; self.positions.len()];
                for (pyramid, weights) in views.iter().zip(weights) {
                    let decoded = self.decode(&decoder, pyramid);
                    let rows = decoded.chunks_exact(classes.max(1)).zip(pyramid.levels[0].points.iter());
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

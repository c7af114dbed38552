//! The training views of stage two: their labelled pixels, with blending weights over the Gaussians that they show.

use super::sampling::stratified_sample;
use super::view_cache::ViewCache;
use crate::backend::device::read;
use crate::config::{Blend, SegmentationConfig};
use crate::data::{Classes, LabelRuns, View};
use crate::error::Result;
use crate::objects::Identities;
use crate::ops::select;
use crate::raster::Settings;
use crate::segmentation::loss::Scores;
use crate::segmentation::pixels::{FrozenGaussians, LabelledPixels};
use crate::splat::Gaussians;
use burn::tensor::{Device, Tensor, TensorData};
use rand::Rng;
use std::sync::Arc;

/// Labelled pixels of a view.
#[derive(Clone, Debug)]
pub struct ViewSample {
    /// Scene index of each Gaussian that the view's labelled pixels show, ascending.
    pub visible: Arc<Vec<u32>>,
    /// The pixels over `visible`.
    pub pixels: LabelledPixels,
}

impl ViewSample {
    /// Eq. 3: the scores `[V, C]` of the visible Gaussians in the pixels, blended before or after their softmax. Two predictions
    /// make a pair.
    ///
    /// # Errors
    /// Those of [`LabelledPixels::blend`].
    pub fn blended(&self, predictions: Vec<Tensor<2>>, blend: Blend) -> Result<Scores> {
        let blended = |scores| match blend {
            Blend::Logits => Ok(Scores::Pixels(self.pixels.blend(scores)?)),
            Blend::Probabilities => Ok(Scores::Gaussians(scores)),
        };
        let mut scores: Vec<Scores> = predictions
            .into_iter()
            .map(blended)
            .collect::<Result<_>>()?;
        let last = scores.pop().expect("at least one prediction");
        Ok(match scores.pop() {
            Some(first) => Scores::Pair(Box::new([first, last])),
            None => last,
        })
    }
}

/// All training views of a scene with raw labels.
pub struct TrainingViews<'a> {
    gaussians: FrozenGaussians,
    views: Vec<&'a View>,
    /// Class index of each label id, [`UNLABELLED`](crate::segmentation::pixels::UNLABELLED) for the others.
    lookup: Vec<u16>,
    min_coverage: f32,
    samples: ViewCache<ViewSample>,
    /// What replaces the raw labels.
    replaced: Option<ReplacedLabels>,
}

/// Labels of the pixels by what identities say.
struct ReplacedLabels {
    /// `[N, C]`, without autodiff.
    scores: Tensor<2>,
    labels: ViewCache<Vec<u16>>,
}

impl<'a> TrainingViews<'a> {
    /// Views without raw labels are left out. Where `device` is a GPU, blending runs on it.
    pub fn new(
        gaussians: &'a Gaussians,
        views: impl Iterator<Item = &'a View>,
        classes: &Classes,
        settings: Settings,
        config: &SegmentationConfig,
        device: &Device,
    ) -> Self {
        let views: Vec<_> = views.filter(|v| v.raw.is_some()).collect();
        Self {
            gaussians: FrozenGaussians::new(gaussians, settings, device),
            lookup: classes.lookup(),
            min_coverage: config.min_coverage as f32,
            samples: ViewCache::new(views.len(), config.weight_cache_mb << 20),
            views,
            replaced: None,
        }
    }

    /// Pixels keep their raw labels from now on.
    pub fn use_raw_labels(&mut self) {
        self.replaced = None;
    }

    /// From now on, labelled pixels take the class of the largest blended score of `identities`. They keep their raw label where
    /// the scores are all zero.
    pub fn use_labels_of(&mut self, identities: &Identities, device: &Device) {
        let classes = identities.classes;
        let size = [identities.scores.len() / classes.max(1), classes];
        let scores = TensorData::new(identities.scores.clone(), size);
        self.replaced = Some(ReplacedLabels {
            scores: Tensor::from_data(scores, device),
            // Two bytes a pixel: less than a hundredth of what the weights take.
            labels: ViewCache::new(self.views.len(), usize::MAX),
        });
    }

    /// Number of views, those left out included.
    pub fn len(&self) -> usize {
        self.views.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.views.is_empty()
    }

    /// Name of view `index`.
    pub fn name(&self, index: usize) -> &str {
        &self.views[index].name
    }

    /// A random share of the labelled, covered pixels of view `index`: one of each run of `1 / share` neighbours in row
    /// order.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] when a Gaussian's parameters are not finite; on a GPU those of
    /// [`crate::raster::SplatView::blend`].
    pub fn sample(&mut self, index: usize, share: f64, rng: &mut impl Rng) -> Result<ViewSample> {
        let mut all = self.all_pixels(index)?;
        if let Some(ReplacedLabels { scores, labels }) = &mut self.replaced {
            let labels = labels.get(index, || {
                let labels = largest_blended(scores, &all)?;
                let bytes = 2 * labels.len();
                Ok((labels, bytes))
            })?;
            all = Arc::new(ViewSample {
                visible: all.visible.clone(),
                pixels: LabelledPixels {
                    weights: all.pixels.weights.clone(),
                    labels,
                },
            });
        }
        if share >= 1.0 {
            return Ok(ViewSample::clone(&all));
        }
        let drawn = stratified_sample(all.pixels.len(), share, rng);
        Ok(ViewSample {
            visible: all.visible.clone(),
            pixels: all.pixels.at(&drawn),
        })
    }

    /// All labelled, covered pixels of view `index`.
    fn all_pixels(&mut self, index: usize) -> Result<Arc<ViewSample>> {
        let (gaussians, view) = (&self.gaussians, self.views[index]);
        let (lookup, min_coverage) = (&self.lookup, self.min_coverage);
        self.samples.get(index, || {
            let raw = view.raw.as_ref().map(LabelRuns::map);
            let ids = raw.map_or_else(Vec::new, |map| map.ids);
            let labels: Vec<u16> = ids.iter().map(|&id| lookup[usize::from(id)]).collect();
            let (visible, pixels) =
                gaussians.labelled_pixels(&view.camera, &labels, min_coverage)?;
            let bytes = pixels.bytes()? + 4 * visible.len();
            let sample = ViewSample {
                visible: Arc::new(visible),
                pixels,
            };
            Ok((sample, bytes))
        })
    }
}

/// The class of the largest blended score of each pixel of `view`, its own label where all are zero.
fn largest_blended(scores: &Tensor<2>, view: &ViewSample) -> Result<Vec<u16>> {
    let classes = scores.dims()[1];
    let blended = view.pixels.blend(select(scores, &view.visible))?;
    let blended = read("labels of pixels", blended)?;
    let rows = blended
        .chunks_exact(classes.max(1))
        .zip(view.pixels.labels.iter());
    let label = |(row, &own): (&[f32], &u16)| {
        let best = (0..classes).reduce(|a, b| if row[b] > row[a] { b } else { a });
        best.filter(|&c| row[c] > 0.0).map_or(own, |c| c as u16)
    };
    Ok(rows.map(label).collect())
}

//! The training views of stage two: their labelled pixels, with blending weights over the Gaussians that they show.

use super::sampling::stratified_sample;
use super::view_cache::ViewCache;
use crate::config::{Blend, SegmentationConfig};
use crate::data::{Classes, LabelRuns, View};
use crate::error::Result;
use crate::raster::Settings;
use crate::segmentation::loss::Scores;
use crate::segmentation::pixels::{FrozenGaussians, LabelledPixels};
use crate::splat::Gaussians;
use burn::tensor::{Device, Tensor};
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
        }
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
        let all = self.all_pixels(index)?;
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

//! The training views of stage two: their labelled pixels, with blending weights over the Gaussians that they show.

use super::sampling::stratified_sample;
use crate::backend::device::{read, upload};
use crate::config::{Blend, SegmentationConfig};
use crate::data::{Classes, LabelProbabilities, LabelRuns, View, ViewCache, winner};
use crate::error::Result;
use crate::objects::Identities;
use crate::ops::select;
use crate::raster::Settings;
use crate::segmentation::loss::Scores;
use crate::segmentation::pixels::{FrozenGaussians, LabelledPixels, LabelledView, NO_CLASS};
use crate::splat::Gaussians;
use burn::tensor::{Device, Tensor};
use rand::Rng;
use std::sync::Arc;

/// Share of a view's labelled pixels in a step, where the settings name none.
const PIXEL_SHARE: f64 = 1.0 / 16.0;
/// Such a step takes at least this many pixels, or all.
const MIN_PIXELS: f64 = 4_096.0;

/// Labelled pixels of a view.
#[derive(Clone, Debug)]
pub struct ViewSample {
    /// Scene index of each Gaussian that the view's labelled pixels show, ascending.
    pub visible: Arc<Vec<u32>>,
    /// The pixels over `visible`.
    pub pixels: LabelledPixels,
    /// Row-major number of each pixel in its view.
    pub numbers: Arc<Vec<u32>>,
}

impl ViewSample {
    /// Eq. 3: the scores `[V, C]` of the visible Gaussians in the pixels, blended before or after their softmax.
    ///
    /// # Errors
    /// Those of [`LabelledPixels::blend`].
    pub fn blended(&self, scores: Tensor<2>, blend: Blend) -> Result<Scores> {
        Ok(match blend {
            Blend::Logits => Scores::Pixels(self.pixels.blend(scores)?),
            Blend::Probabilities => Scores::Gaussians(scores),
        })
    }
}

/// All training views of a scene with raw labels.
pub struct TrainingViews<'a> {
    gaussians: FrozenGaussians,
    device: Device,
    views: Vec<&'a View>,
    /// Class index of each label id, [`NO_CLASS`] for the others. Absent where labels do
    /// not count.
    lookup: Option<Vec<u16>>,
    min_coverage: f32,
    /// The labelled pixels of the views that were used already.
    used: Vec<Option<LabelledView>>,
    /// What replaces the raw labels.
    replaced: Option<ReplacedLabels>,
    classes: Classes,
    /// Class probabilities of raw labels, of the views that were used already and have them.
    scores: ViewCache<LabelProbabilities>,
}

/// Labels of the pixels by what identities say.
struct ReplacedLabels {
    /// `[N, C]`, without autodiff.
    scores: Tensor<2>,
    /// The labels of views that were used already.
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
        let views = views.filter(|view| view.raw.is_some());
        Self {
            lookup: Some(classes.lookup()),
            classes: classes.clone(),
            ..Self::of_all_pixels(gaussians, views, settings, config, device)
        }
    }

    /// All views with all of their covered pixels, which have label 0.
    pub fn of_all_pixels(
        gaussians: &'a Gaussians,
        views: impl Iterator<Item = &'a View>,
        settings: Settings,
        config: &SegmentationConfig,
        device: &Device,
    ) -> Self {
        let views: Vec<_> = views.collect();
        // Eq. 3 does not divide logits by the coverage.
        let over_coverage = config.blend == Blend::Probabilities;
        Self {
            gaussians: FrozenGaussians::new(gaussians, settings, over_coverage, device),
            device: device.clone(),
            lookup: None,
            min_coverage: config.min_coverage as f32,
            classes: Classes::default(),
            scores: ViewCache::new(views.len(), usize::MAX),
            used: vec![None; views.len()],
            views,
            replaced: None,
        }
    }

    /// Pixels keep their raw labels from now on, or the class probabilities that came with them.
    pub fn use_raw_labels(&mut self) {
        self.replaced = None;
    }

    /// From now on, labelled pixels take the class of the largest blended score of `identities`. They keep their raw label where
    /// the scores are all zero.
    pub fn use_labels_of(&mut self, identities: &Identities, device: &Device) {
        let classes = identities.classes;
        let size = [identities.scores.len() / classes.max(1), classes];
        self.replaced = Some(ReplacedLabels {
            scores: upload(identities.scores.clone(), size, device),
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
    /// order. Without a `share` it is a sixteenth, but no fewer than 4,096 pixels.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] when a Gaussian's parameters are not finite; on a GPU those of
    /// [`crate::raster::SplatView::blend`].
    pub fn sample(
        &mut self,
        index: usize,
        share: Option<f64>,
        rng: &mut impl Rng,
    ) -> Result<ViewSample> {
        let view = self.labelled(index)?;
        let labels = self.labels(index, &view)?;
        let share = share.unwrap_or_else(|| default_share(labels.len()));
        let (labels, numbers) = if share < 1.0 {
            let drawn = stratified_sample(labels.len(), share, rng);
            let labels = drawn.iter().map(|&i| labels[i as usize]).collect();
            let numbers = drawn.iter().map(|&i| view.numbers[i as usize]).collect();
            (Arc::new(labels), Arc::new(numbers))
        } else {
            (labels, view.numbers)
        };
        let camera = &self.views[index].camera;
        let weights = (self.gaussians).weights(camera, &view.visible, numbers.clone())?;
        let pixels = LabelledPixels {
            weights,
            distributions: self.distributions(index, &labels, &numbers)?,
            labels,
        };
        Ok(ViewSample {
            visible: view.visible,
            pixels,
            numbers,
        })
    }

    /// The class probabilities that came with the raw labels of the pixels `numbers` of view `index`, where they are trained on and
    /// there are any.
    fn distributions(
        &mut self,
        index: usize,
        labels: &[u16],
        numbers: &[u32],
    ) -> Result<Option<Tensor<2>>> {
        let (None, Some(_), Some(file)) = (&self.replaced, &self.lookup, &self.views[index].scores)
        else {
            return Ok(None);
        };
        if numbers.is_empty() {
            return Ok(None);
        }
        let corrected = self.corrected(index);
        let read = || Ok((file.read(&self.classes)?, 0));
        let scores = self.scores.get(index, read)?;
        let size = [numbers.len(), self.classes.len()];
        let rows = probabilities(&scores, labels, numbers, size[1], &corrected);
        Ok(Some(upload(rows, size, &self.device)))
    }

    /// The labelled, covered pixels of view `index`.
    fn labelled(&mut self, index: usize) -> Result<LabelledView> {
        if let Some(used) = &self.used[index] {
            return Ok(used.clone());
        }
        let view = self.views[index];
        let labels = match &self.lookup {
            Some(lookup) => {
                let raw = view.raw.as_ref().map(LabelRuns::map);
                let ids = raw.map_or_else(Vec::new, |map| map.ids);
                let corrected = self.corrected(index);
                let label = |(number, &id): (u32, &u16)| {
                    let raw = lookup[usize::from(id)];
                    corrected.at(number).unwrap_or(raw)
                };
                (0..).zip(&ids).map(label).collect()
            }
            None => vec![0; view.camera.width * view.camera.height],
        };
        let view = (self.gaussians).labelled_pixels(&view.camera, &labels, self.min_coverage)?;
        self.used[index] = Some(view.clone());
        Ok(view)
    }

    /// The pixels of view `index` whose labels a person corrected.
    fn corrected(&self, index: usize) -> CorrectedPixels {
        let (Some(lookup), Some(corrected)) = (&self.lookup, &self.views[index].corrected) else {
            return CorrectedPixels(Vec::new());
        };
        let ids = corrected.map().ids.into_iter();
        CorrectedPixels(ids.map(|id| lookup[usize::from(id)]).collect())
    }

    /// The labels of the pixels of `view`, number `index`: its own or what replaces them.
    fn labels(&mut self, index: usize, view: &LabelledView) -> Result<Arc<Vec<u16>>> {
        let corrected = self.corrected(index);
        let replaced = self.replaced.as_mut();
        let replaced = replaced.filter(|_| !view.labels.is_empty());
        let Some(ReplacedLabels { scores, labels }) = replaced else {
            return Ok(view.labels.clone());
        };
        let camera = &self.views[index].camera;
        labels.get(index, || {
            let weights = (self.gaussians).rendered(camera, &view.visible, view.numbers.clone());
            let blended = weights.blend(select(scores, &view.visible))?;
            let mut labels = largest_scores(blended, &view.labels)?;
            for (label, &number) in labels.iter_mut().zip(view.numbers.iter()) {
                *label = corrected.at(number).unwrap_or(*label);
            }
            Ok((labels, 0))
        })
    }
}

/// The share of `pixels` labelled pixels that a step takes where the settings name none.
fn default_share(pixels: usize) -> f64 {
    PIXEL_SHARE.max(MIN_PIXELS / pixels.max(1) as f64).min(1.0)
}

/// The class of each pixel of a view whose label a person corrected, [`NO_CLASS`] for the others; empty if there are none.
struct CorrectedPixels(Vec<u16>);

impl CorrectedPixels {
    /// The class of the pixel `number`, where it was corrected.
    fn at(&self, number: u32) -> Option<u16> {
        let class = self.0.get(number as usize).copied();
        class.filter(|class| *class != NO_CLASS)
    }
}

/// `scores` of the pixels `numbers`, `[P, classes]`; 1 for their label where nothing is scored.
fn probabilities(
    scores: &LabelProbabilities,
    labels: &[u16],
    numbers: &[u32],
    classes: usize,
    corrected: &CorrectedPixels,
) -> Vec<f32> {
    let [width, _] = scores.size();
    let mut rows = vec![0.0; numbers.len() * classes];
    let mut found = Vec::new();
    let pixels = numbers.iter().zip(labels);
    for (row, (&number, &label)) in rows.chunks_exact_mut(classes).zip(pixels) {
        let pixel = number as usize;
        scores.at(pixel % width, pixel / width, &mut found);
        if let Some(class) = corrected.at(number) {
            found = vec![(class, 1.0)];
        } else if found.is_empty() {
            found.push((label, 1.0));
        }
        for &(class, p) in &found {
            row[usize::from(class)] = p;
        }
    }
    rows
}

/// The class of the largest score of each pixel, `[P, C]`; its own label where no score is above 0.
fn largest_scores(blended: Tensor<2>, own: &[u16]) -> Result<Vec<u16>> {
    let classes = blended.dims()[1];
    let blended = read("labels of pixels", blended)?;
    let rows = blended.chunks_exact(classes.max(1)).zip(own);
    let label = |(row, &own): (&[f32], &u16)| winner(row).map_or(own, |class| class as u16);
    Ok(rows.map(label).collect())
}

#[cfg(test)]
mod tests {
    use super::default_share;

    #[test]
    fn a_step_takes_a_sixteenth_of_the_pixels_but_not_too_few() {
        let taken = |pixels: usize| (default_share(pixels) * pixels as f64).round();
        let expected = [0.0, 900.0, 4_096.0, 4_096.0, 4_096.0, 10_000.0];
        assert_eq!(
            [0, 900, 4_096, 10_000, 65_536, 160_000].map(taken),
            expected
        );
    }
}

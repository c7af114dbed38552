//! What stage two needs of a training view: normalised blending weights of its labelled pixels, kept while memory allows.

use crate::data::{Classes, View};
use crate::error::Result;
use crate::gaussians::Gaussians;
use crate::objects::{Votes, vote};
use crate::ops::{LabelledPixels, SparseMatrix};
use crate::random::{Purpose, stream};
use crate::raster::{Projected, Settings};
use rand::{Rng, seq::SliceRandom};
use std::sync::Arc;

/// The labelled, covered pixels of one view over the Gaussians it sees.
#[derive(Clone, Debug)]
pub struct ViewWeights {
    /// Rows: pixels; columns: entries of [`ViewWeights::visible`]. Each row sums to 1 (weights over 1 - T).
    pub matrix: Arc<SparseMatrix>,
    /// Scene index of each column, ascending.
    pub visible: Arc<Vec<u32>>,
    /// Class index of each row's raw label.
    pub labels: Vec<u16>,
}

impl ViewWeights {
    /// Projects `view` and keeps the rows of pixels that carry a class and are covered by at least `min_coverage`.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] when a Gaussian's parameters are not finite.
    pub fn new(
        gaussians: &Gaussians,
        view: &View,
        classes: &Classes,
        settings: &Settings,
        min_coverage: f32,
    ) -> Result<Self> {
        let lookup = classes.lookup();
        let ids = view.raw.as_ref().map_or(&[][..], |raw| &raw.ids);
        let class = |pixel: u32| lookup[usize::from(ids[pixel as usize])];
        let labelled: Vec<u32> = (0..ids.len() as u32).filter(|&p| class(p) != u16::MAX).collect();
        let weights = Projected::new(&gaussians.splats(), &view.camera, settings)?.weights(Some(&labelled));
        let weights = weights.normalised(min_coverage);
        let kept: Vec<u32> = (0..weights.rows() as u32).filter(|&r| !weights.row(r as usize).0.is_empty()).collect();
        let labels = kept.iter().map(|&r| class(labelled[r as usize])).collect();
        let compact = weights.select_rows(&kept).compact();
        Ok(Self { matrix: Arc::new(compact.matrix), visible: Arc::new(compact.columns), labels })
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.matrix.bytes() + 4 * self.visible.len() + 2 * self.labels.len()
    }

    /// A random share of the pixels (one of each run of `1 / share` neighbours in row order), with their labels.
    pub fn sample(&self, share: f64, rng: &mut impl Rng) -> LabelledPixels {
        let stride = (1.0 / share.clamp(1e-6, 1.0)).round().max(1.0) as usize;
        let count = self.labels.len();
        let rows: Vec<u32> = match stride {
            1 => (0..count as u32).collect(),
            _ => (0..count)
                .step_by(stride)
                .map(|first| rng.random_range(first..(first + stride).min(count)) as u32)
                .collect(),
        };
        let labels = rows.iter().map(|&r| self.labels[r as usize]).collect();
        LabelledPixels { weights: self.matrix.clone(), rows, labels }
    }
}

/// All training views of a scene; weights are computed once and kept up to a byte budget, else again at each use.
pub struct TrainingViews<'a> {
    gaussians: &'a Gaussians,
    views: Vec<&'a View>,
    /// Views in use.
    used: Vec<usize>,
    classes: &'a Classes,
    settings: Settings,
    min_coverage: f32,
    kept: Vec<Option<Arc<ViewWeights>>>,
    budget: usize,
}

impl<'a> TrainingViews<'a> {
    /// Views without raw labels are left out. `budget` is in bytes.
    pub fn new(
        gaussians: &'a Gaussians,
        views: impl Iterator<Item = &'a View>,
        classes: &'a Classes,
        settings: Settings,
        min_coverage: f32,
        budget: usize,
    ) -> Self {
        let views: Vec<_> = views.filter(|v| v.raw.is_some()).collect();
        let (kept, used) = (vec![None; views.len()], (0..views.len()).collect());
        Self { gaussians, kept, views, used, classes, settings, min_coverage, budget }
    }

    /// Number of views, those left out included.
    pub fn len(&self) -> usize {
        self.views.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.views.is_empty()
    }

    /// Leaves out every `every`-th view, or none.
    pub fn hold_back(&mut self, every: Option<usize>) {
        let out = |i: &usize| every.is_some_and(|every| i % every.max(1) == every / 2);
        self.used = (0..self.views.len()).filter(|i| !out(i)).collect();
    }

    /// The views left out.
    pub fn held_back(&self) -> impl Iterator<Item = &'a View> {
        self.views.iter().enumerate().filter(|(i, _)| self.used.binary_search(i).is_err()).map(|(_, view)| *view)
    }

    /// The view of `iteration`: those in use in a fresh shuffle every epoch, a function of (seed, iteration) alone.
    ///
    /// # Panics
    /// If no view is in use.
    pub fn at(&self, seed: u64, iteration: usize) -> usize {
        self.used[view_at(seed, iteration, self.used.len())]
    }

    /// The votes of the views in use.
    ///
    /// # Errors
    /// As [`ViewWeights::new`].
    pub fn votes(&self) -> Result<Votes> {
        vote(self.gaussians, self.used.iter().map(|&i| self.views[i]), self.classes, &self.settings)
    }

    /// Number of Gaussians in the scene.
    pub fn gaussians(&self) -> usize {
        self.gaussians.len()
    }

    /// Name of view `index`.
    pub fn name(&self, index: usize) -> &str {
        &self.views[index].name
    }

    /// Weights of view `index`.
    ///
    /// # Errors
    /// As [`ViewWeights::new`].
    pub fn weights(&mut self, index: usize) -> Result<Arc<ViewWeights>> {
        if let Some(kept) = &self.kept[index] {
            return Ok(kept.clone());
        }
        let weights =
            ViewWeights::new(self.gaussians, self.views[index], self.classes, &self.settings, self.min_coverage)?;
        let weights = Arc::new(weights);
        if let Some(left) = self.budget.checked_sub(weights.bytes()) {
            self.budget = left;
            self.kept[index] = Some(weights.clone());
        }
        Ok(weights)
    }
}

/// The view of each iteration: a fresh shuffle every epoch, a function of (seed, iteration) alone.
pub fn view_at(seed: u64, iteration: usize, views: usize) -> usize {
    let (epoch, place) = (iteration / views.max(1), iteration % views.max(1));
    let mut order: Vec<usize> = (0..views).collect();
    order.shuffle(&mut stream(seed, Purpose::SegmentationViews, epoch as u64));
    order[place]
}

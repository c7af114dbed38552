//! The training views of stage two: labelled pixels, and their normalised blending weights.

use super::pixel_sample::stratified_sample;
use super::rendered::{RenderedView, visible};
use crate::config::Blend;
use crate::data::{Classes, LabelMap, LabelRuns, View};
use crate::error::Result;
use crate::objects::{Votes, vote};
use crate::ops::SparseMatrix;
use crate::raster::{Settings, SplatTensors, SplatView};
use crate::segmentation::loss::Scores;
use crate::segmentation::pixels::{LabelledPixels, PixelWeights, UNLABELLED};
use crate::splat::Gaussians;
use burn::tensor::{Device, Tensor};
use rand::Rng;
use std::sync::{Arc, OnceLock};

/// Bytes of a listed pixel and its label, and what they are where a device has them too.
const PIXEL: usize = size_of::<u32>() + size_of::<u16>();
const DEVICE_PIXEL: usize = PIXEL + 2 * size_of::<u32>();
/// Pixels whose weights are made together at a view's first use.
const BAND: usize = 1 << 17;

/// Rows of the weights, and class indices.
type PixelList = (Arc<Vec<u32>>, Arc<Vec<u16>>);

/// The labelled, covered pixels of one view, and the Gaussians that they show.
#[derive(Clone, Debug)]
struct LabelledView {
    /// Scene index of each Gaussian that some of the pixels show, ascending.
    visible: Arc<Vec<u32>>,
    /// Class index of each pixel's raw label, [`UNLABELLED`] where it has none or is not covered.
    labels: LabelRuns,
    /// Number of labelled, covered pixels.
    count: usize,
    kept: Kept,
    /// Entries of the tile lists of the visible Gaussians, once a GPU has made them.
    entries: Arc<OnceLock<usize>>,
    /// Rows of the weights and labels of all pixels, once a step has asked for them: 6 bytes a pixel.
    all: OnceLock<PixelList>,
}

/// What is kept of a view beside which pixels and Gaussians take part.
#[derive(Clone, Debug)]
enum Kept {
    Nothing,
    /// Weights of the labelled, covered pixels over the visible Gaussians. Each row sums to 1 (weights over 1 - T).
    Weights(Arc<SparseMatrix>),
    /// The visible Gaussians on a GPU.
    OnDevice(Arc<RenderedView>),
}

impl LabelledView {
    /// Rows of a random share of the pixels: one of each run of `1 / share` neighbours.
    fn sample(&self, share: f64, rng: &mut impl Rng) -> Vec<u32> {
        stratified_sample(self.count, share, rng)
    }

    /// [`LabelledView::sample`] with `weights`, of which `rows` says from the drawn rows and their pixels which are drawn. Those that
    /// `keep` says to be all of them are listed once.
    fn labelled(
        &self,
        weights: PixelWeights,
        keep: bool,
        sample: impl FnOnce() -> Vec<u32>,
        rows: impl FnOnce(Vec<u32>, Vec<u32>) -> Vec<u32>,
    ) -> LabelledPixels {
        let draw = || {
            let drawn = sample();
            let (pixels, labels) = self.pixels(&drawn);
            (Arc::new(rows(drawn, pixels)), Arc::new(labels))
        };
        let (rows, labels) = if keep {
            self.all.get_or_init(draw).clone()
        } else {
            draw()
        };
        LabelledPixels {
            weights,
            rows,
            labels,
        }
    }

    /// Pixel and class index of the labelled, covered pixels `rows`, which ascend.
    fn pixels(&self, rows: &[u32]) -> (Vec<u32>, Vec<u16>) {
        let (mut pixels, mut labels) = (
            Vec::with_capacity(rows.len()),
            Vec::with_capacity(rows.len()),
        );
        let mut rows = rows.iter().map(|&row| row as usize).peekable();
        let (mut pixel, mut row) = (0, 0);
        for (label, length) in self.labels.runs() {
            if label != UNLABELLED {
                while let Some(drawn) = rows.next_if(|drawn| *drawn < row + length) {
                    pixels.push((pixel + drawn - row) as u32);
                    labels.push(label);
                }
                row += length;
            }
            pixel += length;
        }
        (pixels, labels)
    }
}

/// The sampled pixels of a step.
#[derive(Clone, Debug)]
pub struct ViewSample {
    /// Scene index of each Gaussian that the view's labelled pixels show, ascending.
    pub visible: Arc<Vec<u32>>,
    /// The sampled pixels over `visible`.
    pub pixels: LabelledPixels,
}

impl ViewSample {
    /// The scores `[V, C]` of the visible Gaussians, blended before or after their softmax.
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

/// All training views of a scene. Which pixels and Gaussians take part is found at a view's first use; weights are kept up
/// to a byte budget, else computed again for the pixels of each step, to the same bits. On a GPU no weights are kept, but the
/// Gaussians that a view shows.
pub struct TrainingViews<'a> {
    gaussians: &'a Gaussians,
    views: Vec<&'a View>,
    classes: &'a Classes,
    settings: Settings,
    min_coverage: f32,
    seen: Vec<Option<Arc<LabelledView>>>,
    budget: usize,
    splats: SplatTensors,
    votes: Option<Arc<Votes>>,
    keep_votes: bool,
    device: Device,
}

impl<'a> TrainingViews<'a> {
    /// Views without raw labels are left out. `budget` is in bytes. Where `device` is a GPU, blending runs on it.
    pub fn new(
        gaussians: &'a Gaussians,
        views: impl Iterator<Item = &'a View>,
        classes: &'a Classes,
        settings: Settings,
        min_coverage: f32,
        budget: usize,
        device: &Device,
    ) -> Self {
        let views: Vec<_> = views.filter(|v| v.raw.is_some()).collect();
        let seen = vec![None; views.len()];
        let splats = SplatTensors::new(gaussians, device);
        let device = device.clone();
        Self {
            gaussians,
            seen,
            views,
            classes,
            settings,
            min_coverage,
            budget,
            splats,
            votes: None,
            keep_votes: false,
            device,
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

    /// How many classes labels may say.
    pub fn classes(&self) -> usize {
        self.classes.len()
    }

    /// Whether votes are kept for as long as the same views are in use, because they will be asked for again.
    pub fn keep_votes(&mut self, keep: bool) {
        self.keep_votes = keep;
    }

    /// The votes of the views in use.
    ///
    /// # Errors
    /// As [`vote`].
    pub fn votes(&mut self) -> Result<Arc<Votes>> {
        let views = self.views.iter().copied();
        let votes = match self.votes.take() {
            Some(votes) => votes,
            None => Arc::new(vote(
                self.gaussians,
                views,
                self.classes,
                &self.settings,
                &self.device,
            )?),
        };
        self.votes = self.keep_votes.then(|| votes.clone());
        Ok(votes)
    }

    /// Number of Gaussians in the scene.
    pub fn gaussians(&self) -> usize {
        self.gaussians.len()
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
        let stored = self.splats.have_stored_weights();
        let view = match &self.seen[index] {
            Some(view) => view.clone(),
            None if stored => self.look(index)?,
            None => self.look_on_device(index)?,
        };
        let kept = match &view.kept {
            Kept::Nothing if !stored => {
                let rendered = self.rendered(index, &view.visible, &view.entries);
                Kept::OnDevice(Arc::new(rendered))
            }
            kept => kept.clone(),
        };
        let visible = view.visible.clone();
        let keep = share >= 1.0 && self.keeps_pixels(&view);
        let mut sample = || view.sample(share, rng);
        let pixels = match kept {
            Kept::Weights(weights) => {
                view.labelled(PixelWeights::Stored(weights), keep, sample, |rows, _| rows)
            }
            Kept::OnDevice(kept) => {
                view.labelled(PixelWeights::Rendered(kept), keep, sample, |_, pixels| {
                    pixels
                })
            }
            Kept::Nothing => {
                let (pixels, labels) = view.pixels(&sample());
                let weights = self.view(index).weights(&pixels)?;
                let weights = weights.normalised(self.min_coverage);
                let weights = Arc::new(weights.over_columns(&visible));
                LabelledPixels::new(
                    PixelWeights::Stored(weights),
                    (0..pixels.len() as u32).collect(),
                    labels,
                )
            }
        };
        Ok(ViewSample { visible, pixels })
    }

    /// Whether the list of all pixels of `view` is kept: as long as the budget lasts, of views of which more is.
    fn keeps_pixels(&mut self, view: &LabelledView) -> bool {
        let bytes = match view.kept {
            Kept::Nothing => return false,
            Kept::Weights(_) => PIXEL * view.count,
            Kept::OnDevice(_) => DEVICE_PIXEL * view.count,
        };
        let left = if view.all.get().is_some() {
            Some(self.budget)
        } else {
            self.budget.checked_sub(bytes)
        };
        self.budget = left.unwrap_or(self.budget);
        left.is_some()
    }

    /// View `index` of all Gaussians.
    fn view(&self, index: usize) -> SplatView {
        self.splats
            .seen_by(&self.views[index].camera, &self.settings)
    }

    /// Class index of the raw label of each pixel of view `index`, [`UNLABELLED`] where it has none.
    fn raw_classes(&self, index: usize) -> LabelMap {
        let lookup = self.classes.lookup();
        let camera = &self.views[index].camera;
        let none = || LabelMap {
            width: camera.width,
            height: camera.height,
            ids: Vec::new(),
        };
        let mut map = self.views[index]
            .raw
            .as_ref()
            .map_or_else(none, LabelRuns::map);
        map.ids
            .iter_mut()
            .for_each(|id| *id = lookup[usize::from(*id)]);
        map
    }

    /// [`TrainingViews::look`] on a GPU.
    fn look_on_device(&mut self, index: usize) -> Result<Arc<LabelledView>> {
        let mut map = self.raw_classes(index);
        let covered = |pixel: usize, t: f32| {
            let coverage = 1.0 - t;
            map.ids.get(pixel).is_some_and(|&c| c != UNLABELLED)
                && coverage >= self.min_coverage
                && coverage > 0.0
        };
        let (transmittance, visible) = visible(&self.view(index), covered)?;
        let kept: Vec<bool> = transmittance
            .iter()
            .enumerate()
            .map(|(pixel, &t)| covered(pixel, t))
            .collect();
        map.ids
            .iter_mut()
            .zip(&kept)
            .for_each(|(class, kept)| *class = if *kept { *class } else { UNLABELLED });
        let count = kept.iter().filter(|kept| **kept).count();
        let entries = Arc::default();
        let kept = match self.budget.checked_sub(RenderedView::bytes(visible.len())) {
            Some(left) => {
                self.budget = left;
                Kept::OnDevice(Arc::new(self.rendered(index, &visible, &entries)))
            }
            None => Kept::Nothing,
        };
        let (visible, labels) = (Arc::new(visible), LabelRuns::from(map));
        let view = LabelledView {
            visible,
            labels,
            count,
            kept,
            entries,
            all: OnceLock::new(),
        };
        Ok(self.seen[index].insert(Arc::new(view)).clone())
    }

    /// View `index` of the Gaussians `visible`.
    fn rendered(
        &self,
        index: usize,
        visible: &[u32],
        entries: &Arc<OnceLock<usize>>,
    ) -> RenderedView {
        RenderedView(self.splats.select(visible).seen_again_by(
            &self.views[index].camera,
            &self.settings,
            entries,
        ))
    }

    /// Finds the labelled, covered pixels of view `index`; their weights are kept where the budget allows it. Weights of a band
    /// of pixels are made at a time, so that a large photo takes no more memory than what is kept of it.
    fn look(&mut self, index: usize) -> Result<Arc<LabelledView>> {
        let map = self.raw_classes(index);
        let labelled: Vec<u32> = (0..map.ids.len() as u32)
            .filter(|&p| map.ids[p as usize] != UNLABELLED)
            .collect();
        let view = self.view(index);
        let mut covered = vec![UNLABELLED; map.ids.len()];
        let (mut shown, mut count) = (vec![false; self.gaussians.len()], 0);
        let mut keep = Some(SparseMatrix::new(
            self.gaussians.len(),
            vec![0],
            Vec::new(),
            Vec::new(),
        ));
        for band in labelled.chunks(BAND) {
            let weights = view.weights(band)?.normalised(self.min_coverage);
            let rows: Vec<u32> = (0..band.len() as u32)
                .filter(|&r| !weights.row(r as usize).0.is_empty())
                .collect();
            rows.iter()
                .map(|&r| band[r as usize] as usize)
                .for_each(|pixel| covered[pixel] = map.ids[pixel]);
            weights
                .entries()
                .0
                .iter()
                .for_each(|&column| shown[column as usize] = true);
            count += rows.len();
            keep = keep.and_then(|mut kept| {
                kept.append_rows(&weights, &rows);
                (kept.bytes() <= self.budget).then_some(kept)
            });
        }
        let visible: Vec<u32> = (0..shown.len() as u32)
            .filter(|&i| shown[i as usize])
            .collect();
        let kept = keep.map_or(Kept::Nothing, |weights| {
            self.budget -= weights.bytes();
            Kept::Weights(Arc::new(weights.over_columns(&visible)))
        });
        let labels = LabelRuns::from(LabelMap {
            ids: covered,
            ..map
        });
        let (visible, entries) = (Arc::new(visible), Arc::default());
        let view = LabelledView {
            visible,
            labels,
            count,
            kept,
            entries,
            all: OnceLock::new(),
        };
        Ok(self.seen[index].insert(Arc::new(view)).clone())
    }
}

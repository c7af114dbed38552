//! mIoU and accuracy of label maps.

use super::{ClassIou, mean};
use crate::data::Classes;
use serde::{Deserialize, Serialize};

/// How a labelled pixel counts whose prediction is void: the ignored id, or an id that is not a class.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Void {
    /// A wrong prediction of no class.
    Wrong,
    /// Nothing: the pixel is left out, as if it had no truth.
    LeftOut,
}

/// Pixel counts by true class and predicted class; the last column counts void predictions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Confusion {
    classes: usize,
    /// `[classes, classes + 1]`.
    counts: Vec<u64>,
}

impl Confusion {
    /// No pixels yet, for class indices `0..classes`.
    pub fn new(classes: usize) -> Self {
        Self {
            classes,
            counts: vec![0; classes * (classes + 1)],
        }
    }

    /// Counts one view, given as class indices. A true index of `classes` or more means 'not labelled': the pixel is left out. A
    /// predicted index of `classes` or more is void. Pixels past the shorter slice are not counted.
    pub fn add(
        &mut self,
        truth: impl IntoIterator<Item = usize>,
        prediction: impl IntoIterator<Item = usize>,
    ) {
        for (t, p) in truth.into_iter().zip(prediction) {
            if t < self.classes {
                self.counts[t * (self.classes + 1) + p.min(self.classes)] += 1;
            }
        }
    }

    /// Counts one view, given as label ids of `classes`; the truth's ignored id leaves a pixel out.
    pub fn add_ids(&mut self, classes: &Classes, truth: &[u16], prediction: &[u16]) {
        let lookup = classes.lookup();
        let index = |&id: &u16| usize::from(lookup[usize::from(id)]);
        self.add(truth.iter().map(index), prediction.iter().map(index));
    }

    /// Adds the counts of another confusion of as many classes; returns `false` for others.
    pub fn merge(&mut self, other: &Self) -> bool {
        let same = self.classes == other.classes;
        if same {
            self.counts
                .iter_mut()
                .zip(&other.counts)
                .for_each(|(a, b)| *a += b);
        }
        same
    }

    /// Pixels of true class `truth` predicted as `prediction`; `prediction = classes` counts void ones.
    pub fn count(&self, truth: usize, prediction: usize) -> u64 {
        if truth < self.classes && prediction <= self.classes {
            self.counts[truth * (self.classes + 1) + prediction]
        } else {
            0
        }
    }

    /// Pixels of the true class that count under `void`.
    fn truth_pixels(&self, class: usize, void: Void) -> u64 {
        let predicted = self.classes + usize::from(void == Void::Wrong);
        (0..predicted).map(|p| self.count(class, p)).sum()
    }

    /// IoU = TP / (TP + FP + FN) of a class; `None` when no counted pixel has it as its truth.
    pub fn iou(&self, class: usize, void: Void) -> Option<f64> {
        let truth = self.truth_pixels(class, void);
        let both = self.count(class, class);
        let predicted: u64 = (0..self.classes).map(|t| self.count(t, class)).sum();
        (truth > 0).then(|| both as f64 / (truth + predicted - both) as f64)
    }

    /// Mean IoU over the classes present in the truth; `None` when there are none.
    pub fn miou(&self, void: Void) -> Option<f64> {
        mean((0..self.classes).map(|c| self.iou(c, void)))
    }

    /// Share of counted pixels predicted right; `None` when there are none.
    pub fn accuracy(&self, void: Void) -> Option<f64> {
        let right: u64 = (0..self.classes).map(|c| self.count(c, c)).sum();
        let all: u64 = (0..self.classes).map(|c| self.truth_pixels(c, void)).sum();
        (all > 0).then(|| right as f64 / all as f64)
    }
}

/// Scores that count the pixels of a set of views, each in 0..1; `None` if there is nothing to score.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PixelScores {
    /// Mean IoU of all views counted together, over the classes present in their truth.
    pub miou: Option<f64>,
    /// Mean over views of each view's mean IoU over the classes present in its own truth.
    pub miou_per_view: Option<f64>,
    /// Share of labelled pixels predicted right, all views together.
    pub accuracy: Option<f64>,
}

/// Label scores of a set of views, each in 0..1.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LabelScores {
    /// Scores that count pixels.
    #[serde(flatten)]
    pub pixels: PixelScores,
    /// Mean boundary IoU, see [`boundary_iou`](super::boundary_iou); [`label_scores`] leaves it out, as it needs maps.
    pub boundary_iou: Option<f64>,
    /// IoU of each class present in the truth, all views together: (id, IoU).
    pub per_class: Vec<(u16, f64)>,
}

impl LabelScores {
    /// IoU of each class present in the truth, with its name in `classes`.
    pub fn named(&self, classes: &Classes) -> Vec<ClassIou> {
        let named = |&(id, iou): &(u16, f64)| ClassIou {
            id,
            name: classes.name(id).to_owned(),
            iou,
        };
        self.per_class.iter().map(named).collect()
    }
}

/// Scores `views` of (true ids, predicted ids), each `[H, W]`, one after the other. Pixels whose truth is the ignored id are left
/// out.
///
/// A view without any counted pixel adds nothing to the mean over views.
pub fn label_scores(
    classes: &Classes,
    views: impl IntoIterator<Item = (impl AsRef<[u16]>, impl AsRef<[u16]>)>,
    void: Void,
) -> LabelScores {
    let mut pooled = Confusion::new(classes.len());
    let per_view: Vec<Option<f64>> = views
        .into_iter()
        .map(|(truth, prediction)| {
            let mut view = Confusion::new(classes.len());
            view.add_ids(classes, truth.as_ref(), prediction.as_ref());
            pooled.merge(&view);
            view.miou(void)
        })
        .collect();
    let ids = classes.entries.iter().map(|c| c.id);
    LabelScores {
        pixels: PixelScores {
            miou: pooled.miou(void),
            miou_per_view: mean(per_view),
            accuracy: pooled.accuracy(void),
        },
        boundary_iou: None,
        per_class: ids
            .enumerate()
            .filter_map(|(c, id)| Some((id, pooled.iou(c, void)?)))
            .collect(),
    }
}

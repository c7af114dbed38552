//! Boundary IoU of label maps.

use super::labels::Void;
use super::mean;
use crate::data::{Classes, LabelMap};

/// Distance from a mask's outline up to which pixels count, as a share of the image's diagonal: that of the authors.
const DISTANCE: f64 = 0.02;

/// Mean boundary IoU (Cheng et al. 2021) over the classes present in the truth, all views counted together. The boundary IoU of a
/// class is the IoU of the pixels near the outlines of its true and its predicted mask. `views` are pairs of true and predicted
/// maps of ids; pairs of different sizes add nothing. `None` where no pixel counts.
///
/// A pixel is near the outline where the square of pixels at most d away from it leaves the mask or the image. d is 2 % of the
/// image's diagonal, rounded, and at least 1. Pixels whose truth is the ignored id belong to no mask, true or predicted. With
/// [`Void::LeftOut`], pixels whose prediction is void do not either.
pub fn boundary_iou(
    classes: &Classes,
    views: impl IntoIterator<Item = (LabelMap, LabelMap)>,
    void: Void,
) -> Option<f64> {
    let lookup = classes.lookup();
    let none = classes.len();
    let indices = |map: &LabelMap| -> Vec<usize> {
        let index = |&id: &u16| usize::from(lookup[usize::from(id)]).min(none);
        map.ids.iter().map(index).collect()
    };
    let mut counts = vec![Overlap::default(); none];
    for (truth, prediction) in views {
        let size = [truth.width, truth.height];
        if size != [prediction.width, prediction.height] || size.contains(&0) {
            continue;
        }
        let mut truth = indices(&truth);
        let mut prediction = indices(&prediction);
        for (t, p) in truth.iter_mut().zip(&mut prediction) {
            if *t == none || (void == Void::LeftOut && *p == none) {
                (*t, *p) = (none, none);
            }
        }
        let truth = near_outlines(&truth, size, none);
        let prediction = near_outlines(&prediction, size, none);
        for (&t, &p) in truth.iter().zip(&prediction) {
            if t < none {
                counts[t].truth += 1;
                counts[t].both += u64::from(t == p);
            }
            if p < none {
                counts[p].prediction += 1;
            }
        }
    }
    mean(counts.iter().map(Overlap::iou))
}

/// Pixels of a class near its outlines.
#[derive(Clone, Copy, Default)]
struct Overlap {
    truth: u64,
    prediction: u64,
    both: u64,
}

impl Overlap {
    /// `None` for a class that is not in the truth. Each mask has pixels near its outline.
    fn iou(&self) -> Option<f64> {
        let union = self.truth + self.prediction - self.both;
        (self.truth > 0).then(|| self.both as f64 / union as f64)
    }
}

/// `labels` near the outlines of their masks, `none` elsewhere.
fn near_outlines(labels: &[usize], [width, height]: [usize; 2], none: usize) -> Vec<usize> {
    let diagonal = (width as f64).hypot(height as f64);
    let distance = ((DISTANCE * diagonal).round_ties_even() as usize).max(1);
    let rows = eroded(labels, width, distance, none);
    let columns = eroded(&transposed(&rows, width), height, distance, none);
    let interior = transposed(&columns, height);
    let outline = |(&label, &inside): (&usize, &usize)| if inside == none { label } else { none };
    labels.iter().zip(&interior).map(outline).collect()
}

/// `labels` in rows of `width`, with `none` where not all pixels of the row up to `distance` away are there and of one label.
fn eroded(labels: &[usize], width: usize, distance: usize, none: usize) -> Vec<usize> {
    let mut out = vec![none; labels.len()];
    for (row, out) in labels.chunks_exact(width).zip(out.chunks_exact_mut(width)) {
        let mut start = 0;
        for run in row.chunk_by(|a, b| a == b) {
            let end = start + run.len();
            if run.len() > 2 * distance {
                out[start + distance..end - distance].fill(run[0]);
            }
            start = end;
        }
    }
    out
}

/// Rows of `width` as columns.
fn transposed(labels: &[usize], width: usize) -> Vec<usize> {
    let columns = 0..width;
    columns
        .flat_map(|x| labels.iter().skip(x).step_by(width).copied())
        .collect()
}

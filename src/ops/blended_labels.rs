//! Label losses of blended class probabilities, from the scores of the Gaussians to the loss in one pass.
//!
//! A pixel's probability of its label y is `q = sum_j w_j p_j(y)`: only the labelled class of each Gaussian is read. Its
//! gradient goes to those `p_j(y)` alone, for the sum of a Gaussian's probabilities does not change. A pixel therefore
//! costs one multiplication a contribution each way, however many classes there are.

use super::gather::RowList;
use super::gradient_in_hand::with_gradient_in_hand;
use super::label_loss::{ClassLosses, Kind, UNLABELLED, label_losses};
use super::pixel_labels::PixelLabels;
use super::sparse::{SparseMatrix, sparse_apply};
use crate::backend::device::in_host_memory;
use crate::backend::{HostBackend, Real, device_of, real_kernel};
use crate::error::Result;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::{
    Autodiff, Backend, Dispatch, TensorMetadata, backend_extension, tensor::FloatTensor,
};
use burn::tensor::Tensor;
use burn::tensor::activation::softmax;
use rayon::prelude::*;
use std::sync::Arc;

/// Keeps the logarithm of a blended probability finite.
const LEAST_PROBABILITY: f64 = 1e-8;
/// Pixels of one class in a task; also the unit of the fixed summation order.
const TASK: usize = 8192;
/// Gaussians in a task.
const BLOCK: usize = 1024;

/// Frozen blending of the V Gaussians that a view sees onto its pixels; the weights of a pixel sum to 1.
pub trait Blending: std::fmt::Debug + Send + Sync {
    /// The pixels `pixels` (row-major), `[P, C]`, of `values` `[V, C]`, with gradient to these.
    ///
    /// # Errors
    /// When the device fails.
    fn blend(&self, values: Tensor<2>, pixels: &Arc<RowList>) -> Result<Tensor<2>>;
}

/// The weights of [`LabelledPixels`].
#[derive(Clone, Debug)]
pub enum PixelWeights {
    /// Kept, `[R, V]`; rows sum to 1.
    Stored(Arc<SparseMatrix>),
    /// Computed anew at each use: rows are the pixels of a view.
    Rendered(Arc<dyn Blending>),
}

/// Labelled pixels of a view over the Gaussians it sees.
#[derive(Clone, Debug)]
pub struct LabelledPixels {
    /// Frozen blending weights.
    pub weights: PixelWeights,
    /// Rows of `weights` that are looked at.
    pub rows: Arc<RowList>,
    /// Class index of each of those rows, [`UNLABELLED`] where it is not counted.
    pub labels: Arc<PixelLabels>,
}

impl LabelledPixels {
    /// The rows `rows` of `weights`, whose class indices are `labels`.
    pub fn new(weights: PixelWeights, rows: Vec<u32>, labels: Vec<u16>) -> Self {
        Self {
            weights,
            rows: Arc::new(rows.into()),
            labels: Arc::new(labels.into()),
        }
    }

    /// `values` `[V, C]` blended at the chosen rows, `[P, C]`, with gradient to `values`.
    ///
    /// # Errors
    /// Those of [`Blending::blend`].
    pub fn blend(&self, values: Tensor<2>) -> Result<Tensor<2>> {
        match &self.weights {
            PixelWeights::Stored(weights) => Ok(sparse_apply(
                values,
                Arc::new(weights.select_rows(&self.rows)),
            )),
            PixelWeights::Rendered(view) => view.blend(values, &self.rows),
        }
    }

    /// Mean loss over the labelled pixels by stored `weights`, and its gradient to `scores`, `[V, classes]`. No labelled pixel: zeros.
    ///
    /// # Panics
    /// If the loss reads more than the labelled class ([`Kind::reads_all_classes`]).
    fn value_and_gradient<E: Real>(
        &self,
        weights: &SparseMatrix,
        scores: &[E],
        classes: usize,
        losses: &ClassLosses,
    ) -> (E, Vec<E>) {
        assert!(
            !losses.kind.reads_all_classes(),
            "value_and_gradient: {losses:?} reads all classes of a pixel"
        );
        let mut gradient = vec![E::zero(); scores.len()];
        let mut of_class = vec![Vec::new(); classes];
        for (&row, &label) in self.rows.iter().zip(self.labels.iter()) {
            if label != UNLABELLED {
                of_class[usize::from(label)].push(row);
            }
        }
        let count: usize = of_class.iter().map(Vec::len).sum();
        if count == 0 {
            return (E::zero(), gradient);
        }
        let points = scores.len() / classes;
        let p = probabilities(scores, classes);
        let tasks: Vec<(usize, &[u32])> = of_class
            .iter()
            .enumerate()
            .flat_map(|(class, rows)| rows.chunks(TASK).map(move |r| (class, r)))
            .collect();
        let scale = 1.0 / count as f64;
        let done: Vec<(f64, Vec<E>)> = tasks
            .par_iter()
            .map(|&(class, rows)| {
                let p = &p[class * points..][..points];
                of_class_alone(weights, rows, p, classes, losses.of(class), scale)
            })
            .collect();
        let mut d_p: Vec<Option<Vec<E>>> = vec![None; classes];
        let mut loss = 0.0;
        for ((class, _), (value, d)) in tasks.into_iter().zip(done) {
            loss += value;
            d_p[class] = Some(match d_p[class].take() {
                None => d,
                Some(mut sum) => {
                    sum.iter_mut().zip(d).for_each(|(s, d)| *s += d);
                    sum
                }
            });
        }
        let named: Vec<(usize, Vec<E>)> = d_p
            .into_iter()
            .enumerate()
            .filter_map(|(c, d)| Some((c, d?)))
            .collect();
        gradient
            .par_chunks_mut(BLOCK * classes)
            .enumerate()
            .for_each(|(block, gradient)| {
                for (i, gradient) in gradient.chunks_exact_mut(classes).enumerate() {
                    let j = block * BLOCK + i;
                    let mean: E = named.iter().map(|(c, d)| p[c * points + j] * d[j]).sum();
                    for (c, gradient) in gradient.iter_mut().enumerate() {
                        *gradient = -mean * p[c * points + j];
                    }
                    for (c, d) in &named {
                        gradient[*c] += p[c * points + j] * d[j];
                    }
                }
            });
        (E::of(loss * scale), gradient)
    }
}

/// Summed loss of `rows`, all labelled with one class of probabilities `p` (`[V]`), and its gradient times `scale`.
fn of_class_alone<E: Real>(
    weights: &SparseMatrix,
    rows: &[u32],
    p: &[E],
    classes: usize,
    kind: Kind,
    scale: f64,
) -> (f64, Vec<E>) {
    let mut gradient = vec![E::zero(); p.len()];
    let mut sum = 0.0;
    for &row in rows {
        let (columns, weights) = weights.row(row as usize);
        let (mut q, mut total) = (E::zero(), E::zero());
        for (&j, &w) in columns.iter().zip(weights) {
            let w = E::of(f64::from(w));
            q += w * p[j as usize];
            total += w;
        }
        let q = q.wide() + LEAST_PROBABILITY;
        let total = total.wide() + classes as f64 * LEAST_PROBABILITY;
        // p_y dL/dp_y over q is dL/dq, but for the total, which does not change
        let (loss, h) = kind.of_log_probability((q / total).min(1.0).ln());
        sum += loss;
        let factor = E::of(h * scale / q);
        for (&j, &w) in columns.iter().zip(weights) {
            gradient[j as usize] += factor * E::of(f64::from(w));
        }
    }
    (sum, gradient)
}

/// Softmax of `scores` `[V, classes]`, transposed to `[classes, V]`.
fn probabilities<E: Real>(scores: &[E], classes: usize) -> Vec<E> {
    let points = scores.len() / classes;
    let (mut powers, mut factors) = (vec![E::zero(); scores.len()], vec![E::zero(); points]);
    let blocks = powers
        .par_chunks_mut(BLOCK * classes)
        .zip(factors.par_chunks_mut(BLOCK));
    blocks
        .zip(scores.par_chunks(BLOCK * classes))
        .for_each(|((powers, factors), scores)| {
            let rows = powers
                .chunks_exact_mut(classes)
                .zip(scores.chunks_exact(classes));
            for ((powers, scores), factor) in rows.zip(factors) {
                let highest = scores
                    .iter()
                    .fold(scores[0], |h, &s| if s > h { s } else { h });
                powers
                    .iter_mut()
                    .zip(scores)
                    .for_each(|(p, &s)| *p = (s - highest).exp());
                *factor = E::one() / powers.iter().copied().sum();
            }
        });
    let mut out = vec![E::zero(); scores.len()];
    out.par_chunks_mut(points).enumerate().for_each(|(c, out)| {
        for ((out, powers), &factor) in out
            .iter_mut()
            .zip(powers.chunks_exact(classes))
            .zip(&factors)
        {
            *out = powers[c] * factor;
        }
    });
    out
}

/// Backend side of [`blended_label_loss`], for backends whose tensors lie in host memory.
#[backend_extension(NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Autodiff)]
pub trait BlendedLabelBackend: Backend {
    /// The mean loss `[1]` of `pixels` by stored `weights`, and its gradient `[V, C]`.
    fn blended_label_loss(
        scores: FloatTensor<Self>,
        weights: Arc<SparseMatrix>,
        pixels: Arc<LabelledPixels>,
        losses: ClassLosses,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
}

impl<B: HostBackend> BlendedLabelBackend for B {
    fn blended_label_loss(
        scores: FloatTensor<Self>,
        weights: Arc<SparseMatrix>,
        pixels: Arc<LabelledPixels>,
        losses: ClassLosses,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let (device, [rows, classes]) = (device_of::<B>(&scores), scores.shape().dims());
        real_kernel!(scores, E => {
            let (value, gradient) = pixels.value_and_gradient::<E>(&weights, &B::values(scores), classes, &losses);
            (B::tensor::<E>(vec![value], &[1], &device), B::tensor::<E>(gradient, &[rows, classes], &device))
        })
    }
}

impl<B: BlendedLabelBackend, C: CheckpointStrategy> BlendedLabelBackend for Autodiff<B, C> {
    fn blended_label_loss(
        scores: FloatTensor<Self>,
        weights: Arc<SparseMatrix>,
        pixels: Arc<LabelledPixels>,
        losses: ClassLosses,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        with_gradient_in_hand::<B, C>(scores, |scores| {
            B::blended_label_loss(scores, weights, pixels, losses)
        })
    }
}

/// Mean loss `[1]` of the blended class probabilities of `pixels`, with gradient to `scores`, `[V, C]`: class scores of
/// the Gaussians of which each takes the softmax before blending. On a GPU, without stored weights, and for a loss that reads
/// all classes, it is [`blended_label_loss_plain`].
///
/// # Errors
/// Those of [`LabelledPixels::blend`].
///
/// # Panics
/// If `scores` has not one row a column of the weights, there is not one label a row, or a label is neither below C nor
/// [`UNLABELLED`].
pub fn blended_label_loss(
    scores: Tensor<2>,
    pixels: Arc<LabelledPixels>,
    losses: &ClassLosses,
) -> Result<Tensor<1>> {
    let [rows, classes] = scores.dims();
    assert_eq!(
        pixels.rows.len(),
        pixels.labels.len(),
        "blended_label_loss: labels against rows"
    );
    assert!(
        pixels.labels.end() <= classes,
        "blended_label_loss: a label is no class index below {classes}"
    );
    let PixelWeights::Stored(weights) = &pixels.weights else {
        return blended_label_loss_plain(scores, &pixels, losses);
    };
    assert_eq!(
        rows, weights.columns,
        "blended_label_loss: scores against columns of the weights"
    );
    if losses.kind.reads_all_classes() || !in_host_memory(&scores.device()) {
        return blended_label_loss_plain(scores, &pixels, losses);
    }
    let (value, _) = Dispatch::blended_label_loss(
        scores.into_dispatch(),
        weights.clone(),
        pixels,
        losses.clone(),
    );
    Ok(Tensor::from_dispatch(value))
}

/// [`blended_label_loss`] in plain tensors around [`label_losses`]: what runs on a GPU, and the reference of its tests.
///
/// # Errors
/// Those of [`LabelledPixels::blend`].
pub fn blended_label_loss_plain(
    scores: Tensor<2>,
    pixels: &LabelledPixels,
    losses: &ClassLosses,
) -> Result<Tensor<1>> {
    let blended = pixels.blend(softmax(scores, 1))?;
    // softmax(log q) = q / sum q: the loss sees the mixture itself
    Ok(label_losses(
        (blended + LEAST_PROBABILITY).log(),
        &pixels.labels,
        losses,
    ))
}

//! MobileNetV2 on plain slices: batch normalisation folded into the convolutions, bias and ReLU6 in the same pass.
//!
//! The modules' `conv2d` costs about seven times as much on the CPU (1.4 s against 0.19 s an image of 480x360, one
//! thread); they remain the reference of the tests. Activations are planes, `[C, H, W]`. A call uses one thread:
//! views run side by side.

use super::{Block, ConvNorm, EPSILON, MobileNetV2, STEPS, TAPS};
use crate::backend::Real;
use crate::backend::simd::{multiply_add, wide_kernel};
use crate::error::{Error, Result};
use crate::features::{FeatureMap, SCALES};
use burn::tensor::Tensor;
use nalgebra::{DMatrixView, DMatrixViewMut};

/// A convolution with its batch normalisation.
#[derive(Clone, Debug)]
struct Layer {
    /// `[out, in / groups * k * k]`.
    weights: Vec<f32>,
    /// `[out]`.
    bias: Vec<f32>,
}

#[derive(Clone, Debug)]
struct FoldedBlock {
    expand: Option<Layer>,
    depthwise: Layer,
    project: Layer,
    stride: usize,
    residual: bool,
}

/// The network ready to run.
#[derive(Clone, Debug)]
pub struct FoldedNet {
    stem: Layer,
    blocks: Vec<FoldedBlock>,
}

/// An activation.
struct Planes {
    height: usize,
    width: usize,
    data: Vec<f32>,
}

impl Planes {
    fn size(&self) -> usize {
        self.height * self.width
    }
}

impl Layer {
    fn fold(layer: &ConvNorm) -> Self {
        let values = |t: Tensor<1>| t.into_data().into_vec::<f32>().unwrap_or_default();
        let weights = layer
            .conv
            .weight
            .val()
            .into_data()
            .into_vec::<f32>()
            .unwrap_or_default();
        let (gamma, beta) = (
            values(layer.norm.gamma.val()),
            values(layer.norm.beta.val()),
        );
        let (mean, variance) = (
            values(layer.norm.running_mean.value()),
            values(layer.norm.running_var.value()),
        );
        let scale: Vec<f64> = gamma
            .iter()
            .zip(&variance)
            .map(|(&g, &v)| f64::from(g) / (f64::from(v) + EPSILON).sqrt())
            .collect();
        let taps = weights.len() / scale.len().max(1);
        let weights = weights.chunks(taps.max(1)).zip(&scale);
        Self {
            weights: weights
                .flat_map(|(w, s)| w.iter().map(move |&w| (f64::from(w) * s) as f32))
                .collect(),
            bias: (0..scale.len())
                .map(|c| (f64::from(beta[c]) - f64::from(mean[c]) * scale[c]) as f32)
                .collect(),
        }
    }

    /// A 1x1 convolution over `inputs` of `n` pixels each; without `clamp` the activation is the identity.
    fn pointwise(&self, input: &[f32], n: usize, clamp: bool) -> Vec<f32> {
        let (outputs, inputs) = (self.bias.len(), input.len() / n.max(1));
        let mut out = vec![0.0; outputs * n];
        // Column-major [n, inputs] times [inputs, outputs], both as they lie.
        let x = DMatrixView::from_slice(input, n, inputs);
        let w = DMatrixView::from_slice(&self.weights, inputs, outputs);
        DMatrixViewMut::from_slice(&mut out, n, outputs).gemm(1.0, &x, &w, 0.0);
        for (plane, &bias) in out.chunks_exact_mut(n.max(1)).zip(&self.bias) {
            if clamp {
                plane
                    .iter_mut()
                    .for_each(|x| *x = (*x + bias).clamp(0.0, 6.0));
            } else {
                plane.iter_mut().for_each(|x| *x += bias);
            }
        }
        out
    }

    /// A 3x3 convolution of each plane with its own kernel, padding 1, ReLU6.
    fn depthwise(&self, input: &Planes, stride: usize) -> Planes {
        let (height, width) = (input.height.div_ceil(stride), input.width.div_ceil(stride));
        let mut data = vec![0.0; self.bias.len() * height * width];
        let planes = data
            .chunks_exact_mut((height * width).max(1))
            .zip(input.data.chunks_exact(input.size().max(1)));
        let mut padded = vec![0.0; (input.height + 2) * (input.width + 2)];
        for ((out, plane), (kernel, &bias)) in
            planes.zip(self.weights.as_chunks::<9>().0.iter().zip(&self.bias))
        {
            for (to, from) in padded
                .chunks_exact_mut(input.width + 2)
                .skip(1)
                .zip(plane.chunks_exact(input.width))
            {
                to[1..=input.width].copy_from_slice(from);
            }
            convolve(out, width, &padded, input.width + 2, stride, kernel, bias);
        }
        Planes {
            height,
            width,
            data,
        }
    }

    /// The first convolution: 3x3, stride 2, padding 1, over three planes; ReLU6.
    fn stem(&self, input: &Planes) -> Planes {
        let (height, width, n) = (
            input.height.div_ceil(2),
            input.width.div_ceil(2),
            input.size(),
        );
        let mut patches = Vec::with_capacity(27 * height * width);
        for plane in input.data.chunks_exact(n.max(1)) {
            for (dy, dx) in (0..3).flat_map(|dy| (0..3).map(move |dx| (dy, dx))) {
                for y in 0..height {
                    // Padding is 1, so input row 2 y + dy - 1.
                    let row = (2 * y + dy).checked_sub(1).filter(|&r| r < input.height);
                    patches.extend(
                        (0..width).map(|x| match (row, (2 * x + dx).checked_sub(1)) {
                            (Some(row), Some(column)) if column < input.width => {
                                plane[row * input.width + column]
                            }
                            _ => 0.0,
                        }),
                    );
                }
            }
        }
        Planes {
            height,
            width,
            data: self.pointwise(&patches, height * width, true),
        }
    }
}

wide_kernel! {
    /// One plane: `out` is `[h, width]`, `padded` has a border of zeros and rows of `pitch`.
    fn convolve(
        out: &mut [E],
        width: usize,
        padded: &[E],
        pitch: usize,
        stride: usize,
        kernel: &[E; 9],
        bias: E,
    ) => convolve_plane
}

#[inline(always)]
fn convolve_plane<E: Real, const FMA: bool>(
    out: &mut [E],
    width: usize,
    padded: &[E],
    pitch: usize,
    stride: usize,
    kernel: &[E; 9],
    bias: E,
) {
    if stride == 1 {
        convolve_rows::<E, FMA, 1>(out, width, padded, pitch, kernel, bias);
    } else {
        convolve_rows::<E, FMA, 2>(out, width, padded, pitch, kernel, bias);
    }
}

#[inline(always)]
fn convolve_rows<E: Real, const FMA: bool, const STRIDE: usize>(
    out: &mut [E],
    width: usize,
    padded: &[E],
    pitch: usize,
    kernel: &[E; 9],
    bias: E,
) {
    let reach = (width - 1) * STRIDE + 3;
    for (y, out) in out.chunks_exact_mut(width).enumerate() {
        let rows: [&[E]; 3] =
            std::array::from_fn(|dy| &padded[(y * STRIDE + dy) * pitch..][..reach]);
        for (x, out) in out.iter_mut().enumerate() {
            let mut sum = bias;
            for (row, kernel) in rows.iter().zip(kernel.as_chunks::<3>().0) {
                for dx in 0..3 {
                    sum = multiply_add::<E, FMA>(kernel[dx], row[x * STRIDE + dx], sum);
                }
            }
            *out = sum.max(E::zero()).min(E::of(6.0));
        }
    }
}

impl FoldedBlock {
    fn fold(block: &Block) -> Self {
        Self {
            expand: block.expand.as_ref().map(Layer::fold),
            depthwise: Layer::fold(&block.depthwise),
            project: Layer::fold(&block.project),
            stride: block.depthwise.conv.stride[0],
            residual: block.residual,
        }
    }

    fn forward(&self, x: Planes) -> Planes {
        let hidden = match &self.expand {
            Some(expand) => {
                let data = expand.pointwise(&x.data, x.size(), true);
                self.depthwise.depthwise(&Planes { data, ..x }, self.stride)
            }
            None => self.depthwise.depthwise(&x, self.stride),
        };
        let mut data = self.project.pointwise(&hidden.data, hidden.size(), false);
        if self.residual {
            data.iter_mut().zip(&x.data).for_each(|(o, x)| *o += x);
        }
        Planes { data, ..hidden }
    }
}

impl FoldedNet {
    /// The network of `net`.
    pub fn new(net: &MobileNetV2) -> Self {
        Self {
            stem: Layer::fold(&net.stem),
            blocks: net.blocks.iter().map(FoldedBlock::fold).collect(),
        }
    }

    /// The four scales of a normalised image, planes `[3, height, width]`.
    ///
    /// # Errors
    /// [`Error::Argument`] when the planes have another length or no pixel; [`Error::NonFinite`] when an activation is not
    /// finite.
    pub fn forward(
        &self,
        planes: Vec<f32>,
        height: usize,
        width: usize,
    ) -> Result<[FeatureMap; SCALES]> {
        if planes.len() != 3 * height * width || planes.is_empty() {
            let (found, expected) = (
                format!("{} values", planes.len()),
                format!("3 x {height} x {width}, not 0"),
            );
            return Err(Error::argument(
                "image of MobileNetV2",
                found,
                expected,
                "give three planes",
            ));
        }
        let mut x = self.stem.stem(&Planes {
            height,
            width,
            data: planes,
        });
        let mut maps: [FeatureMap; SCALES] = Default::default();
        for (n, block) in self.blocks.iter().enumerate() {
            x = block.forward(x);
            if let Some(scale) = TAPS.iter().position(|&tap| tap == n + 1) {
                maps[scale] = FeatureMap {
                    steps: Some(STEPS[scale]),
                    ..cells(&x)
                };
                maps[scale].check(&format!("MobileNetV2 scale {}", scale + 1))?;
            }
        }
        Ok(maps)
    }
}

/// Planes to cells.
fn cells(x: &Planes) -> FeatureMap {
    let (n, channels) = (x.size(), x.data.len() / x.size());
    let data = (0..n)
        .flat_map(|p| (0..channels).map(move |c| (p, c)))
        .map(|(p, c)| x.data[c * n + p])
        .collect();
    FeatureMap {
        height: x.height,
        width: x.width,
        channels,
        data,
        steps: None,
    }
}

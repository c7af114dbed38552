//! Label losses and their gradients, one unit a pixel.

use super::covers;
use super::numeric::{exp_m1_nonpositive, ln_1p};
use crate::backend::gpu::{Gpu, arg, sum};
use crate::ops::PixelLabels;
use crate::ops::label_loss::{ClassLosses, Kind, LOG_ZERO, LabelLossBackend, UNLABELLED, on_host};
use burn::backend::tensor::FloatTensor;
use burn::tensor::DType;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use std::sync::Arc;

/// Marks pixels that are not counted, as `u32`.
const NO_LABEL: u32 = UNLABELLED as u32;

/// Which [`Kind`], for the compiler of the kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Formula {
    Ce,
    Js,
    Gce,
    Mae,
    NceRce,
}

impl Formula {
    /// With its parameter: `pi_rl` or `q`.
    fn of(kind: Kind) -> (Self, f64) {
        match kind {
            Kind::Ce => (Self::Ce, 0.0),
            Kind::Js { pi_rl } => (Self::Js, pi_rl),
            Kind::Gce { q } => (Self::Gce, q),
            Kind::Mae => (Self::Mae, 0.0),
            Kind::NceRce => (Self::NceRce, 0.0),
        }
    }
}

/// A loss, and h = p_y dL/dp_y.
#[derive(CubeType, Clone, Copy)]
struct Term {
    loss: f32,
    h: f32,
}

/// Of ln p_y and 1 - p_y. `parameter` is `pi_rl` or `q`; `one_minus` 1 less `pi_rl`, and `log_rest` the logarithm of that.
#[cube]
fn term(
    log_p: f32,
    rest: f32,
    parameter: f32,
    one_minus: f32,
    log_rest: f32,
    #[comptime] formula: Formula,
) -> Term {
    let p = log_p.exp();
    let mut loss = -log_p;
    let mut h = f32::new(-1.0);
    if comptime![formula == Formula::Mae] {
        loss = rest;
        h = -p;
    }
    if comptime![formula == Formula::NceRce] {
        loss = -(LOG_ZERO as f32) * rest;
        h = LOG_ZERO as f32 * p;
    }
    if comptime![formula == Formula::Gce] {
        loss = -exp_m1_nonpositive(parameter * log_p) / parameter;
        h = -((parameter * log_p).exp());
    }
    if comptime![formula == Formula::Js] {
        // m = pi_rl + (1 - pi_rl) p, from whichever end keeps its digits
        let missing = one_minus * rest;
        let mut log_m = (parameter + one_minus * p).ln();
        if missing < 0.5f32 {
            log_m = ln_1p(-missing);
        }
        // ln(m / p) = ln(1 + pi_rl (1 - p) / p): the first form for small p, the second for small pi_rl
        let mut log_m_over_p = log_m - log_p;
        if log_p > -40.0f32 {
            let ratio = parameter * rest / p;
            if ratio < 1.0f32 {
                log_m_over_p = ln_1p(ratio);
            }
        }
        let label = -parameter * log_m;
        let prediction = one_minus * (-rest * log_rest - p * log_m_over_p);
        loss = (label + prediction) / (-one_minus * log_rest);
        h = p * (log_m_over_p - log_rest) / log_rest;
    }
    Term { loss, h }
}

#[cube(launch)]
fn label_losses(
    logits: &[f32],
    labels: &[u32],
    parameters: &[f32],
    losses: &mut [f32],
    gradient: &mut [f32],
    pixels: u32,
    classes: u32,
    scale: f32,
    one_minus: f32,
    log_rest: f32,
    #[comptime] formula: Formula,
) {
    let pixel = ABSOLUTE_POS;
    if pixel >= pixels as usize {
        terminate!();
    }
    let count = classes as usize;
    let first = pixel * count;
    let label = labels[pixel];
    if label == NO_LABEL {
        losses[pixel] = 0.0f32;
        for k in 0..count {
            gradient[first + k] = 0.0f32;
        }
    } else {
        let y = label as usize;
        let mut highest = logits[first];
        for k in 0..count {
            highest = max(highest, logits[first + k]);
        }
        let mut others = 0.0f32;
        let mut sum = 0.0f32;
        for k in 0..count {
            let z = logits[first + k] - highest;
            sum += z;
            if k != y {
                others += z.exp();
            }
        }
        let own = logits[first + y] - highest;
        let total = others + own.exp();
        let log_total = total.ln();
        let mut log_p = own - log_total;
        if own == 0.0f32 {
            log_p = -ln_1p(others); // a prediction that is nearly right keeps its digits
        }
        let rest = others / total;
        let t = term(log_p, rest, parameters[y], one_minus, log_rest, formula);
        let mut loss = t.loss;
        let mut h = t.h;
        let mut u = 0.0f32;
        if comptime![formula == Formula::NceRce] {
            // -sum_k ln p_k; a single class has no entropy to compare with
            let all = f32::cast_from(classes) * log_total - sum;
            if all > 0.0f32 {
                loss -= log_p / all;
                h -= 1.0f32 / all;
                u = -log_p / (all * all);
            }
        }
        losses[pixel] = loss * scale;
        let factor = -(h + u * f32::cast_from(classes)) * scale / total;
        let each = u * scale;
        for k in 0..count {
            let mut g = (logits[first + k] - highest).exp() * factor + each;
            if k == y {
                // h (1 - p_y), not h - h p_y
                g = (h * rest + u * (1.0f32 - f32::cast_from(classes) * (own.exp() / total)))
                    * scale;
            }
            gradient[first + k] = g;
        }
    }
}

impl LabelLossBackend for CubeBackend {
    fn label_loss(
        logits: FloatTensor<Self>,
        labels: Arc<PixelLabels>,
        losses: ClassLosses,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let [pixels, classes] = logits.meta.shape().dims();
        let count = labels.counted();
        if !covers(&logits) || count == 0 || classes == 0 {
            return on_host::label_loss::<Self>(logits, &labels, &losses);
        }
        let gpu = Gpu::of(&logits);
        let wide = || labels.iter().map(|&l| u32::from(l)).collect::<Vec<_>>();
        let labels = labels.resident.on(&gpu, || gpu.upload(&wide(), DType::U32));
        let (formula, parameter) = Formula::of(losses.kind);
        let parameters: Vec<f32> = (0..classes)
            .map(|class| Formula::of(losses.of(class)).1 as f32)
            .collect();
        let parameters = gpu.upload(&parameters, DType::F32);
        let (losses, gradient) = (gpu.floats([pixels]), gpu.floats([pixels, classes]));
        label_losses::launch(
            &gpu.client,
            gpu.cubes_for(pixels),
            gpu.dim(),
            arg(&into_contiguous(logits)),
            arg(&labels),
            arg(&parameters),
            arg(&losses),
            arg(&gradient),
            pixels as u32,
            classes as u32,
            (1.0 / count as f64) as f32,
            (1.0 - parameter) as f32,
            (-parameter).ln_1p() as f32,
            formula,
        );
        (sum(&gpu, &losses, pixels), gradient)
    }
}

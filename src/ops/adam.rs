//! One Adam step as a fused operation: parameters, gradient and both moments are read and written once.

use crate::backend::simd::{multiply_add, wide_kernel};
use crate::backend::{HostBackend, HostKernels, Real, device_of, real_kernel};
use burn::backend::{Backend, Dispatch, TensorMetadata, backend_extension, tensor::FloatTensor};
use burn::tensor::{Tensor, TensorData};
use rayon::prelude::*;
use std::sync::Arc;

/// Scalars handled by one task.
const CHUNK: usize = 1 << 14;

/// What a step needs besides the tensors.
///
/// With g the gradient and t the step: m = b1 m + (1 - b1) g; v = b2 v + (1 - b2) g^2;
/// p -= rate m / (1 - b1^t) / (sqrt(v / (1 - b2^t)) + eps).
#[derive(Clone, Debug, PartialEq)]
pub struct AdamStep {
    /// Learning rates, repeated along the row-major scalars: one, or one a column.
    pub rates: Vec<f64>,
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment.
    pub beta2: f64,
    /// Added to the root of the second moment.
    pub epsilon: f64,
    /// Number of this step, from 1.
    pub step: u32,
}

impl AdamStep {
    /// Step `step` (from 1) with the constants of 3DGS: betas 0.9 and 0.999, epsilon 1e-15.
    pub fn splatting(rates: Vec<f64>, step: u32) -> Self {
        Self {
            rates,
            beta1: 0.9,
            beta2: 0.999,
            epsilon: 1e-15,
            step,
        }
    }

    /// 1 - beta^t for both moments.
    pub(super) fn corrections(&self) -> (f64, f64) {
        let t = f64::from(self.step.max(1));
        (1.0 - self.beta1.powf(t), 1.0 - self.beta2.powf(t))
    }

    /// The step on slices, in place. All slices have one length; `rates` must not be empty.
    pub fn apply<E: Real>(&self, param: &mut [E], grad: &[E], m: &mut [E], v: &mut [E]) {
        let period = self.rates.len().max(1);
        let (c1, c2) = self.corrections();
        // whole periods in a tile, so that every tile starts at column 0
        let tile = period * 64_usize.div_ceil(period);
        let rates: Vec<E> = self
            .rates
            .iter()
            .cycle()
            .take(tile)
            .map(|r| E::of(r / c1))
            .collect();
        let constants = Constants {
            beta1: E::of(self.beta1),
            rest1: E::of(1.0 - self.beta1),
            beta2: E::of(self.beta2),
            rest2: E::of(1.0 - self.beta2),
            root: E::of(1.0 / c2.sqrt()),
            epsilon: E::of(self.epsilon),
        };
        let chunk = tile * CHUNK.div_ceil(tile);
        param
            .par_chunks_mut(chunk)
            .zip(grad.par_chunks(chunk))
            .zip(m.par_chunks_mut(chunk).zip(v.par_chunks_mut(chunk)))
            .for_each(|((p, g), (m, v))| update(&constants, &rates, p, g, m, v));
    }
}

struct Constants<E> {
    beta1: E,
    rest1: E,
    beta2: E,
    rest2: E,
    root: E,
    epsilon: E,
}

wide_kernel! {
    fn update(c: &Constants<E>, rates: &[E], p: &mut [E], g: &[E], m: &mut [E], v: &mut [E]) => update_body
}

#[inline(always)]
fn update_body<E: Real, const FMA: bool>(
    c: &Constants<E>,
    rates: &[E],
    p: &mut [E],
    g: &[E],
    m: &mut [E],
    v: &mut [E],
) {
    let tile = rates.len();
    let tiles = p
        .chunks_mut(tile)
        .zip(g.chunks(tile))
        .zip(m.chunks_mut(tile).zip(v.chunks_mut(tile)));
    for ((p, g), (m, v)) in tiles {
        let n = p.len().min(g.len()).min(m.len()).min(v.len()).min(tile);
        let (p, g, m, v, rates) = (&mut p[..n], &g[..n], &mut m[..n], &mut v[..n], &rates[..n]);
        for i in 0..n {
            let first = multiply_add::<E, FMA>(c.beta1, m[i], c.rest1 * g[i]);
            let second = multiply_add::<E, FMA>(c.beta2, v[i], c.rest2 * (g[i] * g[i]));
            m[i] = first;
            v[i] = second;
            p[i] -= rates[i] * first / (second.sqrt() * c.root + c.epsilon);
        }
    }
}

/// Backend side of [`adam_step`]; has no gradient of its own.
#[backend_extension(
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Cube: cfg(feature = "cube")
)]
pub trait AdamBackend: Backend {
    /// New (parameter, first moment, second moment), see [`AdamStep`]. Buffers nobody else holds are reused.
    fn adam_step(
        param: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        first: FloatTensor<Self>,
        second: FloatTensor<Self>,
        step: Arc<AdamStep>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>);
    /// `mean + share (value - mean)`; a buffer of `mean` that nobody else holds is reused.
    fn move_towards(
        mean: FloatTensor<Self>,
        value: FloatTensor<Self>,
        share: f64,
    ) -> FloatTensor<Self>;
}

impl<B: HostKernels> AdamBackend for B {
    fn adam_step(
        param: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        first: FloatTensor<Self>,
        second: FloatTensor<Self>,
        step: Arc<AdamStep>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        on_host::adam_step::<Self>(param, grad, first, second, &step)
    }

    fn move_towards(
        mean: FloatTensor<Self>,
        value: FloatTensor<Self>,
        share: f64,
    ) -> FloatTensor<Self> {
        on_host::move_towards::<Self>(mean, value, share)
    }
}

/// The same by the CPU's kernels, wherever the tensors live.
pub(super) mod on_host {
    use super::*;

    pub fn adam_step<B: HostBackend>(
        param: FloatTensor<B>,
        grad: FloatTensor<B>,
        first: FloatTensor<B>,
        second: FloatTensor<B>,
        step: &AdamStep,
    ) -> (FloatTensor<B>, FloatTensor<B>, FloatTensor<B>) {
        let (device, shape) = (device_of::<B>(&param), param.shape());
        let shape: &[usize] = &shape;
        real_kernel!(param, E => {
            let mut p = B::values::<E>(param).into_vec();
            let mut m = B::values::<E>(first).into_vec();
            let mut v = B::values::<E>(second).into_vec();
            step.apply(&mut p, &B::values::<E>(grad), &mut m, &mut v);
            (B::tensor(p, shape, &device), B::tensor(m, shape, &device), B::tensor(v, shape, &device))
        })
    }

    pub fn move_towards<B: HostBackend>(
        mean: FloatTensor<B>,
        value: FloatTensor<B>,
        share: f64,
    ) -> FloatTensor<B> {
        let (device, shape) = (device_of::<B>(&mean), mean.shape());
        real_kernel!(mean, E => {
            let mut mean = B::values::<E>(mean).into_vec();
            let share = E::of(share);
            mean.iter_mut().zip(B::values::<E>(value).iter()).for_each(|(m, &v)| *m += (v - *m) * share);
            B::tensor(mean, &shape, &device)
        })
    }
}

/// Tensors that one Adam step reads and replaces, all of one shape, none with autodiff.
#[derive(Clone, Debug)]
pub struct AdamTensors<const D: usize> {
    /// The parameter.
    pub param: Tensor<D>,
    /// First moment.
    pub first: Tensor<D>,
    /// Second moment.
    pub second: Tensor<D>,
}

/// One fused Adam step; equals [`adam_step_plain`].
///
/// # Panics
/// If shapes differ, `step.rates` is empty, or a tensor has autodiff or is neither f32 nor f64.
pub fn adam_step<const D: usize>(
    state: AdamTensors<D>,
    grad: Tensor<D>,
    step: &Arc<AdamStep>,
) -> AdamTensors<D> {
    let AdamTensors {
        param,
        first,
        second,
    } = state;
    assert!(!step.rates.is_empty(), "adam_step: no learning rate");
    assert_eq!(
        param.dims(),
        grad.dims(),
        "adam_step: parameter against gradient"
    );
    assert_eq!(
        param.dims(),
        first.dims(),
        "adam_step: parameter against first moment"
    );
    assert_eq!(
        param.dims(),
        second.dims(),
        "adam_step: parameter against second moment"
    );
    let (param, first, second) = Dispatch::adam_step(
        param.into_dispatch(),
        grad.into_dispatch(),
        first.into_dispatch(),
        second.into_dispatch(),
        step.clone(),
    );
    AdamTensors {
        param: Tensor::from_dispatch(param),
        first: Tensor::from_dispatch(first),
        second: Tensor::from_dispatch(second),
    }
}

/// `mean + share (value - mean)`, the step of a running mean, in one pass.
///
/// # Panics
/// If shapes differ, or a tensor has autodiff or is neither f32 nor f64.
pub fn move_towards<const D: usize>(mean: Tensor<D>, value: Tensor<D>, share: f64) -> Tensor<D> {
    assert_eq!(
        mean.dims(),
        value.dims(),
        "move_towards: mean against value"
    );
    Tensor::from_dispatch(Dispatch::move_towards(
        mean.into_dispatch(),
        value.into_dispatch(),
        share,
    ))
}

/// The same step in plain tensor operations: the reference of [`adam_step`].
pub fn adam_step_plain<const D: usize>(
    state: AdamTensors<D>,
    grad: Tensor<D>,
    step: &AdamStep,
) -> AdamTensors<D> {
    let (c1, c2) = step.corrections();
    let first = state.first * step.beta1 + grad.clone() * (1.0 - step.beta1);
    let second = state.second * step.beta2 + grad.clone() * grad * (1.0 - step.beta2);
    let direction =
        first.clone() * (1.0 / c1) / ((second.clone() * (1.0 / c2)).sqrt() + step.epsilon);
    let (shape, device, dtype) = (
        state.param.dims(),
        state.param.device(),
        state.param.dtype(),
    );
    let (count, period) = (shape.iter().product::<usize>(), step.rates.len());
    let update = match step.rates[..] {
        [rate] => direction * rate,
        _ if count.is_multiple_of(period) => {
            let rates = Tensor::<2>::from_data(
                TensorData::new(step.rates.clone(), [1, period]),
                (&device, dtype),
            );
            (direction.reshape([count / period, period]) * rates).reshape(shape)
        }
        _ => {
            let rates = step.rates.iter().copied().cycle().take(count).collect();
            direction
                * Tensor::<D>::from_data(TensorData::new::<f64, _>(rates, shape), (&device, dtype))
        }
    };
    AdamTensors {
        param: state.param - update,
        first,
        second,
    }
}

#[cfg(all(test, feature = "ndarray"))]
mod tests {
    use super::*;
    use burn::backend::NdArray;

    #[test]
    fn buffers_nobody_else_holds_are_updated_in_place() {
        let device = Default::default();
        let make = |x: f32| <NdArray as HostBackend>::tensor(vec![x; 100], &[50, 2], &device);
        let address = |t: &FloatTensor<NdArray>| NdArray::values::<f32>(t.clone()).as_ptr();
        let (p, m, v) = (make(1.0), make(0.0), make(0.0));
        let before = [address(&p), address(&m), address(&v)];
        let step = Arc::new(AdamStep::splatting(vec![0.1, 0.2], 1));
        let (p, m, v) = NdArray::adam_step(p, make(1.0), m, v, step);
        assert_eq!(before, [address(&p), address(&m), address(&v)]);
        assert!((NdArray::values::<f32>(p)[1] - 0.8).abs() < 1e-6);
    }
}

//! One Adam step (Kingma and Ba 2015) as a fused operation, which reads and writes the parameter, its gradient and both
//! moments once.

mod cpu;
#[cfg(feature = "cube")]
mod gpu;

use crate::backend::custom_op;
use crate::ops::CustomOp;
use burn::backend::{Dispatch, tensor::FloatTensor};
use burn::tensor::{Tensor, TensorData};
use std::sync::Arc;

/// Decay of the first moment, as in 3DGS.
const BETA1: f64 = 0.9;
/// Decay of the second moment.
const BETA2: f64 = 0.999;
/// Added to the root of the second moment.
const EPSILON: f64 = 1e-15;

/// One step.
///
/// With the mean gradient `g` of `B` views, `t` views so far, `b1 = 0.9^B` and `b2 = 0.999^B`:
/// `m = b1 m + (1 - b1) g`, `v = b2 v + (1 - b2) g^2`,
/// `p = p - rate (m / (1 - 0.9^t)) / (sqrt(v / (1 - 0.999^t)) + eps)`.
#[derive(Clone, Debug, PartialEq)]
pub struct AdamStep {
    /// Learning rates: one for all scalars, or one for each column of the row-major scalars.
    pub rates: Vec<f64>,
    /// Views until the end of this step: its number, from 1, where steps have one view.
    pub views: u32,
    /// Views of this step.
    pub batch: u32,
}

impl AdamStep {
    /// Step `step` (from 1), of one view, with the constants of 3DGS: betas 0.9 and 0.999, epsilon 1e-15.
    pub fn splatting(rates: Vec<f64>, step: u32) -> Self {
        Self {
            rates,
            views: step,
            batch: 1,
        }
    }

    /// What both moments keep in this step.
    fn betas(&self) -> [f64; 2] {
        [BETA1, BETA2].map(|beta| beta.powi(self.batch as i32))
    }

    /// `1 - beta^t` of both moments.
    fn corrections(&self) -> (f64, f64) {
        let t = f64::from(self.views.max(1));
        (1.0 - BETA1.powf(t), 1.0 - BETA2.powf(t))
    }
}

/// New parameter, first moment and second moment.
type Updated<B> = (FloatTensor<B>, FloatTensor<B>, FloatTensor<B>);

custom_op! {
    /// Backend side of [`adam_step`].
    pub(crate) trait AdamBackend {
        /// New (parameter, first moment, second moment), see [`AdamStep`]. Buffers that nobody else holds are reused.
        fn adam_step(
            param: FloatTensor<Self>,
            grad: FloatTensor<Self>,
            first: FloatTensor<Self>,
            second: FloatTensor<Self>,
            step: Arc<AdamStep>,
        ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>);
    }
    no_gradient
}

/// Tensors that one Adam step reads and replaces. They have one shape and no autodiff.
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
    assert!(!step.rates.is_empty(), "adam_step: no learning rate");
    assert_eq!(
        [state.param.dims(), state.first.dims(), state.second.dims()],
        [grad.dims(); 3],
        "adam_step: parameter and moments against gradient"
    );
    if CustomOp::Adam.is_replaced() {
        return adam_step_plain(state, grad, step);
    }
    let (param, first, second) = Dispatch::adam_step(
        state.param.into_dispatch(),
        grad.into_dispatch(),
        state.first.into_dispatch(),
        state.second.into_dispatch(),
        step.clone(),
    );
    AdamTensors {
        param: Tensor::from_dispatch(param),
        first: Tensor::from_dispatch(first),
        second: Tensor::from_dispatch(second),
    }
}

/// The same step in plain tensor operations: the reference of [`adam_step`].
///
/// # Panics
/// If the number of scalars is not a multiple of the number of rates.
pub fn adam_step_plain<const D: usize>(
    state: AdamTensors<D>,
    grad: Tensor<D>,
    step: &AdamStep,
) -> AdamTensors<D> {
    let (c1, c2) = step.corrections();
    let [beta1, beta2] = step.betas();
    let first = state.first * beta1 + grad.clone() * (1.0 - beta1);
    let second = state.second * beta2 + grad.clone() * grad * (1.0 - beta2);
    let direction = first.clone() * (1.0 / c1) / ((second.clone() * (1.0 / c2)).sqrt() + EPSILON);
    let shape = direction.dims();
    let period = step.rates.len();
    let rates = Tensor::<2>::from_data(
        TensorData::new(step.rates.clone(), [1, period]),
        (&direction.device(), direction.dtype()),
    );
    let columns = direction.reshape([shape.iter().product::<usize>() / period, period]);
    AdamTensors {
        param: state.param - (columns * rates).reshape(shape),
        first,
        second,
    }
}

#[cfg(all(test, feature = "ndarray"))]
mod tests {
    use super::*;
    use crate::backend::HostBackend;
    use burn::backend::NdArray;

    #[test]
    fn buffers_nobody_else_holds_are_updated_in_place() {
        let device = Default::default();
        let make = |x: f32| <NdArray as HostBackend>::tensor(vec![x; 100], &[50, 2], &device);
        let address = |t: &FloatTensor<NdArray>| NdArray::values::<f32>(t.clone()).as_ptr();
        let p = make(1.0);
        let m = make(0.0);
        let v = make(0.0);
        let before = [address(&p), address(&m), address(&v)];
        let step = Arc::new(AdamStep::splatting(vec![0.1, 0.2], 1));
        let (p, m, v) = NdArray::adam_step(p, make(1.0), m, v, step);
        assert_eq!(before, [address(&p), address(&m), address(&v)]);
        assert!((NdArray::values::<f32>(p)[1] - 0.8).abs() < 1e-6);
    }
}

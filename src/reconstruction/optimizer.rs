//! The Gaussians as tensors on the device, with the moments of their optimiser.

use super::densify::{Densification, reset_opacity};
use crate::backend::check_finite;
use crate::backend::device::{indices, read, upload};
use crate::error::{Error, Result};
use crate::ops::{AdamStep, AdamTensors, adam_step, sum_all};
use crate::ranks;
use crate::raster::RasterInput;
use crate::splat::Gaussians;
use burn::tensor::{Bool, Device, Gradients, Tensor, TensorData};
use std::sync::Arc;

/// Names of the parameters, in the order of [`Moments`].
pub const NAMES: [&str; 5] = ["means", "log_scales", "rotations", "opacity_logits", "sh"];
/// Index of the means in [`Moments`].
const MEANS: usize = 0;
/// Index of the log-scales in [`Moments`].
const LOG_SCALES: usize = 1;
/// Index of the opacity logits in [`Moments`].
pub const OPACITY: usize = 3;

/// One value for each scalar of each parameter, row-major: a first or second moment.
pub type Moments = [Vec<f32>; 5];

/// Zero moments for these Gaussians.
pub fn zero_moments(gaussians: &Gaussians) -> Moments {
    widths(gaussians.sh_degree).map(|width| vec![0.0; gaussians.len() * width])
}

/// Scalars of a row of each parameter.
pub fn widths(sh_degree: usize) -> [usize; 5] {
    [3, 3, 4, 1, 3 * (sh_degree + 1).pow(2)]
}

/// The values of each parameter, row-major.
pub fn into_values(gaussians: Gaussians) -> Moments {
    [
        gaussians.means.into_flattened(),
        gaussians.log_scales.into_flattened(),
        gaussians.rotations.into_flattened(),
        gaussians.opacity_logits,
        gaussians.sh,
    ]
}

/// The inverse of [`into_values`].
pub fn from_values(values: Moments, sh_degree: usize) -> Gaussians {
    let [means, log_scales, rotations, opacity_logits, sh] = values;
    Gaussians {
        means: means.as_chunks().0.to_vec(),
        log_scales: log_scales.as_chunks().0.to_vec(),
        rotations: rotations.as_chunks().0.to_vec(),
        opacity_logits,
        sh,
        sh_degree,
    }
}

/// All trained tensors of a scene, each `[N, width]`, with their moments.
#[derive(Clone, Debug)]
pub struct Parameters {
    sh_degree: usize,
    state: [AdamTensors<2>; 5],
}

/// The gradient of `leaf`, `[N, width]`; zeros where it has none.
fn gradient<const D: usize>(leaf: Tensor<D>, gradients: &mut Gradients) -> Tensor<2> {
    let dims = leaf.dims();
    let found = leaf.grad_remove(gradients);
    let gradient = found.unwrap_or_else(|| leaf.inner().zeros_like());
    gradient.reshape([dims[0], dims[1..].iter().product()])
}

/// Gradients of all parameters, each `[N, width]`.
pub struct ParameterGradients([Tensor<2>; 5]);

impl ParameterGradients {
    /// The gradients of `leaves`, which are dropped: they share the buffers of the parameters.
    pub fn of(leaves: RasterInput, gradients: &mut Gradients) -> Self {
        let sh = leaves.sh.expect("parameters have SH");
        Self([
            gradient(leaves.means, gradients),
            gradient(leaves.log_scales, gradients),
            gradient(leaves.rotations, gradients),
            gradient(leaves.opacity_logits, gradients),
            gradient(sh, gradients),
        ])
    }

    /// The sum of both.
    pub fn plus(self, other: Self) -> Self {
        let mut others = other.0.into_iter();
        Self(
            self.0
                .map(|gradient| gradient + others.next().expect("as many parameters")),
        )
    }

    /// The mean of `views` gradients, of which this rank has `own`; zeros for `parameters` where it has none.
    ///
    /// # Errors
    /// [`Error::Device`] when the device does not return them.
    pub fn mean(own: Option<Self>, views: usize, parameters: &Parameters) -> Result<Self> {
        let zeros = |state: &AdamTensors<2>| state.param.zeros_like();
        let mut means = match own {
            Some(own) => own.0,
            None => parameters.state.each_ref().map(zeros),
        };
        for gradient in &mut means {
            let sum = ranks::sum_tensor("gradients", gradient.clone())?;
            *gradient = if views > 1 { sum / views as f64 } else { sum };
        }
        Ok(Self(means))
    }

    /// The value of `loss`, read back together with the check that it and all gradients are finite.
    ///
    /// # Errors
    /// [`Error::NonFinite`] naming the loss, or the gradient and its first bad row.
    pub fn check(&self, loss: Tensor<1>) -> Result<f64> {
        let named: Vec<_> = NAMES.into_iter().zip(&self.0).collect();
        Ok(finite_loss("loss", loss, &named)?.into())
    }
}

/// The value of `loss` (`[1]`), once it and the named `gradients` are known to be finite: one readback.
///
/// # Errors
/// [`Error::NonFinite`] naming the loss, or the gradient and its first bad row; [`Error::Device`] when the device fails.
pub fn finite_loss<const D: usize>(
    name: &str,
    loss: Tensor<1>,
    gradients: &[(&str, &Tensor<D>)],
) -> Result<f32> {
    // A NaN or an infinity always reaches the sum.
    let sums = gradients
        .iter()
        .map(|(_, gradient)| sum_all((*gradient).clone()));
    let all = std::iter::once(loss).chain(sums).collect();
    let found = read("loss", Tensor::cat(all, 0))?;
    if !found[0].is_finite() {
        return Err(Error::non_finite(name, 0));
    }
    // The search clears what was only a sum that overflowed.
    if !found.iter().all(|value| value.is_finite()) {
        for (name, gradient) in gradients {
            find_non_finite(name, gradient)?;
        }
    }
    Ok(found[0])
}

/// Looks at all values of a gradient.
fn find_non_finite<const D: usize>(name: &str, gradient: &Tensor<D>) -> Result<()> {
    let name = format!("gradient of {name}");
    let values = read(&name, gradient.clone())?;
    let width = values.len() / gradient.dims()[0].max(1);
    check_finite(&name, &values, width)
}

impl Parameters {
    /// Puts Gaussians and moments on `device` (without autodiff).
    pub fn new(gaussians: Gaussians, first: Moments, second: Moments, device: &Device) -> Self {
        let n = gaussians.len();
        let sh_degree = gaussians.sh_degree;
        let mut all = [into_values(gaussians), first, second];
        let widths = widths(sh_degree);
        let state = std::array::from_fn(|k| {
            let [param, first, second] = all.each_mut().map(|values| {
                let values = std::mem::take(&mut values[k]);
                upload(values, [n, widths[k]], device)
            });
            AdamTensors {
                param,
                first,
                second,
            }
        });
        Self { sh_degree, state }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.state[MEANS].param.dims()[0]
    }

    /// Handles on the present values, without autodiff, to be rendered in colour.
    pub fn values(&self, active_sh_degree: usize) -> RasterInput {
        let [means, log_scales, rotations, opacity_logits, sh] =
            self.state.each_ref().map(|state| state.param.clone());
        let n = self.len();
        let terms = (self.sh_degree + 1).pow(2);
        RasterInput {
            means,
            log_scales,
            rotations,
            opacity_logits: opacity_logits.reshape([n]),
            sh: Some(sh.reshape([n, terms, 3])),
            active_sh_degree,
            features: None,
            screen: None,
        }
    }

    /// Tracked handles on the present values, to be rendered in colour.
    pub fn leaves(&self, active_sh_degree: usize) -> RasterInput {
        fn tracked<const D: usize>(tensor: Tensor<D>) -> Tensor<D> {
            Tensor::from_inner(tensor).require_grad()
        }
        let values = self.values(active_sh_degree);
        RasterInput {
            means: tracked(values.means),
            log_scales: tracked(values.log_scales),
            rotations: tracked(values.rotations),
            opacity_logits: tracked(values.opacity_logits),
            sh: values.sh.map(tracked),
            ..values
        }
    }

    /// One Adam step of `batch` views, after which there were `views`. `rates` are learning rates of each parameter: one, or one per
    /// column.
    pub fn step(
        &mut self,
        gradients: ParameterGradients,
        rates: &[Vec<f64>; 5],
        views: usize,
        batch: usize,
    ) {
        let updates = self.state.iter_mut().zip(gradients.0).zip(rates);
        for ((state, gradient), rates) in updates {
            let empty = Tensor::empty([0; 2], &gradient.device());
            let emptied = AdamTensors {
                param: empty.clone(),
                first: empty.clone(),
                second: empty,
            };
            // Moved out, so that the step finds buffers that nobody else holds.
            let before = std::mem::replace(state, emptied);
            let step = AdamStep {
                rates: rates.clone(),
                views: views as u32,
                batch: batch as u32,
            };
            *state = adam_step(before, gradient, &Arc::new(step));
        }
    }

    /// The Gaussians without their colours, in one readback.
    ///
    /// # Errors
    /// [`Error::Device`] when the device does not return them.
    pub fn geometry(&self) -> Result<Gaussians> {
        let flat = |state: &AdamTensors<2>| state.param.clone().flatten::<1>(0, 1);
        let parts = self.state[..4].iter().map(flat).collect();
        let mut rest = read("geometry", Tensor::cat(parts, 0))?;
        let mut values = Moments::default();
        for (values, width) in values.iter_mut().zip(widths(0)).take(4) {
            let behind = rest.split_off(width * self.len());
            *values = std::mem::replace(&mut rest, behind);
        }
        Ok(from_values(values, 0))
    }

    /// Keeps `rows`, with their moments.
    pub fn select(&mut self, rows: &[u32]) {
        let rows = indices(rows, &self.state[MEANS].param.device());
        for state in &mut self.state {
            for tensor in [&mut state.param, &mut state.first, &mut state.second] {
                *tensor = tensor.clone().select(0, rows.clone());
            }
        }
    }

    /// Makes the rows those of `densification`.
    pub fn rearrange(&mut self, densification: Densification) {
        let device = self.state[MEANS].param.device();
        let count = densification.rows.len();
        self.select(&densification.rows);
        let is_new = TensorData::new(densification.is_new, [count, 1]);
        let is_new = Tensor::<2, Bool>::from_data(is_new, &device);
        for state in &mut self.state {
            let shape = [count, state.param.dims()[1]];
            for moment in [&mut state.first, &mut state.second] {
                *moment = moment.clone().mask_fill(is_new.clone().expand(shape), 0.0);
            }
        }
        let replaced = [
            (MEANS, densification.means.into_flattened()),
            (LOG_SCALES, densification.log_scales.into_flattened()),
            (OPACITY, densification.opacity_logits),
        ];
        for (k, values) in replaced {
            let param = &mut self.state[k].param;
            *param = upload(values, param.dims(), &device);
        }
    }

    /// Caps every opacity, see [`reset_opacity`], and sets the moments of the opacities to zero.
    ///
    /// # Errors
    /// [`Error::Device`] when the device does not return the opacities.
    pub fn reset_opacity(&mut self) -> Result<()> {
        let state = &mut self.state[OPACITY];
        let mut logits = read(NAMES[OPACITY], state.param.clone())?;
        reset_opacity(&mut logits);
        state.param = upload(logits, state.param.dims(), &state.param.device());
        state.first = state.first.zeros_like();
        state.second = state.second.zeros_like();
        Ok(())
    }

    /// Gaussians, first and second moments, on the host.
    ///
    /// # Errors
    /// [`Error::Device`] when the device does not return them.
    pub fn to_host(&self) -> Result<(Gaussians, Moments, Moments)> {
        let (mut values, mut first, mut second) = <(Moments, Moments, Moments)>::default();
        for (k, state) in self.state.iter().enumerate() {
            values[k] = read(NAMES[k], state.param.clone())?;
            first[k] = read(NAMES[k], state.first.clone())?;
            second[k] = read(NAMES[k], state.second.clone())?;
        }
        Ok((from_values(values, self.sh_degree), first, second))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::device::{BackendName, device_of_tests};

    #[test]
    fn one_value_that_is_not_finite_is_seen() {
        let names = BackendName::compiled().iter();
        for device in names.filter_map(|&name| device_of_tests(name)) {
            let tensor = |values: Vec<f32>| upload(values.clone(), [values.len()], &device);
            let look = |loss: f32, bad: Option<(usize, f32)>| {
                let gradients = [1, 700, 5000].map(|length| {
                    let wave = |i: usize| 2e30 * (i as f32 * 1.7 + 0.3).sin();
                    let mut values: Vec<f32> = (0..length).map(wave).collect();
                    if let Some((place, value)) = bad.filter(|_| length == 700) {
                        values[place] = value;
                    }
                    (format!("the {length}"), tensor(values))
                });
                let named = gradients
                    .each_ref()
                    .map(|(name, tensor)| (name.as_str(), tensor));
                finite_loss("loss", tensor(vec![loss]), &named)
            };
            assert_eq!(look(0.25, None).expect("finite"), 0.25, "{device:?}");
            for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                for place in [0, 333, 699] {
                    let error = look(0.25, Some((place, value))).expect_err("not finite");
                    let want = Error::non_finite("gradient of the 700", place);
                    assert_eq!(error.to_string(), want.to_string(), "{value} on {device:?}");
                }
                let error = look(value, None).expect_err("not finite");
                let want = Error::non_finite("loss", 0);
                assert_eq!(error.to_string(), want.to_string(), "{value} on {device:?}");
            }
            // Only the sum overflows.
            let huge = tensor(vec![f32::MAX; 700]);
            let found = finite_loss("loss", tensor(vec![0.5]), &[("huge", &huge)]);
            assert_eq!(found.expect("finite"), 0.5, "{device:?}");
            let none: [(&str, &Tensor<1>); 0] = [];
            let found = finite_loss("loss", tensor(vec![7.0]), &none);
            assert_eq!(found.expect("finite"), 7.0, "{device:?}");
        }
    }
}

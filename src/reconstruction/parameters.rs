//! The Gaussians as tensors on the device, with the moments of their optimiser.

use super::densify::reset_opacity;
use super::noise::PositionNoise;
use crate::backend::device::read;
use crate::error::{Error, Result};
use crate::ops::{AdamStep, AdamTensors, FiniteCheck, adam_step};
use crate::raster::{ListCount, SplatTensors};
use crate::splat::Gaussians;
use burn::tensor::{Bool, Device, Gradients, Int, Tensor, TensorData};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Names of the parameters, in the order of [`Moments`].
pub const NAMES: [&str; 5] = ["means", "log_scales", "rotations", "opacity_logits", "sh"];

/// Place of the opacity logits in [`Moments`].
pub const OPACITY: usize = 3;

/// One value for each scalar of each parameter: a first or second moment, row-major.
pub type Moments = [Vec<f32>; 5];

/// Learning rates of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Of the means, world units.
    pub means: f64,
    /// Of the log-scales.
    pub log_scales: f64,
    /// Of the rotations.
    pub rotations: f64,
    /// Of the opacity logits.
    pub opacity_logits: f64,
    /// Of the SH constant term.
    pub sh_dc: f64,
    /// Of the higher SH terms.
    pub sh_rest: f64,
}

/// The rows of a densified set: for each the old row that it comes from, and whether its moments start at zero.
#[derive(Clone, Debug)]
pub struct RowMap {
    rows: Tensor<1, Int>,
    is_new: Tensor<1, Bool>,
}

impl RowMap {
    /// From old row and newness of each new row.
    pub fn new(sources: impl Iterator<Item = (u32, bool)>, device: &Device) -> Self {
        let (rows, is_new): (Vec<i32>, Vec<bool>) =
            sources.map(|(row, is_new)| (row as i32, is_new)).unzip();
        let shape = [rows.len()];
        Self {
            rows: Tensor::from_data(TensorData::new(rows, shape), device),
            is_new: Tensor::from_data(TensorData::new(is_new, shape), device),
        }
    }

    /// New rows.
    pub fn len(&self) -> usize {
        self.rows.dims()[0]
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A tensor that is trained.
#[derive(Clone, Debug)]
struct Parameter<const D: usize> {
    name: &'static str,
    state: AdamTensors<D>,
}

impl<const D: usize> Parameter<D> {
    fn new(
        name: &'static str,
        shape: [usize; D],
        [value, first, second]: [Vec<f32>; 3],
        device: &Device,
    ) -> Self {
        let tensor = |values| Tensor::from_data(TensorData::new(values, shape), device);
        Self {
            name,
            state: AdamTensors {
                param: tensor(value),
                first: tensor(first),
                second: tensor(second),
            },
        }
    }

    /// A tracked handle on the present value.
    fn leaf(&self) -> Tensor<D> {
        Tensor::from_inner(self.state.param.clone()).require_grad()
    }

    fn gradient(&self, leaf: &Tensor<D>, gradients: &mut Gradients) -> Tensor<D> {
        leaf.grad_remove(gradients)
            .unwrap_or_else(|| self.state.param.zeros_like())
    }

    fn step(&mut self, gradient: Tensor<D>, rates: Vec<f64>, step: u32) {
        let empty = Tensor::empty([0; D], &gradient.device());
        let emptied = AdamTensors {
            param: empty.clone(),
            first: empty.clone(),
            second: empty,
        };
        // moved out, so that the step finds buffers nobody else holds
        let state = std::mem::replace(&mut self.state, emptied);
        self.state = adam_step(state, gradient, &Arc::new(AdamStep::splatting(rates, step)));
    }

    /// Takes the rows of `map`, or `values` in their place. The moments of new rows are zero.
    fn rearrange(&mut self, map: &RowMap, values: Option<Vec<f32>>) {
        let AdamTensors {
            param,
            first,
            second,
        } = &mut self.state;
        let mut shape = param.dims();
        shape[0] = map.len();
        *param = match values {
            Some(values) => Tensor::from_data(TensorData::new(values, shape), &param.device()),
            None => param.clone().select(0, map.rows.clone()),
        };
        let mut column = [1; D];
        column[0] = map.len();
        let is_new = map.is_new.clone().reshape(column).expand(shape);
        for moment in [first, second] {
            let rows = moment.clone().select(0, map.rows.clone());
            *moment = rows.mask_fill(is_new.clone(), 0.0);
        }
    }

    /// Value and moments, moved to the host.
    fn into_host(self) -> Result<[Vec<f32>; 3]> {
        Ok([
            read(self.name, self.state.param)?,
            read(self.name, self.state.first)?,
            read(self.name, self.state.second)?,
        ])
    }
}

/// Looks at all values of a gradient.
///
/// # Errors
/// [`Error::NonFinite`] naming the tensor and its first bad row.
pub fn find_non_finite<const D: usize>(name: &str, gradient: &Tensor<D>) -> Result<()> {
    let name = format!("gradient of {name}");
    let values = read(&name, gradient.clone())?;
    let width = (values.len() / gradient.dims()[0].max(1)).max(1);
    match values.iter().position(|v| !v.is_finite()) {
        Some(i) => Err(Error::non_finite(name, i / width)),
        None => Ok(()),
    }
}

/// All trained tensors of a scene.
#[derive(Clone, Debug)]
pub struct Parameters {
    sh_degree: usize,
    means: Parameter<2>,
    log_scales: Parameter<2>,
    rotations: Parameter<2>,
    opacity_logits: Parameter<1>,
    sh: Parameter<3>,
}

/// Tracked handles on the parameters, for one pass.
#[derive(Clone, Debug)]
pub struct Leaves {
    /// `[N, 3]`.
    pub means: Tensor<2>,
    /// `[N, 3]`.
    pub log_scales: Tensor<2>,
    /// `[N, 4]`.
    pub rotations: Tensor<2>,
    /// `[N]`.
    pub opacity_logits: Tensor<1>,
    /// `[N, K, 3]`.
    pub sh: Tensor<3>,
}

/// What a densification gives its Gaussians in place of what they had, row-major, `R` rows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NewValues {
    /// `[R, 3]`.
    pub means: Option<Vec<[f32; 3]>>,
    /// `[R, 3]`.
    pub log_scales: Option<Vec<[f32; 3]>>,
    /// `[R]`.
    pub opacity_logits: Option<Vec<f32>>,
}

/// Gradients of all parameters.
pub struct ParameterGradients {
    means: Tensor<2>,
    log_scales: Tensor<2>,
    rotations: Tensor<2>,
    opacity_logits: Tensor<1>,
    sh: Tensor<3>,
}

impl ParameterGradients {
    /// The value of `loss`, after a look at it and at all gradients: one readback, in which the tile lists' count comes too. `None`
    /// where the lists were not as they should be.
    ///
    /// # Errors
    /// [`Error::NonFinite`] naming the loss, or the gradient and its first bad row.
    pub fn check(&self, loss: Tensor<1>, tile_lists: Tensor<1>) -> Result<Option<Checked>> {
        let Self {
            means,
            log_scales,
            rotations,
            opacity_logits,
            sh,
        } = self;
        let mut check = FiniteCheck::default();
        check.add(means);
        check.add(log_scales);
        check.add(rotations);
        check.add(opacity_logits);
        check.add(sh);
        let (value, finite, lists) = check.read_with(loss, Some(tile_lists))?;
        let lists = ListCount::from_values(&lists);
        if lists.is_some_and(|lists| !lists.is_sound) {
            return Ok(None);
        }
        if !value.is_finite() {
            return Err(Error::non_finite("loss", 0));
        }
        // What was a sum beyond its type the search clears.
        if !finite {
            find_non_finite(NAMES[0], means)?;
            find_non_finite(NAMES[1], log_scales)?;
            find_non_finite(NAMES[2], rotations)?;
            find_non_finite(NAMES[OPACITY], opacity_logits)?;
            find_non_finite(NAMES[4], sh)?;
        }
        Ok(Some(Checked {
            loss: value.into(),
            entries: lists.map(|lists| lists.entries),
        }))
    }
}

/// What a look at loss and gradients found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Checked {
    /// The value of the loss.
    pub loss: f64,
    /// Entries of the tile lists, where a GPU counted them.
    pub entries: Option<usize>,
}

/// Zero moments for these Gaussians.
pub fn zero_moments(gaussians: &Gaussians) -> Moments {
    widths(gaussians).map(|width| vec![0.0; gaussians.len() * width])
}

/// Scalars of a row of each parameter.
pub fn widths(gaussians: &Gaussians) -> [usize; 5] {
    [3, 3, 4, 1, 3 * gaussians.sh_len()]
}

impl Parameters {
    /// Puts Gaussians and moments on `device` (without autodiff).
    pub fn new(gaussians: Gaussians, first: Moments, second: Moments, device: &Device) -> Self {
        let (n, k) = (gaussians.len(), gaussians.sh_len());
        let Gaussians {
            means,
            log_scales,
            rotations,
            opacity_logits,
            sh,
            sh_degree,
        } = gaussians;
        let [m0, m1, m2, m3, m4] = first;
        let [v0, v1, v2, v3, v4] = second;
        Self {
            sh_degree,
            means: Parameter::new(NAMES[0], [n, 3], [means.into_flattened(), m0, v0], device),
            log_scales: Parameter::new(
                NAMES[1],
                [n, 3],
                [log_scales.into_flattened(), m1, v1],
                device,
            ),
            rotations: Parameter::new(
                NAMES[2],
                [n, 4],
                [rotations.into_flattened(), m2, v2],
                device,
            ),
            opacity_logits: Parameter::new(NAMES[3], [n], [opacity_logits, m3, v3], device),
            sh: Parameter::new(NAMES[4], [n, k, 3], [sh, m4, v4], device),
        }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.state.param.dims()[0]
    }

    /// Tracked handles on the present values.
    pub fn leaves(&self) -> Leaves {
        Leaves {
            means: self.means.leaf(),
            log_scales: self.log_scales.leaf(),
            rotations: self.rotations.leaf(),
            opacity_logits: self.opacity_logits.leaf(),
            sh: self.sh.leaf(),
        }
    }

    /// What `gradients` hold for `leaves`, which are let go: they share the parameters' buffers.
    pub fn gradients(&self, leaves: Leaves, gradients: &mut Gradients) -> ParameterGradients {
        ParameterGradients {
            means: self.means.gradient(&leaves.means, gradients),
            log_scales: self.log_scales.gradient(&leaves.log_scales, gradients),
            rotations: self.rotations.gradient(&leaves.rotations, gradients),
            opacity_logits: self
                .opacity_logits
                .gradient(&leaves.opacity_logits, gradients),
            sh: self.sh.gradient(&leaves.sh, gradients),
        }
    }

    /// One Adam step, number `step` from 1.
    pub fn step(&mut self, gradients: ParameterGradients, rates: &Rates, step: u32) {
        let ParameterGradients {
            means,
            log_scales,
            rotations,
            opacity_logits,
            sh,
        } = gradients;
        let mut sh_rates = vec![rates.sh_rest; 3 * (self.sh_degree + 1).pow(2)];
        sh_rates[..3].fill(rates.sh_dc);
        self.means.step(means, vec![rates.means], step);
        self.log_scales
            .step(log_scales, vec![rates.log_scales], step);
        self.rotations.step(rotations, vec![rates.rotations], step);
        self.opacity_logits
            .step(opacity_logits, vec![rates.opacity_logits], step);
        self.sh.step(sh, sh_rates, step);
    }

    /// Adds noise to the means.
    pub fn add_noise(&mut self, noise: &PositionNoise, rng: &mut ChaCha8Rng) {
        let splats = SplatTensors {
            means: self.means.state.param.clone(),
            log_scales: self.log_scales.state.param.clone(),
            rotations: self.rotations.state.param.clone(),
            opacity_logits: self.opacity_logits.state.param.clone(),
        };
        self.means.state.param = noise.apply(&splats, rng);
    }

    /// All means, then all log-scales, rotations and opacity logits, in one readback; see
    /// [`crate::splat::Geometry::of_values`].
    ///
    /// # Errors
    /// [`Error::Device`] when the device does not give them back.
    pub fn geometry(&self) -> Result<Vec<f32>> {
        let n = self.len();
        let parts = vec![
            self.means.state.param.clone().reshape([3 * n]),
            self.log_scales.state.param.clone().reshape([3 * n]),
            self.rotations.state.param.clone().reshape([4 * n]),
            self.opacity_logits.state.param.clone(),
        ];
        read("geometry", Tensor::cat(parts, 0))
    }

    /// The rows that `map` names, in its order, with `values` where they are given. Moments of new rows are zero.
    pub fn rearrange(&mut self, map: &RowMap, values: NewValues) {
        let NewValues {
            means,
            log_scales,
            opacity_logits,
        } = values;
        self.means.rearrange(map, means.map(Vec::into_flattened));
        self.log_scales
            .rearrange(map, log_scales.map(Vec::into_flattened));
        self.rotations.rearrange(map, None);
        self.opacity_logits.rearrange(map, opacity_logits);
        self.sh.rearrange(map, None);
    }

    /// Caps every opacity, see [`reset_opacity`], and forgets the opacities' moments.
    ///
    /// # Errors
    /// [`Error::Device`] when the device does not give the opacities back.
    pub fn reset_opacity(&mut self) -> Result<()> {
        let AdamTensors {
            param,
            first,
            second,
        } = &mut self.opacity_logits.state;
        let mut logits = read(NAMES[OPACITY], param.clone())?;
        reset_opacity(&mut logits);
        *param = Tensor::from_data(TensorData::new(logits, param.dims()), &param.device());
        [*first, *second] = [first.zeros_like(), second.zeros_like()];
        Ok(())
    }

    /// Gaussians and both moments, on the host.
    ///
    /// # Errors
    /// [`Error::Device`] when the device does not give them back.
    pub fn into_host(self) -> Result<(Gaussians, Moments, Moments)> {
        let [means, m0, v0] = self.means.into_host()?;
        let [log_scales, m1, v1] = self.log_scales.into_host()?;
        let [rotations, m2, v2] = self.rotations.into_host()?;
        let [opacity_logits, m3, v3] = self.opacity_logits.into_host()?;
        let [sh, m4, v4] = self.sh.into_host()?;
        let gaussians = Gaussians {
            means: means.as_chunks().0.to_vec(),
            log_scales: log_scales.as_chunks().0.to_vec(),
            rotations: rotations.as_chunks().0.to_vec(),
            opacity_logits,
            sh,
            sh_degree: self.sh_degree,
        };
        Ok((gaussians, [m0, m1, m2, m3, m4], [v0, v1, v2, v3, v4]))
    }
}

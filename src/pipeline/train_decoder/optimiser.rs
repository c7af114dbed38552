//! Adam over all parameters of a burn module, with state that a checkpoint can hold exactly.

use crate::error::{Error, Result};
use crate::ops::{AdamStep, AdamTensors, FiniteCheck, adam_step};
use crate::reconstruction::optimizer::find_non_finite;
use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Gradients, Tensor, TensorData};
use std::sync::Arc;

/// Named flat tensors, as checkpoints store them.
pub type NamedValues = Vec<(String, Vec<f32>)>;

/// Adam (betas 0.9 and 0.999, eps 1e-8) with one pair of moments per parameter, in the module's own order.
#[derive(Clone, Debug)]
pub struct ModuleAdam {
    rate: f64,
    steps: i32,
    /// Absent only while a step is at work on them.
    moments: Vec<Option<[Tensor<1>; 2]>>,
    /// Step from which on parameters are averaged.
    average_from: Option<i32>,
    averages: Vec<Tensor<1>>,
}

const BETAS: [f64; 2] = [0.9, 0.999];
const EPSILON: f64 = 1e-8;

impl ModuleAdam {
    /// Fresh state.
    pub fn new(rate: f64) -> Self {
        Self {
            rate,
            steps: 0,
            moments: Vec::new(),
            average_from: None,
            averages: Vec::new(),
        }
    }

    /// Keeps the mean of the parameters over all steps after the first `from` (Polyak and Juditsky 1992).
    #[must_use]
    pub fn averaging(self, from: usize) -> Self {
        Self {
            average_from: Some(from as i32),
            ..self
        }
    }

    /// `module` with the mean of its parameters; as it is where nothing was averaged yet.
    pub fn averaged<M: Module>(&self, module: M) -> M {
        let averages = self.averages.clone();
        if averages.is_empty() {
            return module;
        }
        let name = |i: usize| format!("p.{i}");
        let means: std::collections::HashMap<_, _> = averages
            .into_iter()
            .enumerate()
            .map(|(i, mean)| (name(i), values(mean)))
            .collect();
        with_parameters(module.clone(), &|name| means.get(name).cloned()).unwrap_or(module)
    }

    /// The value of `loss`, after a look at it and at all gradients of `module`: one readback.
    ///
    /// # Errors
    /// [`Error::NonFinite`] naming the loss, or the parameter whose gradient holds a NaN or an infinity; [`Error::Device`] when
    /// the device fails.
    pub fn check<M: Module>(module: &M, loss: Tensor<1>, gradients: &Gradients) -> Result<f32> {
        let mut check = FiniteCheck::default();
        module.visit(&mut Look {
            gradients,
            path: Vec::new(),
            at: &mut |_, gradient| check.add(&gradient),
        });
        let (value, finite) = check.read(loss)?;
        if !value.is_finite() {
            return Err(Error::non_finite("segmentation loss", 0));
        }
        let mut bad = Ok(());
        if !finite {
            let mut find = |path: &[String], gradient: Tensor<2>| {
                if bad.is_ok() {
                    bad = find_non_finite(&path.join("."), &gradient);
                }
            };
            module.visit(&mut Look {
                gradients,
                path: Vec::new(),
                at: &mut find,
            });
        }
        bad.map(|()| value)
    }

    /// One step of every parameter that has a gradient, at `factor` times the learning rate.
    pub fn step<M: Module>(&mut self, module: M, gradients: &mut Gradients, factor: f64) -> M {
        self.steps += 1;
        let [beta1, beta2] = BETAS;
        let rates = vec![self.rate * factor];
        let step = Arc::new(AdamStep {
            rates,
            beta1,
            beta2,
            epsilon: EPSILON,
            step: self.steps as u32,
        });
        module.map(&mut Step {
            adam: self,
            gradients,
            step,
            place: 0,
        })
    }

    /// Moments and step count, named `m.0`, `v.0`, ... and `steps`.
    pub fn state(&self) -> NamedValues {
        let mut out = vec![("steps".to_owned(), vec![self.steps as f32])];
        for (i, [m, v]) in self.moments.iter().flatten().enumerate() {
            out.push((format!("m.{i}"), values(m.clone())));
            out.push((format!("v.{i}"), values(v.clone())));
        }
        for (i, mean) in self.averages.iter().enumerate() {
            out.push((format!("mean.{i}"), values(mean.clone())));
        }
        out
    }

    /// Takes back what [`ModuleAdam::state`] gave, on `device`. `None` when a name is missing.
    pub fn with_state(
        mut self,
        state: &dyn Fn(&str) -> Option<Vec<f32>>,
        device: &burn::tensor::Device,
    ) -> Option<Self> {
        let plain = device.clone().inner();
        let tensor =
            |v: Vec<f32>| Tensor::<1>::from_data(TensorData::new(v.clone(), [v.len()]), &plain);
        self.steps = *state("steps")?.first()? as i32;
        self.moments.clear();
        while let (Some(m), Some(v)) = (
            state(&format!("m.{}", self.moments.len())),
            state(&format!("v.{}", self.moments.len())),
        ) {
            self.moments.push(Some([tensor(m), tensor(v)]));
        }
        self.averages.clear();
        while let Some(mean) = state(&format!("mean.{}", self.averages.len())) {
            self.averages.push(tensor(mean));
        }
        Some(self)
    }
}

impl ModuleAdam {
    fn average(&mut self, place: usize, value: Tensor<1>) {
        let Some(count) = self
            .average_from
            .map(|from| self.steps - from)
            .filter(|count| *count > 0)
        else {
            return;
        };
        match self.averages.get_mut(place) {
            Some(mean) => {
                let before = mean.clone();
                *mean = before.clone() + (value - before) / f64::from(count);
            }
            None => self.averages.push(value),
        }
    }
}

/// Host values of a tensor, flattened.
pub fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor
        .into_data()
        .convert::<f32>()
        .into_vec()
        .unwrap_or_default()
}

struct Step<'a> {
    adam: &'a mut ModuleAdam,
    gradients: &'a mut Gradients,
    step: Arc<AdamStep>,
    place: usize,
}

impl ModuleMapper for Step<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let place = self.place;
        self.place += 1;
        param.map(|tensor| {
            if self.adam.moments.len() <= place {
                self.adam.moments.push(None);
            }
            let param = tensor.clone().inner().flatten(0, D - 1);
            let Some(gradient) = tensor.grad_remove(self.gradients) else {
                self.adam.average(place, param);
                return tensor;
            };
            let shape = gradient.dims();
            let g = gradient.flatten::<1>(0, D - 1);
            // taken, not cloned: buffers that nobody else holds are updated in place
            let moments = self.adam.moments[place].take();
            let [first, second] =
                moments.unwrap_or_else(|| [param.zeros_like(), param.zeros_like()]);
            drop(tensor);
            let state = AdamTensors {
                param,
                first,
                second,
            };
            let AdamTensors {
                param,
                first,
                second,
            } = adam_step(state, g, &self.step);
            self.adam.moments[place] = Some([first, second]);
            self.adam.average(place, param.clone());
            let moved = param.reshape(shape);
            Tensor::from_inner(moved).require_grad()
        })
    }
}

/// Shows the gradients of all parameters, `[rows, scalars of a row]`, with their place in the module.
struct Look<'a> {
    gradients: &'a Gradients,
    path: Vec<String>,
    at: &'a mut dyn FnMut(&[String], Tensor<2>),
}

impl ModuleVisitor for Look<'_> {
    fn enter_module(&mut self, name: &str, _container: &str) {
        self.path.push(name.to_owned());
    }
    fn exit_module(&mut self, _name: &str, _container: &str) {
        self.path.pop();
    }
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = param.val().grad(self.gradients) {
            let (rows, count) = (
                gradient.dims()[0].max(1),
                gradient.dims().iter().product::<usize>(),
            );
            (self.at)(&self.path, gradient.reshape([rows, count / rows]));
        }
    }
}

/// Takes the gradients of the parameters of `module` out of `part` and adds them to those in `gradients`.
pub fn add_gradients<M: Module>(module: &M, part: &mut Gradients, gradients: &mut Gradients) {
    struct Add<'a>([&'a mut Gradients; 2]);
    impl ModuleVisitor for Add<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let ([part, gradients], param) = (&mut self.0, param.val());
            let Some(more) = param.grad_remove(part) else {
                return;
            };
            let sum = match param.grad_remove(gradients) {
                Some(sum) => sum + more,
                None => more,
            };
            param.grad_replace(gradients, sum);
        }
    }
    module.visit(&mut Add([part, gradients]));
}

/// Host values of all parameters of a module, in its own order, named `p.0`, `p.1`, ...
pub fn parameters<M: Module>(module: &M) -> NamedValues {
    struct Read(NamedValues);
    impl ModuleVisitor for Read {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            self.0
                .push((format!("p.{}", self.0.len()), values(param.val())));
        }
    }
    let mut read = Read(Vec::new());
    module.visit(&mut read);
    read.0
}

/// The module with the parameters that [`parameters`] gave; `None` when one is missing or has another length.
pub fn with_parameters<M: Module>(
    module: M,
    state: &dyn Fn(&str) -> Option<Vec<f32>>,
) -> Option<M> {
    struct Write<'a> {
        state: &'a dyn Fn(&str) -> Option<Vec<f32>>,
        place: usize,
        complete: bool,
    }
    impl ModuleMapper for Write<'_> {
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            let stored = (self.state)(&format!("p.{}", self.place));
            self.place += 1;
            param.map(|tensor| {
                let shape = tensor.dims();
                match stored.filter(|v| v.len() == shape.iter().product::<usize>()) {
                    Some(v) => {
                        let device = tensor.device().inner();
                        let fresh = Tensor::<D>::from_data(TensorData::new(v, shape), &device);
                        if tensor.is_require_grad() {
                            Tensor::from_inner(fresh).require_grad()
                        } else {
                            fresh
                        }
                    }
                    None => {
                        self.complete = false;
                        tensor
                    }
                }
            })
        }
    }
    let mut write = Write {
        state,
        place: 0,
        complete: true,
    };
    let module = module.map(&mut write);
    write.complete.then_some(module)
}

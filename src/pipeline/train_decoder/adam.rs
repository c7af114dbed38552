//! The parameters of a burn module as one vector, and Adam over it.

use crate::backend::device::{read, upload};
use crate::error::Result;
use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::optim::{AdamConfig, AdamState, AdaptiveMomentumState, Optimizer};
use burn::tensor::{Device, Gradients, Tensor};

/// Added to the root of the second moment.
const EPSILON: f32 = 1e-8;

/// Named vectors, as checkpoints store them.
pub type NamedValues = Vec<(String, Vec<f32>)>;

/// burn's Adam over all parameters of a module, and the mean of the parameters over the last steps.
#[derive(Clone)]
pub struct Adam {
    /// Learning rate at its highest.
    pub rate: f64,
    steps: usize,
    /// Both moments, `[P]`; absent before the first step.
    state: Option<AdamState<1>>,
    /// Step after which the parameters are averaged.
    average_from: Option<usize>,
    mean: Option<Tensor<1>>,
}

impl Adam {
    /// Fresh state at learning rate `rate`. Keeps the mean of the parameters over the steps after `average_from`
    /// (Polyak and Juditsky 1992).
    pub fn new(rate: f64, average_from: Option<usize>) -> Self {
        Self {
            rate,
            steps: 0,
            state: None,
            average_from,
            mean: None,
        }
    }

    /// Moves `module` against `gradient` `[P]` at `factor` times the learning rate.
    pub fn step<M: Module>(&mut self, module: M, gradient: Tensor<1>, factor: f64) -> M {
        self.steps += 1;
        let adam = AdamConfig::new().with_epsilon(EPSILON).build();
        let rate = self.rate * factor;
        let (moved, state) = adam.step(rate, parameters(&module), gradient, self.state.take());
        self.state = state;
        self.average(&moved);
        with_parameters(module, moved)
    }

    fn average(&mut self, parameters: &Tensor<1>) {
        let averaged = self
            .average_from
            .map_or(0, |from| self.steps.saturating_sub(from));
        if averaged > 0 {
            self.mean = Some(match self.mean.take() {
                Some(mean) => mean.clone() + (parameters.clone() - mean) / averaged as f64,
                None => parameters.clone(),
            });
        }
    }

    /// `module` with the mean of its parameters; as it is where nothing was averaged yet.
    pub fn averaged<M: Module>(&self, module: M) -> M {
        match &self.mean {
            Some(mean) => with_parameters(module, mean.clone()),
            None => module,
        }
    }

    /// Step count, moments and mean.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not return them.
    pub fn state(&self) -> Result<NamedValues> {
        let mut named = vec![("steps".to_owned(), vec![self.steps as f32])];
        if let Some(AdamState { momentum }) = &self.state {
            let moments = [&momentum.moment_1, &momentum.moment_2];
            for (name, moment) in ["first moment", "second moment"].iter().zip(moments) {
                named.push(((*name).to_owned(), read(name, moment.clone())?));
            }
        }
        if let Some(mean) = &self.mean {
            named.push(("mean".to_owned(), read("mean", mean.clone())?));
        }
        Ok(named)
    }

    /// Restores the state of [`Adam::state`] on `device`. `None` when a name is missing.
    pub fn restore(
        &mut self,
        state: &dyn Fn(&str) -> Option<Vec<f32>>,
        device: &Device,
    ) -> Option<()> {
        let vector = |name: &str| Some(vector(state(name)?, device));
        self.steps = *state("steps")?.first()? as usize;
        self.state = match self.steps {
            0 => None,
            time => {
                let [first, second] = [vector("first moment")?, vector("second moment")?];
                let momentum = AdaptiveMomentumState::new(time, first, second);
                Some(AdamState::new(momentum))
            }
        };
        self.mean = vector("mean");
        Some(())
    }
}

/// A vector on `device`, without autodiff.
fn vector(values: Vec<f32>, device: &Device) -> Tensor<1> {
    let shape = [values.len()];
    upload(values, shape, &device.clone().inner())
}

/// The parameters of `module` in its own order, `[P]`, without autodiff.
pub fn parameters<M: Module>(module: &M) -> Tensor<1> {
    struct Flatten(Vec<Tensor<1>>);
    impl ModuleVisitor for Flatten {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            self.0.push(param.val().inner().flatten(0, D - 1));
        }
    }
    let mut flatten = Flatten(Vec::new());
    module.visit(&mut flatten);
    Tensor::cat(flatten.0, 0)
}

/// The gradients of the parameters of `module` in its own order, `[P]`; 0 where `gradients` has none. They leave `gradients`.
pub fn parameter_gradients<M: Module>(module: &M, gradients: &mut Gradients) -> Tensor<1> {
    struct Flatten<'a>(&'a mut Gradients, Vec<Tensor<1>>);
    impl ModuleVisitor for Flatten<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let value = param.val();
            let gradient = value.grad_remove(self.0);
            let gradient = gradient.unwrap_or_else(|| value.inner().zeros_like());
            self.1.push(gradient.flatten(0, D - 1));
        }
    }
    let mut flatten = Flatten(gradients, Vec::new());
    module.visit(&mut flatten);
    Tensor::cat(flatten.1, 0)
}

/// `module` with the parameters `values` `[P]`, in the order of [`parameters`].
pub fn with_parameters<M: Module>(module: M, values: Tensor<1>) -> M {
    struct Unflatten(Tensor<1>, usize);
    impl ModuleMapper for Unflatten {
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            param.map(|old| {
                let shape = old.shape();
                let first = self.1;
                let count = shape.num_elements();
                self.1 += count;
                let new = self.0.clone().narrow(0, first, count).reshape(shape);
                if old.is_require_grad() {
                    Tensor::from_inner(new).require_grad()
                } else {
                    new
                }
            })
        }
    }
    module.map(&mut Unflatten(values, 0))
}

/// `module` with the parameters `values`; `None` where it has another number of them.
pub fn restored<M: Module>(module: M, values: Vec<f32>, device: &Device) -> Option<M> {
    (values.len() == module.num_params()).then(|| with_parameters(module, vector(values, device)))
}

//! The parameters of a burn module as one vector, and Adam over it.

use crate::backend::device::{read, upload};
use crate::checkpoint::Checkpoint;
use crate::error::Result;
use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::optim::{AdamConfig, AdamState, AdaptiveMomentumState, Optimizer};
use burn::tensor::{Gradients, Tensor};

/// Added to the root of the second moment.
const EPSILON: f32 = 1e-8;
/// What both moments keep in a step of one view.
const BETAS: [f32; 2] = [0.9, 0.999];
/// Names of the vectors in a checkpoint.
const FIRST: &str = "first moment";
const SECOND: &str = "second moment";
const MEAN: &str = "mean";

/// burn's Adam over all parameters of a module, and the mean of the parameters over the last steps.
#[derive(Clone)]
pub struct Adam {
    /// Learning rate at its highest, for steps of one view.
    pub rate: f64,
    /// Views of a step.
    batch: usize,
    steps: usize,
    /// Both moments, `[P]`; absent before the first step.
    state: Option<AdamState<1>>,
    /// Steps after which the parameters are averaged.
    average_from: Option<usize>,
    mean: Option<Tensor<1>>,
}

impl Adam {
    /// Fresh state at learning rate `rate`, for steps of `batch` views. Keeps the mean of the parameters over the steps after
    /// `average_from` views (Polyak and Juditsky 1992).
    pub fn new(rate: f64, batch: usize, average_from: Option<usize>) -> Self {
        Self {
            rate,
            batch,
            steps: 0,
            state: None,
            average_from: average_from.map(|views| views.div_ceil(batch)),
            mean: None,
        }
    }

    /// Moves `module` against the mean `gradient` `[P]` of a batch at `factor` times the learning rate. Rate and decay follow from
    /// those of one view as in Grendel-GS (Zhao et al. 2024).
    pub fn step<M: Module>(&mut self, module: M, gradient: Tensor<1>, factor: f64) -> M {
        self.steps += 1;
        let [beta1, beta2] = BETAS.map(|beta| beta.powi(self.batch as i32));
        let adam = AdamConfig::new().with_epsilon(EPSILON);
        let adam = adam.with_beta_1(beta1).with_beta_2(beta2).build();
        let rate = self.rate * factor * (self.batch as f64).sqrt();
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

    /// Puts step count, moments and mean into `checkpoint`.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not return them.
    pub fn save(&self, checkpoint: &mut Checkpoint) -> Result<()> {
        checkpoint.set("steps", &self.steps)?;
        checkpoint.set("averaged", &self.mean.is_some())?;
        if let Some(AdamState { momentum }) = &self.state {
            save_vector(checkpoint, FIRST, momentum.moment_1.clone())?;
            save_vector(checkpoint, SECOND, momentum.moment_2.clone())?;
        }
        if let Some(mean) = &self.mean {
            save_vector(checkpoint, MEAN, mean.clone())?;
        }
        Ok(())
    }

    /// Takes the state of [`Adam::save`] out of `checkpoint`, for as many parameters as `like` has, to its device.
    ///
    /// # Errors
    /// As [`Checkpoint::take`] and [`Checkpoint::get`].
    pub fn load(&mut self, checkpoint: &mut Checkpoint, like: &Tensor<1>) -> Result<()> {
        self.steps = checkpoint.get("steps")?;
        let averaged: bool = checkpoint.get("averaged")?;
        let mut vector = |name| load_vector(checkpoint, name, like);
        self.state = match self.steps {
            0 => None,
            time => {
                let momentum = AdaptiveMomentumState::new(time, vector(FIRST)?, vector(SECOND)?);
                Some(AdamState::new(momentum))
            }
        };
        self.mean = averaged.then(|| vector(MEAN)).transpose()?;
        Ok(())
    }
}

/// Puts a vector into `checkpoint`.
pub fn save_vector(checkpoint: &mut Checkpoint, name: &str, vector: Tensor<1>) -> Result<()> {
    let values = read(name, vector)?;
    checkpoint.put(name, &[values.len()], values)
}

/// Takes a vector as long as `like` out of `checkpoint`, to its device.
pub fn load_vector(checkpoint: &mut Checkpoint, name: &str, like: &Tensor<1>) -> Result<Tensor<1>> {
    let values = checkpoint.take(name, &like.dims())?;
    Ok(upload(values, like.dims(), &like.device()))
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

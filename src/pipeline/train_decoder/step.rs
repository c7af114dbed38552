//! A step of stage two: the passes over its views, and what follows from them together.

use super::adam::parameters;
use super::sampling::view_at;
use super::{IdentityModel, Measurement, Rendered, Training, TrainingPlan, TrainingViews};
use crate::backend::device::read;
use crate::checkpoint::Scalar;
use crate::error::{Error, Result};
use crate::random::{Purpose, stream};
use crate::ranks;
use crate::reconstruction::optimizer::finite_loss;
use crate::segmentation::loss::CoSegLoss;
use burn::tensor::Tensor;
use sha2::{Digest, Sha256};
use std::ops::Range;

/// What one view says of the parameters.
struct Pass {
    /// `[P]`.
    gradient: Tensor<1>,
    loss: f32,
    measured: Measurement,
}

impl<M: IdentityModel> Training<M> {
    /// One step: the next iterations, as many as a batch has, divided among [ranks]. Returns their mean loss, 0 for views
    /// without labelled pixels.
    ///
    /// # Errors
    /// [`Error::NonFinite`] naming view and iteration, [`Error::Limit`] and [`Error::Device`] where a GPU fails. The model is
    /// unchanged then.
    pub fn step(&mut self, views: &mut TrainingViews, plan: &TrainingPlan) -> Result<f32> {
        let batch = self.batch(plan);
        let mut sum: Option<Tensor<1>> = None;
        let mut measured = Measurement::none(self.recall.0.len());
        // Of losses, and of views with labelled pixels.
        let mut sums = [0.0, 0.0];
        for iteration in ranks::share(batch.clone()) {
            let view = view_at(plan.seed, iteration, views.len());
            let pass = self.pass(view, iteration, views, plan);
            let pass = pass.map_err(|error| located(error, views.name(view), iteration))?;
            let Some(pass) = pass else { continue };
            measured.add(&pass.measured);
            sums[0] += f64::from(pass.loss);
            sums[1] += 1.0;
            sum = Some(match sum {
                Some(sum) => sum + pass.gradient,
                None => pass.gradient,
            });
        }
        ranks::sum(&mut sums);
        measured.sum_over_ranks();
        let [loss, labelled] = sums;
        if labelled > 0.0 {
            let gradient = self.mean(sum, labelled)?;
            // The last step may have fewer views.
            let share = batch.len() as f64 / plan.config.batch() as f64;
            let factor = plan.rate_factor(self.iteration) * share.sqrt();
            self.module = self.adam.step(self.module.clone(), gradient, factor);
        }
        self.recall = self.recall.after(&measured);
        self.iteration = batch.end;
        Ok((loss / batch.len() as f64) as f32)
    }

    /// The iterations of the next step.
    fn batch(&self, plan: &TrainingPlan) -> Range<usize> {
        let first = self.iteration;
        let end = first + plan.config.batch();
        first..end.min(plan.config.iterations.max(first + 1))
    }

    /// The mean of `views` gradients, of which this rank has the `sum` of its own.
    fn mean(&self, sum: Option<Tensor<1>>, views: f64) -> Result<Tensor<1>> {
        let sum = sum.unwrap_or_else(|| parameters(&self.module).zeros_like());
        let sum = ranks::sum_tensor("gradients", sum)?;
        Ok(if views > 1.0 { sum / views } else { sum })
    }

    /// The pass of an iteration; `None` for a view without labelled pixels.
    fn pass(
        &mut self,
        view: usize,
        iteration: usize,
        views: &mut TrainingViews,
        plan: &TrainingPlan,
    ) -> Result<Option<Pass>> {
        let mut rng = stream(plan.seed, Purpose::Pixels, iteration as u64);
        let sample = views.sample(view, plan.config.pixel_share, &mut rng)?;
        if sample.pixels.is_empty() {
            return Ok(None);
        }
        let visible = &sample.visible;
        let decoded = self.model.decode(&self.module, view, visible, iteration)?;
        let scores = sample.blended(decoded.scores.clone(), plan.config.blend)?;
        let mut measured = Measurement::none(self.recall.0.len());
        let mut robustness = Vec::new();
        if plan.least_recall > 0.0 {
            measured = self.recall.measure(&scores, &sample.pixels, iteration)?;
            let recall = self.recall.after(&measured);
            robustness = recall.robustness(plan.least_recall);
        }
        // Eq. 10 in this iteration.
        let coseg = CoSegLoss {
            label: plan.label_loss(iteration),
            lambda: plan.weights_of_means(sample.pixels.len()),
            robustness,
        };
        let rendered = Rendered {
            view,
            iteration,
            sample: &sample,
            scores,
            regularisation: decoded.regularisation.clone(),
        };
        let loss = self.model.loss(&coseg, rendered)?;
        let gradients = &mut loss.backward();
        let gradient = self.model.gradient(&self.module, view, &decoded, gradients);
        let named = [("the parameters", &gradient)];
        let loss = finite_loss("segmentation loss", loss.inner(), &named)?;
        Ok(Some(Pass {
            gradient,
            loss,
            measured,
        }))
    }

    /// Checks that all ranks have the same parameters.
    pub(super) fn compare_ranks(&self, variant: &str) -> Result<()> {
        if ranks::count() == 1 {
            return Ok(());
        }
        let values = read("parameters", parameters(&self.module))?;
        let digest = format!("{:x}", Sha256::digest(f32::to_bytes(&values)));
        ranks::expect_same(&format!("the parameters of {variant}"), digest)
    }
}

/// `error` with view and iteration, where a value was not finite.
fn located(error: Error, view: &str, iteration: usize) -> Error {
    match error {
        Error::NonFinite { tensor, row, .. } => Error::NonFinite {
            tensor,
            row,
            context: format!(", view {view}, segmentation iteration {iteration}"),
        },
        other => other,
    }
}

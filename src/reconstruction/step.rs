//! The forward and backward passes over the views of a step: loss and gradients, before they change the Gaussians.

use super::Trainer;
use super::optimizer::ParameterGradients;
use crate::data::View;
use crate::error::{Error, Result};
use crate::ops::{PhotometricTarget, photometric_loss};
use crate::provenance::digest_gaussians;
use crate::random::{Purpose, stream};
use crate::ranks;
use crate::raster::{RasterInput, RasterOutput, rasterize};
use burn::tensor::Tensor;
use rand::Rng;
use sha2::Digest;
use std::ops::RangeInclusive;

/// Weight of the SSIM term of the loss; L1 has the rest (Kerbl et al. 2023).
const SSIM_WEIGHT: f64 = 0.2;

/// Steps after which ranks compare their Gaussians.
const COMPARED_EVERY: usize = 100;

/// Loss and gradients of one view.
pub(crate) struct Pass {
    pub gradients: ParameterGradients,
    /// Screen-space gradient, `[N, 2]` or `[N, 4]`, where densification needs it.
    pub screen: Option<Tensor<2>>,
    /// `[N]`, pixels; 0 for culled Gaussians.
    pub radii: Tensor<1>,
    /// The value of the loss.
    pub loss: f64,
}

/// Loss and gradients of a step.
pub(super) struct BatchPass {
    /// Means over its views.
    pub gradients: ParameterGradients,
    /// Sum over its views.
    pub loss: f64,
}

impl Trainer<'_> {
    /// The passes of the iterations `batch`, divided among ranks.
    pub(super) fn batch_pass(&mut self, batch: &RangeInclusive<usize>) -> Result<BatchPass> {
        let mut loss = 0.0;
        let mut sum: Option<ParameterGradients> = None;
        for iteration in ranks::share(batch.clone()) {
            let index = self.schedule.view(self.config.seed, iteration);
            let view = self.train[index];
            let locate = |mut error| {
                if let Error::NonFinite { context, .. } = &mut error {
                    *context = format!(", view {}, iteration {iteration}", view.name);
                }
                error
            };
            let pass = self.pass(index, view, iteration).map_err(locate)?;
            if let Some(gradient) = pass.screen {
                self.statistics.record(gradient, pass.radii);
            }
            loss += pass.loss;
            sum = Some(match sum {
                Some(sum) => sum.plus(pass.gradients),
                None => pass.gradients,
            });
        }
        let mut loss = [loss];
        ranks::sum(&mut loss);
        let views = batch.clone().count();
        Ok(BatchPass {
            gradients: ParameterGradients::mean(sum, views, &self.parameters)?,
            loss: loss[0],
        })
    }

    /// Checks now and then that all ranks have the same Gaussians.
    pub(super) fn compare_ranks(&self) -> Result<()> {
        let steps = self.iteration.div_ceil(self.config.building.batch());
        if ranks::count() == 1 || !steps.is_multiple_of(COMPARED_EVERY) {
            return Ok(());
        }
        let what = format!("the Gaussians after {} iterations", self.iteration);
        ranks::expect_same(
            &what,
            format!("{:x}", digest_gaussians(&self.gaussians()?).finalize()),
        )
    }

    /// Colour behind the scene in `iteration`.
    fn background(&self, view: &View, iteration: usize) -> [f32; 3] {
        let random =
            self.config.building.random_background && self.schedule.varies_background(iteration);
        if random && !view.image.is_transparent() {
            stream(self.config.seed, Purpose::Background, iteration as u64).random()
        } else {
            self.config.raster.background
        }
    }

    /// The pass of `iteration` over `view`, whose index is `index`.
    pub(crate) fn pass(&mut self, index: usize, view: &View, iteration: usize) -> Result<Pass> {
        let target = self.targets.get(index, || {
            let target = PhotometricTarget::new(view.image.pixels()?, view.mask.clone());
            let bytes = target.bytes(&self.device);
            Ok((target, bytes))
        })?;
        let leaves = self.parameters.leaves(self.schedule.sh_degree(iteration));
        let screen = self.screen();
        let input = RasterInput {
            screen: Some(screen.clone()),
            ..leaves.clone()
        };
        let background = self.background(view, iteration);
        let RasterOutput { image, radii, .. } =
            rasterize(input, &view.camera, &self.settings, background)?;
        let loss = photometric_loss(image, &target, SSIM_WEIGHT);
        let mut gradients = loss.backward();
        let screen = screen.grad_remove(&mut gradients);
        let gradients = ParameterGradients::of(leaves, &mut gradients);
        let loss = gradients.check(loss.inner())?;
        Ok(Pass {
            gradients,
            screen,
            radii,
            loss,
        })
    }
}

#[cfg(all(test, feature = "wgpu"))]
mod tests {
    use super::*;
    use crate::backend::device::gpu_of_tests;
    use crate::config::Config;
    use crate::data::Scene;
    use crate::data::builtin::{BuiltinOptions, scene_with};
    use crate::reconstruction::optimizer::Parameters;
    use burn::tensor::Device;

    const VIEWS: usize = 2;

    /// A scene of two views and the device, if any.
    fn scene() -> Option<(Scene, Device)> {
        let device = gpu_of_tests()?;
        let options = BuiltinOptions {
            width: 320,
            height: 240,
            train_views: VIEWS,
            test_views: 1,
            points: 3_000,
            ..BuiltinOptions::default()
        };
        Some((scene_with(&options).expect("a scene"), device))
    }

    #[test]
    fn what_is_not_finite_is_named_on_a_gpu_too() {
        let Some((scene, device)) = scene() else {
            return;
        };
        let mut trainer = Trainer::new(&scene, &Config::default(), &device).expect("valid");
        (0..2 * VIEWS).for_each(|_| assert!(trainer.step().expect("finite").loss > 0.0));
        let (mut gaussians, first, second) = trainer.parameters.to_host().expect("readable");
        gaussians.means[21][1] = f32::NAN;
        trainer.parameters = Parameters::new(gaussians, first, second, &device);
        let message = trainer.step().expect_err("must stop").to_string();
        assert!(
            message.contains("means") && message.contains("row 21"),
            "{message}"
        );
        assert!(
            message.contains(&format!("iteration {}", 2 * VIEWS + 1)),
            "{message}"
        );
        assert_eq!(trainer.iteration(), 2 * VIEWS);
        assert_eq!(trainer.losses.1, 2 * VIEWS as u64);
    }
}

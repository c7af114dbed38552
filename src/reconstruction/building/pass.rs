//! Rendering one view and going back: the loss and its gradients, before anything is changed by them.

use super::BuildingStage;
use crate::data::View;
use crate::error::Result;
use crate::ops::photometric_loss;
use crate::random::{Purpose, stream};
use crate::raster::{RasterInput, RasterOutput, rasterize_with_capacity};
use crate::reconstruction::parameters::{Checked, ParameterGradients};
use burn::tensor::Tensor;
use rand::Rng;

/// What a view says of the parameters.
pub(crate) struct Pass {
    pub gradients: ParameterGradients,
    /// Screen-space gradient, `[N, 2]` or `[N, 4]`, where densification wants it.
    pub of_screen: Option<Tensor<2>>,
    /// `[N]`, pixels.
    pub radii: Tensor<1>,
    pub checked: Checked,
}

impl BuildingStage<'_> {
    /// The pass of iteration `iteration` over `view`, the one at `index`; its tile lists take the room that they had last time,
    /// so that the one readback of a pass on a GPU is its last act.
    pub(crate) fn pass(&mut self, index: usize, view: &View, iteration: usize) -> Result<Pass> {
        let room = self.rooms.room(index, self.parameters.len());
        let pass = match self.attempt(index, view, iteration, room)? {
            Some(pass) => pass,
            // Without room taken beforehand lists are as they should be, or it is an error.
            None => match self.attempt(index, view, iteration, None)? {
                Some(pass) => pass,
                None => return Err(crate::Error::non_finite("raster input", 0)),
            },
        };
        if let Some(entries) = pass.checked.entries {
            self.rooms.keep(index, entries, self.parameters.len());
        }
        Ok(pass)
    }

    /// What is behind the scene in step `iteration`.
    fn background(&self, view: &View, iteration: usize) -> [f32; 3] {
        let random =
            self.config.building.random_background && self.schedule.varies_background(iteration);
        match random && !view.image.is_transparent() {
            true => stream(self.config.seed, Purpose::Background, iteration as u64).random(),
            false => self.config.raster.background,
        }
    }

    /// `None` where `room` was too small, or an input is not finite.
    fn attempt(
        &mut self,
        index: usize,
        view: &View,
        iteration: usize,
        room: Option<usize>,
    ) -> Result<Option<Pass>> {
        let target = self.targets.get(index, view)?;
        let leaves = self.parameters.leaves();
        let screen = self.screen();
        let input = RasterInput {
            means: leaves.means.clone(),
            log_scales: leaves.log_scales.clone(),
            rotations: leaves.rotations.clone(),
            opacity_logits: leaves.opacity_logits.clone(),
            sh: Some(leaves.sh.clone()),
            active_sh_degree: self.schedule.sh_degree(iteration),
            features: None,
            screen: screen.clone(),
        };
        let background = self.background(view, iteration);
        let RasterOutput {
            image,
            radii,
            tile_lists,
            ..
        } = rasterize_with_capacity(input, &view.camera, &self.settings, background, room)?;
        let loss = photometric_loss(image, &target, f64::from(self.config.building.ssim_weight));
        let loss = self.regularised(loss, &leaves);
        let mut gradients = loss.backward();
        let of_screen = screen.and_then(|screen| screen.grad_remove(&mut gradients));
        let gradients = self.parameters.gradients(leaves, &mut gradients);
        let checked = gradients.check(loss.inner(), tile_lists)?;
        Ok(checked.map(|checked| Pass {
            gradients,
            of_screen,
            radii,
            checked,
        }))
    }
}

#[cfg(all(test, feature = "wgpu"))]
mod tests {
    use super::*;
    use crate::backend::device::gpu_of_tests;
    use crate::config::Config;
    use crate::data::Scene;
    use crate::data::builtin::{BuiltinOptions, scene_with};
    use crate::reconstruction::parameters::Parameters;
    use burn::tensor::Device;

    const VIEWS: usize = 2;

    /// A scene of two views and the device, where there is one.
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
    fn too_little_room_costs_time_and_nothing_else() {
        let Some((scene, device)) = scene() else {
            return;
        };
        let run = |spoil: bool| {
            let mut stage = BuildingStage::new(&scene, &Config::default(), &device).expect("valid");
            (0..5)
                .map(|_| {
                    for view in 0..2 {
                        if spoil {
                            stage.rooms.keep(view, 1, usize::MAX);
                        }
                    }
                    let step = stage.step().expect("finite");
                    let room = (0..2)
                        .filter_map(|view| stage.rooms.room(view, 3_000))
                        .max()
                        .expect("a GPU counts");
                    // A spoilt room has 4,097 entries, and this is a fifth and as many more than the view had.
                    assert!(
                        room > 10_000,
                        "a view has more entries than a spoilt room: {room}"
                    );
                    step.loss.to_bits()
                })
                .collect::<Vec<_>>()
        };
        assert_eq!(run(true), run(false));
    }

    #[test]
    fn what_is_not_finite_is_named_in_views_with_room_too() {
        let Some((scene, device)) = scene() else {
            return;
        };
        let mut stage = BuildingStage::new(&scene, &Config::default(), &device).expect("valid");
        (0..2 * VIEWS).for_each(|_| assert!(stage.step().expect("finite").loss > 0.0));
        assert!(
            (0..VIEWS).all(|view| stage.rooms.room(view, 3_000).is_some()),
            "all have been seen"
        );
        let (mut gaussians, first, second) =
            stage.parameters.clone().into_host().expect("readable");
        gaussians.means[21][1] = f32::NAN;
        stage.parameters = Parameters::new(gaussians, first, second, &device);
        let message = stage.step().expect_err("must stop").to_string();
        assert!(
            message.contains("means") && message.contains("row 21"),
            "{message}"
        );
        assert!(
            message.contains(&format!("iteration {}", 2 * VIEWS + 1)),
            "{message}"
        );
        assert_eq!(stage.iteration(), 2 * VIEWS);
        assert_eq!(stage.losses.1, 2 * VIEWS as u64);
    }
}

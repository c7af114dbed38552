//! The building stage: 3D Gaussians from posed photos.

mod density;
mod pass;
mod rooms;
mod tally;

use super::building_state::BuildingState;
use super::parameters::{Parameters, Rates};
use super::photos::Targets;
use super::schedule::{Schedule, center, extent};
use crate::backend::device::read;
use crate::config::Config;
use crate::data::{Scene, Split, View};
use crate::error::{Error, Result};
use crate::metrics::ImageScores;
use crate::progress::{CurvePoint, Event, Progress};
use crate::provenance::Provenance;
use crate::raster::{RasterInput, Settings, rasterize};
use crate::splat::Gaussians;
use burn::tensor::Device;
use glam::DVec3;
use pass::Pass;
use rooms::Rooms;
use std::path::{Path, PathBuf};
use std::time::Instant;
use tally::GradientAccumulator;

/// What one iteration did.
#[derive(Clone, Debug, PartialEq)]
pub struct StepReport {
    /// Its number, from 1.
    pub iteration: usize,
    /// Name of the view it trained on.
    pub view: String,
    /// Its loss, before the step.
    pub loss: f64,
    /// Gaussians afterwards.
    pub gaussians: usize,
    /// The densification that followed, if one did.
    pub densified: Option<Densified>,
    /// Whether opacities were reset.
    pub reset: bool,
}

/// What one densification did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Densified {
    /// Gaussians added as copies of others.
    pub cloned: usize,
    /// Gaussians replaced by two.
    pub split: usize,
    /// Gaussians removed.
    pub pruned: usize,
    /// Transparent Gaussians moved onto opaque ones.
    pub relocated: usize,
}

/// Trains Gaussians on the training views of a scene.
///
/// An iteration renders one view, compares it with its photo ((1 - w) L1 + w (1 - SSIM)), takes one Adam step on all
/// parameters, and densifies or resets when the [`Schedule`] says so. [`crate::config::Strategy::Mcmc`] adds to the loss what
/// keeps opacities and scales small, and noise to the means after the step. The same scene, settings and seed give the same
/// bits at any thread count, interrupted or not.
pub struct BuildingStage<'a> {
    config: Config,
    settings: Settings,
    schedule: Schedule,
    extent: f64,
    center: DVec3,
    device: Device,
    train: Vec<&'a View>,
    test: Vec<&'a View>,
    targets: Targets,
    parameters: Parameters,
    statistics: GradientAccumulator,
    rooms: Rooms,
    iteration: usize,
    losses: (f64, u64),
    curve: Vec<CurvePoint>,
    seconds: f64,
    checkpoint: Option<PathBuf>,
    provenance: Provenance,
}

impl<'a> BuildingStage<'a> {
    /// Initial Gaussians from the scene's points, or in the camera frusta where it has none.
    ///
    /// # Errors
    /// [`Error::Config`] for settings that cannot work; [`Error::Argument`] for a scene without training views;
    /// [`Error::NonFinite`] for points that are not finite; those of [`crate::data::Photo::pixels`].
    pub fn new(scene: &'a Scene, config: &Config, device: &Device) -> Result<Self> {
        let train: Vec<&View> = scene.split(Split::Train).collect();
        config.building.validate()?;
        let gaussians = density::initial(scene, &train, config)?;
        Self::from_state(
            scene,
            config,
            device,
            BuildingState::new(gaussians, config.seed),
        )
    }

    /// Goes on from a state, exactly as the run that it is of would have.
    ///
    /// # Errors
    /// [`Error::Config`] for settings that cannot work or are not those of the state; [`Error::Argument`] for a scene without
    /// training views; [`Error::Input`] when the state is of another scene; those of [`crate::data::Photo::pixels`].
    pub fn from_state(
        scene: &'a Scene,
        config: &Config,
        device: &Device,
        state: BuildingState,
    ) -> Result<Self> {
        config.building.validate()?;
        let train: Vec<&View> = scene.split(Split::Train).collect();
        let test: Vec<&View> = scene.split(Split::Test).collect();
        if train.is_empty() {
            let found = format!("{} without training views", scene.name);
            return Err(Error::argument(
                "data",
                found,
                "a scene with training views",
                "mark some views as `train`",
            ));
        }
        if let Some(view) = train
            .iter()
            .chain(&test)
            .find(|v| (v.image.width(), v.image.height()) != (v.camera.width, v.camera.height))
        {
            let found = format!(
                "{}x{} pixels in view {}",
                view.image.width(),
                view.image.height(),
                view.name
            );
            let expected = format!("{}x{} as its camera", view.camera.width, view.camera.height);
            return Err(Error::argument(
                "data",
                found,
                expected,
                "resize the photo or correct the intrinsics",
            ));
        }
        train
            .iter()
            .chain(&test)
            .try_for_each(|view| view.check_mask())?;
        let provenance = Provenance::stage_one(config, scene);
        if state.provenance.is_known() {
            provenance.check(
                &state.provenance,
                false,
                Path::new("the building checkpoint"),
            )?;
        }
        if state.seed != config.seed {
            let (found, expected) = (config.seed.to_string(), state.seed.to_string());
            return Err(Error::config(
                "seed",
                found,
                expected,
                "resume with the seed of the checkpoint",
            ));
        }
        if state.gaussians.sh_degree != config.building.sh_degree {
            let (found, expected) = (
                config.building.sh_degree.to_string(),
                state.gaussians.sh_degree.to_string(),
            );
            return Err(Error::config(
                "building.sh_degree",
                found,
                expected,
                "resume with the checkpoint's degree",
            ));
        }
        let size = extent(&train, &scene.points);
        let device = device.clone().inner();
        let BuildingState {
            iteration,
            gaussians,
            first,
            second,
            stats,
            losses,
            curve,
            seconds,
            ..
        } = state;
        Ok(Self {
            settings: Settings::from(&config.raster),
            schedule: Schedule::new(&config.building, train.len(), size),
            extent: size,
            center: center(&train),
            targets: Targets::new(train.len(), &device),
            parameters: Parameters::new(gaussians, first, second, &device),
            config: config.clone(),
            checkpoint: None,
            provenance,
            statistics: GradientAccumulator::new(stats, &device),
            rooms: Rooms::new(train.len()),
            device,
            train,
            test,
            iteration,
            losses,
            curve,
            seconds,
        })
    }

    /// Has [`BuildingStage::run`] keep its checkpoint at `path`.
    #[must_use]
    pub fn checkpoint_at(mut self, path: impl Into<PathBuf>) -> Self {
        self.checkpoint = Some(path.into());
        self
    }

    /// Iterations done.
    pub fn iteration(&self) -> usize {
        self.iteration
    }

    /// Curves so far, one point an evaluation.
    pub fn curve(&self) -> &[CurvePoint] {
        &self.curve
    }

    /// Seconds of training so far.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// The Gaussians as they are now.
    ///
    /// # Errors
    /// [`Error::Device`] when the device does not give them back.
    pub fn gaussians(&self) -> Result<Gaussians> {
        Ok(self.parameters.clone().into_host()?.0)
    }

    /// Everything needed to go on later.
    ///
    /// # Errors
    /// [`Error::Device`] when the device does not give the parameters back.
    pub fn state(&self) -> Result<BuildingState> {
        let (gaussians, first, second) = self.parameters.clone().into_host()?;
        Ok(BuildingState {
            provenance: self.provenance.clone(),
            seed: self.config.seed,
            iteration: self.iteration,
            gaussians,
            first,
            second,
            stats: self.statistics.read()?,
            losses: self.losses,
            curve: self.curve.clone(),
            seconds: self.seconds,
        })
    }

    /// One iteration. After an error nothing has changed, with one exception: a GPU that fails between the step and what follows it
    /// (noise, densification, reset) leaves a state to start over from the last checkpoint with.
    ///
    /// # Errors
    /// [`Error::NonFinite`] naming tensor, row, view and iteration when the loss or a gradient is not finite; [`Error::Limit`]
    /// and [`Error::Device`] where a GPU cannot go on; those of [`crate::data::Photo::pixels`].
    pub fn step(&mut self) -> Result<StepReport> {
        let start = Instant::now();
        let iteration = self.iteration + 1;
        let index = self.schedule.view(self.config.seed, iteration);
        let view = self.train[index];
        let context = format!(", view {}, iteration {iteration}", view.name);
        let locate = |error| match error {
            Error::NonFinite { tensor, row, .. } => Error::NonFinite {
                tensor,
                row,
                context: context.clone(),
            },
            other => other,
        };
        let Pass {
            gradients,
            of_screen,
            radii,
            checked,
        } = self.pass(index, view, iteration).map_err(locate)?;
        if let Some(gradient) = of_screen {
            self.statistics.record(gradient, radii);
        }
        self.parameters
            .step(gradients, &self.rates(iteration), iteration as u32);
        self.add_noise(iteration);
        self.iteration = iteration;
        self.losses.0 += checked.loss;
        self.losses.1 += 1;
        let densified = if self.schedule.densifies(iteration) {
            Some(self.densify()?)
        } else {
            None
        };
        let reset = self.schedule.resets(iteration);
        if reset {
            self.reset()?;
        }
        self.seconds += start.elapsed().as_secs_f64();
        let (view, gaussians) = (view.name.clone(), self.parameters.len());
        Ok(StepReport {
            iteration,
            view,
            loss: checked.loss,
            gaussians,
            densified,
            reset,
        })
    }

    /// Trains to the end of the run, or until `progress` says stop, scoring the held-out views and keeping the
    /// checkpoint as the settings say.
    ///
    /// # Errors
    /// As [`BuildingStage::step`], and [`Error::Io`] from the checkpoint. The last checkpoint stays.
    pub fn run(&mut self, progress: &mut dyn Progress) -> Result<()> {
        let iterations = self.config.building.iterations;
        progress.event(&Event::Started {
            stage: "building",
            done: self.iteration,
            iterations,
        });
        while self.iteration < iterations {
            let report = self.step()?;
            let StepReport {
                iteration,
                loss,
                gaussians,
                ..
            } = report;
            progress.event(&Event::Step {
                iteration,
                loss,
                gaussians,
            });
            if let Some(Densified {
                cloned,
                split,
                pruned,
                relocated,
            }) = report.densified
            {
                progress.event(&Event::Densified {
                    iteration,
                    cloned,
                    split,
                    pruned,
                    relocated,
                });
            }
            if self.schedule.evaluates(iteration) {
                progress.event(&Event::Evaluated(self.evaluate()?));
            }
            let stop = progress.stop();
            if stop || self.schedule.saves(iteration) {
                self.save(progress)?;
            }
            if stop {
                return Ok(());
            }
        }
        progress.event(&Event::Finished);
        Ok(())
    }

    /// Scores the held-out views and adds a point to the curve.
    ///
    /// # Errors
    /// [`Error::NonFinite`] when a parameter is not finite; those of [`crate::data::Photo::pixels`].
    pub fn evaluate(&mut self) -> Result<CurvePoint> {
        let start = Instant::now();
        let scores: Vec<ImageScores> = self
            .test
            .iter()
            .map(|view| self.score(view))
            .collect::<Result<_>>()?;
        self.seconds += start.elapsed().as_secs_f64();
        let (sum, count) = std::mem::take(&mut self.losses);
        let point = CurvePoint {
            iteration: self.iteration,
            seconds: self.seconds,
            loss: sum / count.max(1) as f64,
            held_out: ImageScores::mean(&scores),
            miou: None,
            gaussians: self.parameters.len(),
        };
        self.curve.push(point);
        Ok(point)
    }

    fn score(&self, view: &View) -> Result<ImageScores> {
        let leaves = self.parameters.leaves();
        let input = RasterInput {
            means: leaves.means.inner(),
            log_scales: leaves.log_scales.inner(),
            rotations: leaves.rotations.inner(),
            opacity_logits: leaves.opacity_logits.inner(),
            sh: Some(leaves.sh.inner()),
            active_sh_degree: self.schedule.sh_degree(self.iteration.max(1)),
            features: None,
            screen: None,
        };
        let output = rasterize(
            input,
            &view.camera,
            &self.settings,
            self.config.raster.background,
        )?;
        let image = read("image", output.image)?;
        ImageScores::of_view(&image, view)
    }

    fn save(&self, progress: &mut dyn Progress) -> Result<()> {
        if let Some(path) = &self.checkpoint {
            self.state()?.save(path)?;
            progress.event(&Event::Saved {
                iteration: self.iteration,
            });
        }
        Ok(())
    }

    fn rates(&self, iteration: usize) -> Rates {
        let b = &self.config.building;
        Rates {
            means: self.schedule.means_rate(iteration),
            log_scales: b.lr_scales,
            rotations: b.lr_rotations,
            opacity_logits: b.lr_opacity,
            sh_dc: b.lr_sh_dc,
            sh_rest: b.lr_sh_rest,
        }
    }
}

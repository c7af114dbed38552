//! Training of stage one.

use super::densify::{Densified, GradientAccumulator, GradientStatistics};
use super::initialization::initial_gaussians;
use super::optimizer::Parameters;
use super::schedule::{Schedule, center, extent};
use super::state::TrainerState;
use super::step::BatchPass;
use crate::backend::device::read;
use crate::config::Config;
use crate::data::{Scene, Split, View, ViewCache};
use crate::error::{Result, ensure};
use crate::metrics::ImageScores;
use crate::ops::PhotometricTarget;
use crate::progress::{CurvePoint, Event, Progress, Review};
use crate::provenance::Provenance;
use crate::ranks;
use crate::raster::{Settings, rasterize};
use crate::splat::Gaussians;
use burn::tensor::Device;
use glam::DVec3;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Learning rates of the parameters that no setting names, as in 3DGS (Kerbl et al. 2023): SH constant term, higher SH terms,
/// log-scales, rotations.
const LR_SH_DC: f64 = 2.5e-3;
const LR_SH_REST: f64 = 1.25e-4;
const LR_SCALES: f64 = 5e-3;
const LR_ROTATIONS: f64 = 1e-3;

/// What one step did.
#[derive(Clone, Debug, PartialEq)]
pub struct StepReport {
    /// Iterations until its end, each one view.
    pub iteration: usize,
    /// Its mean loss, before the step.
    pub loss: f64,
    /// Gaussians afterwards.
    pub gaussians: usize,
    /// The review of the number of Gaussians that followed, if one did.
    pub review: Option<Review>,
    /// The densification that followed, if one did.
    pub densified: Option<Densified>,
    /// Whether opacities were reset.
    pub reset: bool,
}

/// Trains Gaussians on the training views of a scene.
///
/// An iteration renders one view and compares it with its photo (`(1 - w) L1 + w (1 - SSIM)`). One Adam step on all parameters
/// follows each iteration, or each `building.batch` of them. It densifies, reviews or resets when the [`Schedule`] says so. The
/// same scene, settings and seed give the same bits at any thread count, interrupted or not. [Ranks](crate::ranks) divide the
/// views of a step, and all have the same Gaussians; how many there are and where they were interrupted changes results by
/// rounding.
pub struct Trainer<'a> {
    pub(super) config: Config,
    pub(super) settings: Settings,
    pub(super) schedule: Schedule,
    pub(super) extent: f64,
    pub(super) center: DVec3,
    pub(super) device: Device,
    pub(super) train: Vec<&'a View>,
    test: Vec<&'a View>,
    /// The photos as targets of the loss.
    pub(super) targets: ViewCache<PhotometricTarget>,
    pub(super) parameters: Parameters,
    pub(super) statistics: GradientAccumulator,
    pub(super) iteration: usize,
    pub(super) reviews: Vec<Review>,
    pub(super) losses: (f64, u64),
    curve: Vec<CurvePoint>,
    seconds: f64,
    checkpoint: Option<PathBuf>,
    provenance: Provenance,
}

impl<'a> Trainer<'a> {
    /// Starts from the points of the scene, or from points in the camera frusta where it has none.
    ///
    /// # Errors
    /// As [`Trainer::from_state`], and [`crate::Error::NonFinite`] for points that are not finite.
    pub fn new(scene: &'a Scene, config: &Config, device: &Device) -> Result<Self> {
        config.building.validate()?;
        let train: Vec<&View> = scene.split(Split::Train).collect();
        let gaussians = initial_gaussians(scene, &train, config)?;
        let state = TrainerState::new(gaussians, config.seed);
        Self::from_state(scene, config, device, state)
    }

    /// Continues from a state exactly as the run that it was taken from would.
    ///
    /// # Errors
    /// [`crate::Error::Config`] for settings that cannot work or are not those of the state; [`crate::Error::Input`] for the
    /// state of another scene; [`crate::Error::Argument`] for a scene without training views, or whose photos and masks differ in
    /// size from their cameras; those of [`crate::data::Photo::pixels`].
    pub fn from_state(
        scene: &'a Scene,
        config: &Config,
        device: &Device,
        state: TrainerState,
    ) -> Result<Self> {
        config.building.validate()?;
        check_scene(scene)?;
        let provenance = check_state(&state, scene, config)?;
        let train: Vec<&View> = scene.split(Split::Train).collect();
        let size = extent(&train, &scene.points);
        let device = device.clone().inner();
        let statistics = match ranks::index() {
            0 => state.stats,
            // The first rank has those of all.
            _ => GradientStatistics::new(state.gaussians.len()),
        };
        Ok(Self {
            settings: Settings::from(&config.raster),
            schedule: Schedule::new(&config.building, train.len(), size),
            extent: size,
            center: center(&train),
            targets: ViewCache::new(train.len(), PhotometricTarget::budget(&device)),
            parameters: Parameters::new(state.gaussians, state.first, state.second, &device),
            config: config.clone(),
            checkpoint: None,
            provenance,
            statistics: GradientAccumulator::new(statistics, &device),
            device,
            train,
            test: scene.split(Split::Test).collect(),
            iteration: state.iteration,
            reviews: state.reviews,
            losses: state.losses,
            curve: state.curve,
            seconds: state.seconds,
        })
    }

    /// Makes [`Trainer::run`] keep its checkpoint at `path`.
    #[must_use]
    pub fn checkpoint_at(mut self, path: impl Into<PathBuf>) -> Self {
        self.checkpoint = Some(path.into());
        self
    }

    /// Iterations done.
    pub fn iteration(&self) -> usize {
        self.iteration
    }

    /// Curve so far, one point per evaluation.
    pub fn curve(&self) -> &[CurvePoint] {
        &self.curve
    }

    /// Reviews of the number of Gaussians so far.
    pub fn reviews(&self) -> &[Review] {
        &self.reviews
    }

    /// Seconds of training so far.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// The Gaussians as they are now.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not return them.
    pub fn gaussians(&self) -> Result<Gaussians> {
        Ok(self.parameters.to_host()?.0)
    }

    /// Everything that a later run needs to continue.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not return the parameters.
    pub fn state(&self) -> Result<TrainerState> {
        let (gaussians, first, second) = self.parameters.to_host()?;
        Ok(TrainerState {
            provenance: self.provenance.clone(),
            seed: self.config.seed,
            iteration: self.iteration,
            gaussians,
            first,
            second,
            stats: self.statistics.read()?,
            reviews: self.reviews.clone(),
            losses: self.losses,
            curve: self.curve.clone(),
            seconds: self.seconds,
        })
    }

    /// One step: the next iterations, as many as a batch has. After an error in a batch of one nothing has changed, with one exception.
    /// Where a review, a densification or a reset fails, and in larger batches, only the last checkpoint can be used.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] naming tensor, row, view and iteration when the loss or a gradient is not finite; [`crate::Error::Limit`]
    /// and [`crate::Error::Device`] where a GPU cannot go on, or where ranks differ; those of [`crate::data::Photo::pixels`].
    pub fn step(&mut self) -> Result<StepReport> {
        let start = Instant::now();
        let batch = self.batch();
        let views = batch.clone().count();
        let BatchPass { gradients, loss } = self.batch_pass(&batch)?;
        let rates = self.rates(*batch.start(), views);
        self.iteration = *batch.end();
        self.parameters
            .step(gradients, &rates, self.iteration, views);
        self.losses.0 += loss;
        self.losses.1 += views as u64;
        let due =
            |is_due: fn(&Schedule, usize) -> bool| batch.clone().any(|i| is_due(&self.schedule, i));
        let [reviews, densifies, reset] =
            [Schedule::reviews, Schedule::densifies, Schedule::resets].map(due);
        let reviews = reviews && self.parameters.len() > 0;
        let review = reviews.then(|| self.review()).transpose()?;
        let densified = densifies.then(|| self.densify()).transpose()?;
        if reset {
            self.parameters.reset_opacity()?;
        }
        self.compare_ranks()?;
        self.seconds += start.elapsed().as_secs_f64();
        let gaussians = self.parameters.len();
        Ok(StepReport {
            iteration: self.iteration,
            loss: loss / views as f64,
            gaussians,
            review,
            densified,
            reset,
        })
    }

    /// The iterations of the next step.
    fn batch(&self) -> RangeInclusive<usize> {
        let first = self.iteration + 1;
        let last = self.iteration + self.config.building.batch();
        first..=last.min(self.config.building.iterations.max(first))
    }

    /// Trains to the end of the run, or until `progress` stops it. Scores the held-out views and writes
    /// the checkpoint on schedule.
    ///
    /// # Errors
    /// As [`Trainer::step`], and [`crate::Error::Io`] from the checkpoint. The last checkpoint stays.
    pub fn run(&mut self, progress: &mut dyn Progress) -> Result<()> {
        let iterations = self.config.building.iterations;
        ranks::expect_same("the iterations done", self.iteration.to_string())?;
        progress.event(&Event::Started {
            stage: "building",
            done: self.iteration,
            iterations,
        });
        while self.iteration < iterations {
            let before = self.iteration;
            let report = self.step()?;
            let iteration = report.iteration;
            progress.event(&Event::Step {
                iteration,
                loss: report.loss,
                gaussians: report.gaussians,
            });
            if let Some(review) = report.review {
                progress.event(&Event::Reviewed(review));
            }
            let step = before + 1..=iteration;
            if step.clone().any(|i| self.schedule.evaluates(i)) {
                progress.event(&Event::Evaluated(self.evaluate()?));
            }
            if progress.wants_gaussians() {
                progress.gaussians(&self.gaussians()?, None);
            }
            let stop = ranks::any(progress.stop())?;
            if stop || step.clone().any(|i| self.schedule.saves(i)) {
                self.save()?;
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
    /// [`crate::Error::NonFinite`] when a parameter is not finite; those of [`crate::data::Photo::pixels`].
    pub fn evaluate(&mut self) -> Result<CurvePoint> {
        let start = Instant::now();
        let scores = ranks::divided(&self.test, |view| self.score(view))?;
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
        let degree = self.schedule.sh_degree(self.iteration.max(1));
        let values = self.parameters.values(degree);
        let background = self.config.raster.background;
        let output = rasterize(values, &view.camera, &self.settings, background)?;
        let image = read("image", output.image)?;
        ImageScores::of_view(&image, view)
    }

    fn save(&mut self) -> Result<()> {
        let Some(path) = self.checkpoint.clone() else {
            return Ok(());
        };
        self.statistics = self.statistics.clone().of_all_ranks()?;
        if ranks::index() == 0 {
            self.state()?.save(&path)?;
        } else {
            // The first rank has the sum from now on.
            let none = GradientStatistics::new(self.parameters.len());
            self.statistics = GradientAccumulator::new(none, &self.device);
        }
        Ok(())
    }

    /// Learning rates of the parameters, in their order, for a step of `views` from `iteration` on.
    fn rates(&self, iteration: usize, views: usize) -> [Vec<f64>; 5] {
        let b = &self.config.building;
        let mut sh = vec![LR_SH_REST; 3 * (b.sh_degree + 1).pow(2)];
        sh[..3].fill(LR_SH_DC);
        let rates = [
            vec![self.schedule.means_rate(iteration)],
            vec![LR_SCALES],
            vec![LR_ROTATIONS],
            vec![b.lr_opacity],
            sh,
        ];
        // Grendel-GS (Zhao et al. 2024).
        let factor = (views as f64).sqrt();
        rates.map(|rates| rates.into_iter().map(|rate| rate * factor).collect())
    }
}

/// Checks that there are training views, and that photos and masks have the sizes of their cameras.
fn check_scene(scene: &Scene) -> Result<()> {
    scene.expect_training_views()?;
    for view in scene.split(Split::Train).chain(scene.split(Split::Test)) {
        let (width, height) = (view.image.width(), view.image.height());
        let camera = &view.camera;
        ensure!((width, height) == (camera.width, camera.height),
            argument "data"; found "{width}x{height} pixels in view {}", view.name;
            expected "{}x{} as its camera", camera.width, camera.height;
            help "resize the photo or correct the intrinsics");
        view.check_mask()?;
    }
    Ok(())
}

/// Checks that settings and scene are those of the state. Returns their provenance.
fn check_state(state: &TrainerState, scene: &Scene, config: &Config) -> Result<Provenance> {
    let provenance = Provenance::stage_one(config, scene);
    if state.provenance.is_known() {
        let file = Path::new("the building checkpoint");
        provenance.check(&state.provenance, false, file, None)?;
    }
    ensure!(state.seed == config.seed, setting "seed"; found "{}", config.seed; expected "{}", state.seed;
        help "resume with the seed of the checkpoint");
    ensure!(state.gaussians.sh_degree == config.building.sh_degree,
        setting "building.sh_degree"; found "{}", config.building.sh_degree;
        expected "{}", state.gaussians.sh_degree; help "resume with the checkpoint's degree");
    Ok(provenance)
}

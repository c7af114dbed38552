//! Runs of both stages on the plates, stopped and whole, and their comparison.

use coseg::config::{
    Budget, BuildingConfig, Config, LabelLoss, SCALES, SegmentationConfig, Variant,
};
use coseg::pipeline::{Outcome, run};
use coseg::progress::{CurvePoint, Event, Progress, Silent};
use std::path::Path;

/// Both stages on the plates in `data`, a second or two: `iterations` of stage two for each of `rows`.
pub fn short(data: &Path, iterations: usize, rows: &[Variant]) -> Config {
    let mut config = Config {
        building: BuildingConfig {
            iterations: 40,
            random_points: 400,
            max_gaussians: Budget::Unlimited,
            ..BuildingConfig::default()
        },
        segmentation: SegmentationConfig {
            iterations,
            rows: Some(rows.to_vec()),
            ..SegmentationConfig::default()
        },
        ..Config::default()
    };
    config.data.dir = Some(data.to_owned());
    config
}

/// A short run with several evaluations and checkpoints.
pub fn config(data: &Path) -> Config {
    let rows = [Variant::Vote, Variant::PerGaussian, Variant::Ours];
    let mut config = short(data, 30, &rows);
    config.seed = 5;
    // All of them, for Eq. 9 draws points of the coarse ones.
    config.features.scales = Some(SCALES);
    config.segmentation = SegmentationConfig {
        pixel_share: Some(0.5),
        eval_every: 10,
        checkpoint_every: 7,
        // Every loss depends on earlier measurements.
        loss: Some(LabelLoss::Gce {
            exponent: 0.7,
            least_recall: 1.0,
        }),
        ..config.segmentation
    };
    config
}

/// Stops after some iterations of a stage.
pub struct StopAt {
    stage: &'static str,
    iteration: usize,
    now: &'static str,
    stopped: bool,
}

impl StopAt {
    pub fn new(stage: &'static str, iteration: usize) -> Self {
        Self {
            stage,
            iteration,
            now: "",
            stopped: false,
        }
    }
}

impl Progress for StopAt {
    fn event(&mut self, event: &Event) {
        match event {
            Event::Started { stage, .. } => self.now = stage,
            Event::Step { iteration, .. } => {
                self.stopped |= self.now == self.stage && *iteration == self.iteration;
            }
            _ => {}
        }
    }
    fn stop(&mut self) -> bool {
        self.stopped
    }
}

/// A run that `progress` stops.
#[track_caller]
pub fn stopped(config: &Config, out: &Path, progress: &mut dyn Progress) {
    let part = run(config, out, &crate::support::device(), progress);
    assert!(matches!(part, Err(coseg::Error::Stopped)), "not stopped");
}

/// A run that nothing stops.
pub fn whole(config: &Config, out: &Path) -> Outcome {
    run(config, out, &crate::support::device(), &mut Silent).expect("a run")
}

/// Curves except for the clock, bit for bit.
fn bits(curve: &[CurvePoint]) -> Vec<(usize, u64, Option<u64>, usize)> {
    curve
        .iter()
        .map(|p| {
            (
                p.iteration,
                p.loss.to_bits(),
                p.miou.map(f64::to_bits),
                p.gaussians,
            )
        })
        .collect()
}

/// Asserts that two runs are equal except for the clock, bit for bit.
#[track_caller]
pub fn same(a: &Outcome, b: &Outcome) {
    assert!(a.gaussians == b.gaussians, "Gaussians differ");
    assert_eq!(a.rows.len(), b.rows.len());
    for (a, b) in a.rows.iter().zip(&b.rows) {
        let row = a.name();
        assert_eq!(bits(&a.curve), bits(&b.curve), "curve of {row}");
        let scores = |r: &coseg::pipeline::VariantOutcome| -> Vec<u32> {
            r.identities
                .iter()
                .flat_map(|i| &i.scores)
                .map(|s| s.to_bits())
                .collect()
        };
        assert!(scores(a) == scores(b), "identities of {row}");
    }
}

/// A short run of `ours` whose second stage is changed by `edit`.
pub fn trained(edit: impl Fn(&mut SegmentationConfig)) -> Outcome {
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let mut config = short(folder.path(), 20, &[Variant::Ours]);
    edit(&mut config.segmentation);
    run(
        &config,
        &folder.path().join("run"),
        &crate::support::device(),
        &mut Silent,
    )
    .expect("a run")
}

//! What a run does once it is told to stop.

use crate::resume::{config, same, whole};
use coseg::config::{Association, Row};
use coseg::train::progress::{Event, Progress};
use coseg::train::run;

/// Says stop from an iteration of a stage on, and notes what began.
struct Told {
    stage: &'static str,
    iteration: usize,
    began: Vec<&'static str>,
    stopped: bool,
}

impl Told {
    fn at(stage: &'static str, iteration: usize) -> Self {
        Self { stage, iteration, began: Vec::new(), stopped: false }
    }
}

impl Progress for Told {
    fn event(&mut self, event: &Event) {
        match event {
            Event::Started { stage, .. } => self.began.push(stage),
            Event::Step { iteration, .. } => {
                self.stopped |= self.began.last() == Some(&self.stage) && *iteration == self.iteration;
            }
            Event::Finished if self.iteration == 0 => self.stopped |= self.began.last() == Some(&self.stage),
            _ => {}
        }
    }
    fn stop(&mut self) -> bool {
        self.stopped
    }
}

#[test]
fn trials_of_learning_rates_stop_too() {
    let folder = tempfile::tempdir().expect("a folder");
    crate::plates::scene(folder.path());
    let mut config = config(folder.path());
    config.segmentation.rows = Some(vec![Row::Vote, Row::PerGaussian]);
    config.segmentation.lr_trials = vec![0.5, 1.0];
    let uninterrupted = whole(&config, &folder.path().join("whole"));
    assert!(!uninterrupted.stopped);
    let out = folder.path().join("parts");
    let mut told = Told::at("rates", 10);
    let part = run(&config, &out, &crate::device(), &mut told).expect("a part");
    assert!(part.stopped && told.began.last() == Some(&"rates"), "{:?}", told.began);
    let row = part.rows.last().expect("a row");
    assert!(row.row == Row::PerGaussian && row.identities.is_none() && row.curve.is_empty());
    assert!(part.stored().is_some_and(|(row, _)| row.row == Row::Vote), "no row that was stopped is stored");
    assert!(!out.join("checkpoint/per_gaussian.rate.safetensors").exists());
    same(&uninterrupted, &whole(&config, &out));
}

#[test]
fn nothing_is_begun_after_a_stop() {
    let folder = tempfile::tempdir().expect("a folder");
    crate::plates::scene(folder.path());
    let mut config = config(folder.path());
    config.data.association = Association::Gaussians;
    config.segmentation.rows = Some(vec![Row::Vote, Row::Ours]);
    let out = folder.path().join("run");
    for (stage, iteration, began) in [
        ("building", 7, &["building"][..]),
        // Even where it was done.
        ("building", 40, &["building"]),
        ("features", 0, &["building", "association", "features"]),
        ("unprojection", 0, &["building", "association", "features", "unprojection"]),
    ] {
        let mut told = Told::at(stage, iteration);
        let part = run(&config, &out, &crate::device(), &mut told).expect("a part");
        assert!(part.stopped && told.began == began, "{:?}", told.began);
        assert!(part.rows.is_empty() && part.association.is_some() == (began.len() > 1));
        assert_eq!(
            part.test.psnr.is_some(),
            (stage, iteration) != ("building", 7),
            "half-built Gaussians are not scored"
        );
    }
    // A stop that comes when all is done ends nothing.
    let mut told = Told::at("ours", 30);
    let done = run(&config, &out, &crate::device(), &mut told).expect("a run");
    assert!(told.stopped && !done.stopped);
    assert!(done.rows.len() == 2 && done.rows.iter().all(|row| row.identities.is_some()));
    same(&done, &whole(&config, &folder.path().join("whole")));
}

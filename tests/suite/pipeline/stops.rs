//! What a run does once it is told to stop.

use crate::support::plate_runs::{config, same, stopped, whole};
use coseg::config::{Association, Variant};
use coseg::pipeline::run;
use coseg::progress::{Event, Progress};

/// Says stop from an iteration of a stage on, and notes what began.
struct Told {
    stage: &'static str,
    iteration: usize,
    began: Vec<&'static str>,
    stopped: bool,
}

impl Told {
    fn at(stage: &'static str, iteration: usize) -> Self {
        Self {
            stage,
            iteration,
            began: Vec::new(),
            stopped: false,
        }
    }
}

impl Progress for Told {
    fn event(&mut self, event: &Event) {
        match event {
            Event::Started { stage, .. } => self.began.push(stage),
            Event::Step { iteration, .. } | Event::Viewed { done: iteration } => {
                self.stopped |=
                    self.began.last() == Some(&self.stage) && *iteration == self.iteration;
            }
            Event::Finished if self.iteration == 0 => {
                self.stopped |= self.began.last() == Some(&self.stage)
            }
            _ => {}
        }
    }
    fn stop(&mut self) -> bool {
        self.stopped
    }
}

#[test]
fn nothing_is_begun_after_a_stop() {
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let mut config = config(folder.path());
    config.data.association = Association::Gaussians;
    config.segmentation.rows = Some(vec![Variant::Vote, Variant::Ours]);
    config.segmentation.fine_tune = Some(true);
    let out = folder.path().join("run");
    for (stage, iteration, began) in [
        ("building", 7, &["building"][..]),
        // Even where it was done.
        ("building", 40, &["building"]),
        ("attendance", 0, &["building", "association", "attendance"]),
        (
            "features",
            0,
            &["building", "association", "attendance", "features"],
        ),
        (
            "unprojection",
            0,
            &[
                "building",
                "association",
                "attendance",
                "features",
                "unprojection",
            ],
        ),
    ] {
        let mut told = Told::at(stage, iteration);
        stopped(&config, &out, &mut told);
        assert_eq!(told.began, began);
    }
    // Fine-tuning is part of the variant.
    stopped(&config, &out, &mut Told::at("ours", 30));
    // A stop that comes when all is done ends nothing.
    let mut told = Told::at("fine-tuning", 100);
    let done = run(&config, &out, &crate::support::device(), &mut told).expect("a run");
    assert!(
        told.stopped
            && done.rows.len() == 2
            && done.rows.iter().all(|row| row.identities.is_some())
    );
    same(&done, &whole(&config, &folder.path().join("whole")));
}

/// Notes how many views each stage that learns nothing announces, and which it reports.
#[derive(Default)]
struct Views(Vec<(&'static str, usize, Vec<usize>)>);

impl Progress for Views {
    fn event(&mut self, event: &Event) {
        match event {
            Event::Started {
                stage, iterations, ..
            } => self.0.push((stage, *iterations, Vec::new())),
            Event::Viewed { done } => self.0.last_mut().expect("a stage").2.push(*done),
            _ => {}
        }
    }
}

#[test]
fn a_stop_between_views_gives_up_what_learns_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let mut config = config(folder.path());
    config.data.association = Association::Gaussians;
    config.segmentation.rows = Some(vec![Variant::Vote, Variant::Ours]);
    let mut views = Views::default();
    let whole = run(
        &config,
        &folder.path().join("whole"),
        &crate::support::device(),
        &mut views,
    )
    .expect("a run");
    // Four training views, each found, relabelled and in four sweeps, and two others.
    let looks = (2 + 4) * 4 + 2;
    let announced = [("association", looks), ("features", 4), ("unprojection", 4)];
    for (stage, count) in announced {
        let all: Vec<usize> = (1..=count).collect();
        assert!(
            views.0.contains(&(stage, count, all)),
            "{stage}: {:?}",
            views.0
        );
    }
    let out = folder.path().join("parts");
    let told = [
        ("association", 1),
        ("association", 7),
        ("association", looks),
        ("features", 2),
        ("features", 4),
    ];
    for (stage, view) in told
        .into_iter()
        .chain([("unprojection", 1), ("unprojection", 4)])
    {
        let mut told = Told::at(stage, view);
        stopped(&config, &out, &mut told);
        assert!(
            told.stopped && told.began.last() == Some(&stage),
            "{stage} {view}: {:?}",
            told.began
        );
    }
    same(
        &whole,
        &run(
            &config,
            &out,
            &crate::support::device(),
            &mut Views::default(),
        )
        .expect("the rest"),
    );
}

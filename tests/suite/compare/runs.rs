//! A small plan as it is run, resumed and refused.

use crate::support::assert_names;
use crate::support::comparison::{PLAN, write_plan};
use crate::support::program::read_json;
use coseg::compare::{Cell, Finished, Options, Plan, Tables, run};
use coseg::error::Error;
use coseg::progress::{Event, Progress};
use std::path::{Path, PathBuf};

/// Notes what is trained, and stops before the cell that it names.
#[derive(Default)]
pub(super) struct Notes {
    pub(super) begun: Vec<String>,
    finished: Vec<String>,
    stop_at: Option<&'static str>,
}

impl Progress for Notes {
    fn event(&mut self, event: &Event) {
        match event {
            Event::Begun(what) => self.begun.push(what.clone()),
            Event::Stored { cell, .. } => self.finished.push(cell.clone()),
            _ => {}
        }
    }

    fn stop(&mut self) -> bool {
        let last = self.begun.last();
        self.stop_at
            .is_some_and(|part| last.is_some_and(|last| last.contains(part)))
    }
}

pub(super) fn options(out: &Path) -> Options {
    Options {
        out: out.to_owned(),
        command: "coseg compare plan.toml --out <here>".into(),
        commit: "abc1234".into(),
        device: "a processor".into(),
        ..Options::default()
    }
}

pub(super) fn compare(
    plan: &Plan,
    options: &Options,
    notes: &mut Notes,
) -> Result<Finished, Error> {
    run(plan, options, &crate::support::device(), notes)
}

#[track_caller]
fn refusal(plan: &Plan, options: &Options) -> Error {
    match compare(plan, options, &mut Notes::default()) {
        Err(error) => error,
        Ok(_) => panic!("no refusal"),
    }
}

/// A folder with the plan, and where its cells go.
pub(super) fn folder() -> (tempfile::TempDir, Plan, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let plan = Plan::read(&write_plan(folder.path(), PLAN), None).expect("a plan");
    let out = folder.path().join("out");
    (folder, plan, out)
}

/// Scores of cells to twelve digits: JSON may change the last bit. Times differ from run to run.
pub(super) fn scores(cells: &[Cell]) -> Vec<(String, [Option<i64>; 5])> {
    let digits = |value: Option<f64>| value.map(|value| (value * 1e12).round() as i64);
    let of = |cell: &Cell| {
        let f = &cell.figures;
        let p = &f.pixels;
        let all = [p.miou, p.miou_per_view, p.accuracy, f.boundary_iou, f.psnr];
        (cell.id.to_string(), all.map(digits))
    };
    cells.iter().map(of).collect()
}

#[test]
fn a_plan_is_run_once_and_resumed_by_cells() {
    let (_keep, plan, out) = folder();
    let mut notes = Notes::default();
    let first = compare(&plan, &options(&out), &mut notes).expect("a table");
    assert!(!first.stopped);
    assert_eq!(notes.finished.len(), 4);
    assert_eq!(notes.begun[0], "plates: Gaussians");
    assert_eq!(
        notes.begun.len(),
        5,
        "rows of other settings are runs of their own"
    );
    assert!(first.cells.iter().all(|cell| {
        let f = &cell.figures;
        f.pixels.miou.is_some()
            && f.boundary_iou.is_some()
            && f.frames_per_second.is_some_and(|n| n > 0.0)
    }));
    let trained = |cell: &&Cell| cell.figures.training_seconds.is_some();
    assert_eq!(
        first.cells.iter().filter(trained).count(),
        2,
        "the vote is not trained"
    );

    let deleted = out.join("cells/plates/swapped/ours, count/1.json");
    std::fs::remove_file(&deleted).expect("a cell");
    let mut notes = Notes::default();
    let second = compare(&plan, &options(&out), &mut notes).expect("a table");
    assert_eq!(notes.finished, ["plates/swapped/ours, count/1"]);
    assert_eq!(notes.begun, ["plates/swapped/seed 1: ours, count"]);
    assert_eq!(scores(&second.cells), scores(&first.cells));

    let mut notes = Notes::default();
    compare(&plan, &options(&out), &mut notes).expect("a table");
    assert!(notes.begun.is_empty(), "{:?}", notes.begun);
    let left: Vec<_> = walk(&out.join("runs")).collect();
    assert!(left.is_empty(), "checkpoints of finished cells: {left:?}");
}

/// All files below a folder.
fn walk(dir: &Path) -> Box<dyn Iterator<Item = PathBuf>> {
    let entries = std::fs::read_dir(dir).into_iter().flatten().flatten();
    Box::new(
        entries.flat_map(|entry| -> Box<dyn Iterator<Item = PathBuf>> {
            let path = entry.path();
            if path.is_dir() {
                walk(&path)
            } else {
                Box::new(std::iter::once(path))
            }
        }),
    )
}

#[test]
fn a_stopped_comparison_continues() {
    let (_keep, plan, out) = folder();
    let mut notes = Notes {
        stop_at: Some("seed 1: ours"),
        ..Notes::default()
    };
    let stopped = compare(&plan, &options(&out), &mut notes).expect("no error");
    assert!(stopped.stopped);
    assert_eq!(stopped.cells.len(), 3);
    let mut notes = Notes::default();
    let rest = compare(&plan, &options(&out), &mut notes).expect("a table");
    assert_eq!((rest.stopped, rest.cells.len()), (false, 4));
    assert_eq!(notes.finished, ["plates/swapped/ours, count/1"]);
}

#[test]
fn other_settings_data_and_commits_are_refused() {
    let (keep, plan, out) = folder();
    let only = Options {
        only: "/ours, count/0".into(),
        ..options(&out)
    };
    let done = compare(&plan, &only, &mut Notes::default()).expect("a cell");
    assert_eq!(done.cells.len(), 1);
    let cell = "cells/plates/swapped/ours, count/0.json";

    let plan_with = |from: &str, to: &str| {
        assert!(PLAN.contains(from));
        Plan::read(&write_plan(keep.path(), &PLAN.replacen(from, to, 1)), None).expect("a plan")
    };
    let other = plan_with("segmentation.iterations = 8", "segmentation.iterations = 9");
    assert_names(
        &refusal(&other, &only),
        &[
            cell,
            "segmentation.iterations",
            "found 9",
            "expected 8, as when",
            "--out",
        ],
    );
    let other = plan_with(
        "name = \"swapped\"",
        "name = \"swapped\"\nlabelled_photos = 2",
    );
    assert_names(&refusal(&other, &only), &[cell, "raw labels"]);
    let other = plan_with("building.iterations = 20", "building.iterations = 21");
    assert_names(
        &refusal(&other, &only),
        &["stage_one.json", "building.iterations"],
    );

    let commit = Options {
        commit: "def5678".into(),
        ..only.clone()
    };
    assert_names(
        &refusal(&plan, &commit),
        &[cell, "commit", "abc1234", "def5678", "--keep-cells"],
    );
    let kept = Options {
        keep_cells: true,
        only: "vote/0".into(),
        ..commit
    };
    let mixed = compare(&plan, &kept, &mut Notes::default()).expect("two cells");
    let commits: Vec<&str> = mixed.cells.iter().map(|cell| &*cell.commit).collect();
    assert_eq!(commits, ["abc1234", "def5678"]);
    let table = Tables::new(&plan, &mixed.cells, "a command").markdown();
    for part in [
        "abc1234 (1 cells), def5678 (1 cells)",
        "empty cells: 2 of 4",
        "(1 of 2)",
    ] {
        assert!(table.contains(part), "{part:?} is not in: {table}");
    }

    // A label of a held-out view, which nothing is trained on.
    let truth = keep.path().join("plates/labels/v2.png");
    std::fs::copy(keep.path().join("plates/labels/v1.png"), truth).expect("copied");
    assert_names(&refusal(&plan, &only), &["held-out"]);
    let first = "cells/plates/swapped/vote/0.json";
    std::fs::write(out.join(first), "{}").expect("written");
    assert_names(&refusal(&plan, &only), &[first, "missing field"]);
}

#[test]
fn unusable_options_are_named() {
    let (keep, plan, out) = folder();
    let only = Options {
        only: "kitchen".into(),
        ..options(&out)
    };
    assert_names(&refusal(&plan, &only), &["--only", "kitchen"]);
    let given = Options {
        gaussians: [("kitchen".to_owned(), out.clone())].into(),
        ..options(&out)
    };
    assert_names(
        &refusal(&plan, &given),
        &["--gaussians", "kitchen", "plates"],
    );
    let inside = options(&keep.path().join("plates"));
    assert_names(&refusal(&plan, &inside), &["--out"]);
}

#[test]
fn gaussians_of_a_file_are_stage_one() {
    let (keep, plan, out) = folder();
    let ply = keep.path().join("plates/plates.ply");
    let given = Options {
        gaussians: [("plates".to_owned(), ply)].into(),
        only: "vote/0".into(),
        ..options(&out)
    };
    let done = compare(&plan, &given, &mut Notes::default()).expect("a cell");
    assert_eq!(done.cells[0].figures.gaussians, 111);
    assert!(done.cells[0].figures.psnr.is_some_and(|psnr| psnr > 35.0));
    // They stay without being named again; others are refused.
    let again = Options {
        gaussians: Default::default(),
        only: "vote/".into(),
        ..given.clone()
    };
    let mut notes = Notes::default();
    compare(&plan, &again, &mut notes).expect("two cells");
    assert_eq!(notes.finished, ["plates/swapped/vote/1"]);
    let other = Options {
        gaussians: [("plates".to_owned(), keep.path().join("other.ply"))].into(),
        ..given
    };
    assert_names(
        &refusal(&plan, &other),
        &["stage_one.json", "plates.ply", "other.ply"],
    );
}

#[test]
fn as_many_photos_as_asked_for_are_labelled() {
    let (keep, ..) = folder();
    let labelled = |photos: usize| {
        let text = PLAN.replace(
            "name = \"swapped\"",
            &format!("name = \"swapped\"\nlabelled_photos = {photos}"),
        );
        Plan::read(&write_plan(keep.path(), &text), None).expect("a plan")
    };
    let only = |out: &str| Options {
        only: "/vote/".into(),
        ..options(&keep.path().join(out))
    };
    // What the labels are, by their digests.
    let labels_of = |photos: usize, out: &str| {
        let plan = labelled(photos);
        compare(&plan, &only(out), &mut Notes::default()).expect("cells");
        [0, 1].map(|seed| {
            let cell = format!("{out}/cells/plates/swapped/vote/{seed}.json");
            let cell = read_json(&keep.path().join(cell));
            cell["provenance"]["data"]["labels"]["digest"].clone()
        })
    };
    let [all, again] = labels_of(4, "four");
    assert!(all.is_string() && all == again, "all photos of any draw");
    let [two, others] = labels_of(2, "two");
    assert!(
        two != all && others != all && two != others,
        "seeds draw other photos"
    );
    let error = refusal(&labelled(5), &only("five"));
    assert_names(&error, &["labelled_photos", "found 5", "at most 4"]);
}

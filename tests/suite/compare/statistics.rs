//! Means and spreads, and what of them is bold.

use super::{PLAN, write_plan};
use coseg::compare::{Cell, Figures, Plan, Statistic, Tables};

fn near(found: Option<f64>, want: f64) -> bool {
    found.is_some_and(|found| (found - want).abs() < 1e-12)
}

#[test]
fn means_are_over_scenes_and_spreads_over_seeds() {
    let values = [
        vec![Some(0.5), Some(0.6), Some(0.7)],
        vec![Some(0.3), Some(0.1), Some(0.2)],
    ];
    let found = Statistic::of(&values).expect("values");
    // Means over scenes: 0.4, 0.35, 0.45.
    assert!(near(Some(found.mean), 0.4), "{found:?}");
    assert!(near(found.spread, 0.05), "{found:?}");
    assert_eq!(found.cells, 6);
}

#[test]
fn scenes_with_fewer_cells_count_as_much() {
    let values = [vec![Some(0.5), Some(0.7)], vec![Some(0.2), None]];
    let found = Statistic::of(&values).expect("values");
    assert!(near(Some(found.mean), 0.4), "{found:?}");
    assert_eq!(
        (found.spread, found.cells),
        (None, 3),
        "one seed has both scenes"
    );
    assert_eq!(Statistic::of(&[vec![None, None]]), None);
    assert_eq!(Statistic::of(&[]), None);
}

/// The lines of both rows in the table of cells with the mIoU `scores` of the seeds; `None` is a cell that is missing.
fn lines(scores: [[Option<f64>; 2]; 2]) -> [String; 2] {
    let folder = tempfile::tempdir().expect("a folder");
    let plan = Plan::read(&write_plan(folder.path(), PLAN), None).expect("a plan");
    let of = |row: &str, seed: u64| scores[usize::from(row != "vote")][seed as usize];
    let cells: Vec<Cell> = plan
        .cells()
        .into_iter()
        .filter_map(|id| {
            let miou = of(&id.row, id.seed)?;
            Some(Cell {
                variant: coseg::config::Variant::Vote,
                commit: "abc1234".into(),
                command: "a command".into(),
                device: "a processor".into(),
                figures: Figures {
                    miou: Some(miou),
                    ..Figures::default()
                },
                class_iou: Vec::new(),
                id,
            })
        })
        .collect();
    let table = Tables::new(&plan, &cells, "a command").markdown();
    ["| vote |", "| ours, count |"].map(|start| {
        let line = table.lines().find(|line| line.starts_with(start));
        line.expect("a line").to_owned()
    })
}

#[test]
fn only_a_lead_beyond_the_spread_is_bold() {
    let both = |a, b| [Some(a), Some(b)];
    let [vote, ours] = lines([both(0.50, 0.52), both(0.60, 0.64)]);
    assert!(vote.starts_with("| vote | 51.0 ± 1.4 | – |"), "{vote}");
    assert!(
        ours.starts_with("| ours, count | **62.0 ± 2.8** | – |"),
        "{ours}"
    );
    // 2.5 points ahead, with a spread of 2.8.
    let [vote, ours] = lines([both(0.585, 0.605), both(0.60, 0.64)]);
    assert!(
        !vote.contains("**") && !ours.contains("**"),
        "{vote} {ours}"
    );
    // A row with a missing cell may be better.
    let [vote, ours] = lines([[Some(0.5), None], both(0.60, 0.64)]);
    assert!(vote.starts_with("| vote | 50.0 (1 of 2) |"), "{vote}");
    assert!(ours.starts_with("| ours, count | 62.0 ± 2.8 |"), "{ours}");
    let [vote, _] = lines([[None, None], both(0.60, 0.64)]);
    assert!(vote.starts_with("| vote | empty | empty |"), "{vote}");
}

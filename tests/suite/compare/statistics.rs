//! Means and spreads, and what of them is bold.

use crate::support::comparison::{PLAN, write_plan};
use coseg::compare::{Cell, Figures, Plan, Statistic, Tables};
use coseg::metrics::PixelScores;
use coseg::pipeline::FieldScores;

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
    let figures = |miou| Figures {
        pixels: PixelScores {
            miou: Some(miou),
            ..PixelScores::default()
        },
        ..Figures::default()
    };
    let [_, vote, ours] = table(scores.map(|row| row.map(|miou| miou.map(figures))));
    [vote, ours]
}

/// The headings and the lines of both rows in the table of cells with these figures.
fn table(figures: [[Option<Figures>; 2]; 2]) -> [String; 3] {
    let folder = tempfile::tempdir().expect("a folder");
    let plan = Plan::read(&write_plan(folder.path(), PLAN), None).expect("a plan");
    let of = |row: &str, seed: u64| figures[usize::from(row != "vote")][seed as usize];
    let cells: Vec<Cell> = plan
        .cells()
        .into_iter()
        .filter_map(|id| {
            Some(Cell {
                figures: of(&id.row, id.seed)?,
                variant: coseg::config::Variant::Vote,
                commit: "abc1234".into(),
                command: "a command".into(),
                device: "a processor".into(),
                class_iou: Vec::new(),
                id,
            })
        })
        .collect();
    let table = Tables::new(&plan, &cells, "a command").markdown();
    ["| | mIoU", "| vote |", "| ours, count |"].map(|start| {
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

#[test]
fn columns_of_feature_fields_are_shown_where_there_are_some() {
    let plain = Some(Figures::default());
    let field = |ch: f64, db: f64| {
        let field = FieldScores {
            calinski_harabasz: Some(ch),
            davies_bouldin: Some(db),
            seconds: 20.0,
            learnable_bytes: 1_500_000,
        };
        Some(Figures {
            field: Some(field),
            ..Figures::default()
        })
    };
    let [headings, vote, _] = table([[plain; 2]; 2]);
    assert!(headings.ends_with("| PSNR, dB |"), "{headings}");
    assert!(vote.ends_with("| – |"), "{vote}");

    let [headings, vote, ours] = table([
        [field(700.0, 4.0), field(702.0, 4.2)],
        [field(650.0, 3.0), field(652.0, 3.2)],
    ]);
    assert!(
        headings.ends_with("| PSNR, dB | CH | DB | features, s | features, MB |"),
        "{headings}"
    );
    // A low Davies-Bouldin index is the better one.
    assert!(
        vote.ends_with("| **701.0 ± 1.4** | 4.10 ± 0.14 | 20 | 1.50 |"),
        "{vote}"
    );
    assert!(
        ours.ends_with("| 651.0 ± 1.4 | **3.10 ± 0.14** | 20 | 1.50 |"),
        "{ours}"
    );
    // A cell of an earlier program has no such figures.
    let [_, vote, ours] = table([[plain; 2], [plain, field(650.0, 3.0)]]);
    assert!(vote.ends_with("| – | – | – | – | – |"), "{vote}");
    let partial = "| – | 650.0 (1 of 2) | 3.00 (1 of 2) | 20 (1 of 2) | 1.50 (1 of 2) |";
    assert!(ours.ends_with(partial), "{ours}");
    // A row with an empty cell, and a column that none of its cells has.
    let [_, vote, _] = table([[plain, None], [field(650.0, 3.0); 2]]);
    assert!(vote.ends_with("| – | – | – | – | – |"), "{vote}");
}

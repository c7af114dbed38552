//! Tables of a small plan.

use super::runs::{Notes, compare, folder, options, scores};
use crate::support::comparison::{PLAN, write_plan};
use crate::support::program::read_json;
use coseg::compare::{Options, Plan, Tables};
use std::path::Path;

#[test]
fn the_tables_show_the_figures_of_the_cells() {
    let (_keep, plan, out) = folder();
    let options = options(&out);
    let done = compare(&plan, &options, &mut Notes::default()).expect("a table");
    let files = Tables::new(&plan, &done.cells, &options.command)
        .write(&out)
        .expect("files");
    let names: Vec<_> = files
        .iter()
        .map(|path| path.strip_prefix(&out).expect("in out"))
        .collect();
    let want = [
        "table.md",
        "compare.json",
        "miou_frames_swapped.svg",
        "miou_seconds_swapped.svg",
        "iou_swapped_plates.svg",
    ];
    assert_eq!(names, want.map(Path::new));

    let json = read_json(&out.join("compare.json"));
    assert_eq!(
        (json["empty"].as_array().map(Vec::len), &json["command"]),
        (Some(0), &options.command.clone().into())
    );
    assert_eq!(json["commits"]["abc1234"], 4);
    let markdown = std::fs::read_to_string(out.join("table.md")).expect("a table");
    for (line, row) in ["vote", "ours, count"].iter().enumerate() {
        let cells = [0, 1]
            .map(|seed| read_json(&out.join(format!("cells/plates/swapped/{row}/{seed}.json"))));
        let of = |key: &str| {
            cells
                .each_ref()
                .map(|cell| cell["figures"][key].as_f64().expect("a figure"))
        };
        for key in [
            "miou",
            "miou_per_view",
            "accuracy",
            "boundary_iou",
            "frames_per_second",
            "psnr",
            "learnable_bytes",
        ] {
            let [a, b] = of(key);
            let found = &json["lines"][line]["figures"][key];
            let near = |value: &serde_json::Value, want: f64| {
                (value.as_f64().expect("a number") - want).abs() <= 1e-12 * want.abs().max(1.0)
            };
            assert!(near(&found["mean"], 0.5 * (a + b)), "{key}: {found}");
            assert!(
                near(&found["spread"], (a - b).abs() / 2.0_f64.sqrt()),
                "{key}: {found}"
            );
        }
        let [a, b] = of("miou");
        let shown = format!(
            "{:.1} ± {:.1}",
            50.0 * (a + b),
            100.0 * (a - b).abs() / 2.0_f64.sqrt()
        );
        let found = markdown
            .lines()
            .find(|line| line.starts_with(&format!("| {row} |")))
            .expect("a line");
        assert_eq!(
            found.split(" | ").nth(1).map(|cell| cell.replace('*', "")),
            Some(shown),
            "{found}"
        );
    }
    assert!(markdown.contains(&options.command) && markdown.contains("empty cells: 0 of 4"));
    for name in &want[2..] {
        let svg = std::fs::read_to_string(out.join(name)).expect("a plot");
        assert!(
            svg.contains("<desc>coseg compare plan.toml --out &lt;here&gt;</desc>"),
            "{name}"
        );
        assert!(svg.contains("ours, count"), "{name}");
    }
}

#[test]
fn feature_fields_are_scored_and_cells_without_scores_are_read() {
    let (keep, ..) = folder();
    let distilled = "\n[[rows]]\nname = \"distilled\"\nvariant = \"distilled\"\n";
    let path = write_plan(keep.path(), &(PLAN.to_owned() + distilled));
    let plan = Plan::read(&path, None).expect("a plan");
    let out = keep.path().join("out");
    let options = Options {
        only: "/0".into(),
        ..options(&out)
    };
    let done = compare(&plan, &options, &mut Notes::default()).expect("three cells");
    let field = |row: &str| {
        let cell = done.cells.iter().find(|cell| cell.id.row == row);
        cell.expect("a cell").figures.field
    };
    assert_eq!(field("vote"), None, "it reads no features");
    let [lifted, learned] = ["ours, count", "distilled"].map(|row| field(row).expect("scores"));
    for scores in [lifted, learned] {
        assert!(
            scores.calinski_harabasz.is_some_and(|ch| ch > 0.0),
            "{scores:?}"
        );
        assert!(
            scores.davies_bouldin.is_some_and(|db| db > 0.0),
            "{scores:?}"
        );
        assert!(scores.seconds > 0.0, "{scores:?}");
    }
    let figures = done.cells.iter().find(|cell| cell.id.row == "distilled");
    let figures = figures.expect("a cell").figures;
    assert_eq!(lifted.learnable_bytes, 0);
    assert!((1..figures.learnable_bytes).contains(&learned.learnable_bytes));
    assert!(
        figures
            .training_seconds
            .is_some_and(|all| all > learned.seconds)
    );

    // Cells as they were before fields were scored.
    for row in ["ours, count", "distilled", "vote"] {
        let cell = out.join(format!("cells/plates/swapped/{row}/0.json"));
        let mut json = read_json(&cell);
        let figures = json["figures"].as_object_mut().expect("figures");
        figures.remove("field").expect("written by this program");
        std::fs::write(&cell, json.to_string()).expect("written");
    }
    let mut notes = Notes::default();
    let read = compare(&plan, &options, &mut notes).expect("three cells");
    assert!(notes.begun.is_empty(), "{:?}", notes.begun);
    assert_eq!(scores(&read.cells), scores(&done.cells));
    assert!(read.cells.iter().all(|cell| cell.figures.field.is_none()));
    let tables = [&done.cells, &read.cells].map(|cells| Tables::new(&plan, cells, "a command"));
    let [new, old] = tables.map(|tables| tables.markdown());
    assert!(new.contains("| CH | DB | features, s |"), "{new}");
    assert!(!old.contains("| CH |"), "{old}");
}

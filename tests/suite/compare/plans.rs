//! Plans: what each fault of a file is answered with.

use crate::support::assert_names;
use crate::support::comparison::{PLAN, write_plan};
use coseg::compare::{Plan, Tables};
use coseg::error::Error;

/// The refusal of the plan with `from` replaced by `to`.
#[track_caller]
fn refused(from: &str, to: &str) -> Error {
    assert!(PLAN.contains(from), "{from:?} is not in the plan");
    let folder = tempfile::tempdir().expect("a folder");
    let path = write_plan(folder.path(), &PLAN.replacen(from, to, 1));
    let error = Plan::read(&path, None).expect_err("a refusal");
    assert_names(&error, &["plan.toml"]);
    error
}

#[test]
fn a_plan_names_its_cells() {
    let folder = tempfile::tempdir().expect("a folder");
    let plan = Plan::read(&write_plan(folder.path(), PLAN), None).expect("a plan");
    let names: Vec<String> = plan.cells().iter().map(ToString::to_string).collect();
    let want = [
        "plates/swapped/vote/0",
        "plates/swapped/ours, count/0",
        "plates/swapped/vote/1",
        "plates/swapped/ours, count/1",
    ];
    assert_eq!(names, want);
    // The scenes may lie elsewhere.
    let error = Plan::read(&plan.path, Some(&folder.path().join("elsewhere")));
    assert_names(
        &error.expect_err("no scene"),
        &["no such folder", "elsewhere/plates"],
    );
}

#[test]
fn faults_are_named() {
    let cases: &[(&str, &str, &[&str])] = &[
        (
            "title = \"plates\"",
            "title = \" \"",
            &["title", "a line of text"],
        ),
        ("title = \"plates\"", "", &["title", "a plan: "]),
        (
            "title = \"plates\"",
            "titel = \"plates\"",
            &["line 2", "unknown field", "titel"],
        ),
        ("title = \"plates\"", "title = [", &["line 3"]),
        ("seeds = 2", "seeds = 0", &["seeds", "1 or more"]),
        ("seeds = 2", "seeds = -1", &["line 4"]),
        (
            "seeds = 2",
            "seeds = 9000000000000000000",
            &["exceeds the limit of 10000"],
        ),
        ("seeds = 2", "seeds = 6000", &["12000", "10000"]),
        ("[\"plates\"]", "[]", &["scenes", "one or more"]),
        ("[\"plates\"]", "[\"other\"]", &["no such folder", "other"]),
        (
            "[\"plates\"]",
            "[\"plates\", \"plates\"]",
            &["scenes, number 2", "twice"],
        ),
        ("[\"plates\"]", "[\"..\"]", &["scenes, number 1", "\"\""]),
        (
            "name = \"vote\"",
            "name = \"ours, count\"",
            &["rows, number 2", "twice"],
        ),
        (
            "name = \"vote\"",
            "name = \"../vote\"",
            &["rows, number 1", "../vote"],
        ),
        (
            "name = \"vote\"",
            "name = \"a | b\"",
            &["rows, number 1", "a | b"],
        ),
        ("name = \"vote\"", "name = \"\"", &["rows, number 1"]),
        (
            "name = \"swapped\"",
            "name = \"a\\\\b\"",
            &["labels, number 1"],
        ),
        (
            "variant = \"vote\"",
            "variant = \"votes\"",
            &["unknown variant", "votes", "pooled_vote"],
        ),
        (
            "variant = \"vote\"",
            "variant = \"vote\"\ncolour = 3",
            &["unknown field", "colour"],
        ),
        (
            "normalisation = \"count\"",
            "normalisation = \"counts\"",
            &["rows \"ours, count\", unprojection.normalisation", "counts"],
        ),
        (
            "unprojection.normalisation = \"count\"",
            "building.iterations = 3",
            &["rows \"ours, count\", building", "the same Gaussians"],
        ),
        (
            "unprojection.normalisation = \"count\"",
            "data.raw_labels = \"labels\"",
            &["rows \"ours, count\", data"],
        ),
        (
            "unprojection.normalisation = \"count\"",
            "segmentation.rows = [\"raw\"]",
            &["segmentation.rows", "`rows` lists them"],
        ),
        (
            "data.raw_labels = \"raw\"",
            "building.iterations = 3",
            &["labels \"swapped\", building"],
        ),
        (
            "data.raw_labels = \"raw\"",
            "data.dir = \"x\"",
            &["labels \"swapped\", data.dir"],
        ),
        (
            "settings.data.raw_labels = \"raw\"",
            "labelled_photos = 0",
            &["labelled_photos", "1 or more"],
        ),
        (
            "segmentation.iterations = 8",
            "seed = 8",
            &["settings, seed", "`seeds` counts them"],
        ),
        (
            "segmentation.iterations = 8",
            "segmentation.iteration = 8",
            &[
                "segmentation.iteration",
                "did you mean segmentation.iterations?",
            ],
        ),
        (
            "segmentation.iterations = 8",
            "segmentation.iterations = 0",
            &["segmentation.iterations"],
        ),
    ];
    for (from, to, parts) in cases {
        assert_names(&refused(from, to), parts);
    }
}

#[test]
fn published_figures_are_shown_below() {
    let folder = tempfile::tempdir().expect("a folder");
    let rows = "| | mIoU, % | source |\n|---|---:|---|\n| theirs | 81.75 | a paper, Table 1 |";
    let text = format!("published = '''\n{rows}\n'''\n{PLAN}");
    let plan = Plan::read(&write_plan(folder.path(), &text), None).expect("a plan");
    assert_eq!(plan.cells().len(), 4, "nothing is trained for them");
    let table = Tables::new(&plan, &[], "a command").markdown();
    let (measured, published) = table.split_once("## Published").expect("a heading");
    assert!(
        measured.contains("empty cells: 4 of 4") && !measured.contains("theirs"),
        "{measured}"
    );
    assert!(published.contains("not comparable"), "{published}");
    assert!(published.ends_with(&format!("\n\n{rows}\n")), "{published}");
    let without = Plan::read(&write_plan(folder.path(), PLAN), None).expect("a plan");
    let table = Tables::new(&without, &[], "a command").markdown();
    assert!(!table.contains("Published"), "{table}");
}

#[test]
fn files_that_are_no_plan_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = write_plan(folder.path(), "");
    for bytes in [
        &b"\xff\xfe\0"[..],
        b"",
        b"[[rows]]",
        b"title = {}",
        b"rows = 3\nlabels = []",
    ] {
        std::fs::write(&path, bytes).expect("written");
        assert_names(
            &Plan::read(&path, None).expect_err("a refusal"),
            &["plan.toml"],
        );
    }
    let error = Plan::read(&folder.path().join("none.toml"), None);
    assert!(matches!(error, Err(Error::Io { .. })));
}

#[test]
fn plans_of_the_crate_are_valid_but_for_their_scenes() {
    let tables = concat!(env!("CARGO_MANIFEST_DIR"), "/configs/tables");
    let scenes = tempfile::tempdir().expect("a folder");
    for scene in ["house_living", "house_kitchen", "studio"] {
        std::fs::create_dir(scenes.path().join(scene)).expect("a folder");
    }
    let mut plans = 0;
    for entry in std::fs::read_dir(tables).expect("configs/tables") {
        let path = entry.expect("an entry").path();
        let plan = Plan::read(&path, Some(scenes.path()));
        plan.unwrap_or_else(|error| panic!("{error}"));
        plans += 1;
    }
    assert!(plans >= 5, "{plans} plans");
}

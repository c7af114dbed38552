//! `coseg associate`, and a run on the objects that it finds.

use crate::support::plate_objects::{plate_folder, short_run};
use crate::support::plates::plates;
use crate::support::program::{fails, read_json, succeeds, utf8, warnings};
use coseg::data::{Classes, LabelMap};
use coseg::splat::ply;
use std::collections::BTreeSet;
use std::fs;

#[test]
fn associate_writes_maps_of_global_ids() {
    let folder = tempfile::tempdir().expect("folder");
    let dir = folder.path();
    plate_folder(dir);
    let ply = dir.join("plates.ply");
    let out = dir.join("out");
    let arguments = [
        "associate",
        "--scene",
        utf8(&ply),
        "--data",
        utf8(dir),
        "--out",
        utf8(&out),
    ];
    let said = succeeds(&arguments);
    assert!(
        said.contains(
            "16 segments of training views joined into 4 objects; 0 segments are in no object"
        ),
        "{said}"
    );
    assert!(
        said.contains("held-out views, maps: accuracy 1.0000, mIoU 1.0000, PQ 1.0000"),
        "{said}"
    );
    assert!(
        said.contains("held-out views, rendered: accuracy 1.0000"),
        "{said}"
    );
    let classes = Classes::read(&out.join("classes.json")).expect("classes");
    assert_eq!((classes.len(), classes.name(4)), (4, "object 4"));
    let bytes = fs::read(out.join("labels/v2.png")).expect("map");
    assert_eq!(bytes[24..26], [16, 0], "16-bit grey");
    let labels = ply::read(&out.join("scene.ply"))
        .expect("scene")
        .labels
        .expect("labels");
    let (_, truth) = plates();
    let pairs: BTreeSet<(u16, u16)> = labels
        .iter()
        .copied()
        .zip(truth)
        .filter(|(found, _)| *found > 0)
        .collect();
    assert_eq!(pairs.len(), 4, "{pairs:?}");
    // The ids mean the same in all views.
    let mut pairs = BTreeSet::new();
    for i in 0..6 {
        let map = LabelMap::read(&out.join(format!("labels/v{i}.png"))).expect("map");
        let truth = LabelMap::read(&dir.join(format!("labels/v{i}.png"))).expect("truth");
        pairs.extend(map.ids.into_iter().zip(truth.ids));
    }
    assert_eq!(
        pairs.iter().filter(|(found, _)| *found > 0).count(),
        4,
        "{pairs:?}"
    );
    let message = fails(
        &[&arguments[..], &["--set", "data.association=tracks"]].concat(),
        2,
    );
    assert!(
        message.contains("\"none\"") && message.contains("\"gaussians\""),
        "{message}"
    );
}

#[test]
fn a_run_trains_on_objects_and_scores_them() {
    let folder = tempfile::tempdir().expect("folder");
    let dir = folder.path();
    plate_folder(dir);
    let run = dir.join("run");
    let said = short_run(dir, &run);
    assert!(
        said.contains("16 segments of training views joined into"),
        "{said}"
    );
    let warned = warnings(&["train", "--resume", utf8(&run)]);
    assert!(!warned.contains("only the Gaussians"), "{warned}");
    let metrics = read_json(&run.join("metrics.json"));
    assert_eq!(metrics["association"]["segments"], 16);
    let labels = &metrics["test"]["labels"];
    for row in ["raw", "vote", "per_gaussian"] {
        let scores = &labels[row]["instances"];
        assert_eq!(
            (&scores["instances"], &labels[row]["miou"]),
            (&4.into(), &serde_json::Value::Null),
            "{labels}"
        );
        assert!(
            scores["accuracy"].as_f64().expect("accuracy") > 0.5,
            "{row}: {scores}"
        );
    }
    let page = fs::read_to_string(run.join("report.html")).expect("page");
    assert!(
        page.contains("Objects against true instances")
            && page.contains("By association, 16 segments of training views joined into"),
        "the page says so"
    );
    let classes = Classes::read(&run.join("classes.json")).expect("classes");
    assert!(classes.name(1).starts_with("object "));
    let said: serde_json::Value =
        serde_json::from_str(&succeeds(&["eval", utf8(&run), "--json"])).expect("JSON");
    let scores = &said["test"]["labels"]["per_gaussian"];
    let [found, told] = [
        &scores["instances"]["accuracy"],
        &labels["per_gaussian"]["instances"]["accuracy"],
    ];
    assert!(
        (found.as_f64().expect("score") - told.as_f64().expect("score")).abs() < 1e-3,
        "{said}"
    );
    assert_eq!(scores["miou"], serde_json::Value::Null);
}

//! `coseg bench` as a person runs it. The tests check that it measures, never what.

use crate::support::plates::scene;
use crate::support::program::{cpu_backend, fails, read_json, succeeds, utf8};
use std::path::Path;

/// `bench --repeats 1` on a CPU backend.
fn quick(more: &[&str]) -> String {
    succeeds(
        &[
            &["bench", "--repeats", "1", "--backend", &cpu_backend()],
            more,
        ]
        .concat(),
    )
}

/// The figures of a section for this number of Gaussians in a JSON file.
fn figures(path: &Path, section: &str, gaussians: usize) -> Vec<serde_json::Value> {
    let json = read_json(path);
    let sections = json["sections"].as_array().unwrap();
    let found = sections
        .iter()
        .find(|s| s["section"] == section && s["gaussians"] == gaussians)
        .unwrap_or_else(|| panic!("{section}: {json}"));
    let figures = found["figures"].as_array().unwrap();
    for figure in figures {
        let number = |key: &str| {
            figure[key]
                .as_f64()
                .unwrap_or_else(|| panic!("{key}: {figure}"))
        };
        let (low, median, high) = (number("low"), number("median"), number("high"));
        assert!(low <= median && median <= high && low >= 0.0, "{figure}");
        assert!(figure["samples"].as_u64().unwrap() > 0, "{figure}");
    }
    figures.clone()
}

fn named<'a>(figures: &'a [serde_json::Value], name: &str) -> &'a serde_json::Value {
    let found = figures.iter().find(|figure| figure["name"] == name);
    found.unwrap_or_else(|| panic!("{name}: {figures:?}"))
}

#[test]
fn both_sections_run_before_training() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let json = folder.path().join("deep/figures.json");
    let said = quick(&[
        "--data",
        utf8(folder.path()),
        "--gaussians",
        "300,400",
        "--set",
        "building.random_points=300",
        "--json",
        utf8(&json),
    ]);
    let places = [
        "300 initial Gaussians",
        "curve: 300 Gaussians",
        "curve: 400 Gaussians",
        "stages: 300 Gaussians",
        "stages: 400 Gaussians",
        "figures: ",
    ]
    .map(|text| said.find(text));
    assert!(places.is_sorted() && places[0].is_some(), "{said}");
    for gaussians in [300, 400] {
        let stages = figures(&json, "stages", gaussians);
        for name in [
            "stage one, a step",
            "image features of all views",
            "their lifting onto the Gaussians",
            "stage two, the first step on a view",
            "stage two, a step",
        ] {
            assert!(
                named(&stages, name)["median"].as_f64().unwrap() > 0.0,
                "{name}"
            );
        }
        assert_eq!(named(&stages, "stage two, a step")["samples"], 20);
    }
    let machine = &read_json(&json)["machine"];
    assert!(
        machine["threads"].as_u64().unwrap() > 0 && !machine["cpu"].as_str().unwrap().is_empty(),
        "{machine}"
    );
}

#[test]
fn coarser_settings_err_more_and_exact_ones_least() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let json = folder.path().join("figures.json");
    let data = utf8(folder.path());
    quick(&[
        "--only",
        "curve",
        "--data",
        data,
        "--gaussians",
        "300",
        "--json",
        utf8(&json),
    ]);
    let found = figures(&json, "curve", 300);
    let error = |name: &str| named(&found, name)["errors"][0].as_f64().unwrap();
    assert!(
        error("alpha_min 1/32") > error("alpha_min 1/64")
            && error("alpha_min 1/64") > error("alpha_min 1/1024")
    );
    assert!(error("t_min 0.01") > error("t_min 1e-3"));
    assert!(error("all exact") < 1e-6, "{}", error("all exact"));
    assert!(error("0.5 of the Gaussians") > error("0.75 of the Gaussians"));
    assert!(error("image scale 1/4") > error("image scale 1/2"));
    assert!(error("SH rounded to f16") > 0.0);
    let gradients = figures(&json, "curve of gradients", 300);
    // Initial Gaussians are round, so their rotations have no gradient to compare with.
    for kind in [0, 1, 3, 4] {
        let error = |name: &str| named(&gradients, name)["errors"][kind].as_f64().unwrap();
        assert!(error("all exact") < 1e-4, "{}", error("all exact"));
        assert!(error("alpha_min 1/32") > error("alpha_min 1/1024"));
    }
}

#[test]
fn trained_gaussians_come_from_a_run() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join("run");
    let data = utf8(folder.path());
    let out = utf8(&run);
    let backend = cpu_backend();
    let mut train = vec!["train", "--data", data, "--out", out, "--backend", &backend];
    for setting in [
        "building.iterations=3",
        "building.random_points=200",
        "building.max_gaussians=unlimited",
        "segmentation.rows=raw",
    ] {
        train.extend(["--set", setting]);
    }
    succeeds(&train);
    let said = quick(&["--run", out, "--only", "stages"]);
    for part in [
        "200 trained Gaussians",
        "stages: 200 Gaussians",
        "stage two, a step",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    assert!(!said.contains("curve: "), "{said}");
}

#[test]
fn mistakes_are_named() {
    let message = fails(&["bench", "--only", "speed"], 2);
    assert!(
        message.contains("speed") && message.contains("curve, stages"),
        "{message}"
    );
    fails(&["bench", "--repeats", "0"], 2);
    fails(&["bench", "--gaussians", "0"], 2);
    fails(&["bench", "--run", "runs/x", "--data", "y"], 2);
    let message = fails(&["bench", "--run", "no/such/run"], 1);
    assert!(message.contains("no such folder"), "{message}");
}

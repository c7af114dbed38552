//! `coseg bench` as a person runs it. The tests check that it measures, never what.

use crate::cli::commands::{fails, read_json, succeeds, utf8};
use crate::support::plates::scene;
use coseg::backend::device::BackendName;
use coseg::bench::{Section, Source, Subject};
use coseg::config::Config;
use coseg::data::Limits;
use std::path::Path;

/// The name of a CPU backend.
fn backend() -> String {
    BackendName::compiled()
        .iter()
        .rfind(|name| **name != BackendName::Wgpu)
        .unwrap()
        .to_string()
}

/// `bench --quick` on a CPU backend.
fn quick(more: &[&str]) -> String {
    succeeds(&[&["bench", "--quick", "--backend", &backend()], more].concat())
}

/// The figures of a section in a JSON file.
fn figures(path: &Path, section: &str) -> Vec<serde_json::Value> {
    let json = read_json(path);
    let sections = json["sections"].as_array().unwrap();
    let found = sections
        .iter()
        .find(|s| s["section"] == section)
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
        assert!(
            !figure["case"].as_str().unwrap().is_empty() && figure["samples"].as_u64().unwrap() > 0,
            "{figure}"
        );
    }
    figures.clone()
}

#[test]
fn every_section_runs_on_the_built_in_room() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("deep/figures.json");
    let said = quick(&["--json", utf8(&json)]);
    for section in Section::ALL {
        let title = format!("{section}: {}", section.title());
        assert!(said.contains(&title), "{title}: {said}");
        assert!(figures(&json, section.key()).len() > 1, "{section}: {said}");
    }
    assert!(
        said.contains("not trained") && !said.contains("skipped"),
        "{said}"
    );
    let machine = &read_json(&json)["machine"];
    assert!(
        machine["threads"].as_u64().unwrap() > 0 && !machine["cpu"].as_str().unwrap().is_empty(),
        "{machine}"
    );
}

#[test]
fn coarser_settings_err_more_and_exact_ones_least() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("figures.json");
    quick(&["--only", "curve", "--json", utf8(&json)]);
    let found = figures(&json, "curve");
    let error = |case: &str| {
        let row = found
            .iter()
            .find(|f| f["case"] == case && f["name"] == "mean error");
        row.unwrap_or_else(|| panic!("{case}: {found:?}"))["median"]
            .as_f64()
            .unwrap()
    };
    assert!(
        error("alpha_min 1/32") > error("alpha_min 1/64")
            && error("alpha_min 1/64") > error("alpha_min 1/1024")
    );
    assert!(error("t_min 0.01") > error("t_min 1e-3"));
    assert!(error("all exact") < 1e-6, "{}", error("all exact"));
    assert_eq!(found[1]["name"], "of the first");
    assert_eq!(found[1]["median"], 1.0);
}

#[test]
fn trained_scenes_come_from_files_or_from_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let (ply, cameras) = (scene(folder.path()), folder.path().join("transforms.json"));
    let files = ["--scene", utf8(&ply), "--cameras", utf8(&cameras)];
    let said = quick(&[&files[..], &["--only", "curve,building"]].concat());
    assert!(
        said.contains("plates.ply, 111 trained Gaussians") && said.contains("300 Gaussians"),
        "{said}"
    );
    assert!(
        said.contains("skipped: --scene and --cameras have no photos"),
        "{said}"
    );

    // Sections keep their own order, whatever the order in which they are named.
    let said = quick(&[
        "--data",
        utf8(folder.path()),
        "--only",
        "segmentation,building",
        "--gaussians",
        "300,400",
        "--set",
        "building.random_points=300",
    ]);
    let places = [
        "building: ",
        "300 Gaussians",
        "400 Gaussians",
        "segmentation: ",
    ]
    .map(|word| said.find(word));
    assert!(places.is_sorted() && places[0].is_some(), "{said}");
    let run = folder.path().join("run");
    let (data, out, backend) = (utf8(folder.path()), utf8(&run), backend());
    let mut train = vec!["train", "--data", data, "--out", out, "--backend", &backend];
    for setting in [
        "building.iterations=3",
        "building.random_points=200",
        "segmentation.rows=raw",
    ] {
        train.extend(["--set", setting]);
    }
    succeeds(&train);
    let said = quick(&["--run", utf8(&run), "--only", "unprojection"]);
    assert!(said.contains("scene.ply, 200 trained Gaussians"), "{said}");
}

#[test]
fn other_renderers_get_the_same_gaussians_and_cameras() {
    let folder = tempfile::tempdir().unwrap();
    let (ply, cameras) = (scene(folder.path()), folder.path().join("transforms.json"));
    let out = folder.path().join("out");
    let said = quick(&[
        "--scene",
        utf8(&ply),
        "--cameras",
        utf8(&cameras),
        "--gaussians",
        "600",
        "--only",
        "curve",
        "--export",
        utf8(&out),
    ]);
    let files = [
        "gaussians_600.ply",
        "cameras_64x48.json",
        "cameras_96x64.json",
    ]
    .map(|name| out.join(name));
    assert!(files.iter().all(|file| said.contains(utf8(file))), "{said}");
    // Both are read back as what they are, and show what the plates show.
    let gaussians = coseg::splat::ply::read(&files[0], &Limits::default()).unwrap();
    assert_eq!(
        (gaussians.gaussians.len(), gaussians.origin),
        (600, glam::DVec3::ZERO)
    );
    let views = coseg::data::formats::transforms::load_cameras(&files[2], None).unwrap();
    let sizes: Vec<_> = views
        .iter()
        .map(|view| [view.camera.width, view.camera.height])
        .collect();
    assert_eq!(sizes, [[96, 64]; 2]);
    for view in &views {
        let picture = coseg::raster::render(
            &gaussians.gaussians,
            &view.camera,
            &Default::default(),
            [0.0; 3],
        )
        .unwrap();
        let covered = picture.transmittance.iter().filter(|t| **t < 0.5).count();
        assert!(
            covered * 4 > 96 * 64,
            "{covered} pixels of {} show something",
            view.name
        );
    }
}

#[test]
fn mistakes_are_named() {
    let message = fails(&["bench", "--only", "raster,speed"], 2);
    assert!(
        message.contains("speed") && message.contains("raster, curve, building"),
        "{message}"
    );
    fails(&["bench", "--repeats", "0"], 2);
    fails(&["bench", "--gaussians", "0"], 2);
    fails(&["bench", "--cameras", "x.json"], 2);
    fails(&["bench", "--run", "runs/x", "--data", "y"], 2);
    let message = fails(&["bench", "--quick", "--scene", "no/such.ply"], 1);
    assert!(
        message.contains("no such file: no/such.ply; give a .ply file"),
        "{message}"
    );
    let message = fails(&["bench", "--quick", "--run", "no/such/run"], 1);
    assert!(message.contains("a run folder"), "{message}");
}

#[test]
fn cameras_are_chosen_evenly_and_cycled() {
    let device = crate::support::device();
    let subject = Subject::load(&Source::Untrained, &Config::default(), true, &device).unwrap();
    let cameras = subject.cameras(9, [32, 32]);
    assert_eq!(
        (subject.cameras.len(), cameras.len(), &cameras[0]),
        (6, 9, &cameras[6])
    );
}

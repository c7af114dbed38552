//! `coseg bench` as a person runs it. What it measures is never asserted, only that it measures and says what.

use crate::cli::commands::{fails, read_json, succeeds, utf8};
use crate::support::plates::scene;
use coseg::backend::device::BackendName;
use coseg::bench::{Effort, Section, Source, Subject, Surfaces};
use coseg::config::Config;
use coseg::data::Limits;
use coseg::data::builtin::{BuiltinOptions, scene_with};
use coseg::raster::{Projected, Settings};
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

fn named<'f>(figures: &'f [serde_json::Value], name: &str) -> Vec<&'f serde_json::Value> {
    figures
        .iter()
        .filter(|f| f["name"].as_str().unwrap().starts_with(name))
        .collect()
}

#[test]
fn the_rasterizer_gets_a_table_and_json() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("deep/figures.json");
    let said = quick(&["--only", "raster", "--repeats", "2", "--json", utf8(&json)]);
    for word in [
        "raster: ",
        "thread",
        "made without training",
        "1,200 Gaussians",
        "forward + backward",
        "pairs a pixel",
    ] {
        assert!(said.contains(word), "{word}: {said}");
    }
    assert!(
        said.contains("figures mean nothing") && !said.contains("building: "),
        "{said}"
    );
    let found = figures(&json, "raster");
    let forward = named(&found, "forward");
    assert!(
        forward
            .iter()
            .any(|f| f["samples"] == 2 && f["unit"] == "ms"),
        "{forward:?}"
    );
    let pairs = named(&found, "forward, a pair and core");
    assert_eq!(pairs.len(), 2);
    // Bars are for full size: shown, not judged.
    assert!(
        pairs[0]["bar"]["limit"] == 4.0 && pairs[0]["bar"]["met"].is_null(),
        "{pairs:?}"
    );
    assert!(
        named(&found, "pairs a pixel")
            .iter()
            .all(|f| f["median"].as_f64().unwrap() > 1.0)
    );
    let growth = named(&found, "growth of forward from 300");
    assert!(
        growth[0]["bar"]["limit"] == 4.0 && growth[0]["bar"]["met"].is_boolean(),
        "{growth:?}"
    );
    let machine = &read_json(&json)["machine"];
    assert!(
        machine["threads"].as_u64().unwrap() > 0 && !machine["cpu"].as_str().unwrap().is_empty(),
        "{machine}"
    );
}

#[test]
fn every_section_runs_on_the_built_in_room() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("figures.json");
    let said = quick(&["--json", utf8(&json)]);
    for section in Section::ALL {
        assert!(
            said.contains(&format!("{section}: {}", section.title())),
            "{section}: {said}"
        );
        assert!(
            !figures(&json, section.key()).is_empty(),
            "{section}: {said}"
        );
    }
    assert!(!said.contains("skipped"), "{said}");
}

#[test]
fn memory_is_told_for_each_size_of_the_parts() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("figures.json");
    let said = quick(&["--only", "memory", "--json", utf8(&json)]);
    let found = figures(&json, "memory");
    assert_eq!(named(&found, "an iteration").len(), 4, "{said}");
    assert!(
        said.contains("600 Gaussians, 4,096 together")
            && said.contains("600 Gaussians, all together"),
        "{said}"
    );
    if cfg!(target_os = "linux") {
        let peaks = named(&found, "peak memory");
        assert!(
            peaks.len() == 4 && peaks.iter().all(|f| f["median"].as_f64().unwrap() > 1.0),
            "{peaks:?}"
        );
    }
}

/// The roofline's table: columns follow from counts and ceilings, and counts from the pairs of the very views.
fn is_a_roofline(json: &Path, latencies: bool) {
    let found = figures(json, "roofline");
    let value = |figure: &serde_json::Value| figure["median"].as_f64().unwrap();
    assert!(
        found.iter().all(|f| value(f).is_finite() && value(f) > 0.0),
        "{found:?}"
    );
    let ceilings: Vec<_> = found.iter().filter(|f| f["case"] == "at most").collect();
    let units: Vec<_> = ceilings
        .iter()
        .map(|f| f["unit"].as_str().unwrap())
        .collect();
    assert_eq!(
        units,
        if latencies {
            &["GB/s", "GFLOP/s", "us", "us"][..]
        } else {
            &["GB/s", "GFLOP/s"]
        }
    );
    let column = |case: &str, name: &str| {
        let cell = found
            .iter()
            .find(|f| f["case"] == case && f["name"] == name);
        value(cell.unwrap_or_else(|| panic!("{case}, {name}: {found:?}")))
    };
    let cases: Vec<_> = named(&found, "reached")
        .iter()
        .map(|f| f["case"].as_str().unwrap())
        .collect();
    // Two sizes of three forward passes and a backward one, and a lifting.
    assert_eq!(cases.len(), 9, "{cases:?}");
    let close = |a: f64, b: f64| (a - b).abs() <= 1e-9 * b.abs();
    for case in cases {
        let roof = column(case, "roof");
        assert!(
            close(
                roof,
                column(case, "by memory").max(column(case, "by arithmetic"))
            ),
            "{case}"
        );
        assert!(
            close(
                column(case, "reached"),
                100.0 * roof / column(case, "measured")
            ),
            "{case}"
        );
        let highest = |i: usize| ceilings[i]["high"].as_f64().unwrap();
        assert!(
            close(
                column(case, "by memory"),
                column(case, "moved") / highest(0)
            ),
            "{case}"
        );
        assert!(
            close(
                column(case, "by arithmetic"),
                column(case, "operations") / highest(1)
            ),
            "{case}"
        );
    }
    let rgb = "600 at 64x48, RGB, forward";
    for more in [
        "600 at 64x48, RGB + 20 classes, forward",
        "600 at 64x48, RGB, forward + backward",
    ] {
        for name in ["moved", "operations"] {
            assert!(column(more, name) > column(rgb, name), "{more}: {name}");
        }
    }
    // 20 channels more are two operations more a channel and contributing pair, and nothing else.
    let device = crate::support::device();
    let subject = Subject::load(&Source::Untrained, &Config::default(), true, &device).unwrap();
    let (gaussians, settings) = (subject.gaussians(600).unwrap(), Settings::default());
    let cameras = subject.cameras(2, [64, 48]);
    let pairs = cameras.iter().map(|camera| {
        let view = Projected::new(&gaussians.splats(), camera, &settings).unwrap();
        view.count_pairs().contributing as f64
    });
    let more =
        column("600 at 64x48, RGB + 20 classes, forward", "operations") - column(rgb, "operations");
    let want = 40.0 * pairs.sum::<f64>() / 2.0 * 1e-6;
    assert!(
        (more - want).abs() < 1e-9,
        "{more} million operations, counted {want}"
    );
}

#[test]
fn the_roofline_follows_from_counts_and_ceilings() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("figures.json");
    let said = quick(&[
        "--only",
        "roofline",
        "--repeats",
        "2",
        "--json",
        utf8(&json),
    ]);
    assert!(
        said.contains("GFLOP/s") && said.contains("by arithmetic") && !said.contains("read back"),
        "{said}"
    );
    assert!(
        said.lines().all(|line| line.chars().count() <= 130),
        "{said}"
    );
    is_a_roofline(&json, false);
}

#[cfg(feature = "wgpu")]
#[test]
fn the_roofline_of_a_gpu_has_latencies_too() {
    if crate::support::gpu().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("figures.json");
    let command = [
        "bench",
        "--quick",
        "--backend",
        "wgpu",
        "--only",
        "roofline",
        "--json",
        utf8(&json),
    ];
    let said = succeeds(&command);
    assert!(said.contains("one value read back"), "{said}");
    is_a_roofline(&json, true);
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
    assert!(
        error("all exact, f32") < 1e-6,
        "{}",
        error("all exact, f32")
    );
    assert!(error("all exact, f64 (the reference)") < 1e-15);
    assert_eq!(found[1]["name"], "of the first");
    assert_eq!(found[1]["median"], 1.0);
}

#[test]
fn trained_scenes_come_from_files_or_from_a_folder() {
    let folder = tempfile::tempdir().unwrap();
    let (ply, cameras) = (scene(folder.path()), folder.path().join("transforms.json"));
    let said = quick(&[
        "--scene",
        utf8(&ply),
        "--cameras",
        utf8(&cameras),
        "--only",
        "raster,building",
    ]);
    assert!(
        said.contains("plates.ply, 111 trained Gaussians") && said.contains("300 Gaussians"),
        "{said}"
    );
    assert!(
        said.contains("skipped: --scene and --cameras come without photos"),
        "{said}"
    );

    // A folder with photos: sections in their own order, whatever the order they are named in.
    let said = quick(&[
        "--data",
        utf8(folder.path()),
        "--only",
        "segmentation,building",
        "--set",
        "building.random_points=90",
    ]);
    let places = [
        "building: ",
        "its initial 90 Gaussians, not trained",
        "segmentation: ",
    ]
    .map(|word| said.find(word));
    assert!(places.is_sorted() && places[0].is_some(), "{said}");
    let run = folder.path().join("run");
    let small = [
        "--set",
        "building.iterations=3",
        "--set",
        "building.random_points=200",
        "--set",
        "segmentation.rows=raw",
    ];
    let train = [
        "train",
        "--data",
        utf8(folder.path()),
        "--out",
        utf8(&run),
        "--backend",
        &backend(),
    ];
    succeeds(&[&train[..], &small].concat());
    let said = quick(&["--run", utf8(&run), "--only", "encoding"]);
    assert!(said.contains("scene.ply, 200 trained Gaussians"), "{said}");
}

#[test]
fn what_is_rendered_can_be_rendered_by_others() {
    let folder = tempfile::tempdir().unwrap();
    let (ply, cameras, out) = (
        scene(folder.path()),
        folder.path().join("transforms.json"),
        folder.path().join("out"),
    );
    let said = quick(&[
        "--scene",
        utf8(&ply),
        "--cameras",
        utf8(&cameras),
        "--only",
        "channels",
        "--export",
        utf8(&out),
    ]);
    let files = [
        "gaussians_600.ply",
        "cameras_64x48.json",
        "cameras_96x64.json",
    ]
    .map(|name| out.join(name));
    assert!(
        files
            .iter()
            .all(|file| said.contains(utf8(file)) && file.is_file()),
        "{said}"
    );
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
        message.contains("speed") && message.contains("raster, channels, curve, building"),
        "{message}"
    );
    fails(&["bench", "--repeats", "0"], 2);
    fails(&["bench", "--cameras", "x.json"], 2);
    let message = fails(&["bench", "--quick", "--scene", "no/such.ply"], 1);
    assert!(
        message.contains("no such file: no/such.ply; give a .ply file"),
        "{message}"
    );
    fails(&["bench", "--run", "runs/x", "--data", "y"], 2);
    let message = fails(&["bench", "--quick", "--run", "no/such/run"], 1);
    assert!(message.contains("a run folder"), "{message}");
}

#[test]
fn untrained_scenes_have_the_number_asked_for_and_are_seen() {
    let options = BuiltinOptions {
        width: 64,
        height: 48,
        train_views: 4,
        test_views: 0,
        ..Default::default()
    };
    let room = scene_with(&options).unwrap();
    let surfaces = Surfaces::new(&room);
    for count in [1, 700] {
        let gaussians = surfaces.gaussians(count, 1, 5).unwrap();
        assert_eq!((gaussians.len(), gaussians.sh.len()), (count, 12 * count));
        assert_eq!(gaussians, surfaces.gaussians(count, 1, 5).unwrap());
    }
    // Discs: the normal is the short axis, and faces a camera that saw it.
    let gaussians = surfaces.gaussians(700, 0, 5).unwrap();
    assert!(
        gaussians
            .log_scales
            .iter()
            .all(|s| s[2] < s[0] - 2.0 && s[0] == s[1])
    );

    let device = crate::support::device();
    let subject = Subject::load(&Source::Untrained, &Config::default(), true, &device).unwrap();
    let cameras = subject.cameras(9, [32, 32]);
    assert_eq!(
        (subject.cameras.len(), cameras.len(), &cameras[0]),
        (6, 9, &cameras[6])
    );
    assert!(subject.trained().is_none() && subject.extent() > 0.0);
    assert!(Effort::full(5, true).sizes.len() > Effort::full(5, false).sizes.len());
}

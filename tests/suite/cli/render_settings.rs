//! A scene in a run folder is rendered as the run rendered it.

use crate::support::plates::scene;
use crate::support::program::{succeeds, utf8};
use std::path::Path;
use std::process::Command;

/// Trains a little under raster settings that are not the defaults; gives the run folder.
fn run(data: &Path) -> std::path::PathBuf {
    let run = data.join("run");
    let sets = [
        "building.iterations=30",
        "building.random_points=300",
        "segmentation.rows=vote",
        "raster.alpha_max=0.1",
        "raster.background=1,1,1",
    ];
    let train = ["train", "--data", utf8(data), "--out", utf8(&run)];
    succeeds(
        &train
            .into_iter()
            .chain(sets.into_iter().flat_map(|set| ["--set", set]))
            .collect::<Vec<_>>(),
    );
    run
}

#[test]
fn labels_are_shown_from_the_runs_coverage_on() {
    let folder = tempfile::tempdir().unwrap();
    let plates = scene(folder.path());
    let run = folder.path().join("run");
    let sets = [
        "--set",
        "segmentation.rows=vote",
        "--set",
        "segmentation.min_coverage=0.97",
    ];
    let train = [
        "train",
        "--data",
        utf8(folder.path()),
        "--scene",
        utf8(&plates),
        "--out",
        utf8(&run),
    ];
    succeeds(&[&train[..], &sets].concat());
    let labels = |scene: &Path, out: &str| {
        let out = folder.path().join(out);
        rendered(scene, &out, &["--labels"]);
        image::open(out.join("v2.label.png")).unwrap().into_luma8()
    };
    let own = image::open(run.join("renders/v2.label.png"))
        .unwrap()
        .into_luma8();
    // Except for the rounding of the file's positions.
    let differ =
        |map: &image::GrayImage| own.iter().zip(map.iter()).filter(|(a, b)| a != b).count();
    let of_run = labels(&run, "of_run");
    assert!(differ(&of_run) < 10, "{}", differ(&of_run));
    // Keys of another version are no obstacle, and without its own the coverage is the usual one.
    let file = run.join("config.toml");
    std::fs::write(
        &file,
        "[raster]\nalpha_max = 0.999\n[segmentation]\ntelepathy = 3\n",
    )
    .unwrap();
    let usual = labels(&run, "usual");
    assert!(differ(&usual) > 100, "{}", differ(&usual));
    std::fs::write(
        &file,
        "[raster]\nalpha_max = 0.999\n[segmentation]\ntelepathy = 3\nmin_coverage = 0.97\n",
    )
    .unwrap();
    assert_eq!(labels(&run, "again"), of_run);
}

/// Largest difference of two pictures, 0 to 255.
#[track_caller]
fn apart(a: &Path, b: &Path) -> u8 {
    let [a, b] = [a, b].map(|path| image::open(path).unwrap().into_rgb8());
    assert_eq!(a.dimensions(), b.dimensions());
    a.iter()
        .zip(b.iter())
        .map(|(a, b)| a.abs_diff(*b))
        .max()
        .unwrap()
}

/// Renders the held-out views of `scene`; gives one of them, and what was said on standard error.
#[track_caller]
fn rendered(scene: &Path, out: &Path, more: &[&str]) -> (std::path::PathBuf, String) {
    let render = [
        "render",
        "--scene",
        utf8(scene),
        "--out",
        utf8(out),
        "--split",
        "test",
    ];
    let output = Command::new(env!("CARGO_BIN_EXE_coseg"))
        .args(render)
        .args(more)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    (out.join("v2.rgb.png"), said)
}

#[test]
fn a_run_folder_is_rendered_as_it_was_trained() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = run(folder.path());
    let (own, out) = (run.join("renders/v2.rgb.png"), |name: &str| {
        folder.path().join(name)
    });
    for (name, scene) in [("folder", run.clone()), ("file", run.join("scene.ply"))] {
        let (picture, said) = rendered(&scene, &out(name), &[]);
        assert!(apart(&own, &picture) <= 1, "{name}");
        assert!(!said.contains("config.toml"), "{said}");
    }
    // What is said on the command line comes before what the run says.
    let (black, _) = rendered(&run, &out("black"), &["--background", "0,0,0"]);
    let (opaque, _) = rendered(&run, &out("opaque"), &["--alpha-max", "0.999"]);
    let differences = [
        apart(&own, &black),
        apart(&own, &opaque),
        apart(&black, &opaque),
    ];
    assert!(
        differences.iter().all(|difference| *difference > 5),
        "{differences:?}"
    );

    // The same scene elsewhere is one of any tool.
    let alone = folder.path().join("alone");
    std::fs::create_dir(&alone).unwrap();
    for file in ["scene.ply", "cameras.json", "classes.json"] {
        std::fs::copy(run.join(file), alone.join(file)).unwrap();
    }
    let (plain, _) = rendered(&alone, &out("plain"), &[]);
    assert!(apart(&own, &plain) > 5, "{}", apart(&own, &plain));
    let share = |scene: &Path| {
        let pick = [
            "objects",
            "--scene",
            utf8(scene),
            "--frame",
            "v2",
            "--pixel",
            "40,32",
            "--json",
        ];
        let picked: serde_json::Value = serde_json::from_str(&succeeds(&pick)).unwrap();
        picked["share"].as_f64().unwrap()
    };
    let cap = |scene: &Path| {
        let page = scene.join("viewer.html");
        succeeds(&["view", "--scene", utf8(scene), "--out", utf8(&page)]);
        let text = std::fs::read_to_string(page).unwrap();
        [0.1, 0.999].map(|cap| text.contains(&format!("\"alpha_max\":{cap},")))
    };
    assert!(
        (share(&run) - share(&alone)).abs() > 1e-3,
        "{} {}",
        share(&run),
        share(&alone)
    );
    assert_eq!((cap(&run), cap(&alone)), ([true, false], [false, true]));

    // Other sections may be those of another version, and an edited scene in the run's folder is the run's.
    let file = alone.join("config.toml");
    let text = std::fs::read_to_string(run.join("config.toml")).unwrap();
    std::fs::write(&file, format!("{text}\n[telepathy]\nstrength = 3\n")).unwrap();
    let edited = alone.join("edited.ply");
    let objects: serde_json::Value =
        serde_json::from_str(&succeeds(&["objects", "--scene", utf8(&alone), "--json"])).unwrap();
    let every: Vec<String> = objects
        .as_array()
        .unwrap()
        .iter()
        .map(|o| o["id"].to_string())
        .collect();
    succeeds(&[
        "edit",
        "--scene",
        utf8(&alone),
        "--out",
        utf8(&edited),
        "--keep",
        &every.join(","),
    ]);
    for (name, scene) in [("again", &alone), ("edited", &edited)] {
        assert!(
            apart(&own, &rendered(scene, &out(name), &[]).0) <= 1,
            "{name}"
        );
    }
    assert_eq!(share(&run), share(&alone));
    assert_eq!(cap(&alone), [true, false]);
    // Other programs have files of that name too.
    for (name, text, told) in [
        (
            "foreign",
            &b"title = \"a page\"\n[params]\nraster = true\n"[..],
            None,
        ),
        ("no-toml", b"background: white\n", Some("config.toml")),
        ("no-text", &[0xff, 0xfe, 0x00], Some("config.toml")),
        (
            "wrong",
            b"[raster]\nalpha_max = 3.0\n",
            Some("raster.alpha_max"),
        ),
    ] {
        std::fs::write(&file, text).unwrap();
        let (picture, said) = rendered(&alone, &out(name), &[]);
        assert_eq!(apart(&plain, &picture), 0, "{name}");
        match told {
            None => assert!(!said.contains("raster"), "{name}: {said}"),
            Some(told) => assert!(
                said.contains("default raster settings") && said.contains(told),
                "{name}: {said}"
            ),
        }
    }
}

//! The program where no GPU has a driver.

use crate::support::plates::scene;
use crate::support::program::{text, utf8};
use std::process::Command;

/// Where the loaders of Vulkan and OpenGL find no driver.
const WITHOUT_DRIVERS: [(&str, &str); 4] = [
    ("VK_ICD_FILENAMES", "/nonexistent"),
    ("VK_DRIVER_FILES", "/nonexistent"),
    ("__EGL_VENDOR_LIBRARY_FILENAMES", "/nonexistent"),
    ("XDG_RUNTIME_DIR", "/nonexistent"),
];

fn without_drivers(arguments: &[&str]) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_coseg"))
        .args(arguments)
        .envs(WITHOUT_DRIVERS)
        .output()
        .unwrap();
    let message = text(&output.stderr);
    assert!(
        !message.contains("panicked") && !message.contains("fault of its own"),
        "{message}"
    );
    (output.status.code(), message)
}

#[test]
fn a_missing_adapter_is_an_error_or_a_notice_and_no_panic() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join("run");
    let small = [
        "--set",
        "building.iterations=3",
        "--set",
        "building.random_points=100",
    ];
    let train = [
        "train",
        "--data",
        utf8(folder.path()),
        "--out",
        utf8(&run),
        "--set",
        "segmentation.rows=raw",
    ];
    let (code, message) = without_drivers(&[&train[..], &small, &["--backend", "wgpu"]].concat());
    assert_eq!(code, Some(1), "{message}");
    for word in [
        "error: device wgpu: no usable adapter",
        "driver",
        "another backend",
    ] {
        assert!(message.contains(word), "{word}: {message}");
    }
    assert!(!message.contains(" -> ") && !run.exists(), "{message}");

    let (code, message) = without_drivers(&[&train[..], &small].concat());
    assert_eq!(code, Some(0), "{message}");
    let next = if cfg!(feature = "flex") {
        "flex"
    } else {
        "ndarray"
    };
    assert_eq!(message.matches("no usable adapter").count(), 1, "{message}");
    assert!(
        message.contains(&format!("computing with {next} instead")),
        "{message}"
    );
    assert!(message.contains(&format!("({next} backend")), "{message}");
}

#[test]
#[cfg(feature = "ndarray")]
fn weights_of_features_are_read_on_the_device_of_the_run() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join("run");
    let weights = folder.path().join("blur.safetensors");
    crate::support::mobilenet_weights::write_blur_weights(&weights);
    let source = format!("features.weights={}", utf8(&weights));
    let sets = [
        "building.iterations=3",
        "building.random_points=100",
        "segmentation.iterations=1",
        &source,
    ];
    let sets = sets.iter().flat_map(|set| ["--set", set]);
    let train = [
        "train",
        "--data",
        utf8(folder.path()),
        "--out",
        utf8(&run),
        "--backend",
        "ndarray",
    ];
    let arguments: Vec<&str> = train
        .into_iter()
        .chain(sets)
        .chain(["--set", "segmentation.rows=ours"])
        .collect();
    // Nothing else may be asked for: there is no adapter.
    let (code, message) = without_drivers(&arguments);
    assert_eq!(code, Some(0), "{message}");
    assert!(!message.contains("adapter"), "{message}");
    let features = &crate::support::program::read_json(&run.join("metrics.json"))["features"];
    assert!(
        features.as_str().unwrap().starts_with("mobilenetv2"),
        "{features}"
    );
}

//! Settings that are refused, and what the error says.

use crate::support::settings_file::{assert_names, load};
use coseg::config::{Config, SpatialSource};

#[test]
fn unknown_keys_name_file_line_and_the_nearest_key() {
    let error = load("seed = 1\n[building]\niteratons = 5\n", &[]).unwrap_err();
    assert_names(
        &error,
        &[
            "run.toml",
            "line 3",
            "building.iteratons",
            "did you mean building.iterations?",
        ],
    );
    let error = load("[segmentaton]\nlr = 0.5\n", &[]).unwrap_err();
    assert_names(
        &error,
        &["line 1", "segmentaton", "did you mean segmentation"],
    );
    let error = load("iterations = 5\n", &[]).unwrap_err();
    assert_names(
        &error,
        &["iterations: found an unknown key", ".iterations?"],
    );
    let error = load("", &["segmentation.lambdareg=0.5"]).unwrap_err();
    assert_names(
        &error,
        &[
            "setting segmentation.lambdareg",
            "did you mean segmentation.lambda_reg?",
        ],
    );
}

#[test]
fn wrong_types_name_found_and_expected() {
    let error = load("[building]\n\niterations = \"many\"\n", &[]).unwrap_err();
    assert_names(
        &error,
        &[
            "line 3, building.iterations",
            "found \"many\"",
            "a whole number of 0 or more",
        ],
    );
    let error = load("", &["building.random_background=yes"]).unwrap_err();
    assert_names(
        &error,
        &[
            "building.random_background",
            "found \"yes\", expected true or false",
        ],
    );
    let error = load("seed = -4\n", &[]).unwrap_err();
    assert_names(&error, &["seed", "-4", "a whole number of 0 or more"]);
    let error = load("[segmentation]\nloss = \"mse\"\n", &[]).unwrap_err();
    assert_names(
        &error,
        &["segmentation.loss", "\"mse\"", "\"js\"", "\"ce\""],
    );
    let error = load("preset = \"best\"\n", &[]).unwrap_err();
    assert_names(&error, &["line 1, preset", "\"best\"", "\"paper\""]);
    let error = load("building = 3\n", &[]).unwrap_err();
    assert_names(&error, &["building", "found 3", "a section"]);
    let error = load("", &["raster.background=1,0"]).unwrap_err();
    assert_names(&error, &["raster.background", "a list of 3 numbers"]);
    let error = load("", &["segmentation.rows=raw,best"]).unwrap_err();
    assert_names(&error, &["segmentation.rows", "\"ours\""]);
    let error = load("", &["segmentation.rows=raw,vote,our"]).unwrap_err();
    assert_names(&error, &["found \"our\"", "did you mean ours?"]);
    let error = load("", &["building"]).unwrap_err();
    assert_names(&error, &["--set", "found building", "section.key=value"]);
    let error = load("", &["building=4"]).unwrap_err();
    assert_names(&error, &["a key within it"]);
}

#[test]
fn values_out_of_range_are_refused() {
    for (set, expected) in [
        ("building.iterations=0", "above 0"),
        ("building.sh_degree=4", "0, 1, 2 or 3"),
        ("building.lr_means=nan", "finite number of 0 or more"),
        ("building.lr_means=-1e-3", "finite number of 0 or more"),
        ("building.iterations=4294967296", "fewer than 2^32"),
        ("raster.alpha_max=0", "at most 1"),
        ("raster.background=0,0,-0.1", "from 0 to 1"),
        ("building.size_limit=best", "\"distance\" or \"extent\""),
        (
            "building.gradient_threshold=-0.1",
            "finite number of 0 or more",
        ),
        ("segmentation.loss.gce.exponent=0", "from 0.000001 to 1"),
        ("segmentation.loss.gce.exponent=1.01", "from 0.000001 to 1"),
        ("segmentation.loss.js.pi_rl=1.0", "above 0 and below 1"),
        ("segmentation.loss.js.pi_rl=0", "above 0 and below 1"),
        ("segmentation.pixel_share=0.0", "above 0, at most 1"),
        ("segmentation.warmup=-0.1", "from 0 to 1"),
        ("segmentation.lambda_reg=inf", "finite number of 0 or more"),
        ("segmentation.rows=raw,raw", "each variant once"),
        ("unprojection.attendance=2", "from 0 to 1"),
        ("seed=9300000000000000000", "whole number"),
    ] {
        let error = load("", &[set]).unwrap_err();
        assert_names(&error, &[set.split_once('=').unwrap().0, expected]);
    }
    let error = load("[segmentation.loss.js]\npi_rl = 1.0\n", &[]).unwrap_err();
    assert_names(&error, &["run.toml", "line 2, segmentation.loss.js.pi_rl"]);
}

#[test]
fn values_that_need_each_other_are_checked() {
    assert_names(
        &load("", &["features.source=import"]).unwrap_err(),
        &["features.source", "features.source.import ="],
    );
    assert_names(
        &load("", &["features.source=mobilenetv2"]).unwrap_err(),
        &["features.weights", "MobileNetV2"],
    );
    assert_names(
        &load("", &["features.source=dino"]).unwrap_err(),
        &["features.weights", "DINO"],
    );
    assert_names(
        &load("", &["spatial.source=pretrained"]).unwrap_err(),
        &["spatial.source", "spatial.source.pretrained ="],
    );
    let config = load("", &["spatial.source.pretrained=w.pth"]).unwrap();
    assert_eq!(
        config.spatial.source,
        SpatialSource::Pretrained("w.pth".into())
    );
}

#[test]
fn arguments_are_not_called_settings() {
    let message = load("", &["building"]).unwrap_err();
    assert!(message.starts_with("--set: found building"), "{message}");
    let broken = coseg::splat::Gaussians {
        sh_degree: 9,
        ..Default::default()
    };
    let message = broken.check(None).unwrap_err().to_string();
    assert!(
        message.starts_with("gaussians.sh_degree: found 9, expected 0 to 3"),
        "{message}"
    );
    let message = load("", &["building.iterations=0"]).unwrap_err();
    assert!(
        message.starts_with("setting building.iterations: found 0"),
        "{message}"
    );
}

#[test]
fn syntax_errors_name_the_line() {
    let error = load("seed = 1\n[building\n", &[]).unwrap_err();
    assert_names(&error, &["run.toml", "line 2", "[building"]);
    let missing = Config::load(Some(std::path::Path::new("no/such/file.toml")), &[]).unwrap_err();
    assert_names(&missing.to_string(), &["no/such/file.toml", "read"]);
}

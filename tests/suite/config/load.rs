//! Loading settings: what overrides what, and what a name stands for.

use crate::support::settings_file::{assert_names, load};
use coseg::config::{
    Budget, Config, Encode, FeatureSource, LabelLoss, Normalisation, Preset, Reduction, Variant,
};
use std::path::{Path, PathBuf};

#[test]
fn nothing_given_is_the_default_config() {
    assert_eq!(Config::load(None, &[]).unwrap(), Config::default());
    assert_eq!(load("", &[]).unwrap(), Config::default());
}

#[test]
fn file_overrides_preset_and_set_overrides_file() {
    let toml =
        "preset = \"paper\"\n[segmentation]\niterations = 500\nloss = { js = { pi_rl = 0.5 } }\n";
    let config = load(
        toml,
        &[
            "segmentation.loss.js.pi_rl=0.97",
            "data.dir=scenes/room",
            "features.weights=dino.pth",
        ],
    )
    .unwrap();
    assert_eq!(config.preset, Preset::Paper);
    assert_eq!(config.unprojection.normalisation, Normalisation::Count);
    assert_eq!(config.spatial.encode, Encode::View);
    assert_eq!(config.segmentation.reduction, Reduction::Sum);
    assert_eq!(
        config.features.source,
        FeatureSource::Dino,
        "named, never `auto`"
    );
    assert_eq!(config.segmentation.warmup, 0.0);
    assert_eq!(config.segmentation.iterations, 500);
    assert_eq!(config.data.dir, Some(PathBuf::from("scenes/room")));
    assert_eq!(config.segmentation.lr, 1e-3, "the paper's own rate");
    assert_eq!(config.segmentation.loss(), LabelLoss::Js { pi_rl: 0.97 });
    assert_eq!(
        config.features.dimensions,
        Config::default().features.dimensions
    );
}

#[test]
fn a_set_preset_replaces_the_files_preset() {
    let config = load("preset = \"paper\"\n", &["preset=default"]).unwrap();
    assert_eq!(config, Config::default());
}

#[test]
fn the_built_in_scene_has_defaults_of_its_own_below_all_that_is_given() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.toml");
    let own = |data: Option<&str>, toml: &str, sets: &[&str]| {
        std::fs::write(&file, toml).unwrap();
        let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
        Config::load_for(data.map(Path::new), Some(&file), &sets).unwrap()
    };
    let size = |config: &Config| {
        let building = &config.building;
        (building.iterations, building.max_gaussians)
    };
    let builtin = (2_400, Budget::Auto);
    assert_eq!(
        Config::load_for(None, None, &[]).unwrap(),
        Config::builtin_preset(Preset::Default)
    );
    assert_eq!(size(&own(None, "", &[])), builtin);
    assert_eq!(
        size(&own(
            None,
            "[data]\nraw_labels_note = \"mine\"\n",
            &["preset=default"]
        )),
        builtin
    );
    let toml = "[building]\niterations = 9\n";
    assert_eq!(
        size(&own(None, toml, &["building.max_gaussians=unlimited"])),
        (9, Budget::Unlimited)
    );
    let mut paper = Config::preset(Preset::Paper);
    paper.features.weights = Some("dino.pth".into());
    assert_eq!(
        own(None, "preset = \"paper\"\n", &["features.weights=dino.pth"]),
        paper,
        "the paper's are the paper's"
    );
    let default = own(None, "preset = \"paper\"\n", &["preset=default"]);
    assert_eq!(size(&default), builtin);
    // A scene folder, wherever it is named.
    let usual = size(&Config::default());
    for config in [
        own(Some("a"), "", &[]),
        own(None, "[data]\ndir = \"a\"\n", &[]),
        own(None, "", &["data.dir=b", "data.dir=a"]),
    ] {
        assert_eq!(
            (size(&config), config.data.dir),
            (usual, Some(PathBuf::from("a")))
        );
    }
    assert_eq!(
        size(&own(None, "[data]\ndir = \"a\"\n", &["data.dir="])),
        builtin
    );
    assert_eq!(
        own(Some("a"), "", &["data.dir=b"]).data.dir,
        Some(PathBuf::from("a")),
        "--data is the last word"
    );
}

#[test]
fn set_takes_lists_text_and_numbers_without_quotes() {
    let sets = [
        "segmentation.rows=raw,vote, ours",
        "segmentation.loss=ce",
        "raster.background=1,1,0.5",
        "building.lr_means=1",
    ];
    let config = load("", &sets).unwrap();
    assert_eq!(
        config.segmentation.rows(),
        [Variant::Raw, Variant::Vote, Variant::Ours]
    );
    assert_eq!(config.segmentation.loss(), LabelLoss::Ce);
    assert_eq!(config.raster.background, [1.0, 1.0, 0.5]);
    assert_eq!(config.building.lr_means, 1.0);
    let quoted = load("", &["segmentation.rows=[\"raw\"]", "data.raw_labels=12"]).unwrap();
    assert_eq!(quoted.segmentation.rows(), [Variant::Raw]);
    assert_eq!(quoted.data.raw_labels, "12");
}

#[test]
fn an_empty_value_takes_an_optional_path_away() {
    let config = load("[data]\ndir = \"a\"\n", &["data.dir="]).unwrap();
    assert_eq!(config.data.dir, None);
}

#[test]
fn written_config_loads_as_itself() {
    for preset in [Preset::Default, Preset::Paper] {
        let mut config = Config::preset(preset);
        config.data.dir = Some("with \"quotes\" and \\".into());
        config.seed = 77;
        config.features.weights = Some("weights.pth".into());
        config.building.lr_means = 0.15;
        let text = config.to_toml().unwrap();
        assert_eq!(load(&text, &[]).unwrap(), config, "{text}");
    }
}

#[test]
fn row_names_are_those_of_the_config_file() {
    for row in Variant::COMPARED
        .into_iter()
        .chain([Variant::NoImageFeatures, Variant::NoSpatial])
    {
        assert_eq!(
            toml::Value::try_from(row).unwrap().as_str(),
            Some(row.key())
        );
    }
}

#[test]
fn a_name_alone_chooses_a_variant_with_its_defaults() {
    for text in [
        "loss = \"gce\"",
        "loss = { gce = {} }",
        "[segmentation.loss.gce]",
    ] {
        let config = load(&format!("[segmentation]\n{text}\n"), &[]).unwrap();
        assert_eq!(config.segmentation.loss(), LabelLoss::GCE, "{text}");
    }
    let loss = |sets: &[&str]| load("", sets).unwrap().segmentation.loss();
    assert_eq!(
        loss(&["segmentation.loss={ gce = { exponent = 0.5 } }"]),
        LabelLoss::Gce {
            exponent: 0.5,
            least_recall: 0.3
        }
    );
    assert_eq!(
        loss(&["segmentation.loss=js"]),
        LabelLoss::Js { pi_rl: 0.99 }
    );
    // The name of the variant that is chosen already keeps its payload.
    assert_eq!(
        loss(&[
            "preset=paper",
            "features.source=descriptor",
            "segmentation.loss=js"
        ]),
        LabelLoss::Js { pi_rl: 0.9 }
    );
    assert_eq!(
        loss(&["segmentation.loss.js.pi_rl=0.5", "segmentation.loss=ce"]),
        LabelLoss::Ce
    );
    let unknown = load("", &["segmentation.loss.js.exponent=1"]).unwrap_err();
    assert_names(&unknown, &["segmentation.loss.js.exponent", "unknown key"]);
    let import = |sets: &[&str]| load("", sets).unwrap().features.source;
    assert_eq!(
        import(&["features.source.import=maps"]),
        FeatureSource::Import("maps".into())
    );
    assert_eq!(
        import(&[
            "features.source.import=maps",
            "features.source=dino",
            "features.weights=w"
        ]),
        FeatureSource::Dino
    );
}

#[test]
fn the_threshold_of_densification_follows_absgrad() {
    let threshold = |sets: &[&str]| load("", sets).unwrap().building.gradient_threshold();
    assert_eq!(threshold(&[]), 8e-4);
    assert_eq!(threshold(&["building.absgrad=false"]), 2e-4);
    let set = ["building.absgrad=false", "building.gradient_threshold=1e-3"];
    assert_eq!(threshold(&set), 1e-3);
}

#[test]
fn a_misspelt_key_of_a_payload_is_named() {
    let error = load("[segmentation.loss.gce]\nexponents = 1\n", &[]).unwrap_err();
    assert_names(
        &error,
        &[
            "line 2",
            "segmentation.loss.gce.exponents",
            "did you mean segmentation.loss.gce.exponent?",
        ],
    );
}

#[test]
fn the_example_configs_load() {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("configs");
    let mut seen = 0;
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            continue;
        }
        Config::load(Some(&path), &[]).unwrap_or_else(|e| panic!("{e}"));
        seen += 1;
    }
    assert!(seen >= 2);
}

//! Contracts: what is refused, and what errors list.

use crate::support::assert_names;
use crate::support::onnx::Onnx;
use coseg::data::Classes;
use coseg::segmenter::{ClassFile, Contract, Mapping};
use std::path::Path;

fn parse(text: &str) -> coseg::Result<Contract> {
    Contract::parse(text, Path::new("net.toml"))
}

#[test]
fn each_damage_is_named() {
    let sound = Onnx::contract(80, 64);
    parse(&sound).expect("sound");
    let cases = [
        ("layout = \"nchw\"", "layout = \"hwc\"", "line 3"),
        ("tensor = \"image\"", "tensr = \"image\"", "tensr"),
        ("size = [80, 64]", "size = [0, 64]", "input.size"),
        ("size = [80, 64]", "size = [80, 64000]", "input.size"),
        (
            "std = [255.0, 255.0, 255.0]",
            "std = [255.0, 0.0, 255.0]",
            "std not 0",
        ),
        ("mean = [0.0, 0.0, 0.0]", "mean = [nan, 0.0, 0.0]", "finite"),
        ("stride = 4", "stride = 0", "output.stride"),
        ("stride = 4", "stride = 65", "output.stride"),
        ("alignment = \"half_pixel\"", "", "alignment"),
        ("none = 0", "none = 5", "output.none"),
        ("\"lime\"", "\"Crimson \"", "twice"),
        ("values = \"logits\"", "values = \"scores\"", "scores"),
    ];
    for (part, other, named) in cases {
        assert!(sound.contains(part), "{part}");
        let error = parse(&sound.replacen(part, other, 1)).expect_err(part);
        assert_names(&error, &["net.toml", named]);
    }
}

#[test]
fn a_missing_contract_lists_the_shipped_ones_near_matches_first() {
    let error =
        Contract::find(Path::new("nets/my.onnx"), Some("segformer_ade")).expect_err("no contract");
    let text = error.to_string();
    assert_names(
        &error,
        &[
            "--contract",
            "segformer_ade20k",
            "deeplab_mnv2_ade20k",
            "torchvision_voc",
        ],
    );
    let at = |name: &str| text.find(name).expect("listed");
    assert!(at("segformer_ade20k") < at("deeplab_mnv2_ade20k"), "{text}");
    assert_names(
        &Contract::find(Path::new("my.onnx"), None).expect_err("none beside it"),
        &[
            "--model",
            "my.onnx, which has no contract",
            "my.toml",
            "torchvision_voc",
        ],
    );
    Contract::find(Path::new("weights/deeplab_mnv2_ade20k.onnx"), None)
        .expect("by the model's name");
}

#[test]
fn unknown_class_names_list_the_valid_ones() {
    let contract = parse(&Onnx::contract(80, 64)).expect("sound");
    let user = |text: &str| {
        let folder = tempfile::tempdir().expect("folder");
        let file = folder.path().join("mine.toml");
        std::fs::write(&file, text).expect("write");
        ClassFile::read(&file)
    };
    let scene = Classes::from_names(0, [(3, "plate"), (7, "wall")]);
    let of = |text: &str, scene: &Classes| {
        Mapping::of_user(&contract, &user(text).expect("toml"), scene)
    };
    let mapping = of(
        "[classes]\nplate = [\"crimson\", \"LIME\"]\nwall = [\"plaster\"]",
        &scene,
    )
    .expect("known");
    assert_eq!(mapping.classes, scene);
    let error = of("[classes]\nplate = [\"crimsom\"]", &scene).expect_err("network class");
    assert_names(
        &error,
        &[
            "classes.plate",
            "\"crimsom\"",
            "perhaps \"crimson\"",
            "the network has: crimson; lime; navy; nothing; plaster",
        ],
    );
    let error = of("[classes]\nwalls = [\"plaster\"]", &scene).expect_err("scene class");
    assert_names(&error, &["\"walls\"", "wall, plate"]);
    let error = of("[classes]\nplate = [\"lime\"]\nwall = [\"lime\"]", &scene).expect_err("twice");
    assert_names(&error, &["\"lime\", which plate has too"]);
    of("[classes]\nplate = []", &Classes::default()).expect_err("nothing listed");
    assert_names(
        &user("[classes]\na = \"lime\"").expect_err("no list"),
        &["line 2"],
    );
    assert_names(
        &user("[clases]\na = [\"lime\"]").expect_err("other table"),
        &["clases"],
    );
    // Without a table of the scene, ids count from 1.
    let own = of(
        "[classes]\nplate = [\"lime\"]\nwall = [\"plaster\"]",
        &Classes::default(),
    )
    .expect("own");
    assert_eq!(
        own.classes,
        Classes::from_names(0, [(1, "plate"), (2, "wall")])
    );
}

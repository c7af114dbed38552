//! Networks that do not fit their contract, and files that are damaged: an error each, that names the tensor, and no panic.

use crate::support::assert_names;
use crate::support::onnx::{NAMES, Onnx, STRIDE, graph, node};
use coseg::segmenter::{Contract, Network};
use rand::{Rng, SeedableRng};
use std::path::Path;

const SIZE: (usize, usize) = (16, 12);

fn load(bytes: &[u8], contract: &str) -> coseg::Result<Network> {
    let folder = tempfile::tempdir().expect("folder");
    let file = folder.path().join("net.onnx");
    std::fs::write(&file, bytes).expect("write");
    Network::load(&file, Contract::parse(contract, Path::new("net.toml"))?)
}

#[test]
fn the_network_says_what_its_weights_say() {
    let network = load(
        &Onnx::new(SIZE.0, SIZE.1).bytes(),
        &Onnx::contract(SIZE.0, SIZE.1),
    )
    .expect("sound");
    let red = image::RgbImage::from_pixel(16, 12, image::Rgb([255, 0, 0]));
    let logits = network.run(&red).expect("run");
    assert_eq!((logits.width, logits.height), (16 / STRIDE, 12 / STRIDE));
    let expected = [-6.0, 40.0, -20.0, -20.0, 18.0];
    for cell in logits.values.chunks(NAMES.len()) {
        for (found, expected) in cell.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-4, "{cell:?}");
        }
    }
}

#[test]
fn numbers_that_are_not_finite_are_an_error() {
    for value in [f32::NAN, f32::INFINITY] {
        let onnx = Onnx {
            bias: [0.0, 0.0, value, 0.0, 0.0],
            ..Onnx::new(SIZE.0, SIZE.1)
        };
        let network = load(&onnx.bytes(), &Onnx::contract(SIZE.0, SIZE.1)).expect("a network");
        let error = network.run(&image::RgbImage::new(16, 12)).err();
        assert_names(
            &error.expect("refused"),
            &["logits of", "net.onnx", "non-finite"],
        );
    }
}

#[test]
fn tensors_that_do_not_fit_are_named_with_their_shapes() {
    let contract = Onnx::contract(SIZE.0, SIZE.1);
    let sound = || Onnx::new(SIZE.0, SIZE.1);
    let classes = contract.replace("\"plaster\"]", "\"plaster\", \"more\"]");
    let cases: [(Onnx, &str, &[&str]); 11] = [
        (
            Onnx {
                input: ("image", vec![1, 3, 12, 20]),
                ..sound()
            },
            &contract,
            &["tensor image", "[1, 3, 12, 20]", "[1, 3, 12, 16]"],
        ),
        (
            Onnx {
                input: ("photo", vec![1, 3, 12, 16]),
                ..sound()
            },
            &contract,
            &["inputs", "photo", "image"],
        ),
        (
            Onnx {
                output: ("scores", vec![1, 5, 3, 4]),
                ..sound()
            },
            &contract,
            &["outputs", "scores", "\"logits\""],
        ),
        (
            Onnx {
                made: "other",
                ..sound()
            },
            &contract,
            &["logits", "no operator that makes it"],
        ),
        (
            Onnx {
                operator: "Segment",
                ..sound()
            },
            &contract,
            &["head", "Segment"],
        ),
        (
            Onnx {
                missing: 4,
                ..sound()
            },
            &contract,
            &["tensor weights", "[5, 3, 4, 4]", "956 bytes"],
        ),
        (
            Onnx {
                weights_shape: vec![5, 4, 4, 3],
                ..sound()
            },
            &contract,
            &["network"],
        ),
        (
            Onnx {
                weights_shape: vec![1 << 40, 1 << 40, 4, 4],
                ..sound()
            },
            &contract,
            &["tensor weights"],
        ),
        (
            Onnx {
                external: true,
                ..sound()
            },
            &contract,
            &["tensor weights", "another file", "onnx.save"],
        ),
        (
            sound(),
            &classes,
            &[
                "tensor logits",
                "F32 [1, 5, 3, 4]",
                "[1, 6, 3, 4]",
                "6 classes",
            ],
        ),
        (
            sound(),
            &contract.replace("stride = 4", "stride = 2"),
            &["tensor logits", "[1, 5, 6, 8]", "stride 2"],
        ),
    ];
    for (onnx, contract, parts) in cases {
        assert_names(&load(&onnx.bytes(), contract).expect_err("refused"), parts);
    }
}

#[test]
fn inputs_of_other_types_are_named() {
    // Numbers of types in ONNX.
    for (input_type, name) in [(2, "uint8"), (10, "float16"), (11, "double")] {
        let onnx = Onnx {
            input_type,
            ..Onnx::new(SIZE.0, SIZE.1)
        };
        let error = load(&onnx.bytes(), &Onnx::contract(SIZE.0, SIZE.1)).expect_err(name);
        assert_names(&error, &["net.onnx", "tensor image", name, "float32"]);
    }
}

#[test]
fn operators_of_other_domains_are_named() {
    let of = |domain| Onnx {
        domain,
        ..Onnx::new(SIZE.0, SIZE.1)
    };
    let contract = Onnx::contract(SIZE.0, SIZE.1);
    load(&of("ai.onnx").bytes(), &contract).expect("a standard operator");
    for domain in ["com.microsoft", "ai.onnx.ml", "mine"] {
        let error = load(&of(domain).bytes(), &contract).expect_err(domain);
        let parts = ["net.onnx", "operator \"head\"", "\"Conv\"", domain];
        assert_names(&error, &parts);
    }
}

#[test]
fn operators_within_operators_are_checked() {
    let unknown = node("Nonsense", &["cells"], "inner", &[]);
    let branch = graph("then_branch", &[unknown]);
    let onnx = Onnx {
        made: "cells",
        nodes: vec![node("If", &["cells"], "logits", &[branch])],
        ..Onnx::new(SIZE.0, SIZE.1)
    };
    let error = load(&onnx.bytes(), &Onnx::contract(SIZE.0, SIZE.1));
    let parts = ["net.onnx", "operator \"make inner\"", "\"Nonsense\""];
    assert_names(&error.expect_err("unknown"), &parts);
}

#[test]
fn cut_off_and_spoilt_files_are_errors() {
    let contract = Onnx::contract(SIZE.0, SIZE.1);
    let bytes = Onnx::new(SIZE.0, SIZE.1).bytes();
    for end in 0..bytes.len() {
        // A file may end after a whole field; the network then lacks something.
        assert!(
            load(&bytes[..end], &contract).is_err() || end + 8 > bytes.len(),
            "{end}"
        );
    }
    assert_names(
        &load(b"\x89PNG\r\n\x1a\n", &contract).expect_err("PNG"),
        &["a PNG image"],
    );
    // Whatever single bytes say, the answer is a network or an error.
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let mut refused = 0;
    for _ in 0..2000 {
        let mut spoilt = bytes.clone();
        for _ in 0..rng.random_range(1..4) {
            let at = rng.random_range(0..spoilt.len());
            spoilt[at] = rng.random();
        }
        refused += usize::from(load(&spoilt, &contract).is_err());
    }
    assert!(refused > 50, "{refused}");
}

#[test]
fn a_real_network_cut_off_is_an_error() {
    let Some(file) = crate::support::shared_file("weights/deeplab_ade20k/deeplab_mnv2_ade20k.onnx")
    else {
        return;
    };
    let bytes = std::fs::read(file).expect("read");
    let folder = tempfile::tempdir().expect("folder");
    let cut = folder.path().join("cut.onnx");
    for share in [0.01, 0.3, 0.77, 0.999] {
        std::fs::write(&cut, &bytes[..(bytes.len() as f64 * share) as usize]).expect("write");
        let contract = Contract::find(&cut, Some("deeplab_mnv2_ade20k")).expect("shipped");
        assert_names(
            &Network::load(&cut, contract).expect_err("cut off"),
            &["cut.onnx"],
        );
    }
    // The contract of another network.
    std::fs::write(&cut, &bytes).expect("write");
    let contract = Contract::find(&cut, Some("segformer_ade20k")).expect("shipped");
    assert_names(
        &Network::load(&cut, contract).expect_err("other"),
        &["image", "[1, 3, 513, 513]", "pixel_values"],
    );
}

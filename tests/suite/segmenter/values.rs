//! Outputs that are not what their contract calls them.

use crate::support::assert_names;
use crate::support::onnx::{Onnx, flag, node};
use coseg::segmenter::{Contract, Logits, Network};
use image::RgbImage;
use std::path::Path;

/// The output for a red photo, of the network with an operator at its end, by a contract that calls the output `values`.
fn run(operator: &str, values: &str) -> coseg::Result<Logits> {
    let attributes = match operator {
        "Softmax" => vec![flag("axis", 1)],
        _ => vec![],
    };
    let onnx = Onnx {
        made: "cells",
        nodes: vec![node(operator, &["cells"], "logits", &attributes)],
        ..Onnx::new(16, 12)
    };
    let folder = tempfile::tempdir().expect("folder");
    let file = folder.path().join("net.onnx");
    std::fs::write(&file, onnx.bytes()).expect("write");
    let contract = Onnx::contract(16, 12);
    let contract = contract.replace("values = \"logits\"", &format!("values = \"{values}\""));
    let contract = Contract::parse(&contract, Path::new("net.toml"))?;
    Network::load(&file, contract)?.run(&RgbImage::from_pixel(16, 12, image::Rgb([255, 0, 0])))
}

#[test]
fn logits_that_are_called_probabilities_are_refused() {
    run("Softmax", "probabilities").expect("probabilities");
    let beyond = "values = \"logits\"";
    for (operator, help) in [
        ("Identity", beyond),
        ("Neg", beyond),
        ("Sigmoid", "softmax"),
    ] {
        let error = run(operator, "probabilities").err();
        let parts = [
            "net.onnx",
            "tensor logits",
            "values from",
            "sums",
            "net.toml",
            help,
        ];
        assert_names(&error.expect(operator), &parts);
    }
    // What the network says of red.
    let error = run("Identity", "probabilities").expect_err("logits");
    assert_names(&error, &["from -20", "to 40", "12"]);
}

#[test]
fn probabilities_that_are_called_logits_are_refused() {
    for operator in ["Identity", "Sigmoid", "Neg"] {
        run(operator, "logits").expect(operator);
    }
    let error = run("Softmax", "logits").expect_err("probabilities");
    assert_names(
        &error,
        &[
            "net.onnx",
            "tensor logits",
            "net.toml",
            "values = \"probabilities\"",
        ],
    );
}

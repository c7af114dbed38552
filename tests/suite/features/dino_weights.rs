//! DINO's weight files: PyTorch and safetensors, nested, broken, of other networks.

use crate::support::dino_weights::{Size, Tensors, generated, write};
use crate::support::pictures::picture;
use crate::support::torch_file::{self, Value};
use coseg::Error;
use coseg::features::FeatureMap;
use coseg::features::dino::Vit;
use std::path::Path;

#[test]
fn full_checkpoints_give_the_teacher() {
    let size = Size {
        width: 64,
        patch: 2,
        depth: 2,
        side: 2,
        hidden: 8,
    };
    let teacher = generated(size);
    let mut student = teacher.clone();
    student
        .values_mut()
        .for_each(|(_, values)| values.iter_mut().for_each(|v| *v *= 0.5));
    let dir = tempfile::tempdir().expect("temporary folder");
    let plain = dir.path().join("plain.safetensors");
    write(&plain, &teacher);
    let image = picture(9, 7, 0);
    let maps = |path: &Path| -> Vec<FeatureMap> {
        Vit::load(path, &crate::support::device())
            .expect("weights")
            .maps(&image)
            .expect("maps")
    };
    let expected = maps(&plain);

    let entry = |name: &str, value| (name.to_owned(), value);
    let mut backbone = torch_file::state_dict(&teacher, "module.backbone.");
    if let Value::Dict(entries) = &mut backbone {
        entries.push(entry(
            "module.head.mlp.0.weight",
            Value::Tensor(vec![2, 2], vec![1.0; 4]),
        ));
    }
    let full = Value::Dict(vec![
        entry(
            "student",
            torch_file::state_dict(&student, "module.backbone."),
        ),
        entry("teacher", backbone),
        entry("epoch", Value::Int(100)),
        entry(
            "args",
            Value::Namespace(vec![entry("patch_size", Value::Int(8))]),
        ),
    ]);
    let students = Value::Dict(vec![entry(
        "student",
        torch_file::state_dict(&teacher, "module.backbone."),
    )]);
    let prefixed = torch_file::state_dict(&teacher, "module.");
    for (name, value) in [
        ("full.pth", full),
        ("student.pth", students),
        ("prefixed.pth", prefixed),
    ] {
        let path = dir.path().join(name);
        let bytes = torch_file::bytes(&value);
        std::fs::write(&path, &bytes).expect("write");
        assert!(maps(&path) == expected, "{name}");
        for cut in [0, 3, 500, bytes.len() / 2, bytes.len() - 30] {
            std::fs::write(&path, &bytes[..cut]).expect("write");
            let found = Vit::load(&path, &crate::support::device());
            assert!(
                matches!(&found, Err(Error::Input { path: p, .. }) if *p == path),
                "{name} {cut}"
            );
        }
    }
    let mut both: Tensors = teacher
        .iter()
        .map(|(k, v)| (format!("teacher.backbone.{k}"), v.clone()))
        .collect();
    both.extend(
        student
            .into_iter()
            .map(|(k, v)| (format!("student.module.backbone.{k}"), v)),
    );
    write(&plain, &both);
    assert!(maps(&plain) == expected);
}

#[test]
fn unusable_weights_are_named() {
    let size = Size {
        width: 64,
        patch: 2,
        depth: 2,
        side: 2,
        hidden: 8,
    };
    let dir = tempfile::tempdir().expect("temporary folder");
    let path = dir.path().join("vit.safetensors");
    let error = |change: &dyn Fn(&mut Tensors), words: &[&str]| {
        let mut weights = generated(size);
        change(&mut weights);
        write(&path, &weights);
        let error = Vit::load(&path, &crate::support::device()).expect_err("unusable");
        assert!(matches!(error, Error::Input { .. }), "{error}");
        for word in words.iter().chain(&["vit.safetensors", "expected", "DINO"]) {
            assert!(error.to_string().contains(word), "{word}: {error}");
        }
    };
    let shaped = |shape: &[usize]| (shape.to_vec(), vec![0.1; shape.iter().product()]);
    for name in generated(size).into_keys() {
        error(&|w| drop(w.remove(&name)), &[&name, "no such"]);
    }
    error(
        &Tensors::clear,
        &["patch_embed.proj.weight", "no such tensor"],
    );
    let with = |name: &str, shape: &[usize], words: &[&str]| {
        error(
            &|w| drop(w.insert(name.to_owned(), shaped(shape))),
            &[&[name], words].concat(),
        );
    };
    with(
        "patch_embed.proj.weight",
        &[64, 3, 2, 4],
        &["[64, 3, 2, 4]", "[width, 3, patch, patch]"],
    );
    with(
        "patch_embed.proj.weight",
        &[64, 1, 2, 2],
        &["[64, 1, 2, 2]"],
    );
    with(
        "patch_embed.proj.weight",
        &[100, 3, 2, 2],
        &["multiple of 64"],
    );
    with("pos_embed", &[1, 6, 64], &["[1, 6, 64]", "square grid"]);
    with("pos_embed", &[1, 1, 64], &["square grid"]);
    with("cls_token", &[1, 64], &["[1, 64]", "[1, 1, 64]"]);
    with(
        "blocks.1.attn.qkv.weight",
        &[128, 64],
        &["[128, 64]", "[192, 64]"],
    );
    with(
        "blocks.0.mlp.fc1.weight",
        &[8, 32],
        &["[8, 32]", "[hidden, 64]"],
    );
    with("blocks.0.mlp.fc2.weight", &[64, 9], &["[64, 9]", "[64, 8]"]);
    with("blocks.0.ls1.gamma", &[64], &["this tensor"]);
    with("register_tokens", &[1, 4, 64], &["registers"]);
    // A block whose number cannot be read is named; for a gap, the tensor that is missing.
    for (name, word) in [
        ("blocks.x.norm1.weight", "blocks.x"),
        ("blocks.123456789.norm1.weight", "blocks.123456789"),
        ("blocks.3.norm1.weight", "blocks.2"),
    ] {
        error(&|w| drop(w.insert(name.to_owned(), shaped(&[64]))), &[word]);
    }
    error(
        &|w| w.get_mut("blocks.1.attn.proj.bias").expect("a tensor").1[5] = f32::NAN,
        &["blocks.1.attn.proj.bias", "NaN"],
    );
    let absent =
        Vit::load(&dir.path().join("absent.pth"), &crate::support::device()).expect_err("no file");
    assert!(matches!(absent, Error::Io { .. }) && absent.to_string().contains("absent.pth"));
}

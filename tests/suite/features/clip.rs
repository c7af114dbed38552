//! CLIP's text encoder beside Hugging Face transformers, its tokenizer, and hostile weight files.
//!
//! `scripts/reference_clip.py` made the fixture: token ids, and embeddings in f64 of weights that the test makes anew.

use crate::support::clip_weights::{BASE, SMALL, Size, as_openai, generated};
use crate::support::device;
use crate::support::dino_weights::{Tensors, write};
use crate::support::torch_file;
use coseg::Error;
use coseg::features::Activation;
use coseg::features::clip::{TextEncoder, Tokenizer};
use safetensors::SafeTensors;
use std::path::Path;

const FILE: &[u8] = include_bytes!("../../fixtures/clip.safetensors");
/// Largest length of the difference of two embeddings beside that of one of them.
const TOLERANCE: f64 = 1e-5;

/// The 4-byte numbers of a tensor of the fixture.
fn numbers<T>(name: &str, number: impl Fn([u8; 4]) -> T) -> Vec<T> {
    let file = SafeTensors::deserialize(FILE).unwrap();
    let tensor = file.tensor(name).unwrap();
    let (bytes, _) = tensor.data().as_chunks();
    bytes.iter().map(|bytes| number(*bytes)).collect()
}

/// The token lists of a case.
fn token_lists(case: &str) -> Vec<Vec<u32>> {
    let file = SafeTensors::deserialize(FILE).unwrap();
    let names = (0..).map(|n| format!("{case}.tokens.{n}"));
    let names = names.take_while(|name| file.tensor(name).is_ok());
    names
        .map(|name| numbers(&name, u32::from_le_bytes))
        .collect()
}

fn load(path: &Path) -> coseg::Result<TextEncoder> {
    TextEncoder::load(path, &device())
}

/// The largest relative difference from the reference, whatever the nonlinearity.
fn difference(case: &str, size: Size, encoder: &TextEncoder) -> f64 {
    let lists = token_lists(case);
    assert!(lists.len() >= 5, "{case}");
    let mut worst = 0.0_f64;
    for (name, activation) in [
        ("quick_gelu", Activation::QuickGelu),
        ("gelu", Activation::Gelu),
    ] {
        let expected = numbers(&format!("{case}.{name}"), f32::from_le_bytes);
        assert_eq!(expected.len(), lists.len() * size.projection);
        for (tokens, expected) in lists.iter().zip(expected.chunks_exact(size.projection)) {
            let found = encoder.embedding(tokens, activation).unwrap();
            assert_eq!(found.len(), size.projection);
            let length = |values: &mut dyn Iterator<Item = f32>| {
                values.map(|v| f64::from(v).powi(2)).sum::<f64>().sqrt()
            };
            let off = length(&mut found.iter().zip(expected).map(|(a, b)| a - b));
            worst = worst.max(off / length(&mut expected.iter().copied()));
        }
    }
    println!("{case}: relative difference {worst:.2e}");
    worst
}

#[test]
fn embeddings_are_those_of_transformers() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("clip.safetensors");
    write(&path, &generated(SMALL));
    let encoder = load(&path).unwrap();
    assert_eq!(
        (
            encoder.vocabulary(),
            encoder.most_tokens(),
            encoder.channels()
        ),
        (600, 16, 24)
    );
    assert!(difference("small", SMALL, &encoder) <= TOLERANCE);
    // The nonlinearities differ by more than the tolerance.
    let tokens = &token_lists("small")[3];
    let [one, other] = [Activation::Gelu, Activation::QuickGelu]
        .map(|activation| encoder.embedding(tokens, activation).unwrap());
    assert!(one.iter().zip(&other).any(|(a, b)| (a - b).abs() > 1e-3));
}

#[test]
fn embeddings_of_the_shape_of_vit_b_32_are_those_of_transformers() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("clip.safetensors");
    write(&path, &generated(BASE));
    assert!(difference("base", BASE, &load(&path).unwrap()) <= TOLERANCE);
}

#[test]
fn names_of_openai_and_pytorch_files_give_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let tokens = &token_lists("small")[4];
    let embedding = |path: &Path| {
        let encoder = load(path).unwrap();
        encoder.embedding(tokens, Activation::QuickGelu).unwrap()
    };
    let paths = ["hf.safetensors", "openai.safetensors", "openai.bin"];
    let [hf, openai, torch] = paths.map(|name| dir.path().join(name));
    let mut tensors = generated(SMALL);
    write(&hf, &tensors);
    let expected = embedding(&hf);
    // The image encoder is ignored, whatever it holds.
    tensors.insert("vision_model.x".into(), (vec![1], vec![f32::NAN]));
    write(&hf, &tensors);
    assert_eq!(embedding(&hf), expected);
    tensors.remove("vision_model.x");
    let mut tensors = as_openai(tensors);
    tensors.insert("visual.proj".into(), (vec![1], vec![f32::NAN]));
    write(&openai, &tensors);
    assert_eq!(embedding(&openai), expected);
    let state = torch_file::state_dict(&tensors, "");
    std::fs::write(&torch, torch_file::bytes(&state)).unwrap();
    assert_eq!(embedding(&torch), expected);
}

#[test]
fn unusable_weights_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("clip.safetensors");
    type Change<'a> = &'a dyn Fn(&mut Tensors);
    let error = |tensors: &Tensors, change: Change<'_>, words: &[&str]| {
        let mut tensors = tensors.clone();
        change(&mut tensors);
        write(&path, &tensors);
        let error = load(&path).expect_err("unusable");
        assert!(matches!(error, Error::Input { .. }), "{error}");
        for word in words
            .iter()
            .chain(&["clip.safetensors", "expected", "CLIP"])
        {
            assert!(error.to_string().contains(word), "{word}: {error}");
        }
    };
    let tiny = Size {
        vocabulary: 8,
        width: 64,
        hidden: 4,
        blocks: 2,
        positions: 3,
        projection: 5,
    };
    let theirs = generated(tiny);
    let openai = as_openai(theirs.clone());
    for tensors in [&theirs, &openai] {
        for name in tensors
            .keys()
            .filter(|name| *name != "token_embedding.weight")
        {
            error(tensors, &|t| drop(t.remove(name)), &[name, "no such"]);
            let spoil = |t: &mut Tensors| t.get_mut(name).unwrap().1[0] = f32::NAN;
            error(tensors, &spoil, &[name, "NaN"]);
            let reshape = |t: &mut Tensors| drop(t.insert(name.clone(), (vec![7], vec![0.1; 7])));
            error(tensors, &reshape, &[name, "[7]"]);
        }
    }
    let tokens = "text_model.embeddings.token_embedding.weight";
    error(&theirs, &Tensors::clear, &[tokens, "no such tensor"]);
    for (name, shape, word) in [
        (tokens, [8, 100], "multiple of 64"),
        (tokens, [0, 64], "[0, 64]"),
        ("text_projection.weight", [0, 64], "width 64"),
        (
            "text_model.embeddings.position_embedding.weight",
            [0, 64],
            "[rows, 64]",
        ),
        (
            "text_model.encoder.layers.1.mlp.fc2.weight",
            [64, 5],
            "[64, 4]",
        ),
        (
            "text_model.encoder.layers.x.mlp.fc2.weight",
            [64, 5],
            "layers.x",
        ),
        (
            "text_model.encoder.layers.3.mlp.fc2.weight",
            [64, 5],
            "layers.2",
        ),
    ] {
        let values = vec![0.1; shape[0] * shape[1]];
        let change =
            |t: &mut Tensors| drop(t.insert(name.to_owned(), (shape.to_vec(), values.clone())));
        error(&theirs, &change, &[word]);
    }
    write(&path, &theirs);
    let bytes = std::fs::read(&path).unwrap();
    for cut in [0, 7, 100, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..cut]).unwrap();
        assert!(matches!(load(&path), Err(Error::Input { .. })), "{cut}");
    }
    let absent = load(&dir.path().join("absent.safetensors")).expect_err("no file");
    assert!(matches!(absent, Error::Io { .. }), "{absent}");

    write(&path, &theirs);
    let encoder = load(&path).unwrap();
    for tokens in [&[][..], &[1, 2, 3, 4], &[1, 8]] {
        let error = encoder
            .embedding(tokens, Activation::Gelu)
            .expect_err("no text");
        assert!(matches!(error, Error::Argument { .. }), "{error}");
    }
    let mut huge = theirs.clone();
    let (_, values) = huge.get_mut("text_projection.weight").unwrap();
    values.fill(f32::MAX);
    write(&path, &huge);
    let error = load(&path).unwrap().embedding(&[1, 2], Activation::Gelu);
    assert!(matches!(error, Err(Error::NonFinite { .. })), "{error:?}");
}

#[test]
fn the_configuration_beside_the_weights_names_the_nonlinearity() {
    let dir = tempfile::tempdir().unwrap();
    let weights = dir.path().join("model.safetensors");
    let beside = || TextEncoder::activation_beside(&weights);
    assert_eq!(beside().unwrap(), None);
    let config = dir.path().join("config.json");
    for (text, expected) in [
        (
            r#"{"text_config": {"hidden_act": "gelu"}}"#,
            Activation::Gelu,
        ),
        (r#"{"hidden_act": "quick_gelu"}"#, Activation::QuickGelu),
        (r#"{"text_config": {}}"#, Activation::QuickGelu),
    ] {
        std::fs::write(&config, text).unwrap();
        assert_eq!(beside().unwrap(), Some(expected), "{text}");
    }
    for text in [r#"{"hidden_act": "relu"}"#, r#"{"hidden_act": 1}"#, "{"] {
        std::fs::write(&config, text).unwrap();
        let error = beside().expect_err(text).to_string();
        assert!(error.contains("config.json"), "{error}");
    }
}

#[test]
fn token_ids_are_those_of_clip() {
    let tokenizer = Tokenizer::new();
    assert_eq!(tokenizer.vocabulary(), 49408);
    let file = SafeTensors::deserialize(FILE).unwrap();
    for (number, expected) in token_lists("base").iter().enumerate() {
        let text = file
            .tensor(&format!("text.{number}"))
            .unwrap()
            .data()
            .to_vec();
        let text = String::from_utf8(text).unwrap();
        assert_eq!(&tokenizer.tokens(&text), expected, "{text}");
    }
    // As published: of CLIP's own notebook, and of an empty text.
    assert_eq!(tokenizer.tokens("a diagram"), [49406, 320, 22697, 49407]);
    assert_eq!(
        tokenizer.tokens("hello world!"),
        [49406, 3306, 1002, 256, 49407]
    );
    assert_eq!(tokenizer.tokens(" "), [49406, 49407]);
}

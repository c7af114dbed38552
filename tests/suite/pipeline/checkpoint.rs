//! Checkpoint files: exact round trips, and errors that name file and field.

use coseg::checkpoint::Checkpoint;
use std::fs;

/// Numbers that a fast parser of JSON reads with an error in the last bit, and the smallest ones.
const FINITE: [f64; 5] = [
    0.1 + 0.2,
    1.0 / 3.0 * 1e-17,
    0.123_456_789_012_345_67e-5,
    f64::MIN_POSITIVE,
    5e-324,
];

fn sample() -> Checkpoint {
    let mut c = Checkpoint::new("building");
    c.put(
        "means",
        &[2, 3],
        vec![1.0_f32, f32::MIN_POSITIVE / 4.0, -0.0, f32::MAX, 1e-30, 0.1],
    )
    .expect("fits");
    c.put("curve", &[2], vec![0.1_f64 + 0.2, f64::NAN])
        .expect("fits");
    c.put("visible", &[3], vec![0_u32, 7, u32::MAX])
        .expect("fits");
    c.put("iteration", &[], vec![u64::MAX]).expect("fits");
    c.put("empty", &[0, 3], Vec::<f32>::new()).expect("fits");
    c.set("names", &["a", "b"]).expect("JSON");
    c.set("seed", &u64::MAX).expect("JSON");
    c.set("losses", &FINITE).expect("JSON");
    c
}

#[test]
fn round_trip_is_exact_and_leaves_no_temporary_file() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("building.safetensors");
    fs::write(&path, "an older file").expect("written");
    sample().save(&path).expect("saved");
    assert_eq!(fs::read_dir(dir.path()).expect("listed").count(), 1);
    let mut c = Checkpoint::load(&path, "building").expect("loaded");
    let means: Vec<u32> = c
        .take::<f32>("means", &[2, 3])
        .expect("there")
        .into_iter()
        .map(f32::to_bits)
        .collect();
    let want = [1.0_f32, f32::MIN_POSITIVE / 4.0, -0.0, f32::MAX, 1e-30, 0.1].map(f32::to_bits);
    assert_eq!(means, want);
    let curve = c.take::<f64>("curve", &[2]).expect("there");
    assert!(curve[0] == 0.1 + 0.2 && curve[1].is_nan());
    assert_eq!(
        c.take::<u32>("visible", &[3]).expect("there"),
        [0, 7, u32::MAX]
    );
    assert_eq!(c.take::<u64>("iteration", &[]).expect("there"), [u64::MAX]);
    assert_eq!(c.take::<f32>("empty", &[0, 3]).expect("there"), [0.0; 0]);
    assert_eq!(c.get::<Vec<String>>("names").expect("there"), ["a", "b"]);
    assert_eq!(c.get::<u64>("seed").expect("there"), u64::MAX);
    assert_eq!(c.get::<[f64; 5]>("losses").expect("there"), FINITE);

    // the same state gives the same bytes
    let again = dir.path().join("again.safetensors");
    sample().save(&again).expect("saved");
    assert_eq!(
        fs::read(&path).expect("read"),
        fs::read(&again).expect("read")
    );
}

#[test]
fn damaged_and_foreign_files_are_named() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("state.safetensors");
    sample().save(&path).expect("saved");
    let whole = fs::read(&path).expect("read");
    let failure = |bytes: &[u8], kind: &str| {
        fs::write(&path, bytes).expect("written");
        Checkpoint::load(&path, kind)
            .expect_err("must fail")
            .to_string()
    };
    for length in [0, 4, 60, whole.len() - 1] {
        let message = failure(&whole[..length], "building");
        assert!(
            message.contains("state.safetensors") && message.contains("header"),
            "{length}: {message}"
        );
    }
    assert!(failure(b"not a safetensors file at all", "building").contains("header"));
    let message = failure(&whole, "segmentation");
    assert!(
        message.contains("metadata kind") && message.contains("building"),
        "{message}"
    );
    let plain = {
        let values = 1.0_f32.to_le_bytes();
        let view = safetensors::tensor::TensorView::new(safetensors::Dtype::F32, vec![1], &values)
            .expect("valid");
        safetensors::serialize([("x", view)], None).expect("encoded")
    };
    assert!(failure(&plain, "building").contains("metadata version"));
    let missing = Checkpoint::load(&dir.path().join("absent"), "building")
        .expect_err("absent")
        .to_string();
    assert!(
        missing.contains("absent") && missing.contains("read"),
        "{missing}"
    );
}

#[test]
fn wrong_fields_are_named() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("state.safetensors");
    sample().save(&path).expect("saved");
    let load = || Checkpoint::load(&path, "building").expect("loaded");
    let message = |e: coseg::Error| e.to_string();
    let e = message(load().take::<f32>("scales", &[2, 3]).expect_err("missing"));
    assert!(
        e.contains("state.safetensors") && e.contains("tensor scales"),
        "{e}"
    );
    let e = message(load().take::<f32>("means", &[3, 3]).expect_err("shape"));
    assert!(
        e.contains("tensor means") && e.contains("[2, 3]") && e.contains("[3, 3]"),
        "{e}"
    );
    let e = message(load().take::<u32>("means", &[2, 3]).expect_err("type"));
    assert!(
        e.contains("tensor means") && e.contains("F32") && e.contains("U32"),
        "{e}"
    );
    let e = message(load().get::<u64>("names").expect_err("type"));
    assert!(e.contains("metadata names"), "{e}");
    let e = message(load().get::<u64>("absent").expect_err("missing"));
    assert!(e.contains("metadata absent"), "{e}");
    assert!(
        Checkpoint::new("x")
            .put("y", &[2, 2], vec![0.0_f32; 3])
            .is_err()
    );
}

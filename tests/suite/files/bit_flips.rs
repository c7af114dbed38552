//! Files of a run with a checksum: a flipped bit never gives another result.

use crate::support::program::{fails, utf8};
use crate::support::{plates::scene, short_runs::short_run};
use coseg::checkpoint::Checkpoint;
use coseg::features::FeatureColors;
use coseg::objects::Identities;
use std::fs;
use std::path::Path;

/// Flips 250 bits of the file, one at a time, evenly over its bytes, and expects that `read` refuses each.
fn refused(path: &Path, read: impl Fn() -> coseg::Result<()>) {
    const FLIPS: usize = 250;
    read().expect("whole");
    let whole = fs::read(path).expect("read");
    for flip in 0..FLIPS {
        let mut damaged = whole.clone();
        // The header is short beside the tensors: half of the flips are in it.
        let header = 8 + u64::from_le_bytes(whole[..8].try_into().expect("length")) as usize;
        let part = [0..header, header..whole.len()][flip % 2].clone();
        damaged[part.start + part.len() * flip / FLIPS] ^= 1 << (flip / 2 % 8);
        fs::write(path, damaged).expect("write");
        let error = read().expect_err("damaged").to_string();
        assert!(error.contains(utf8(path)), "{flip}: {error}");
    }
    fs::write(path, whole).expect("write");
}

#[test]
fn flipped_bits_are_refused() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("state.safetensors");
    let mut checkpoint = Checkpoint::new("building");
    let values: Vec<f32> = (0..60).map(|v| v as f32).collect();
    checkpoint
        .put("means", &[20, 3], values.clone())
        .expect("fits");
    checkpoint.set("seed", &7).expect("JSON");
    checkpoint.save(&path).expect("saved");
    refused(&path, || Checkpoint::load(&path, "building").map(|_| ()));
    let path = dir.path().join("identities.safetensors");
    let identities = Identities {
        scores: values,
        classes: 3,
    };
    identities.write(&path).expect("written");
    refused(&path, || Identities::read(&path).map(|_| ()));
    let path = dir.path().join("feature_colors.safetensors");
    let rgb = vec![[0.25, 0.5, 1.0]; 9];
    FeatureColors { rgb }.write(&path).expect("written");
    refused(&path, || FeatureColors::read(&path, 9).map(|_| ()));
}

#[test]
fn identities_that_do_not_fit_their_run_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    scene(folder.path());
    let run = folder.path().join("run");
    short_run(folder.path(), &run);
    let path = run.join("identities.safetensors");
    let whole = Identities::read(&path).expect("identities");
    let rows = whole.scores.len() / whole.classes;
    let wider = Identities {
        scores: vec![0.5; rows * (whole.classes + 1)],
        classes: whole.classes + 1,
    };
    wider.write(&path).expect("write");
    let message = fails(&["eval", utf8(&run)], 1);
    assert!(message.contains("5 columns, expected 4"), "{message}");
    let mut unknown = whole;
    unknown.scores[6] = f32::NAN;
    unknown.write(&path).expect("write");
    let message = fails(&["eval", utf8(&run)], 1);
    assert!(message.contains("scores, row 1: found NaN"), "{message}");
}

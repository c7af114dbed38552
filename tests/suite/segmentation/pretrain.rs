//! Pretraining on procedural rooms: it learns, it repeats, and what it stores is what it trained.

use crate::support::pretraining::{PretrainOptions, TrainedEncoder, pretrain};
use coseg::weights::WeightFile;
use coseg::{Error, Result};
use std::path::Path;

fn run(options: &PretrainOptions) -> Result<TrainedEncoder> {
    pretrain(options, &crate::support::device(), &mut |_, _| ())
}

fn small() -> PretrainOptions {
    let points = [600, 1_200];
    PretrainOptions {
        rooms: 2,
        held_out: 1,
        room_points: 1_500,
        points,
        steps: 24,
        ..PretrainOptions::default()
    }
}

#[test]
fn the_loss_falls_and_the_stored_file_is_what_was_trained() {
    let trained = run(&small()).expect("finite");
    let (first, last) = (trained.curve[0], trained.curve[trained.curve.len() - 1]);
    assert!(last < 0.9 * first, "{:?}", trained.curve);
    assert!(
        trained.held_out.accuracy > 0.1 && trained.held_out.accuracy <= 1.0,
        "{:?}",
        trained.held_out
    );
    let bytes = trained.weights.to_safetensors().expect("whole tensors");
    let read =
        WeightFile::from_safetensors(&bytes, "pretrained RandLA weights").expect("just written");
    assert_eq!(read, trained.weights);
    assert!(
        read.metadata["options"].contains("seed: 0") && read.metadata.contains_key("held_out_miou")
    );
}

#[test]
fn same_seed_same_bits_at_one_and_two_threads() {
    let options = PretrainOptions {
        steps: 3,
        ..small()
    };
    let weights = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        pool.install(|| run(&options)).expect("finite").weights
    };
    let one = weights(1);
    assert_eq!(one, weights(2));
    let other = run(&PretrainOptions {
        seed: 1,
        ..options.clone()
    })
    .expect("finite")
    .weights;
    assert_ne!(one.tensors, other.tensors);
}

#[test]
fn impossible_sizes_are_refused() {
    for options in [
        PretrainOptions {
            rooms: 0,
            ..small()
        },
        PretrainOptions {
            steps: 0,
            ..small()
        },
        PretrainOptions {
            points: [2_000, 1_000],
            ..small()
        },
        PretrainOptions {
            points: [100, 2_000],
            ..small()
        },
    ] {
        assert!(
            matches!(run(&options), Err(Error::Argument { .. })),
            "{options:?}"
        );
    }
}

fn shipped() -> WeightFile {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/randla_builtin.safetensors");
    WeightFile::open(file).expect("weights")
}

#[test]
fn the_notes_of_the_weights_inside_the_crate_name_todays_options() {
    let notes = shipped().metadata;
    assert_eq!(
        notes["options"],
        format!("{:?}", PretrainOptions::default())
    );
    assert_eq!(notes["command"], "coseg pretrain --seed 0");
}

#[test]
#[ignore = "minutes: pretrains in full"]
fn the_weights_inside_the_crate_are_what_pretraining_gives() {
    let notes = shipped().metadata;
    let made = run(&PretrainOptions::default()).expect("finite");
    // Processors that round differently drift apart over the steps.
    for (note, found) in [
        ("held_out_accuracy", made.held_out.accuracy),
        ("held_out_miou", made.held_out.miou),
    ] {
        let stored: f64 = notes[note].parse().expect("a number");
        assert!(
            (stored - found).abs() < 0.03,
            "{note}: {stored} stored, {found} found"
        );
    }
}

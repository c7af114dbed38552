//! Pretraining on procedural rooms: it learns, it repeats, and what it stores is what it trained.

use coseg::device;
use coseg::segmentation::checkpoint::Checkpoint;
use coseg::segmentation::pretrain::{PretrainOptions, TrainedEncoder, pretrain};
use coseg::{Error, Result};

fn run(options: &PretrainOptions) -> Result<TrainedEncoder> {
    pretrain(options, &device::open(None).expect("a backend"), &mut |_| ())
}

fn small() -> PretrainOptions {
    let points = [600, 1_200];
    PretrainOptions { rooms: 2, held_out: 1, room_points: 1_500, points, steps: 24, ..PretrainOptions::default() }
}

#[test]
fn the_loss_falls_and_the_stored_file_is_what_was_trained() {
    let trained = run(&small()).expect("finite");
    let (first, last) = (trained.curve[0], trained.curve[trained.curve.len() - 1]);
    assert!(last < 0.9 * first, "{:?}", trained.curve);
    assert!(trained.held_out.accuracy > 0.1 && trained.held_out.accuracy <= 1.0, "{:?}", trained.held_out);
    let bytes = trained.weights.to_safetensors().expect("whole tensors");
    let read = Checkpoint::from_safetensors(&bytes, "pretrained RandLA weights").expect("just written");
    assert_eq!(read, trained.weights);
    assert!(read.metadata["options"].contains("seed: 0") && read.metadata.contains_key("held_out_miou"));
}

#[test]
fn same_seed_same_bits_at_one_and_two_threads() {
    let options = PretrainOptions { steps: 3, ..small() };
    let weights = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| run(&options)).expect("finite").weights
    };
    let one = weights(1);
    assert_eq!(one, weights(2));
    let other = run(&PretrainOptions { seed: 1, ..options.clone() }).expect("finite").weights;
    assert_ne!(one.tensors, other.tensors);
}

#[test]
fn impossible_sizes_are_refused() {
    for options in [
        PretrainOptions { rooms: 0, ..small() },
        PretrainOptions { steps: 0, ..small() },
        PretrainOptions { points: [2_000, 1_000], ..small() },
        PretrainOptions { points: [100, 2_000], ..small() },
    ] {
        assert!(matches!(run(&options), Err(Error::Config { .. })), "{options:?}");
    }
}

/// Makes the weights that ship: `COSEG_PRETRAIN_OUT=FILE cargo test --release -- --ignored make_builtin --nocapture`.
/// `coseg pretrain` does the same for its users.
#[test]
#[ignore = "minutes; only run to make the weights anew"]
fn make_builtin_weights() {
    let Some(out) = std::env::var_os("COSEG_PRETRAIN_OUT") else { return };
    let mut options = PretrainOptions::default();
    if let Some(steps) = std::env::var("COSEG_PRETRAIN_STEPS").ok().and_then(|s| s.parse().ok()) {
        options.steps = steps;
    }
    let start = std::time::Instant::now();
    let device = device::open(None).expect("a backend");
    let trained = pretrain(&options, &device, &mut |p| {
        if p.steps[0] % 20 == 0 {
            eprintln!("{:6.1} s  {p:?}", start.elapsed().as_secs_f64());
        }
    })
    .expect("finite");
    std::fs::write(out, trained.weights.to_safetensors().expect("whole tensors")).expect("a writable file");
    eprintln!("{:.0} s, {:?}, {:?}", start.elapsed().as_secs_f64(), trained.held_out, trained.curve);
}

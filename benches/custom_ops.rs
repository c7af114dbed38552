//! What each custom operation gains: milliseconds of a training step with it, and with its plain-tensor reference instead.
//! `cargo bench --bench custom_ops`. The environment variables `BACKEND`, `GAUSSIANS` (25000) and `ROUNDS` (5) change the run.
//! All variants are measured in turn, round by round.

use coseg::backend::device;
use coseg::bench::Bench;
use coseg::config::Config;
use coseg::ops::{CustomOp, with_references};

/// Names of the variants and the operations that they replace.
const VARIANTS: [(&str, &[CustomOp]); 5] = [
    ("all operations", &[]),
    ("without the photometric loss", &[CustomOp::Photometric]),
    ("without Adam", &[CustomOp::Adam]),
    ("without both", &[CustomOp::Photometric, CustomOp::Adam]),
    ("without sparse products", &[CustomOp::Sparse]),
];
const STEPS: [&str; 2] = ["stage one, a step", "stage two, a step"];

fn variable(name: &str, default: usize) -> usize {
    let value = std::env::var(name).ok();
    value
        .and_then(|value| value.parse().ok())
        .unwrap_or(default)
}

fn main() -> coseg::Result<()> {
    let name = std::env::var("BACKEND").ok();
    let device = device::open(name.and_then(|name| name.parse().ok()))?;
    let bench = Bench::load(Config::default(), None, device, 1)?;
    let gaussians = variable("GAUSSIANS", 25_000);
    let mut samples = vec![[const { Vec::new() }; STEPS.len()]; VARIANTS.len()];
    for _ in 0..variable("ROUNDS", 5) {
        for ((_, replaced), samples) in VARIANTS.iter().zip(&mut samples) {
            let figures = with_references(replaced, || bench.stages(gaussians))?;
            for (name, samples) in STEPS.iter().zip(samples) {
                let step = figures.figures.iter().find(|figure| figure.name == *name);
                samples.extend(step.map(|figure| figure.median));
            }
        }
    }
    for (stage, name) in STEPS.iter().enumerate() {
        println!("{name}");
        let first = median(&mut samples[0][stage]);
        for ((variant, _), samples) in VARIANTS.iter().zip(&mut samples) {
            let median = median(&mut samples[stage]);
            println!("  {variant}: {median:.1} ms, {:.2}x", median / first);
        }
    }
    Ok(())
}

fn median(samples: &mut [f64]) -> f64 {
    samples.sort_by(f64::total_cmp);
    samples.get(samples.len() / 2).copied().unwrap_or(f64::NAN)
}

//! What each custom operation gains: milliseconds of a training step with it, and with its plain-tensor reference instead.
//! `cargo bench --bench custom_ops`, or `-- building` or `-- segmentation` for one stage. The environment variables `BACKEND`,
//! `GAUSSIANS` (25000), `ROUNDS` (5) and `STEPS` (10) change the run. All variants are measured in turn, round by round.

use coseg::backend::device;
use coseg::bench::{Bench, Effort, Samples, Section, Source, Subject};
use coseg::config::Config;
use coseg::ops::{CustomOp, with_references};

/// Names of the variants and the operations that they replace.
type Variants = [(&'static str, &'static [CustomOp])];

const BUILDING: &Variants = &[
    ("all operations", &[]),
    ("without the photometric loss", &[CustomOp::Photometric]),
    ("without Adam", &[CustomOp::Adam]),
    ("without both", &[CustomOp::Photometric, CustomOp::Adam]),
];
const SEGMENTATION: &Variants = &[
    ("all operations", &[]),
    ("without sparse products", &[CustomOp::Sparse]),
];

fn variable(name: &str, default: usize) -> usize {
    let value = std::env::var(name).ok();
    value
        .and_then(|value| value.parse().ok())
        .unwrap_or(default)
}

fn main() -> coseg::Result<()> {
    let only = std::env::args().skip(1).find(|name| name != "--bench");
    let name = std::env::var("BACKEND").ok();
    let device = device::open(name.and_then(|name| name.parse().ok()))?;
    let config = Config::default();
    let subject = Subject::load(&Source::default(), &config, false, &device)?;
    let effort = Effort {
        settle: 5,
        steps: variable("STEPS", 10),
        ..Effort::full(1, vec![variable("GAUSSIANS", 25_000)])
    };
    let bench = Bench {
        config,
        subject,
        device,
        effort,
    };
    let stages = [
        (Section::Building, BUILDING),
        (Section::Segmentation, SEGMENTATION),
    ];
    for (section, variants) in stages {
        if only.as_ref().is_none_or(|only| only == section.key()) {
            measure(&bench, section, variants)?;
        }
    }
    Ok(())
}

fn measure(bench: &Bench, section: Section, variants: &Variants) -> coseg::Result<()> {
    let mut samples = vec![Samples::default(); variants.len()];
    for _ in 0..variable("ROUNDS", 5) {
        for ((_, replaced), samples) in variants.iter().zip(&mut samples) {
            let findings = with_references(replaced, || bench.measure(section))?;
            let step = |figure: &&coseg::bench::Figure| figure.name == "a step";
            if let Some(figure) = findings.figures.iter().find(step) {
                samples.push(figure.median);
            }
        }
    }
    println!("{}", section.title());
    let first = samples[0].median();
    for ((name, _), samples) in variants.iter().zip(&samples) {
        let (median, [low, high]) = (samples.median(), samples.spread());
        println!(
            "  {name}: {median:.1} ms ({low:.1} to {high:.1}), {:.2}x",
            median / first
        );
    }
    Ok(())
}

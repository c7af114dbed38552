//! The roofline: bytes that a view has to move and operations that it has to do ([`model`]), the time that the device needs for
//! either at its highest rates ([`ceilings`]), and the time that it takes.

mod ceilings;
mod counts;
#[cfg(feature = "cube")]
mod device;
#[cfg(feature = "cube")]
mod gpu;
mod host;
mod model;

use super::channels::{CASES, Rendering};
use super::unprojection::{CHANNELS, maps};
use super::{Bench, Figure, Findings, Layout, Samples, Section, figures};
use crate::backend::device::in_host_memory;
use crate::config::Resolution;
use crate::error::{Error, Result};
use crate::features::{Lattice, SCALES};
use crate::raster::Settings;
use crate::segmentation::unprojection::Lifting;
use crate::splat::Gaussians;
use ceilings::Ceilings;
use model::{Channels, Counts, Sorting, Work, backward, forward, lifting};

pub(super) fn measure(bench: &Bench) -> Result<Findings> {
    let effort = &bench.effort;
    let ceilings = Ceilings::measure(bench)?;
    let copied = figures::short(ceilings.copied_bytes as f64 / 1e6);
    let mut notes = vec![
        format!("{} views of {}; lifting: the first of them", effort.views, bench.subject.description),
        format!("first the device itself: a buffer of {copied} MB copied, multiply-adds in the widest registers, the fastest pass"),
        "then the mean view: bytes and operations by a count of what a view needs (bench::roofline::model), with each".into(),
        "array moved once a step; the time of either at the device's highest rate; the longer of them is the roof.".into(),
        "Pairs counted are those of the kernels for CPUs; reached = roof / measured. Lifting is at `feature` resolution,".into(),
        "where pairs are what it costs: at `image` resolution kernels for CPUs fold them first.".into(),
    ];
    if !ceilings.latencies.is_empty() {
        notes.push(
            "A rendered view waits for at least one readback and for its kernels' launches, which no roof holds."
                .into(),
        );
    }
    let mut findings = Findings::new(Section::Roofline, notes);
    findings.figures = ceilings.figures();
    findings.layout = Layout::GridAfter(findings.figures.len());
    for &count in &effort.memory {
        let gaussians = bench.subject.gaussians(count)?;
        for size in [effort.size, effort.channels_size] {
            rendered(bench, &gaussians, size, &ceilings, &mut findings)?;
        }
        let case = format!(
            "{}, {SCALES} x {CHANNELS} channels lifted",
            words(&gaussians, effort.size)
        );
        let lifted = lifted(bench, &gaussians);
        add(&mut findings, &case, lifted, &ceilings)?;
    }
    Ok(findings)
}

/// `100,000 at 480x360`.
fn words(gaussians: &Gaussians, [width, height]: [usize; 2]) -> String {
    format!(
        "{} at {width}x{height}",
        figures::thousands(gaussians.len() as f64)
    )
}

/// Time of a view in milliseconds, and what it has to do.
type Measured = (Samples, Work);

/// The cases of one number of Gaussians and one size.
fn rendered(
    bench: &Bench,
    gaussians: &Gaussians,
    size: [usize; 2],
    ceilings: &Ceilings,
    findings: &mut Findings,
) -> Result<()> {
    let cameras = &bench.subject.cameras(bench.effort.views, size);
    let counts = Counts::of_views(gaussians, cameras, &Settings::from(&bench.config.raster))?;
    let mean = |work: &dyn Fn(&Counts) -> Work| {
        counts
            .iter()
            .map(work)
            .sum::<Work>()
            .scaled(1.0 / counts.len() as f64)
    };
    let sorting = sorting(bench);
    for (colour, channels, name) in CASES {
        let rendering = Rendering {
            bench,
            gaussians,
            cameras,
            colour,
            channels,
        };
        let blended = Channels {
            sh_degree: colour.then_some(gaussians.sh_degree),
            features: channels as f64,
        };
        let case = format!("{}, {name}", words(gaussians, size));
        let forward = |n: &Counts| forward(n, &blended, sorting);
        let measured = rendering.forward().map(|time| (time, mean(&forward)));
        add(findings, &format!("{case}, forward"), measured, ceilings)?;
        if channels == 0 {
            let both = |n: &Counts| forward(n) + backward(n, &blended);
            let measured = rendering.both().map(|time| (time, mean(&both)));
            add(
                findings,
                &format!("{case}, forward + backward"),
                measured,
                ceilings,
            )?;
        }
    }
    Ok(())
}

/// The unprojection's part of one view.
fn lifted(bench: &Bench, gaussians: &Gaussians) -> Result<Measured> {
    let (effort, settings) = (&bench.effort, Settings::from(&bench.config.raster));
    let cameras = bench.subject.cameras(effort.views, effort.size);
    let maps = maps(bench, 0);
    let mut sums = Lifting::new(gaussians, &[CHANNELS; SCALES], &bench.device);
    let (mut time, mut work) = (Samples::default(), Work::default());
    if let Some(camera) = cameras.first() {
        time = Samples::of(effort.repeats, || {
            sums.add(camera, &maps, None, Resolution::Feature, &settings)?;
            sums.wait()
        })?;
        // Scales on one grid are one view of all their channels.
        let mut grids: Vec<(Lattice, f64)> = Vec::new();
        for map in &maps {
            match grids.iter_mut().find(|(of, _)| *of == map.lattice()) {
                Some((_, channels)) => *channels += map.channels as f64,
                None => grids.push((map.lattice(), map.channels as f64)),
            }
        }
        for (lattice, channels) in grids {
            let counts = Counts::of(gaussians, &lattice.camera(camera), &settings)?;
            work = work + lifting(&counts, channels, sorting(bench));
        }
    }
    Ok((time.scaled(1e3), work))
}

/// As the device of `bench` sorts.
fn sorting(bench: &Bench) -> Sorting {
    if in_host_memory(&bench.device) {
        Sorting::Host
    } else {
        Sorting::Device
    }
}

/// A line of the table; or a note, where the device cannot hold it.
fn add(
    findings: &mut Findings,
    case: &str,
    measured: Result<Measured>,
    ceilings: &Ceilings,
) -> Result<()> {
    match measured {
        Ok((time, work)) => findings.figures.extend(line(case, &time, &work, ceilings)),
        Err(error @ Error::Limit { .. }) => {
            findings.notes.push(format!("{case}: left out, {error}"))
        }
        Err(error) => return Err(error),
    }
    Ok(())
}

fn line(case: &str, time: &Samples, work: &Work, ceilings: &Ceilings) -> [Figure; 7] {
    let [memory, arithmetic] = ceilings.seconds(work).map(|seconds| 1e3 * seconds);
    let roof = memory.max(arithmetic);
    let counted = |name: &str, unit, value| Figure::counted(case, name, unit, value);
    [
        Figure::measured(case, "measured", "ms", time),
        counted("moved", "MB", work.bytes * 1e-6),
        counted("operations", "MFLOP", work.operations * 1e-6),
        counted("by memory", "ms", memory),
        counted("by arithmetic", "ms", arithmetic),
        counted("roof", "ms", roof),
        counted("reached", "%", 100.0 * roof / time.median()),
    ]
}

//! What the device can do at most, measured.

#[cfg(feature = "cube")]
use super::device;
use super::host;
use super::model::Work;
#[cfg(feature = "cube")]
use crate::backend::device::{in_host_memory, largest_allocation};
use crate::bench::machine::available_memory;
use crate::bench::{Bench, Effort, Figure, Samples};
use crate::error::Result;
#[cfg(feature = "cube")]
use burn::tensor::{Device, Tensor};

/// Of the table's first figures.
const CASE: &str = "at most";
/// The copied buffers are this share of the memory that can be had, at most.
const SHARE: u64 = 8;
/// A measurement takes this many times as long as reading its end back.
#[cfg(feature = "cube")]
const READBACKS: f64 = 50.0;
/// Times that one value is read back a repeat.
#[cfg(feature = "cube")]
const READS: usize = 10;
/// Starts of the chains of a device: enough to fill it several times over. A buffer of them is a small part of what is
/// copied.
#[cfg(feature = "cube")]
const STARTS_SHARE: usize = 16;

/// Highest rates of a device.
pub(super) struct Ceilings {
    /// Bytes a second, read and written, of a copy.
    copy: Samples,
    /// Operations a second of multiply-adds, two each.
    arithmetic: Samples,
    /// Seconds of what does not depend on the amount of work, and what that is; none where host and device are one.
    pub latencies: Vec<(&'static str, Samples)>,
    /// Bytes of each of the two buffers that were copied.
    pub copied_bytes: usize,
}

impl Ceilings {
    /// Of the bench's device.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when it fails.
    pub fn measure(bench: &Bench) -> Result<Self> {
        #[cfg(feature = "cube")]
        if !in_host_memory(&bench.device) {
            return Self::of_device(&bench.effort, &bench.device);
        }
        Self::of_host(&bench.effort)
    }

    fn of_host(effort: &Effort) -> Result<Self> {
        let room = available_memory().map_or(usize::MAX, |bytes| (bytes / SHARE) as usize);
        let copied_bytes = effort.copied_bytes.min(room);
        let len = copied_bytes / size_of::<f32>();
        let (from, mut to) = (host::buffer(len, 1.5), host::buffer(len, 0.0));
        let least = effort.probe.as_secs_f64();
        let copy = one_of_many(effort, least, |passes| {
            (0..passes).for_each(|_| host::copy(&from, &mut to));
            Ok(())
        })?;
        let step = one_of_many(effort, least, |steps| {
            host::multiply_add(steps);
            Ok(())
        })?;
        Ok(Self {
            copy: copy.rates((2 * copied_bytes) as f64),
            arithmetic: step.rates(host::operations_of_a_step()),
            latencies: Vec::new(),
            copied_bytes,
        })
    }

    #[cfg(feature = "cube")]
    fn of_device(effort: &Effort, place: &Device) -> Result<Self> {
        let cell = Tensor::<1>::zeros([1], place);
        let readback = Samples::of(effort.repeats, || {
            (0..READS).try_for_each(|_| device::wait(cell.clone()))
        })?;
        let readback = readback.scaled(1.0 / READS as f64);
        let least = effort
            .probe
            .as_secs_f64()
            .max(READBACKS * readback.median());
        let launch = one_of_many(effort, least, |launches| device::launches(&cell, launches))?;
        let copied_bytes = effort
            .copied_bytes
            .min(largest_allocation(place).unwrap_or(usize::MAX));
        // A multiple of the vectors that are copied.
        let len = copied_bytes / size_of::<f32>() / STARTS_SHARE * STARTS_SHARE;
        let (from, to) = (
            Tensor::<1>::full([len], 1.5, place),
            Tensor::<1>::zeros([len], place),
        );
        let copy = one_of_many(effort, least, |passes| device::copy(&from, &to, passes))?;
        drop(to);
        let starts = from.narrow(0, 0, len / STARTS_SHARE);
        let round = one_of_many(effort, least, |rounds| {
            device::multiply_add(&starts, rounds)
        })?;
        Ok(Self {
            copy: copy.rates((2 * len * size_of::<f32>()) as f64),
            arithmetic: round.rates(device::operations_of_a_round(len / STARTS_SHARE)),
            latencies: vec![
                ("one value read back", readback),
                ("a small kernel in a row of them", launch),
            ],
            copied_bytes: len * size_of::<f32>(),
        })
    }

    /// Seconds that moving the bytes of `work`, and doing its operations, takes at least.
    pub fn seconds(&self, work: &Work) -> [f64; 2] {
        // The fastest pass: others are slower for reasons that are not the device's.
        let highest = |rates: &Samples| rates.spread()[1];
        [
            work.bytes / highest(&self.copy),
            work.operations / highest(&self.arithmetic),
        ]
    }

    /// As figures.
    pub fn figures(&self) -> Vec<Figure> {
        let mut figures = vec![
            Figure::measured(
                CASE,
                "memory, read and written",
                "GB/s",
                &self.copy.scaled(1e-9),
            ),
            Figure::measured(
                CASE,
                "f32 multiply-adds, two operations each",
                "GFLOP/s",
                &self.arithmetic.scaled(1e-9),
            ),
        ];
        let latencies = self.latencies.iter();
        figures.extend(
            latencies
                .map(|(name, seconds)| Figure::measured(CASE, name, "us", &seconds.scaled(1e6))),
        );
        figures
    }
}

/// Seconds of one of the parts of `work`, which does as many as it is told: so many that they take `least` seconds together.
fn one_of_many(
    effort: &Effort,
    least: f64,
    mut work: impl FnMut(usize) -> Result<()>,
) -> Result<Samples> {
    let mut seconds = |count: usize| -> Result<f64> {
        let mut one = Samples::default();
        one.time(|| work(count))?;
        Ok(one.sum())
    };
    // Compiles kernels where there are some.
    seconds(1)?;
    let count = enough(least, &mut seconds)?;
    let samples = (0..effort.repeats.max(1)).map(|_| Ok(seconds(count)? / count as f64));
    samples.collect::<Result<Samples>>()
}

/// A count at which `seconds` is `least` or more.
fn enough(least: f64, mut seconds: impl FnMut(usize) -> Result<f64>) -> Result<usize> {
    /// A count is found in few steps, and never by leaps that a short measurement would make.
    const GROWTH: [f64; 2] = [1.5, 10.0];
    /// Where the clock stands still.
    const MOST: usize = 1 << 30;
    let mut count = 1;
    while count < MOST {
        let found = seconds(count)?;
        if found >= least {
            break;
        }
        let [low, high] = GROWTH;
        count = (count as f64 * (1.1 * least / found).clamp(low, high)).ceil() as usize;
    }
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_grow_until_they_take_long_enough() {
        // A hundred a second, after a start that takes some time of its own.
        let mut asked = Vec::new();
        let count = enough(2.0, |count| {
            asked.push(count);
            Ok(0.5 + count as f64 / 100.0)
        });
        assert!(
            (150..400).contains(&count.expect("no error")) && asked.len() < 10,
            "{asked:?}"
        );
        assert!(asked.is_sorted());
        assert_eq!(enough(0.1, |_| Ok(1.0)).expect("no error"), 1);
    }

    #[test]
    fn work_takes_what_the_highest_rates_allow() {
        let ceilings = Ceilings {
            copy: [5.0, 10.0, 8.0].into_iter().collect(),
            arithmetic: [100.0].into_iter().collect(),
            latencies: Vec::new(),
            copied_bytes: 1,
        };
        assert_eq!(
            ceilings.seconds(&Work {
                bytes: 20.0,
                operations: 50.0
            }),
            [2.0, 0.5]
        );
        assert_eq!(ceilings.figures().len(), 2);
    }
}

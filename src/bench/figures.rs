//! Measured figures with their spread, and the table of them.

use crate::report::thousands;
use serde::Serialize;
use std::fmt::Write;

/// One measured quantity.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// What was measured.
    pub name: String,
    /// Its unit.
    pub unit: &'static str,
    /// The median of the measurements.
    pub median: f64,
    /// The smallest measurement.
    pub low: f64,
    /// The largest measurement.
    pub high: f64,
    /// Number of measurements.
    pub samples: usize,
    /// Errors named by [`Figures::error_names`], where the figure has a reference.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<f64>,
}

/// What one part of the benchmark measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// Its name on the command line.
    pub section: &'static str,
    /// Number of Gaussians.
    pub gaussians: usize,
    /// What was measured and how; one line each.
    pub notes: Vec<String>,
    /// What the errors of the figures measure.
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    pub error_names: &'static [&'static str],
    /// The figures.
    pub figures: Vec<Figure>,
}

impl Figures {
    /// No figures yet.
    pub fn new(section: &'static str, gaussians: usize) -> Self {
        Self {
            section,
            gaussians,
            notes: Vec::new(),
            error_names: &[],
            figures: Vec::new(),
        }
    }

    /// Adds the median and the spread of `samples`; nothing without samples.
    pub fn add(&mut self, name: impl Into<String>, unit: &'static str, samples: &[f64]) {
        let mut sorted = samples.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let (Some(&low), Some(&high)) = (sorted.first(), sorted.last()) else {
            return;
        };
        self.figures.push(Figure {
            name: name.into(),
            unit,
            median: median(&sorted),
            low,
            high,
            samples: sorted.len(),
            errors: Vec::new(),
        });
    }

    /// Title, notes and table as text.
    pub fn text(&self) -> String {
        let count = thousands(self.gaussians as u64);
        let mut out = format!("{}: {count} Gaussians\n", self.section);
        for note in &self.notes {
            let _ = writeln!(out, "  {note}");
        }
        let _ = write!(out, "  {:<30}{:>12}{:>20}", "", "median", "spread");
        for name in self.error_names {
            let _ = write!(out, "{name:>12}");
        }
        out.push('\n');
        for figure in &self.figures {
            let spread = match figure.samples {
                1 => String::new(),
                _ => format!("{} .. {}", short(figure.low), short(figure.high)),
            };
            let median = format!("{} {}", short(figure.median), figure.unit);
            let _ = write!(out, "  {:<30}{median:>12}{spread:>20}", figure.name);
            for &error in &figure.errors {
                let _ = write!(out, "{:>12}", short(error));
            }
            out.push('\n');
        }
        out
    }
}

/// The middle of sorted values, or the mean of the middle two.
fn median(sorted: &[f64]) -> f64 {
    let middle = sorted.len() / 2;
    if sorted.len() % 2 == 1 {
        sorted[middle]
    } else {
        0.5 * (sorted[middle - 1] + sorted[middle])
    }
}

/// About three digits; whole numbers stay whole.
fn short(value: f64) -> String {
    match value.abs() {
        0.0 => "0".to_owned(),
        v if v < 1e-2 => format!("{value:.1e}"),
        v if v < 0.1 => format!("{value:.3}"),
        v if v < 10.0 && value.fract() != 0.0 => format!("{value:.2}"),
        v if v < 100.0 && value.fract() != 0.0 => format!("{value:.1}"),
        _ => thousands(value.round() as u64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        let cases = [
            (0.0, "0"),
            (3.2e-5, "3.2e-5"),
            (0.0804, "0.080"),
            (3.987, "3.99"),
            (28.44, "28.4"),
            (30.0, "30"),
            (12345.6, "12,346"),
        ];
        for (value, text) in cases {
            assert_eq!(short(value), text);
        }
    }

    #[test]
    fn figures_have_their_median_and_spread() {
        let mut found = Figures::new("stages", 1_200);
        found.notes.push("a note".to_owned());
        found.add("nothing", "ms", &[]);
        found.add("odd", "ms", &[5.0, 1.0, 3.0]);
        found.add("even", "ms", &[4.0, 1.0, 2.0, 100.0]);
        let [odd, even] = &found.figures[..] else {
            panic!("{found:?}");
        };
        assert_eq!(
            (odd.median, odd.low, odd.high, odd.samples),
            (3.0, 1.0, 5.0, 3)
        );
        assert_eq!(even.median, 3.0);
        let text = found.text();
        for part in ["stages: 1,200 Gaussians", "a note", "3 ms", "1 .. 5"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        found.error_names = &["mean", "largest"];
        found.figures[0].errors = vec![0.25, 0.375];
        let text = found.text();
        assert!(text.contains("largest") && text.contains("0.38"), "{text}");
    }
}

//! The figures of a section, with their spread, and the table of them.

use super::{Samples, Section};
use crate::report::thousands;
use serde::Serialize;
use std::fmt::Write;

/// One measured or counted quantity.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// What it was measured on, such as `100,000 Gaussians`.
    pub case: String,
    /// What it is.
    pub name: String,
    /// Its unit; empty for plain numbers.
    pub unit: &'static str,
    /// The median of the measurements, or the count.
    pub median: f64,
    /// The smallest measurement.
    pub low: f64,
    /// The largest measurement.
    pub high: f64,
    /// Measurements behind the median; 1 for a count.
    pub samples: usize,
}

impl Figure {
    fn value(&self) -> String {
        format!("{} {}", short(self.median), self.unit)
            .trim_end()
            .to_owned()
    }

    fn spread(&self) -> String {
        if self.samples > 1 {
            format!("{} .. {}", short(self.low), short(self.high))
        } else {
            String::new()
        }
    }
}

/// What a section found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Findings {
    /// The section.
    pub section: Section,
    /// What was measured and how; one line each.
    pub notes: Vec<String>,
    /// Why nothing was measured, where nothing was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub skipped: Option<String>,
    /// The figures, in order of their cases.
    pub figures: Vec<Figure>,
}

impl Findings {
    pub(super) fn new(section: Section, subject: &str) -> Self {
        Self {
            section,
            notes: vec![subject.to_owned()],
            skipped: None,
            figures: Vec::new(),
        }
    }

    /// Adds a line of explanation, once.
    pub(super) fn note(&mut self, note: impl Into<String>) {
        let note = note.into();
        if !self.notes.contains(&note) {
            self.notes.push(note);
        }
    }

    /// Adds the median and the spread of `samples`.
    pub(super) fn measured(
        &mut self,
        case: &str,
        name: &str,
        unit: &'static str,
        samples: &Samples,
    ) {
        let [low, high] = samples.spread();
        self.figures.push(Figure {
            case: case.to_owned(),
            name: name.to_owned(),
            unit,
            median: samples.median(),
            low,
            high,
            samples: samples.len(),
        });
    }

    /// Adds a single value.
    pub(super) fn counted(&mut self, case: &str, name: &str, unit: &'static str, value: f64) {
        self.measured(case, name, unit, &[value].into_iter().collect());
    }

    /// Title, notes and table as text.
    pub fn text(&self) -> String {
        let mut out = format!("{}: {}\n", self.section, self.section.title());
        for note in &self.notes {
            let _ = writeln!(out, "  {note}");
        }
        if let Some(why) = &self.skipped {
            let _ = writeln!(out, "  skipped: {why}");
            return out;
        }
        out.push_str(&match self.section {
            Section::Curve => grid(&self.figures),
            _ => lines(&self.figures),
        });
        out
    }
}

/// A line for each figure; a case is named once.
fn lines(figures: &[Figure]) -> String {
    let mut rows = vec![["", "", "median", "spread"].map(str::to_owned).to_vec()];
    let mut last = "";
    for figure in figures {
        let case = match &figure.case {
            case if case == last => String::new(),
            case => case.clone(),
        };
        last = &figure.case;
        rows.push(vec![
            case,
            figure.name.clone(),
            figure.value(),
            figure.spread(),
        ]);
    }
    aligned(&rows, 2)
}

/// A line for each case, a column for each name.
fn grid(figures: &[Figure]) -> String {
    let mut names = vec![""];
    let mut rows: Vec<Vec<String>> = Vec::new();
    for figure in figures {
        let column = names.iter().position(|name| *name == figure.name);
        let column = column.unwrap_or_else(|| {
            names.push(&figure.name);
            names.len() - 1
        });
        if rows.last().is_none_or(|row| row[0] != figure.case) {
            rows.push(vec![figure.case.clone()]);
        }
        if let Some(row) = rows.last_mut() {
            row.resize(column.max(row.len()), String::new());
            row.push(figure.value());
        }
    }
    rows.insert(0, names.into_iter().map(str::to_owned).collect());
    aligned(&rows, 1)
}

/// Rows with padded columns, those from `right` on aligned to the right.
fn aligned(rows: &[Vec<String>], right: usize) -> String {
    let mut widths: Vec<usize> = Vec::new();
    for row in rows {
        widths.resize(widths.len().max(row.len()), 0);
        for (width, cell) in widths.iter_mut().zip(row) {
            *width = (*width).max(cell.chars().count());
        }
    }
    let mut out = String::new();
    for row in rows {
        let mut line = String::new();
        for (column, (cell, &width)) in row.iter().zip(&widths).enumerate() {
            let _ = if column < right {
                write!(line, "  {cell:<width$}")
            } else {
                write!(line, "  {cell:>width$}")
            };
        }
        let _ = writeln!(out, "{}", line.trim_end());
    }
    out
}

/// About three digits; whole numbers stay whole.
pub(super) fn short(value: f64) -> String {
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
    fn tables_are_aligned_and_name_a_case_once() {
        let mut findings = Findings::new(Section::Raster, "a room");
        findings.note("a note");
        findings.counted("ten", "pairs", "", 5.0);
        findings.measured("ten", "time", "ms", &[1.0, 2.0].into_iter().collect());
        let text = findings.text();
        assert_eq!(text.matches("ten").count(), 1, "{text}");
        assert!(
            text.contains("a note") && text.contains("1.50 ms  1 .. 2"),
            "{text}"
        );
        findings.section = Section::Curve;
        let text = findings.text();
        assert!(text.ends_with("  ten      5  1.50 ms\n"), "{text}");
    }
}

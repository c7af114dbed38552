//! What a section found: figures with their spread and the bar they are held against, and the table of them.

use super::{Samples, Section};
use serde::Serialize;
use std::fmt::Write;

/// The largest value that a figure should have.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bar {
    /// In the figure's unit.
    pub limit: f64,
    /// Whether the median stays within it; absent where the bar was set for other circumstances.
    pub met: Option<bool>,
    /// The circumstances that the bar was set for, where they are not these.
    #[serde(skip_serializing_if = "str::is_empty")]
    pub meant_for: &'static str,
}

/// One measured or counted quantity.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// What it was measured on, such as `100,000 Gaussians`; figures of one case follow each other.
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
    /// Measurements behind the median; 1 for what was counted or computed.
    pub samples: usize,
    /// What it is held against.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bar: Option<Bar>,
}

impl Figure {
    /// Median and spread of `samples`.
    pub fn measured(case: &str, name: &str, unit: &'static str, samples: &Samples) -> Self {
        let [low, high] = samples.spread();
        let (case, name) = (case.to_owned(), name.to_owned());
        Self {
            case,
            name,
            unit,
            median: samples.median(),
            low,
            high,
            samples: samples.len(),
            bar: None,
        }
    }

    /// A single value.
    pub fn counted(case: &str, name: &str, unit: &'static str, value: f64) -> Self {
        Self::measured(case, name, unit, &[value].into_iter().collect())
    }

    /// Held against `limit`.
    #[must_use]
    pub fn at_most(mut self, limit: f64) -> Self {
        self.bar = Some(Bar {
            limit,
            met: Some(self.median <= limit),
            meant_for: "",
        });
        self
    }

    /// Held against `limit` if these are the circumstances it was set for, else shown beside it without a verdict.
    #[must_use]
    pub fn at_most_if(self, here: bool, limit: f64, meant_for: &'static str) -> Self {
        if here {
            return self.at_most(limit);
        }
        Self {
            bar: Some(Bar {
                limit,
                met: None,
                meant_for,
            }),
            ..self
        }
    }

    fn value(&self) -> String {
        with_unit(self.median, self.unit)
    }

    fn spread(&self) -> String {
        if self.samples > 1 {
            format!("{} .. {}", short(self.low), short(self.high))
        } else {
            String::new()
        }
    }

    /// The bar and the verdict.
    fn verdict(&self) -> [String; 2] {
        let Some(bar) = &self.bar else {
            return Default::default();
        };
        let verdict = match bar.met {
            Some(true) => "met".to_owned(),
            Some(false) => "MISSED".to_owned(),
            None => format!("- (for {})", bar.meant_for),
        };
        [format!("<= {}", with_unit(bar.limit, self.unit)), verdict]
    }
}

/// How figures are laid out as text.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Layout {
    /// A line each, with spread and bar.
    #[default]
    Lines,
    /// A line for each case, a column for each name.
    Grid,
    /// So many figures a line each, the others as a grid.
    GridAfter(usize),
}

/// What a section found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Findings {
    /// Which section.
    pub section: Section,
    /// What was measured, how, and what the figures do not say; one line each.
    pub notes: Vec<String>,
    /// Why nothing was measured, where nothing was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub skipped: Option<String>,
    /// The figures, cases together.
    pub figures: Vec<Figure>,
    #[serde(skip)]
    pub(super) layout: Layout,
}

impl Findings {
    /// Figures still to come.
    pub fn new(section: Section, notes: Vec<String>) -> Self {
        Self {
            section,
            notes,
            skipped: None,
            figures: Vec::new(),
            layout: Layout::Lines,
        }
    }

    /// Nothing was measured, and why.
    pub fn skipped(section: Section, why: impl Into<String>) -> Self {
        Self {
            skipped: Some(why.into()),
            ..Self::new(section, Vec::new())
        }
    }

    /// Title, notes and table, for people.
    pub fn text(&self) -> String {
        let mut out = format!("{}: {}\n", self.section, self.section.title());
        for note in &self.notes {
            let _ = writeln!(out, "  {note}");
        }
        if let Some(why) = &self.skipped {
            let _ = writeln!(out, "  skipped: {why}");
            return out;
        }
        out.push_str(&match self.layout {
            Layout::Lines => lines(&self.figures),
            Layout::Grid => grid(&self.figures),
            Layout::GridAfter(count) => {
                let (first, rest) = self.figures.split_at(count.min(self.figures.len()));
                format!("{}\n{}", lines(first), grid(rest))
            }
        });
        out
    }
}

fn lines(figures: &[Figure]) -> String {
    let mut rows = vec![
        ["", "", "median", "spread", "bar", ""]
            .map(str::to_owned)
            .to_vec(),
    ];
    let mut last = "";
    for figure in figures {
        let case = if figure.case == last {
            String::new()
        } else {
            figure.case.clone()
        };
        last = &figure.case;
        let [bar, verdict] = figure.verdict();
        rows.push(vec![
            case,
            figure.name.clone(),
            figure.value(),
            figure.spread(),
            bar,
            verdict,
        ]);
    }
    aligned(&rows, &[2, 3, 4])
}

fn grid(figures: &[Figure]) -> String {
    let mut names: Vec<&str> = Vec::new();
    let mut cases: Vec<&str> = Vec::new();
    for figure in figures {
        if !names.contains(&&*figure.name) {
            names.push(&figure.name);
        }
        if !cases.contains(&&*figure.case) {
            cases.push(&figure.case);
        }
    }
    let mut rows = vec![
        std::iter::once("")
            .chain(names.iter().copied())
            .map(str::to_owned)
            .collect::<Vec<_>>(),
    ];
    for case in cases {
        let cell = |name: &&str| figures.iter().find(|f| f.case == case && f.name == **name);
        let cells = names
            .iter()
            .map(|name| cell(name).map_or_else(|| "-".to_owned(), Figure::value));
        rows.push(std::iter::once(case.to_owned()).chain(cells).collect());
    }
    let right: Vec<usize> = (1..=names.len()).collect();
    aligned(&rows, &right)
}

/// Rows with columns padded to one width, those of `right` to the left of their text; indented, empty columns dropped.
fn aligned(rows: &[Vec<String>], right: &[usize]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |c: usize| {
        rows.iter()
            .filter_map(|row| row.get(c))
            .map(|cell| cell.chars().count())
            .max()
            .unwrap_or(0)
    };
    let used = |c: &usize| {
        rows.iter()
            .skip(1)
            .any(|row| row.get(*c).is_some_and(|cell| !cell.is_empty()))
    };
    let widths: Vec<(usize, usize)> = (0..columns).filter(used).map(|c| (c, width(c))).collect();
    let mut out = String::new();
    for row in rows {
        let cells = widths.iter().map(|&(c, width)| {
            let cell = row.get(c).map_or("", |cell| cell);
            if right.contains(&c) {
                format!("{cell:>width$}")
            } else {
                format!("{cell:<width$}")
            }
        });
        let line = cells.collect::<Vec<_>>().join("  ");
        let _ = writeln!(out, "  {}", line.trim_end());
    }
    out
}

fn with_unit(value: f64, unit: &str) -> String {
    match unit {
        "" => short(value),
        "x" => format!("x{}", short(value)),
        _ => format!("{} {unit}", short(value)),
    }
}

/// Three digits or so, whole numbers whole.
pub(super) fn short(value: f64) -> String {
    match value.abs() {
        0.0 => "0".to_owned(),
        v if v < 1e-2 => format!("{value:.1e}"),
        v if v < 0.1 => format!("{value:.3}"),
        v if v < 10.0 && value.fract() != 0.0 => format!("{value:.2}"),
        v if v < 100.0 && value.fract() != 0.0 => format!("{value:.1}"),
        _ => thousands(value),
    }
}

/// `12,345`.
pub(super) fn thousands(value: f64) -> String {
    let digits = format!("{:.0}", value.abs());
    let mut out = String::from(if value < 0.0 { "-" } else { "" });
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
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
    fn bars_are_judged_only_where_they_apply() {
        let samples: Samples = [28.0, 31.0, 29.0].into_iter().collect();
        let figure = Figure::measured("a", "forward", "ms", &samples);
        assert_eq!(figure.clone().at_most(30.0).verdict(), ["<= 30 ms", "met"]);
        assert_eq!(
            figure.clone().at_most(28.5).verdict(),
            ["<= 28.5 ms", "MISSED"]
        );
        assert_eq!(
            figure.clone().at_most_if(false, 9.0, "others").verdict(),
            ["<= 9 ms", "- (for others)"]
        );
        assert_eq!(figure.spread(), "28 .. 31");
    }

    #[test]
    fn tables_are_aligned_and_name_a_case_once() {
        let mut findings = Findings::new(Section::Raster, vec!["a note".into()]);
        findings.figures = vec![
            Figure::counted("ten", "pairs", "", 5.0),
            Figure::measured("ten", "time", "ms", &[1.0, 2.0].into_iter().collect()).at_most(1.0),
        ];
        let text = findings.text();
        assert_eq!(text.matches("ten").count(), 1, "{text}");
        assert!(
            text.contains("a note") && text.contains("1.50 ms") && text.contains("MISSED"),
            "{text}"
        );
        findings.layout = Layout::Grid;
        let text = findings.text();
        assert!(
            text.lines()
                .any(|l| l.split_whitespace().eq(["ten", "5", "1.50", "ms"])),
            "{text}"
        );
        findings.layout = Layout::GridAfter(1);
        let text = findings.text();
        assert!(
            text.contains("ten  pairs") && text.ends_with("  ten  1.50 ms\n"),
            "{text}"
        );
    }
}

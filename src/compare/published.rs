//! Rows that a paper printed, shown below those that were measured.

use crate::error::{Result, ensure};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A row that somebody else measured, on other data. The units are those of papers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Published {
    /// The method.
    pub name: String,
    /// The data that it was measured on.
    pub data: String,
    /// Where it is printed.
    pub source: String,
    /// Mean IoU, %.
    pub miou: Option<f64>,
    /// Share of pixels that are right, %.
    pub accuracy: Option<f64>,
    /// Frames in a second.
    pub frames_per_second: Option<f64>,
    /// Learned parameters, MB.
    pub learnable_mb: Option<f64>,
    /// PSNR, dB.
    pub psnr: Option<f64>,
    /// Calinski-Harabasz index of rendered features.
    pub calinski_harabasz: Option<f64>,
    /// Davies-Bouldin index of rendered features.
    pub davies_bouldin: Option<f64>,
    /// Seconds.
    pub seconds: Option<f64>,
}

/// Headings of the figures.
const HEADINGS: [&str; 8] = [
    "mIoU, %",
    "accuracy, %",
    "frames/s",
    "learnable, MB",
    "PSNR, dB",
    "CH",
    "DB",
    "seconds",
];

impl Published {
    /// The figures, in the order of the headings.
    fn figures(&self) -> [Option<f64>; HEADINGS.len()] {
        [
            self.miou,
            self.accuracy,
            self.frames_per_second,
            self.learnable_mb,
            self.psnr,
            self.calinski_harabasz,
            self.davies_bouldin,
            self.seconds,
        ]
    }

    /// Checks row `number` of the plan at `path`.
    pub(super) fn check(&self, path: &Path, number: usize) -> Result<()> {
        let texts = [
            ("name", &self.name),
            ("data", &self.data),
            ("source", &self.source),
        ];
        for (key, text) in texts {
            let is_plain = !text.trim().is_empty() && !text.contains(['|', '\n', '\r']);
            ensure!(is_plain, path, "published, number {number}, {key}"; found "{text:?}";
                expected "a line of text without |"; help "say what is printed where");
        }
        let mut figures = self.figures().into_iter().flatten().peekable();
        ensure!(figures.peek().is_some(), path, "published, number {number}"; found "no figure";
            expected "one or more of those of docs/compare.md"; help "give what is printed, or leave out the row");
        let wrong = figures.find(|figure| !(figure.is_finite() && *figure >= 0.0));
        ensure!(wrong.is_none(), path, "published, number {number}"; found "{}", wrong.unwrap_or_default();
            expected "figures of 0 or more"; help "give them as they are printed");
        Ok(())
    }
}

/// A table of `rows` with a column for each figure that one of them has, and a line that says what they are; nothing without rows.
pub(super) fn table(rows: &[Published]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let has = |column: &usize| rows.iter().any(|row| row.figures()[*column].is_some());
    let columns: Vec<usize> = (0..HEADINGS.len()).filter(has).collect();
    let headings: Vec<&str> = columns.iter().map(|&column| HEADINGS[column]).collect();
    let mut text = format!(
        "\n## Published\n\nThese figures are as printed by their sources. They were measured on other data, by other programs and on \
         other machines, and are not comparable with those above.\n\n| | data | {} | source |\n|---|---|{}---|\n",
        headings.join(" | "),
        "---:|".repeat(columns.len())
    );
    for row in rows {
        let shown = |&column: &usize| {
            let figure = row.figures()[column];
            figure.map_or("–".to_owned(), |figure| figure.to_string())
        };
        let figures: Vec<String> = columns.iter().map(shown).collect();
        let figures = figures.join(" | ");
        text += &format!(
            "| {} | {} | {figures} | {} |\n",
            row.name, row.data, row.source
        );
    }
    text
}

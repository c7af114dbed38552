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

impl Published {
    /// The figures with their headings.
    fn figures(&self) -> [(&'static str, Option<f64>); 8] {
        [
            ("mIoU, %", self.miou),
            ("accuracy, %", self.accuracy),
            ("frames/s", self.frames_per_second),
            ("learnable, MB", self.learnable_mb),
            ("PSNR, dB", self.psnr),
            ("CH", self.calinski_harabasz),
            ("DB", self.davies_bouldin),
            ("seconds", self.seconds),
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
        let figures = self.figures().into_iter();
        let mut figures = figures.filter_map(|(_, figure)| figure).peekable();
        ensure!(figures.peek().is_some(), path, "published, number {number}"; found "no figure";
            expected "one or more of those of docs/compare.md"; help "give what is printed, or leave out the row");
        let wrong = figures.find(|figure| !(figure.is_finite() && *figure >= 0.0));
        ensure!(wrong.is_none(), path, "published, number {number}"; found "{}", wrong.unwrap_or_default();
            expected "figures of 0 or more"; help "give them as they are printed");
        Ok(())
    }
}

/// A table of `rows` and a line that explains it. Figures that no row has get no column. Empty without rows.
pub(super) fn table(rows: &[Published]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let figures: Vec<_> = rows.iter().map(Published::figures).collect();
    let is_given = |column: &usize| figures.iter().any(|row| row[*column].1.is_some());
    let columns: Vec<usize> = (0..figures[0].len()).filter(is_given).collect();
    let headings: Vec<&str> = columns.iter().map(|&column| figures[0][column].0).collect();
    let mut text = format!(
        "\n## Published\n\nThese figures are as printed by their sources. They were measured on other data, by other programs and on \
         other machines, and are not comparable with those above.\n\n| | data | {} | source |\n|---|---|{}---|\n",
        headings.join(" | "),
        "---:|".repeat(columns.len())
    );
    for (row, figures) in rows.iter().zip(&figures) {
        let shown = |&column: &usize| {
            let figure = figures[column].1;
            figure.map_or("–".to_owned(), |figure| figure.to_string())
        };
        let shown: Vec<String> = columns.iter().map(shown).collect();
        text += &format!(
            "| {} | {} | {} | {} |\n",
            row.name,
            row.data,
            shown.join(" | "),
            row.source
        );
    }
    text
}

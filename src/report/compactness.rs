//! Table of how compact identities are.

use super::Report;
use super::tables::{cell, row_name, table};
use std::fmt::Write;

/// Neighbours that differ by variant, and how far the raw labels agree; empty where no variant has them.
pub(super) fn compactness(report: &Report<'_>) -> String {
    let labels = &report.metrics.test.labels;
    let rows: Vec<_> = labels
        .iter()
        .filter_map(|(row, s)| Some((*row, s.compactness?)))
        .collect();
    if rows.is_empty() {
        return String::new();
    }
    let mut body = String::new();
    for (row, compactness) in rows {
        let _ = writeln!(
            body,
            "<tr>{}<td>{}</td></tr>",
            row_name(row),
            cell(Some(compactness.neighbours_differ))
        );
    }
    let head = ["".to_owned(), "neighbours that differ,&nbsp;%".to_owned()];
    let agreement = labels.values().find_map(|s| s.agreement).map_or(String::new(), |a| {
        format!(
            " The raw labels' votes on a Gaussian have a mean entropy of {:.3} nats; the winner has less than two thirds of them \
             on {}&nbsp;% of the Gaussians.",
            a.entropy,
            super::markup::percent(a.contested)
        )
    });
    format!(
        "<h3>Compactness</h3>\n<p class=\"quiet\">Share of the pairs of neighbouring Gaussians whose labels differ: borders between \
         things, and specks.{agreement}</p>\n{}",
        table(&head, &body)
    )
}

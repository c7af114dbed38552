//! Table of how compact identities are.

use super::Report;
use super::tables::{cell, row_name, table};
use std::fmt::Write;

/// Neighbours that differ by row, with and without diffusion, and how far the raw labels agree; empty where no row has them.
pub(super) fn compactness(report: &Report<'_>) -> String {
    let labels = &report.metrics.test.labels;
    let rows: Vec<_> = labels
        .iter()
        .filter_map(|(row, s)| Some((*row, s, s.compactness?)))
        .collect();
    if rows.is_empty() {
        return String::new();
    }
    let diffused = rows.iter().any(|(_, _, c)| c.without_diffusion.is_some());
    let mut body = String::new();
    for (row, scores, compactness) in rows {
        let _ = write!(
            body,
            "<tr>{}<td>{}</td>",
            row_name(row),
            cell(Some(compactness.neighbours_differ))
        );
        if diffused {
            let before = compactness.without_diffusion;
            let shares = [
                before.map(|b| b.neighbours_differ),
                scores.miou,
                before.and_then(|b| b.miou),
                scores.miou_per_view,
                before.and_then(|b| b.miou_per_view),
            ];
            shares.iter().for_each(|share| {
                let _ = write!(body, "<td>{}</td>", cell(*share));
            });
        }
        body.push_str("</tr>\n");
    }
    let mut head = vec!["".to_owned(), "neighbours that differ,&nbsp;%".to_owned()];
    if diffused {
        let names = [
            "without diffusion",
            "mIoU pooled,&nbsp;%",
            "without",
            "mIoU per&nbsp;view,&nbsp;%",
            "without",
        ];
        head.extend(names.map(String::from));
    }
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

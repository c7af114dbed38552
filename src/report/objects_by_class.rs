//! Tables of objects scored by what they are.

use super::Report;
use super::markup::escape;
use super::tables::{cell, row_name, table};
use crate::metrics::{PanopticScores, SemanticScores};
use std::fmt::Write;

/// Scores of objects against true classes, and the IoU of each class; empty where no row has them.
pub(super) fn semantic(report: &Report<'_>) -> String {
    let labels = &report.metrics.test.labels;
    let rows: Vec<_> = labels
        .iter()
        .filter_map(|(row, s)| Some((*row, s.semantic.as_ref()?)))
        .collect();
    let Some((_, first)) = rows.first() else {
        return String::new();
    };
    let mut body = String::new();
    for (row, s) in &rows {
        let quality = |pick: fn(&PanopticScores) -> Option<f64>| s.panoptic.as_ref().and_then(pick);
        let shares = [s.miou, s.miou_per_view, s.accuracy].into_iter().chain([
            quality(|p| p.all.pq),
            quality(|p| p.all.sq),
            quality(|p| p.all.rq),
            quality(|p| p.things.pq),
            quality(|p| p.stuff.pq),
            quality(|p| p.scene.pq),
        ]);
        let cells: String = shares
            .map(|share| format!("<td>{}</td>", cell(share)))
            .collect();
        let _ = writeln!(body, "<tr>{}{cells}</tr>", row_name(*row));
    }
    let head = [
        "",
        "mIoU pooled,&nbsp;%",
        "mIoU per&nbsp;view,&nbsp;%",
        "accuracy,&nbsp;%",
        "PQ,&nbsp;%",
        "SQ,&nbsp;%",
        "RQ,&nbsp;%",
        "PQ of things,&nbsp;%",
        "PQ of stuff,&nbsp;%",
        "PQ of the scene,&nbsp;%",
    ];
    let mut classes = String::new();
    for class in &first.per_class {
        let of = |s: &SemanticScores| s.per_class.iter().find(|c| c.id == class.id).map(|c| c.iou);
        let cells: String = rows
            .iter()
            .map(|(_, s)| format!("<td>{}</td>", cell(of(s))))
            .collect();
        let _ = writeln!(
            classes,
            "<tr><th scope=\"row\">{}</th>{cells}</tr>",
            escape(&class.name)
        );
    }
    let names = std::iter::once("class".to_owned())
        .chain(rows.iter().map(|(row, _)| row.title().to_owned()));
    format!(
        "<h3>Objects by class against true labels</h3>\n<p class=\"quiet\">An object counts as its class. PQ, SQ and RQ are means \
         over classes: of things each instance is a segment, of stuff all of a class; PQ of the scene has all views as one \
         image.</p>\n{}<h3>IoU by class of the objects, %</h3>\n{}",
        table(&head.map(String::from), &body),
        table(&names.collect::<Vec<_>>(), &classes)
    )
}

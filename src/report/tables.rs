//! Tables of the page: rows of scores, IoU by class, times and sizes.

use super::curves::row_class;
use super::markup::{bytes, duration, escape, percent};
use super::{Report, RowScores};
use crate::config::Variant;
use std::fmt::Write;

/// A table whose wide content scrolls on its own.
pub(super) fn table(head: &[String], body: &str) -> String {
    let head: String = head
        .iter()
        .map(|h| format!("<th scope=\"col\">{h}</th>"))
        .collect();
    format!(
        "<div class=\"scroll\"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>\n"
    )
}

pub(super) fn row_name(row: Variant) -> String {
    format!(
        "<th scope=\"row\" class=\"{}\"><span class=\"mark\"></span>{}</th>",
        row_class(row),
        row.title()
    )
}

type Pick = fn(&RowScores) -> Option<f64>;

/// A share as percent, or a dash.
pub(super) fn cell(share: Option<f64>) -> String {
    share.map_or("–".into(), percent)
}

/// Scores of all rows. Raw labels have two lines: their unlabelled pixels as wrong, and left out.
pub(super) fn scores(report: &Report<'_>) -> String {
    let labels = &report.metrics.test.labels;
    let best = |pick: Pick| labels.values().filter_map(pick).max_by(f64::total_cmp);
    let columns: [Pick; 3] = [|s| s.miou, |s| s.miou_per_view, |s| s.accuracy];
    let mut body = String::new();
    for (row, scores) in labels {
        let class = if *row == Variant::Ours {
            " class=\"ours\""
        } else {
            ""
        };
        let _ = write!(body, "<tr{class}>{}", row_name(*row));
        for pick in columns {
            let mark = if pick(scores).is_some() && pick(scores) == best(pick) {
                " class=\"best\""
            } else {
                ""
            };
            let _ = write!(body, "<td{mark}>{}</td>", cell(pick(scores)));
        }
        let or_dash = |text: Option<String>| text.unwrap_or_else(|| "–".into());
        let _ = writeln!(
            body,
            "<td>{}</td><td>{}</td><td>{}</td></tr>",
            or_dash(
                scores
                    .iterations
                    .map(|n| super::markup::thousands(n as u64))
            ),
            or_dash(scores.learning_rate.map(|rate| rate.to_string())),
            or_dash(scores.seconds.map(duration)),
        );
        if let Some(s) = scores.void_left_out {
            let cells: String = [s.miou, s.miou_per_view, s.accuracy]
                .map(|v| format!("<td>{}</td>", cell(v)))
                .concat();
            let _ = writeln!(
                body,
                "<tr class=\"quiet\"><th scope=\"row\" class=\"{}\"><span class=\"mark\"></span>{}, unlabelled left out</th>\
                 {cells}<td>–</td><td>–</td><td>–</td></tr>",
                row_class(*row),
                row.title(),
            );
        }
    }
    let head = [
        "",
        "mIoU pooled,&nbsp;%",
        "mIoU per&nbsp;view,&nbsp;%",
        "accuracy,&nbsp;%",
        "iterations",
        "learning rate",
        "time",
    ];
    table(&head.map(String::from), &body)
}

/// Scores of objects against true instances; empty where no row has them.
pub(super) fn instances(report: &Report<'_>) -> String {
    let labels = &report.metrics.test.labels;
    let rows: Vec<_> = labels
        .iter()
        .filter_map(|(row, s)| Some((*row, s.instances.as_ref()?)))
        .collect();
    if rows.is_empty() {
        return String::new();
    }
    let mut body = String::new();
    for (row, s) in rows {
        let shares = [
            s.accuracy,
            s.miou,
            s.panoptic.pq,
            s.panoptic.sq,
            s.panoptic.rq,
            s.scene.pq,
        ];
        let cells: String = shares
            .map(|share| format!("<td>{}</td>", cell(share)))
            .concat();
        let _ = writeln!(
            body,
            "<tr>{}{cells}<td>{}</td><td>{}</td></tr>",
            row_name(row),
            s.instances,
            s.objects
        );
    }
    let head = [
        "",
        "accuracy,&nbsp;%",
        "mIoU,&nbsp;%",
        "PQ,&nbsp;%",
        "SQ,&nbsp;%",
        "RQ,&nbsp;%",
        "PQ of the scene,&nbsp;%",
    ];
    let head = head
        .into_iter()
        .chain(["true instances", "objects"])
        .map(String::from);
    format!(
        "<h3>Objects against true instances</h3>\n<p class=\"quiet\">Accuracy and mIoU after matching objects and instances one \
         to one over all held-out views; PQ, SQ and RQ (Kirillov et al. 2019) of each view's segments as one class, and PQ \
         with all views as one image.</p>\n{}",
        table(&head.collect::<Vec<_>>(), &body)
    )
}

/// IoU by class and row; empty when no row has them.
pub(super) fn class_iou(report: &Report<'_>) -> String {
    let labels = &report.metrics.test.labels;
    let rows: Vec<_> = labels
        .iter()
        .filter(|(_, s)| !s.class_iou.is_empty())
        .collect();
    if rows.is_empty() {
        return String::new();
    }
    let mut body = String::new();
    for class in &report.classes.entries {
        let cells: Vec<Option<f64>> = rows
            .iter()
            .map(|(_, s)| s.class_iou.get(&class.id).copied())
            .collect();
        if cells.iter().all(Option::is_none) {
            continue;
        }
        let best = cells
            .iter()
            .flatten()
            .copied()
            .fold(f64::NEG_INFINITY, f64::max);
        let [r, g, b] = class.color;
        let _ = write!(
            body,
            "<tr><th scope=\"row\"><span class=\"mark\" style=\"background:rgb({r} {g} {b})\"></span>{}</th>",
            escape(&class.name)
        );
        for cell in cells {
            let mark = if cell == Some(best) {
                " class=\"best\""
            } else {
                ""
            };
            let _ = write!(body, "<td{mark}>{}</td>", self::cell(cell));
        }
        body.push_str("</tr>\n");
    }
    let head: Vec<String> = std::iter::once("class".to_owned())
        .chain(rows.iter().map(|(row, _)| row.title().to_owned()))
        .collect();
    format!("<h3>IoU by class, %</h3>\n{}", table(&head, &body))
}

/// Where the time went: a bar and a table.
pub(super) fn times(report: &Report<'_>) -> String {
    let s = &report.metrics.seconds;
    let parts = [
        ("building", s.building, "--ours"),
        ("2D features", s.features, "--vote"),
        ("unprojection", s.unprojection, "--per_gaussian"),
        ("segmentation", s.segmentation, "--ours_ce"),
    ];
    let rest = (s.total - parts.iter().map(|p| p.1).sum::<f64>()).max(0.0);
    let all = parts
        .into_iter()
        .chain([("loading, scoring, writing", rest, "--raw")]);
    let (mut bar, mut body) = (String::new(), String::new());
    for (name, seconds, color) in all {
        let share = if s.total > 0.0 {
            100.0 * seconds / s.total
        } else {
            0.0
        };
        let _ = write!(
            bar,
            "<i style=\"width:{share:.2}%;background:var({color})\" title=\"{name}: {}\"></i>",
            duration(seconds)
        );
        let _ = writeln!(
            body,
            "<tr><th scope=\"row\"><span class=\"mark\" style=\"background:var({color})\"></span>{name}</th>\
             <td>{}</td><td>{share:.0} %</td></tr>",
            duration(seconds)
        );
    }
    let _ = writeln!(
        body,
        "<tr><th scope=\"row\">total</th><td class=\"best\">{}</td><td></td></tr>",
        duration(s.total)
    );
    let head = ["stage", "time", "share"].map(String::from);
    format!(
        "<div class=\"bar\" aria-hidden=\"true\">{bar}</div>\n{}",
        table(&head, &body)
    )
}

/// Peak memory and the size of what was trained.
pub(super) fn sizes(report: &Report<'_>) -> String {
    let m = &report.metrics;
    let peak = m
        .peak_memory_bytes
        .map_or("not known on this system".to_owned(), bytes);
    let mut body =
        format!("<tr><th scope=\"row\">peak memory of the process</th><td>{peak}</td></tr>\n");
    for (part, size) in &m.learnable_bytes {
        let name = escape(&part.replace('_', " "));
        let _ = writeln!(
            body,
            "<tr><th scope=\"row\">learnable: {name}</th><td>{}</td></tr>",
            bytes(*size)
        );
    }
    table(&["what".into(), "size".into()], &body)
}

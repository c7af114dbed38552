//! Tables of the page: scores by row and by class, times and sizes.

use super::chart::swatch;
use super::curves::color;
use super::units::{duration, percent, thousands};
use super::{Report, VariantScores};
use crate::config::Variant;
use crate::metrics::{InstanceScores, PanopticScores, PixelScores, SemanticScores};
use crate::reconstruction::MAX_GAP;
use indicatif::DecimalBytes;
use maud::{Markup, html};

/// A table whose wide content scrolls on its own.
fn table(head: &[&str], body: Markup) -> Markup {
    html! {
        div.scroll {
            table {
                thead { tr { @for name in head { th scope="col" { (name) } } } }
                tbody { (body) }
            }
        }
    }
}

fn row_name(row: Variant) -> Markup {
    html! { th scope="row" { (swatch(color(row))) (row.title()) } }
}

/// A share, bold where it is the best and above 0.
fn share(share: Option<f64>, best: Option<f64>) -> Markup {
    let is_best = share.is_some_and(|share| share > 0.0) && share == best;
    html! { td.best[is_best] { (percent(share)) } }
}

/// The rows that have scores of one kind.
fn rows_with<'a, T>(
    report: &'a Report<'_>,
    pick: impl Fn(&'a VariantScores) -> Option<T>,
) -> Vec<(Variant, T)> {
    let labels = report.metrics.test.labels.iter();
    labels
        .filter_map(|(row, scores)| Some((*row, pick(scores)?)))
        .collect()
}

/// Scores of all rows. Raw labels have two lines: with unlabelled pixels as wrong, and with those left out.
pub(super) fn scores(report: &Report<'_>) -> Markup {
    let labels = &report.metrics.test.labels;
    let columns: [fn(&PixelScores) -> Option<f64>; 3] =
        [|s| s.miou, |s| s.miou_per_view, |s| s.accuracy];
    let pixels = || labels.values().map(|scores| &scores.pixels);
    let best = columns.map(|pick| pixels().filter_map(pick).max_by(f64::total_cmp));
    let or_dash = |text: Option<String>| text.unwrap_or_else(|| "–".into());
    let head = [
        "",
        "mIoU pooled, %",
        "mIoU per view, %",
        "accuracy, %",
        "steps (+ fine-tuning)",
        "learning rate",
        "time",
    ];
    let body = html! {
        @for (row, scores) in labels {
            tr.ours[*row == Variant::Ours] {
                (row_name(*row))
                @for (pick, best) in columns.iter().zip(best) { (share(pick(&scores.pixels), best)) }
                td { (or_dash(steps(scores))) }
                td { (or_dash(scores.learning_rate.map(|rate| rate.to_string()))) }
                td { (or_dash(scores.seconds.map(duration))) }
            }
            @if let Some(s) = scores.void_left_out {
                tr.quiet {
                    th scope="row" { (swatch(color(*row))) (row.title()) ", unlabelled left out" }
                    @for pick in columns { td { (percent(pick(&s))) } }
                    td { "–" } td { "–" } td { "–" }
                }
            }
        }
    };
    table(&head, body)
}

/// The steps of a trained variant, and those of its fine-tuning.
fn steps(scores: &VariantScores) -> Option<String> {
    let trained = thousands(scores.iterations? as u64);
    Some(match scores.fine_tuning_steps {
        Some(steps) => format!("{trained} + {}", thousands(steps as u64)),
        None => trained,
    })
}

/// The reviews of the number of Gaussians; nothing where there was none.
pub(super) fn reviews(report: &Report<'_>) -> Markup {
    let reviews = &report.metrics.curves.building.reviews;
    let head = [
        "after step",
        "Gaussians",
        "stayed",
        "PSNR of views trained on, dB",
        "held back, dB",
        "held back after it, dB",
    ];
    let body = html! {
        @for review in reviews {
            tr {
                th scope="row" { (thousands(review.iteration as u64)) }
                td { (thousands(review.gaussians as u64)) }
                td { (thousands(review.kept as u64)) }
                td { (format!("{:.2}", review.psnr_trained)) }
                td { (format!("{:.2}", review.psnr_before)) }
                td { (format!("{:.2}", review.psnr_after)) }
            }
        }
    };
    html! {
        @if !reviews.is_empty() {
            p {
                "Some training views were held back from training for a time. Each review removed the Gaussians that hardly change "
                "the pictures of these views. Between reviews, training added Gaussians. "
                @match reviews.iter().find(|review| review.learns_photos()) {
                    Some(review) => {
                        "Growth ended after step " (thousands(review.iteration as u64)) ": the views trained on were "
                        (format!("{:.1}", review.psnr_trained - review.psnr_before)) " dB better than those held back, and the limit is "
                        (MAX_GAP) " dB. More Gaussians would have learned single photos."
                    }
                    None => {
                        "Growth ended with densification: the views trained on were never more than " (MAX_GAP)
                        " dB better than those held back."
                    }
                }
            }
            (table(&head, body))
        }
    }
}

/// A column of a table: its head, and the text of a cell.
type Column<T> = (&'static str, fn(&T) -> String);

/// A table with a line for each row.
fn row_table<T>(rows: &[(Variant, &T)], columns: &[Column<T>]) -> Markup {
    let head: Vec<&str> = std::iter::once("")
        .chain(columns.iter().map(|(head, _)| *head))
        .collect();
    let body = html! {
        @for (row, scores) in rows {
            tr {
                (row_name(*row))
                @for (_, cell) in columns { td { (cell(scores)) } }
            }
        }
    };
    table(&head, body)
}

/// Scores of objects against true instances; nothing where no row has them.
pub(super) fn instances(report: &Report<'_>) -> Option<Markup> {
    let rows = rows_with(report, |scores| scores.instances.as_ref());
    let columns: [Column<InstanceScores>; 8] = [
        ("accuracy, %", |s| percent(s.accuracy)),
        ("mIoU, %", |s| percent(s.miou)),
        ("PQ, %", |s| percent(s.panoptic.pq)),
        ("SQ, %", |s| percent(s.panoptic.sq)),
        ("RQ, %", |s| percent(s.panoptic.rq)),
        ("PQ of the scene, %", |s| percent(s.scene.pq)),
        ("true instances", |s| s.instances.to_string()),
        ("objects", |s| s.objects.to_string()),
    ];
    (!rows.is_empty()).then(|| {
        html! {
            h3 { "Objects against true instances" }
            p.quiet {
                "Accuracy and mIoU after matching objects and instances one to one over all held-out views. PQ, SQ and RQ \
                 (Kirillov et al. 2019) treat the segments of each view as one class; PQ of the scene treats all views as \
                 one image."
            }
            (row_table(&rows, &columns))
        }
    })
}

/// The panoptic quality of objects; without figures where there is none.
fn quality(scores: &SemanticScores) -> PanopticScores {
    scores.panoptic.unwrap_or_default()
}

/// Scores of objects against true classes, and the IoU of each class; nothing where no row has them.
pub(super) fn objects_by_class(report: &Report<'_>) -> Option<Markup> {
    let rows = rows_with(report, |scores| scores.semantic.as_ref());
    let (_, first) = rows.first()?;
    let columns: [Column<SemanticScores>; 9] = [
        ("mIoU pooled, %", |s| percent(s.pixels.miou)),
        ("mIoU per view, %", |s| percent(s.pixels.miou_per_view)),
        ("accuracy, %", |s| percent(s.pixels.accuracy)),
        ("PQ, %", |s| percent(quality(s).all.pq)),
        ("SQ, %", |s| percent(quality(s).all.sq)),
        ("RQ, %", |s| percent(quality(s).all.rq)),
        ("PQ of things, %", |s| percent(quality(s).things.pq)),
        ("PQ of stuff, %", |s| percent(quality(s).stuff.pq)),
        ("PQ of the scene, %", |s| percent(quality(s).scene.pq)),
    ];
    let iou = |s: &SemanticScores, id| s.per_class.iter().find(|c| c.id == id).map(|c| c.iou);
    let classes = first.per_class.iter().map(|class| {
        let name = html! { (class.name) };
        let cells = rows.iter().map(|(_, s)| iou(s, class.id));
        (name, cells.collect())
    });
    Some(html! {
        h3 { "Objects by class against true labels" }
        p.quiet {
            "An object counts as its class. PQ, SQ and RQ are means over classes. In a class of things each instance is a \
             segment, in a class of stuff all pixels are one. PQ of the scene treats all views as one image."
        }
        (row_table(&rows, &columns))
        h3 { "IoU by class of the objects, %" }
        (class_table(&rows, classes))
    })
}

/// IoU by class and row; nothing when no row has them.
pub(super) fn class_iou(report: &Report<'_>) -> Option<Markup> {
    let rows = rows_with(report, |s| {
        (!s.class_iou.is_empty()).then_some(&s.class_iou)
    });
    let classes = report.classes.entries.iter().map(|class| {
        let name = html! { (swatch(class.color)) (class.name) };
        let cells = rows.iter().map(|(_, iou)| iou.get(&class.id).copied());
        (name, cells.collect())
    });
    (!rows.is_empty()).then(|| {
        html! {
            h3 { "IoU by class, %" }
            (class_table(&rows, classes))
        }
    })
}

/// A table with a line for each class that any row has a share for, and a column for each row.
fn class_table<T>(
    rows: &[(Variant, T)],
    classes: impl Iterator<Item = (Markup, Vec<Option<f64>>)>,
) -> Markup {
    let head: Vec<&str> = std::iter::once("class")
        .chain(rows.iter().map(|(row, _)| row.title()))
        .collect();
    let body = html! {
        @for (name, cells) in classes {
            @let best = cells.iter().flatten().copied().max_by(f64::total_cmp);
            @if best.is_some() {
                tr {
                    th scope="row" { (name) }
                    @for cell in cells { (share(cell, best)) }
                }
            }
        }
    };
    table(&head, body)
}

/// Where the time went: a bar and a table.
pub(super) fn times(report: &Report<'_>) -> Markup {
    let s = &report.metrics.seconds;
    let known = s.building + s.features + s.unprojection + s.segmentation;
    let rest = (s.total - known).max(0.0);
    let stages = [
        ("building", s.building, color(Variant::Ours)),
        ("2D features", s.features, color(Variant::Vote)),
        ("unprojection", s.unprojection, color(Variant::PerGaussian)),
        ("segmentation", s.segmentation, color(Variant::NoDecoder)),
        ("loading, scoring, writing", rest, color(Variant::Raw)),
    ];
    let share = |seconds: f64| 100.0 * seconds / s.total.max(1e-9);
    let body = html! {
        @for (name, seconds, color) in stages {
            tr {
                th scope="row" { (swatch(color)) (name) }
                td { (duration(seconds)) }
                td { (format!("{:.0} %", share(seconds))) }
            }
        }
        tr { th scope="row" { "total" } td.best { (duration(s.total)) } td {} }
    };
    html! {
        div.bar aria-hidden="true" {
            @for (name, seconds, [r, g, b]) in stages {
                i title=(name) style=(format!("width:{:.2}%;background:rgb({r} {g} {b})", share(seconds))) {}
            }
        }
        (table(&["stage", "time", "share"], body))
    }
}

/// Peak memory and the size of what was trained.
pub(super) fn sizes(report: &Report<'_>) -> Markup {
    let m = &report.metrics;
    let peak = m.peak_memory_bytes;
    let body = html! {
        tr {
            th scope="row" { "peak memory of the process" }
            td { (peak.map_or("not known on this system".to_owned(), |bytes| DecimalBytes(bytes).to_string())) }
        }
        @for (part, size) in &m.learnable_bytes {
            tr { th scope="row" { "learnable: " (part.replace('_', " ")) } td { (DecimalBytes(*size)) } }
        }
    };
    table(&["what", "size"], body)
}

//! Which charts a run has.

use super::chart::{Chart, Level, Line, thinned};
use super::{Report, Sample};
use crate::config::Variant;

/// CSS class of a row's colour.
pub(super) fn row_class(row: Variant) -> &'static str {
    // `ours` alone marks a table row.
    if row == Variant::Ours {
        "row-ours"
    } else {
        row.key()
    }
}

fn line(name: &str, class: &str, samples: &[Sample]) -> Line {
    Line {
        name: name.into(),
        class: class.into(),
        points: thinned(samples).0,
    }
}

fn single(title: &str, y_title: &str, samples: &[Sample], decimals: usize) -> Chart {
    Chart {
        title: title.into(),
        y_title: y_title.into(),
        lines: vec![line("", "", samples)],
        levels: Vec::new(),
        log: false,
        decimals,
    }
}

/// A training loss; long ones are averaged, and the heading says over how many iterations.
fn loss(title: &str, class: &str, samples: &[Sample]) -> Chart {
    let (points, group) = thinned(samples);
    let span = match (samples.first(), samples.get(group)) {
        (Some(first), Some(next)) if group > 1 => {
            format!(" (means of {} iterations)", next.0 - first.0)
        }
        _ => String::new(),
    };
    Chart {
        title: format!("{title}{span}"),
        y_title: "loss".into(),
        lines: vec![Line {
            name: String::new(),
            class: class.into(),
            points,
        }],
        levels: Vec::new(),
        log: true,
        decimals: 4,
    }
}

/// Charts of the building stage.
pub(super) fn building(report: &Report<'_>) -> String {
    let b = &report.metrics.curves.building;
    let charts = [
        single("Held-out PSNR", "PSNR, dB", &b.psnr, 2),
        single("Held-out SSIM", "SSIM", &b.ssim, 3),
        loss("Training loss", "second", &b.loss),
        single("Gaussians", "Gaussians", &b.gaussians, 0),
    ];
    charts.iter().filter_map(Chart::figure).collect()
}

/// Charts of the segmentation stage: one of the held-out mIoU of all rows, one loss a row.
pub(super) fn segmentation(report: &Report<'_>) -> String {
    let rows = &report.metrics.curves.rows;
    let as_percent = |s: &[Sample]| s.iter().map(|&(i, v)| (i, 100.0 * v)).collect::<Vec<_>>();
    let untrained = |row: &Variant| !rows.iter().any(|r| r.row == *row);
    let scored = report
        .metrics
        .test
        .labels
        .iter()
        .filter(|(row, _)| untrained(row));
    let miou = Chart {
        title: "Held-out mIoU, pooled".into(),
        y_title: "mIoU, %".into(),
        lines: rows
            .iter()
            .map(|r| line(r.row.title(), row_class(r.row), &as_percent(&r.miou)))
            .collect(),
        levels: scored
            .filter_map(|(row, s)| {
                let value = 100.0 * s.miou?;
                Some(Level {
                    name: row.title().into(),
                    class: row_class(*row).into(),
                    value,
                })
            })
            .collect(),
        log: false,
        decimals: 1,
    };
    let losses = rows.iter().map(|r| {
        loss(
            &format!("Loss, {}", r.row.title()),
            row_class(r.row),
            &r.loss,
        )
    });
    std::iter::once(miou)
        .chain(losses)
        .filter_map(|chart| chart.figure())
        .collect()
}

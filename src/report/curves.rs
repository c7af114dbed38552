//! The charts of a run.

use super::chart::{Chart, Line, row_color, thinned};
use super::{Report, Sample};
use crate::config::Variant;
use maud::Markup;

/// Colours of charts with a single line.
const BLUE: [u8; 3] = row_color(Variant::Ours as usize);
const ORANGE: [u8; 3] = row_color(Variant::Vote as usize);

/// The colour of a row.
pub(super) fn color(row: Variant) -> [u8; 3] {
    row_color(row as usize)
}

/// A chart of one line.
fn single(title: String, color: [u8; 3], points: Vec<(f64, f64)>, decimals: usize) -> Chart {
    let line = Line {
        name: "",
        color,
        points,
    };
    Chart {
        title,
        lines: vec![line],
        log: false,
        decimals,
    }
}

/// A training loss. Long ones are averaged, and the title says over how many iterations.
fn loss(title: &str, color: [u8; 3], samples: &[Sample]) -> Chart {
    let (points, group) = thinned(samples);
    let span = match (samples.first(), samples.get(group)) {
        (Some(first), Some(next)) if group > 1 => {
            format!(" (means of {} iterations)", next.0 - first.0)
        }
        _ => String::new(),
    };
    Chart {
        log: true,
        ..single(format!("{title}{span}"), color, points, 4)
    }
}

/// Charts of stage one.
pub(super) fn building(report: &Report<'_>) -> Vec<Markup> {
    let b = &report.metrics.curves.building;
    let chart = |title: &str, samples, decimals| {
        single(title.to_owned(), BLUE, thinned(samples).0, decimals)
    };
    let charts = [
        chart("Held-out PSNR, dB", &b.psnr, 2),
        chart("Held-out SSIM", &b.ssim, 3),
        loss("Training loss", ORANGE, &b.loss),
        chart("Gaussians", &b.gaussians, 0),
    ];
    charts.iter().filter_map(Chart::figure).collect()
}

/// Charts of stage two: the held-out mIoU of all rows, and one loss per trained row.
pub(super) fn segmentation(report: &Report<'_>) -> Vec<Markup> {
    let rows = &report.metrics.curves.rows;
    let mut lines: Vec<Line> = rows
        .iter()
        .filter(|trained| !trained.miou.is_empty())
        .map(|trained| {
            let points = thinned(&trained.miou).0;
            Line {
                name: trained.variant.title(),
                color: color(trained.variant),
                points: points.into_iter().map(|(i, v)| (i, 100.0 * v)).collect(),
            }
        })
        .collect();
    for (row, scores) in &report.metrics.test.labels {
        let is_trained = rows.iter().any(|trained| trained.variant == *row);
        if let (false, Some(miou)) = (is_trained, scores.pixels.miou) {
            lines.push(Line {
                name: row.title(),
                color: color(*row),
                points: vec![(0.0, 100.0 * miou)],
            });
        }
    }
    let miou = Chart {
        title: "Held-out mIoU, pooled, %".into(),
        lines,
        log: false,
        decimals: 1,
    };
    let losses = rows.iter().map(|trained| {
        let title = format!("Loss, {}", trained.variant.title());
        loss(&title, color(trained.variant), &trained.loss)
    });
    std::iter::once(miou)
        .chain(losses)
        .filter_map(|chart| chart.figure())
        .collect()
}

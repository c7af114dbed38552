//! `report.html`: one page that needs nothing else.

use super::history::late_gain;
use super::markup::{bytes, duration, escape, percent, thousands};
use super::{Report, compactness, curves, objects_by_class, tables, views};
use crate::config::Variant;
use crate::error::Result;
use std::fmt::Write;
use std::path::Path;

/// The whole page.
pub(super) fn page(report: &Report<'_>, path: &Path) -> Result<String> {
    let m = &report.metrics;
    let title = escape(&m.scene);
    let mut out = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title} – coseg</title>\n\
         <style>\n{}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n",
        include_str!("page.css")
    );
    let _ = writeln!(out, "<p class=\"lead\">{}</p>", lead(report));
    if path.with_file_name("viewer.html").is_file() {
        out.push_str(
            "<p><a href=\"viewer.html\">Walk through the scene</a> in this browser.</p>\n",
        );
    }
    out.push_str(&tiles(report));
    if !m.test.labels.is_empty() {
        out.push_str("<h2>Labels</h2>\n<p class=\"quiet\">Scored on held-out views against the true labels; unlabelled truth is left out. \
            Every row but the raw labels is rendered from the Gaussian scene. The best of each column is bold.</p>\n");
        if let Some(origin) = report.config.data.raw_labels_origin() {
            let _ = writeln!(out, "<p class=\"quiet\">{}</p>", escape(&origin));
        }
        out.push_str(&tables::scores(report));
        out.push_str(&tables::instances(report));
        out.push_str(&objects_by_class::semantic(report));
        out.push_str(&compactness::compactness(report));
        out.push_str(&tables::class_iou(report));
    }
    out.push_str("<h2>Held-out views</h2>\n");
    out.push_str(&views::views(report, path)?);
    section(
        &mut out,
        "Building the Gaussians",
        &flattened(report),
        &curves::building(report),
    );
    section(
        &mut out,
        "Learning the labels",
        "",
        &curves::segmentation(report),
    );
    let _ = write!(
        out,
        "<h2>Time and memory</h2>\n<div class=\"two\"><div>{}</div><div>{}</div></div>\n",
        tables::times(report),
        tables::sizes(report)
    );
    out.push_str(&notes(report));
    let _ = write!(
        out,
        "<h2>How it was run</h2>\n{}<p class=\"quiet\">Seed {}.</p>\n\
         <details><summary>All settings (config.toml)</summary>\n<pre>{}</pre>\n</details>\n",
        commands(report),
        report.config.seed,
        escape(&report.config.to_toml()?),
    );
    let _ = writeln!(
        out,
        "<footer>coseg {}. The same figures, for programs: <code>metrics.json</code>.</footer>\n</main>\n</body>\n</html>",
        env!("CARGO_PKG_VERSION")
    );
    Ok(out)
}

/// What the run was, in a sentence.
fn lead(report: &Report<'_>) -> String {
    let m = &report.metrics;
    let views = match report.held_out {
        1 => "1 held-out view".to_owned(),
        n => format!("{n} held-out views"),
    };
    let labels = match report.classes.len() {
        0 => "no labels".to_owned(),
        n => format!("{n} classes"),
    };
    format!(
        "{} Gaussians, {labels}, {views}, preset {}.",
        thousands(m.gaussians as u64),
        preset(report)
    )
}

fn preset(report: &Report<'_>) -> &'static str {
    match report.config.preset {
        crate::config::Preset::Default => "default",
        crate::config::Preset::Paper => "paper",
        crate::config::Preset::Fast => "fast",
    }
}

fn tiles(report: &Report<'_>) -> String {
    let m = &report.metrics;
    let mut tiles: Vec<(String, &str, String)> = Vec::new();
    if let Some(psnr) = m.test.psnr {
        tiles.push((format!("{psnr:.2}"), "dB", "held-out PSNR".into()));
    }
    if let Some(ssim) = m.test.ssim {
        tiles.push((format!("{ssim:.3}"), "", "held-out SSIM".into()));
    }
    let labels = &m.test.labels;
    let miou = |row| labels.get(&row).and_then(|scores| scores.miou);
    if let Some(ours) = miou(Variant::Ours) {
        tiles.push((percent(ours), "%", "held-out mIoU, pooled".into()));
        for row in [Variant::Raw, Variant::Vote] {
            if let Some(other) = miou(row) {
                let gain = 100.0 * (ours - other);
                let against = if row == Variant::Raw {
                    "mIoU against the raw labels"
                } else {
                    "mIoU against the vote"
                };
                tiles.push((
                    format!("{gain:+.1}").replace('-', "−"),
                    "points",
                    against.into(),
                ));
            }
        }
    }
    tiles.push((duration(m.seconds.total), "", "total time".into()));
    if let Some(peak) = m.peak_memory_bytes {
        tiles.push((bytes(peak), "", "peak memory".into()));
    }
    let tiles: String = tiles
        .iter()
        .map(|(figure, unit, name)| {
            let unit = if unit.is_empty() {
                String::new()
            } else {
                format!(" <small>{unit}</small>")
            };
            format!("<div class=\"tile\"><b>{figure}{unit}</b><span>{name}</span></div>\n")
        })
        .collect();
    format!("<div class=\"tiles\">\n{tiles}</div>\n")
}

/// A section of charts; nothing without charts.
fn section(out: &mut String, title: &str, text: &str, charts: &str) {
    if !charts.is_empty() {
        let _ = write!(
            out,
            "<h2>{title}</h2>\n{text}<div class=\"charts\">\n{charts}</div>\n"
        );
    }
}

/// How much the held-out PSNR still moved at the end.
fn flattened(report: &Report<'_>) -> String {
    late_gain(&report.metrics.curves.building.psnr).map_or(String::new(), |gain| {
        let gain = format!("{gain:+.2}").replace('-', "−");
        format!("<p class=\"quiet\">Over the last fifth of the run the held-out PSNR changed by {gain} dB.</p>\n")
    })
}

/// The command lines of the run, with what each ran on.
fn commands(report: &Report<'_>) -> String {
    let one = |command: &super::Command| {
        format!(
            "<pre>{}</pre>\n<p class=\"quiet\">{}.</p>\n",
            escape(&command.line),
            escape(&command.device)
        )
    };
    report.metrics.commands.iter().map(one).collect()
}

fn notes(report: &Report<'_>) -> String {
    let m = &report.metrics;
    let mut notes = Vec::new();
    if !m.features.is_empty() {
        notes.push(format!("2D features: {}.", m.features));
    }
    if !m.spatial.is_empty() {
        notes.push(format!("Point encoder: {}.", m.spatial));
    }
    notes.extend(report.notes.iter().cloned());
    if notes.is_empty() {
        return String::new();
    }
    let items: String = notes
        .iter()
        .map(|n| format!("<li>{}</li>\n", escape(n)))
        .collect();
    format!("<h2>Notes</h2>\n<ul class=\"notes\">\n{items}</ul>\n")
}

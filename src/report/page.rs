//! `report.html`: one page that needs nothing else.

use super::units::{duration, percent, signed, thousands};
use super::{Report, VariantScores, curves, tables, views};
use crate::config::Variant;
use crate::error::Result;
use indicatif::DecimalBytes;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use std::path::Path;

/// The page loads and sends nothing, and runs no script.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'";

/// The whole page.
pub(super) fn page(report: &Report<'_>, path: &Path) -> Result<Markup> {
    let m = &report.metrics;
    let settings = report.config.to_toml()?;
    let pictures = views::views(report, path)?;
    let has_viewer = path.with_file_name("viewer.html").is_file();
    Ok(html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (m.scene) " – coseg" }
                style { (PreEscaped(include_str!("page.css"))) }
            }
            body {
                main {
                    h1 { (m.scene) }
                    p.lead { (lead(report)) }
                    @if has_viewer {
                        p { a href="viewer.html" { "Walk through the scene" } " in this browser." }
                    }
                    (tiles(report))
                    @if !m.test.labels.is_empty() { (labels(report)) }
                    h2 { "Held-out views" }
                    (pictures)
                    (charts("Building the Gaussians", &curves::building(report)))
                    (tables::reviews(report))
                    (charts("Learning the labels", &curves::segmentation(report)))
                    h2 { "Time and memory" }
                    div.two {
                        div { (tables::times(report)) }
                        div { (tables::sizes(report)) }
                    }
                    (notes(report))
                    h2 { "How it was run" }
                    @for command in &m.commands {
                        pre { (command.line) }
                        p.quiet { (command.device) "." }
                    }
                    p.quiet { "Seed " (report.config.seed) "." }
                    details {
                        summary { "All settings (config.toml)" }
                        pre { (settings) }
                    }
                    footer {
                        "coseg " (env!("CARGO_PKG_VERSION")) ". The same figures for programs: " code { "metrics.json" } "."
                    }
                }
            }
        }
    })
}

/// The run in a sentence.
fn lead(report: &Report<'_>) -> String {
    let views = match report.held_out {
        1 => "1 held-out view".to_owned(),
        n => format!("{n} held-out views"),
    };
    let labels = match report.classes.len() {
        0 => "no labels".to_owned(),
        n => format!("{n} classes"),
    };
    let preset = report.config.preset;
    let gaussians = thousands(report.metrics.gaussians as u64);
    format!("{gaussians} Gaussians, {labels}, {views}, preset {preset}.")
}

/// The main figures.
fn tiles(report: &Report<'_>) -> Markup {
    let m = &report.metrics;
    let tile = |figure: String, unit: &str, name: &str| {
        html! {
            div.tile {
                b { (figure) @if !unit.is_empty() { " " small { (unit) } } }
                span { (name) }
            }
        }
    };
    let miou = |row: Variant| m.test.labels.get(&row)?.pixels.miou;
    html! {
        div.tiles {
            @if let Some(psnr) = m.test.psnr { (tile(format!("{psnr:.2}"), "dB", "held-out PSNR")) }
            @if let Some(ssim) = m.test.ssim { (tile(format!("{ssim:.3}"), "", "held-out SSIM")) }
            @if let Some(ours) = miou(Variant::Ours) {
                (tile(percent(Some(ours)), "%", "held-out mIoU, pooled"))
                @if let Some(raw) = miou(Variant::Raw) {
                    (tile(signed(100.0 * (ours - raw)), "points", "mIoU against the raw labels"))
                }
                @if let Some(vote) = miou(Variant::Vote) {
                    (tile(signed(100.0 * (ours - vote)), "points", "mIoU against the vote"))
                }
            }
            (tile(duration(m.seconds.total), "", "total time"))
            @if let Some(peak) = m.peak_memory_bytes { (tile(DecimalBytes(peak).to_string(), "", "peak memory")) }
        }
    }
}

fn labels(report: &Report<'_>) -> Markup {
    let is_scored = |scores: &VariantScores| {
        scores.pixels.miou.is_some() || scores.instances.is_some() || scores.semantic.is_some()
    };
    html! {
        h2 { "Labels" }
        p.quiet {
            @if report.metrics.test.labels.values().any(is_scored) {
                "Scores on held-out views against the true labels, without pixels whose truth is unlabelled. Every row but the raw \
                 labels is rendered from the Gaussian scene. The best of each column is bold."
            } @else {
                "Not scored: no held-out view has true labels."
            }
        }
        @if let Some(origin) = report.config.data.raw_labels_origin() { p.quiet { (origin) } }
        (tables::scores(report))
        @for part in [
            tables::instances(report),
            tables::objects_by_class(report),
            tables::class_iou(report),
        ].into_iter().flatten() { (part) }
    }
}

/// A section of charts; nothing without charts.
fn charts(title: &str, charts: &[Markup]) -> Markup {
    html! {
        @if !charts.is_empty() {
            h2 { (title) }
            div.charts { @for chart in charts { (chart) } }
        }
    }
}

fn notes(report: &Report<'_>) -> Markup {
    let m = &report.metrics;
    let is_empty = m.features.is_empty() && m.spatial.is_empty() && report.notes.is_empty();
    html! {
        @if !is_empty {
            h2 { "Notes" }
            ul.notes {
                @if !m.features.is_empty() { li { "2D features: " (m.features) "." } }
                @if !m.spatial.is_empty() { li { "Point encoder: " (m.spatial) "." } }
                @for note in &report.notes { li { (note) } }
            }
        }
    }
}

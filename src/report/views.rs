//! Pictures of held-out views, side by side.

use super::markup::{escape, percent};
use super::pictures::{
    AGREEMENT, ERROR_FULL, UNLABELLED, accuracy, colored, from_floats, heat, label_error, png,
};
use super::{HeldOutView, Report};
use crate::config::Variant;
use crate::data::{LabelMap, LabelRuns};
use crate::error::Result;
use base64::Engine;
use image::RgbImage;
use std::fmt::Write;
use std::path::Path;

/// More views than this are only in `renders/`.
const SHOWN: usize = 6;
/// Views after these are folded away.
const OPEN: usize = 2;

/// The section's content: legend and, for up to [`SHOWN`] views spread over the split, all pictures.
pub(super) fn views(report: &Report<'_>, path: &Path) -> Result<String> {
    let mut out = String::new();
    let (all, kept) = (report.held_out, report.views.len());
    if kept == 0 {
        return Ok("<p class=\"quiet\">The scene has no held-out views.</p>\n".into());
    }
    let shown = kept.min(SHOWN);
    if shown < all {
        let _ = writeln!(
            out,
            "<p class=\"quiet\">{shown} of {all} held-out views, evenly spaced in file order; all are in <code>renders/</code>.</p>"
        );
    }
    if report
        .views
        .iter()
        .any(|v| !v.labels.is_empty() || v.view.truth.is_some())
    {
        out.push_str(&legend(report));
    }
    out.push_str(&scales(report));
    for (i, place) in shown_of(kept).enumerate() {
        if i == OPEN {
            let _ = writeln!(out, "<details><summary>{} more</summary>", shown - OPEN);
        }
        out.push_str(&one(report, &report.views[place], path)?);
    }
    if shown > OPEN {
        out.push_str("</details>\n");
    }
    Ok(out)
}

/// Which of `all` views the page shows: the middle of each of up to [`SHOWN`] equal parts.
pub(super) fn shown_of(all: usize) -> impl Iterator<Item = usize> {
    let shown = all.min(SHOWN);
    (0..shown).map(move |i| (2 * i + 1) * all / (2 * shown))
}

fn swatch([r, g, b]: [u8; 3]) -> String {
    format!("<span class=\"mark\" style=\"background:rgb({r} {g} {b})\"></span>")
}

fn legend(report: &Report<'_>) -> String {
    let mut items: String = report
        .classes
        .entries
        .iter()
        .map(|c| {
            format!(
                "<li>{}<i>{}</i>{}</li>",
                swatch(c.color),
                c.id,
                escape(&c.name)
            )
        })
        .collect();
    let _ = write!(
        items,
        "<li>{}<i>{}</i>unlabelled</li>",
        swatch(UNLABELLED),
        report.classes.ignore
    );
    format!("<ul class=\"legend\">{items}</ul>\n")
}

/// What the colours of the error maps mean.
fn scales(report: &Report<'_>) -> String {
    let stops: Vec<String> = (0..=8)
        .map(|i| heat(i as f32 / 8.0))
        .map(|[r, g, b]| format!("rgb({r} {g} {b})"))
        .collect();
    let mut text = format!(
        "<p class=\"quiet\">Colour error: mean |render − photo| over the channels, 0 \
         <span class=\"ramp\" style=\"background:linear-gradient(90deg,{})\"></span> {ERROR_FULL} or more.",
        stops.join(",")
    );
    if report.views.iter().any(|v| v.view.mask.is_some()) {
        let _ = write!(text, " {} left out by a mask.", swatch(AGREEMENT[2]));
    }
    if report.views.iter().any(|v| v.view.truth.is_some()) {
        let [right, wrong, void] = AGREEMENT.map(swatch);
        let _ = write!(
            text,
            " Label errors: {right}right &nbsp;{wrong}wrong &nbsp;{void}truth unlabelled."
        );
    }
    text + "</p>\n"
}

fn one(report: &Report<'_>, held_out: &HeldOutView<'_>, path: &Path) -> Result<String> {
    let view = held_out.view;
    let rgb = from_floats(&held_out.rgb, view.camera.width, view.camera.height)?;
    let mut out = format!(
        "<h3>{}</h3>\n<div class=\"pictures\">\n",
        escape(&view.name)
    );
    let psnr = held_out.scores.psnr.map(|v| format!("{v:.2} dB"));
    let ssim = held_out.scores.ssim.map(|v| format!("SSIM {v:.3}"));
    let figures = psnr.into_iter().chain(ssim).collect::<Vec<_>>().join(", ");
    let photo = view.image.pixels()?;
    out.push_str(&figure(&photo, "photo", "", false, path)?);
    out.push_str(&figure(&rgb, "render", &figures, false, path)?);
    out.push_str(&figure(
        &held_out.color_error(&rgb)?,
        "colour error",
        "",
        false,
        path,
    )?);
    let truth = view.truth.as_ref().map(LabelRuns::map);
    if let Some(truth) = &truth {
        out.push_str(&figure(
            &colored(truth, report.classes),
            "truth",
            "",
            true,
            path,
        )?);
    }
    let raw = view.raw.as_ref().map(LabelRuns::map);
    let raw = raw.iter().map(|labels| (Variant::Raw, labels));
    let rows: Vec<(Variant, &LabelMap)> = raw
        .chain(held_out.labels.iter().map(|(row, labels)| (*row, labels)))
        .collect();
    for (row, labels) in &rows {
        let share = truth
            .as_ref()
            .and_then(|truth| accuracy(labels, truth, report.classes.ignore));
        let note = share.map_or(String::new(), |share| format!("{} % right", percent(share)));
        out.push_str(&figure(
            &colored(labels, report.classes),
            row.title(),
            &note,
            true,
            path,
        )?);
    }
    if let Some(truth) = &truth {
        if rows.len() > 2 {
            // A line of their own, each below its labels.
            out.push_str("</div>\n<div class=\"pictures\" style=\"margin-top:12px\">\n");
        }
        for (row, labels) in rows {
            let map = label_error(labels, truth, report.classes.ignore);
            out.push_str(&figure(
                &map,
                &format!("errors: {}", row.title()),
                "",
                true,
                path,
            )?);
        }
    }
    out.push_str("</div>\n");
    Ok(out)
}

fn figure(
    image: &RgbImage,
    caption: &str,
    note: &str,
    labels: bool,
    path: &Path,
) -> Result<String> {
    let data = base64::engine::general_purpose::STANDARD.encode(png(image, path)?);
    let class = if labels { " class=\"labels\"" } else { "" };
    Ok(format!(
        "<figure><img{class} width=\"{}\" height=\"{}\" loading=\"lazy\" alt=\"{caption}\" \
         src=\"data:image/png;base64,{data}\"><figcaption>{caption} <span>{note}</span></figcaption></figure>\n",
        image.width(),
        image.height(),
    ))
}

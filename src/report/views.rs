//! Pictures of held-out views, side by side.

use super::chart::swatch;
use super::pictures::{
    AGREEMENT, ERROR_FULL, UNLABELLED_COLOR, accuracy, colored, from_floats, heat, label_error, png,
};
use super::units::percent;
use super::{HeldOutView, Report};
use crate::config::Variant;
use crate::data::LabelRuns;
use crate::error::Result;
use base64::Engine;
use image::RgbImage;
use maud::{Markup, html};
use std::path::Path;

/// More views than this are only in `renders/`.
const MAX_ON_PAGE: usize = 6;
/// Views after these are folded away.
const UNFOLDED: usize = 2;

/// The section's content: legend and, for up to [`MAX_ON_PAGE`] views spread over the split, all pictures.
pub(super) fn views(report: &Report<'_>, path: &Path) -> Result<Markup> {
    if report.views.is_empty() {
        return Ok(html! { p.quiet { "The scene has no held-out views." } });
    }
    let shown = shown_of(report.views.len())
        .map(|i| one(report, &report.views[i], path))
        .collect::<Result<Vec<_>>>()?;
    let (open, folded) = shown.split_at(shown.len().min(UNFOLDED));
    let has_labels = |v: &HeldOutView| !v.labels.is_empty() || v.view.truth.is_some();
    Ok(html! {
        p.quiet {
            @if shown.len() < report.held_out {
                (shown.len()) " of " (report.held_out) " held-out views, evenly spaced in file order. All are in "
                code { "renders/" } ". "
            }
            "Click a picture, or press the space bar on it, to enlarge it; again to shrink it."
        }
        @if report.views.iter().any(has_labels) { (legend(report)) }
        (scales(report))
        @for view in open { (view) }
        @if !folded.is_empty() {
            details {
                summary { (folded.len()) " more" }
                @for view in folded { (view) }
            }
        }
    })
}

/// Which of `all` views the page shows: the middle of each of up to [`MAX_ON_PAGE`] equal parts.
pub(super) fn shown_of(all: usize) -> impl Iterator<Item = usize> {
    let shown = all.min(MAX_ON_PAGE);
    (0..shown).map(move |i| (2 * i + 1) * all / (2 * shown))
}

fn legend(report: &Report<'_>) -> Markup {
    html! {
        ul.legend {
            @for class in &report.classes.entries {
                li { (swatch(class.color)) i { (class.id) } (class.name) }
            }
            li { (swatch(UNLABELLED_COLOR)) i { (report.classes.ignore) } "unlabelled" }
        }
    }
}

/// What the colours of the error maps mean.
fn scales(report: &Report<'_>) -> Markup {
    let stops: Vec<String> = (0..=8)
        .map(|i| heat(i as f32 / 8.0))
        .map(|[r, g, b]| format!("rgb({r} {g} {b})"))
        .collect();
    let [right, wrong, void] = AGREEMENT.map(swatch);
    html! {
        p.quiet {
            "Colour error: mean |render − photo| over the channels, 0 "
            span.ramp style={ "background:linear-gradient(90deg," (stops.join(",")) ")" } {}
            " " (ERROR_FULL) " or more."
            @if report.views.iter().any(|v| v.view.mask.is_some()) {
                " " (void) "left out by a mask."
            }
            @if report.views.iter().any(|v| v.view.truth.is_some()) {
                " Label errors: " (right) "right " (wrong) "wrong " (void) "truth unlabelled."
            }
        }
    }
}

fn one(report: &Report<'_>, held_out: &HeldOutView<'_>, path: &Path) -> Result<Markup> {
    let view = held_out.view;
    let classes = report.classes;
    let rgb = from_floats(&held_out.rgb, view.camera.width, view.camera.height)?;
    let psnr = held_out.scores.psnr.map(|v| format!("{v:.2} dB"));
    let ssim = held_out.scores.ssim.map(|v| format!("SSIM {v:.3}"));
    let scores = psnr.into_iter().chain(ssim).collect::<Vec<_>>().join(", ");
    let labels = |image: &RgbImage, caption: &str, note: &str| {
        figure(image, caption, note, Some("labels"), path)
    };
    let mut pictures = vec![
        figure(&*view.image.pixels()?, "photo", "", None, path)?,
        figure(&rgb, "render", &scores, None, path)?,
        figure(&held_out.color_error(&rgb)?, "colour error", "", None, path)?,
    ];
    let truth = view.truth.as_ref().map(LabelRuns::map);
    if let Some(truth) = &truth {
        pictures.push(labels(&colored(truth, classes), "truth", "")?);
    }
    let raw = view.raw.as_ref().map(LabelRuns::map);
    let raw = raw.iter().map(|map| (Variant::Raw, map));
    let rendered = held_out.labels.iter().map(|(row, map)| (*row, map));
    let mut errors = Vec::new();
    for (row, map) in raw.chain(rendered) {
        let truth = truth.as_ref();
        let share = truth.and_then(|truth| accuracy(map, truth, classes.ignore));
        let note = share.map(|share| format!("{} % right", percent(Some(share))));
        let note = note.unwrap_or_default();
        pictures.push(labels(&colored(map, classes), row.title(), &note)?);
        if let Some(truth) = truth {
            let caption = format!("errors: {}", row.title());
            let error = label_error(map, truth, classes.ignore);
            errors.push(labels(&error, &caption, "")?);
        }
    }
    Ok(html! {
        h3 { (view.name) }
        div.pictures { @for picture in pictures { (picture) } }
        // On lines of their own, each below its labels.
        @if !errors.is_empty() { div.pictures { @for picture in errors { (picture) } } }
    })
}

fn figure(
    image: &RgbImage,
    caption: &str,
    note: &str,
    class: Option<&str>,
    path: &Path,
) -> Result<Markup> {
    let data = base64::engine::general_purpose::STANDARD.encode(png(image, path)?);
    // A box that is ticked enlarges the picture behind it: the page has no script.
    Ok(html! {
        figure {
            label style={ "aspect-ratio:" (image.width()) "/" (image.height()) } {
                input type="checkbox" autocomplete="off" aria-label={ "enlarge " (caption) };
                img class=[class] width=(image.width()) height=(image.height()) loading="lazy" alt=(caption)
                    src={ "data:image/png;base64," (data) };
            }
            figcaption { (caption) " " span { (note) } }
        }
    })
}

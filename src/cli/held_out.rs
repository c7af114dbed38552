//! Held-out scores as lines of text.

use super::terminal;
use coseg::data::Classes;
use coseg::metrics::{ClassIou, PixelScores};
use coseg::pipeline::HeldOutScores;

/// Prints a line for each kind of score that is there. Each line starts with `what`.
pub fn print(scores: &HeldOutScores, what: &str) {
    let line = |kind: &str, figures: &[(&str, Option<f64>)]| {
        let figures: Vec<String> = figures
            .iter()
            .filter_map(|(name, value)| Some(format!("{name} {:.4}", (*value)?)))
            .collect();
        if !figures.is_empty() {
            terminal::say(&format!("{what}{kind}: {}", figures.join(", ")));
        }
    };
    let of_pixels = |p: &PixelScores| {
        [
            ("mIoU", p.miou),
            ("mIoU per view", p.miou_per_view),
            ("accuracy", p.accuracy),
        ]
    };
    line("", &of_pixels(&scores.labels.pixels));
    if let Some(s) = &scores.instances {
        let figures = [
            ("accuracy", s.accuracy),
            ("mIoU", s.miou),
            ("PQ", s.panoptic.pq),
            ("SQ", s.panoptic.sq),
            ("RQ", s.panoptic.rq),
        ];
        line("", &figures);
    }
    if let Some(s) = &scores.semantic {
        let quality = s.panoptic.unwrap_or_default();
        let panoptic = [
            ("PQ", quality.all.pq),
            ("PQ of things", quality.things.pq),
            ("PQ of stuff", quality.stuff.pq),
        ];
        let figures = [&of_pixels(&s.pixels)[..], &panoptic].concat();
        line(", by class", &figures);
    }
}

/// Prints the IoU of each class.
pub fn print_classes(scores: &HeldOutScores, classes: &Classes) {
    let of_labels = scores.labels.named(classes);
    let of_objects = scores.semantic.iter().flat_map(|s| &s.per_class);
    for ClassIou { id, name, iou } in of_labels.iter().chain(of_objects) {
        terminal::say(&format!("  {iou:.4}  IoU of {id} {name}"));
    }
}

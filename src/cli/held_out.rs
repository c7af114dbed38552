//! Held-out scores as lines of text.

use super::terminal;
use coseg::data::Classes;
use coseg::pipeline::HeldOutScores;

/// Prints a line for each kind of score that is there, with `what` at its front.
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
    let labels = &scores.labels.pixels;
    line(
        "",
        &[
            ("mIoU", labels.miou),
            ("mIoU per view", labels.miou_per_view),
            ("accuracy", labels.accuracy),
        ],
    );
    if let Some(s) = &scores.instances {
        line(
            "",
            &[
                ("accuracy", s.accuracy),
                ("mIoU", s.miou),
                ("PQ", s.panoptic.pq),
                ("SQ", s.panoptic.sq),
                ("RQ", s.panoptic.rq),
            ],
        );
    }
    if let Some(s) = &scores.semantic {
        let quality = s.panoptic.unwrap_or_default();
        line(
            ", by class",
            &[
                ("mIoU", s.pixels.miou),
                ("mIoU per view", s.pixels.miou_per_view),
                ("accuracy", s.pixels.accuracy),
                ("PQ", quality.all.pq),
                ("PQ of things", quality.things.pq),
                ("PQ of stuff", quality.stuff.pq),
            ],
        );
    }
}

/// Prints the IoU of each class.
pub fn print_classes(scores: &HeldOutScores, classes: &Classes) {
    let of_labels = scores.labels.per_class.iter();
    let of_labels = of_labels.map(|(id, iou)| (*iou, *id, classes.name(*id)));
    let of_objects = scores.semantic.iter().flat_map(|s| &s.per_class);
    let of_objects = of_objects.map(|class| (class.iou, class.id, class.name.as_str()));
    for (iou, id, name) in of_labels.chain(of_objects) {
        terminal::say(&format!("  {iou:.4}  IoU of {id} {name}"));
    }
}

//! Line charts as inline SVG: ticks, units, direct labels, no script. Colours are CSS classes of the page.

use super::markup::{escape, thousands};
use std::fmt::Write;

/// One line of a chart.
pub(super) struct Line {
    /// Label at the line's end.
    pub name: String,
    /// CSS class that gives the colour.
    pub class: String,
    /// (iteration, value), ascending.
    pub points: Vec<(f64, f64)>,
}

/// A horizontal reference, for rows that are not trained.
pub(super) struct Level {
    /// Label at its right end.
    pub name: String,
    /// CSS class that gives the colour.
    pub class: String,
    /// Its height.
    pub value: f64,
}

/// A line chart.
pub(super) struct Chart {
    /// Heading.
    pub title: String,
    /// Name and unit of the vertical axis.
    pub y_title: String,
    /// Lines.
    pub lines: Vec<Line>,
    /// Horizontal references.
    pub levels: Vec<Level>,
    /// Logarithmic vertical axis; needs values above zero.
    pub log: bool,
    /// Decimals of the labels at the line ends.
    pub decimals: usize,
}

const WIDTH: f64 = 460.0;
const HEIGHT: f64 = 270.0;
const LEFT: f64 = 64.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 44.0;
/// Lines with more points than this are averaged in groups.
const MOST_POINTS: usize = 160;
/// Lines with at most this many points have markers that tell their value.
const MARKED_POINTS: usize = 40;

/// Data to drawing coordinates along one axis.
struct Axis {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
    log: bool,
}

impl Axis {
    fn place(&self, value: f64) -> f64 {
        let (value, low, high) = if self.log {
            (value.log10(), self.low.log10(), self.high.log10())
        } else {
            (value, self.low, self.high)
        };
        self.from + (value - low) / (high - low) * (self.to - self.from)
    }

    fn ticks(&self) -> Vec<f64> {
        if self.log {
            let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
            let many = self.high / self.low > 200.0;
            let within = |t: &f64| *t >= self.low * 0.999 && *t <= self.high * 1.001;
            let steps: &[f64] = if many { &[1.0] } else { &[1.0, 2.0, 5.0] };
            return decades
                .flat_map(|d| steps.iter().map(move |s| s * 10_f64.powi(d)))
                .filter(within)
                .collect();
        }
        let step = nice_step((self.high - self.low) / 4.5);
        let first = (self.low / step).ceil() as i64;
        let last = (self.high / step + 1e-9).floor() as i64;
        (first..=last).map(|i| i as f64 * step).collect()
    }
}

/// 1, 2 or 5 times a power of ten, near `raw`.
fn nice_step(raw: f64) -> f64 {
    let power = 10_f64.powf(raw.log10().floor());
    let leading = raw / power;
    let nice = if leading < 1.5 {
        1.0
    } else if leading < 3.5 {
        2.0
    } else if leading < 7.5 {
        5.0
    } else {
        10.0
    };
    nice * power
}

/// A tick's text: as few digits as tell it from its neighbours.
fn tick_text(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude >= 10_000.0 {
        return format!("{}k", trim(format!("{:.1}", value / 1_000.0)));
    }
    if value >= 1_000.0 {
        return thousands(value.round() as u64);
    }
    if magnitude > 0.0 && magnitude < 1e-3 {
        return format!("{value:e}");
    }
    trim(format!("{value:.4}"))
}

fn trim(text: String) -> String {
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// `samples` averaged in equal groups, so that at most [`MOST_POINTS`] remain; also the group size.
pub(super) fn thinned(samples: &[(usize, f64)]) -> (Vec<(f64, f64)>, usize) {
    let finite: Vec<(f64, f64)> = samples
        .iter()
        .filter(|(_, v)| v.is_finite())
        .map(|&(iteration, v)| (iteration as f64, v))
        .collect();
    let group = finite.len().div_ceil(MOST_POINTS).max(1);
    let mean = |chunk: &[(f64, f64)]| {
        let n = chunk.len() as f64;
        (
            chunk.iter().map(|p| p.0).sum::<f64>() / n,
            chunk.iter().map(|p| p.1).sum::<f64>() / n,
        )
    };
    (finite.chunks(group).map(mean).collect(), group)
}

impl Chart {
    /// The chart as a `<figure>`; `None` when no line has two points.
    pub(super) fn figure(&self) -> Option<String> {
        let points = || self.lines.iter().flat_map(|l| l.points.iter().copied());
        if !self.lines.iter().any(|line| line.points.len() >= 2) {
            return None;
        }
        let log = self.log && points().all(|(_, v)| v > 0.0);
        let (mut low, mut high) = range(
            points()
                .map(|p| p.1)
                .chain(self.levels.iter().map(|l| l.value)),
        )?;
        let pad = if log {
            1.15
        } else {
            0.06 * (high - low).max(1e-9)
        };
        (low, high) = if log {
            (low / pad, high * pad)
        } else {
            (low - pad, high + pad)
        };
        let longest = self
            .end_labels()
            .iter()
            .map(|(_, _, text)| text.chars().count())
            .max()
            .unwrap_or(0);
        let right = 14.0 + 7.3 * longest as f64;
        let (first, last) = range(points().map(|p| p.0))?;
        let x = Axis {
            low: first.min(0.0),
            high: last,
            from: LEFT,
            to: WIDTH - right,
            log: false,
        };
        let y = Axis {
            low,
            high,
            from: HEIGHT - BOTTOM,
            to: TOP,
            log,
        };
        let mut svg = format!(
            "<figure class=\"chart\"><figcaption>{}</figcaption>\
             <svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">",
            escape(&self.title),
            escape(&self.summary()),
        );
        self.draw_axes(&mut svg, &x, &y);
        self.draw_lines(&mut svg, &x, &y);
        self.draw_end_labels(&mut svg, &x, &y);
        svg.push_str("</svg></figure>\n");
        Some(svg)
    }

    /// The chart in words, for those who do not see it.
    fn summary(&self) -> String {
        let ends: Vec<String> = self
            .end_labels()
            .into_iter()
            .map(|(_, _, text)| text)
            .collect();
        format!(
            "{}, {}, last values: {}",
            self.title,
            self.y_title,
            ends.join("; ")
        )
    }

    /// (height, class, text) of the labels at the right.
    fn end_labels(&self) -> Vec<(f64, &str, String)> {
        let text = |name: &str, value: f64| {
            let value = if self.decimals == 0 && value >= 1_000.0 {
                thousands(value as u64)
            } else {
                format!("{value:.*}", self.decimals)
            };
            if name.is_empty() {
                value
            } else {
                format!("{name} {value}")
            }
        };
        let lines = self.lines.iter().filter_map(|l| {
            l.points
                .last()
                .map(|p| (p.1, &*l.class, text(&l.name, p.1)))
        });
        lines
            .chain(
                self.levels
                    .iter()
                    .map(|l| (l.value, &*l.class, text(&l.name, l.value))),
            )
            .collect()
    }

    fn draw_axes(&self, svg: &mut String, x: &Axis, y: &Axis) {
        for tick in y.ticks() {
            let at = y.place(tick);
            let _ = write!(
                svg,
                "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{:.1}\" y1=\"{at:.1}\" y2=\"{at:.1}\"/>\
                 <text class=\"tick\" x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                x.to,
                LEFT - 7.0,
                at + 4.0,
                tick_text(tick),
            );
        }
        let floor = HEIGHT - BOTTOM;
        for tick in x.ticks() {
            let at = x.place(tick);
            let _ = write!(
                svg,
                "<line class=\"axis\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{floor}\" y2=\"{}\"/>\
                 <text class=\"tick\" x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                floor + 4.0,
                floor + 18.0,
                tick_text(tick),
            );
        }
        let (middle_x, middle_y) = ((x.from + x.to) / 2.0, (TOP + floor) / 2.0);
        let _ = write!(
            svg,
            "<line class=\"axis\" x1=\"{LEFT}\" x2=\"{:.1}\" y1=\"{floor}\" y2=\"{floor}\"/>\
             <text class=\"name\" x=\"{middle_x:.1}\" y=\"{}\" text-anchor=\"middle\">iteration</text>\
             <text class=\"name\" transform=\"translate(12 {middle_y:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            x.to,
            HEIGHT - 6.0,
            escape(&self.y_title),
        );
    }

    fn draw_lines(&self, svg: &mut String, x: &Axis, y: &Axis) {
        for level in &self.levels {
            let at = y.place(level.value);
            let _ = write!(
                svg,
                "<line class=\"level {}\" x1=\"{LEFT}\" x2=\"{:.1}\" y1=\"{at:.1}\" y2=\"{at:.1}\"/>",
                level.class, x.to
            );
        }
        for line in &self.lines {
            let path: Vec<String> = line
                .points
                .iter()
                .map(|p| format!("{:.1},{:.1}", x.place(p.0), y.place(p.1)))
                .collect();
            let _ = write!(
                svg,
                "<polyline class=\"line {}\" points=\"{}\"/>",
                line.class,
                path.join(" ")
            );
            if line.points.len() > MARKED_POINTS {
                continue;
            }
            for &(iteration, value) in &line.points {
                let _ = write!(
                    svg,
                    "<circle class=\"dot {}\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"2.6\">\
                     <title>{} at iteration {iteration:.0}: {value:.*}</title></circle>",
                    line.class,
                    x.place(iteration),
                    y.place(value),
                    escape(if line.name.is_empty() {
                        &self.title
                    } else {
                        &line.name
                    }),
                    self.decimals,
                );
            }
        }
    }

    /// Labels at the line ends, pushed apart until none overlap.
    fn draw_end_labels(&self, svg: &mut String, x: &Axis, y: &Axis) {
        const GAP: f64 = 13.5;
        let mut labels = self.end_labels();
        labels.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut heights: Vec<f64> = labels.iter().map(|l| y.place(l.0)).collect();
        for i in 1..heights.len() {
            heights[i] = heights[i].max(heights[i - 1] + GAP);
        }
        let overflow = heights
            .last()
            .map_or(0.0, |h| (h - (HEIGHT - BOTTOM)).max(0.0));
        if let Some(last) = heights.last_mut() {
            *last -= overflow;
        }
        for i in (1..heights.len()).rev() {
            heights[i - 1] = heights[i - 1].min(heights[i] - GAP);
        }
        for ((_, class, text), height) in labels.iter().zip(heights) {
            let at = (x.to + 7.0, height + 4.0);
            let text = escape(text);
            let _ = write!(
                svg,
                "<text class=\"end {class}\" x=\"{:.1}\" y=\"{:.1}\">{text}</text>",
                at.0, at.1
            );
        }
    }
}

/// Smallest and largest finite value; a little apart when they are equal.
fn range(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (low.min(v), high.max(v))
        });
    if low > high {
        return None;
    }
    Some(if high - low > 1e-12 * high.abs() {
        (low, high)
    } else {
        (
            low - 0.5 * low.abs().max(1e-3),
            high + 0.5 * high.abs().max(1e-3),
        )
    })
}

//! Line charts as inline SVG.

use super::units::thousands;
use maud::{Markup, PreEscaped, html};
use plotters::chart::MeshStyle;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use std::ops::Range;

/// A line of a chart.
pub(super) struct Line {
    /// Its name in the legend; empty in a chart of one line.
    pub name: &'static str,
    pub color: [u8; 3],
    /// (iteration, value), ascending. A single point is a level: a dashed line across the chart.
    pub points: Vec<(f64, f64)>,
}

/// A line chart over iterations.
pub(super) struct Chart {
    /// What is drawn, with its unit.
    pub title: String,
    pub lines: Vec<Line>,
    /// Logarithmic vertical axis, where all values are above zero.
    pub log: bool,
    /// Decimals of the last values in the legend.
    pub decimals: usize,
}

/// The grid of a chart.
type Mesh<'a, 'b, 's> = MeshStyle<'a, 'b, RangedCoordf64, RangedCoordf64, SVGBackend<'s>>;

/// The page shows charts at about half this size: plotters places points on whole units.
const SIZE: (u32, u32) = (960, 520);
pub(crate) const TEXT: RGBColor = RGBColor(118, 121, 130);
const GRID: RGBColor = RGBColor(226, 226, 221);
pub(crate) const FONT: &str = "sans-serif";
/// Ticks of an axis, about.
pub(crate) const TICKS: usize = 6;
/// Colours of the rows of a table, readable on light and on dark pages.
const PALETTE: [[u8; 3]; 11] = [
    [128, 131, 138],
    [194, 118, 26],
    [180, 148, 24],
    [138, 95, 199],
    [86, 122, 64],
    [176, 96, 176],
    [96, 110, 160],
    [47, 125, 225],
    [181, 81, 122],
    [111, 145, 48],
    [156, 106, 56],
];
/// A logarithmic axis spans this ratio or more.
const MIN_RATIO: f64 = 3.0;
/// Lines with more points than this are averaged in groups.
const MAX_POINTS: usize = 160;
/// Lines with at most this many points have markers.
const MARKED_POINTS: usize = 40;

/// The colour of a row by its number; in a label table that of its [`Variant`](crate::config::Variant).
pub(crate) const fn row_color(number: usize) -> [u8; 3] {
    PALETTE[number % PALETTE.len()]
}

/// `samples` averaged in equal groups, so that at most [`MAX_POINTS`] remain; also the group size. Non-finite values are
/// left out.
pub(super) fn thinned(samples: &[(usize, f64)]) -> (Vec<(f64, f64)>, usize) {
    let finite: Vec<(f64, f64)> = samples
        .iter()
        .filter(|(_, value)| value.is_finite())
        .map(|&(iteration, value)| (iteration as f64, value))
        .collect();
    let group = finite.len().div_ceil(MAX_POINTS).max(1);
    let mean = |chunk: &[(f64, f64)]| {
        let n = chunk.len() as f64;
        let (x, y) = chunk
            .iter()
            .fold((0.0, 0.0), |sum, p| (sum.0 + p.0, sum.1 + p.1));
        (x / n, y / n)
    };
    (finite.chunks(group).map(mean).collect(), group)
}

impl Chart {
    /// The chart with its title and legend; nothing when no line has two points.
    pub(super) fn figure(&self) -> Option<Markup> {
        let svg = self.svg()?;
        let last = |line: &Line| self.value(line.points.last().map_or(0.0, |point| point.1));
        let is_single = self.lines.len() == 1;
        Some(html! {
            figure.chart {
                figcaption {
                    (self.title)
                    @if is_single { " " span.quiet { "last " (last(&self.lines[0])) } }
                }
                (svg)
                @if !is_single {
                    ul.legend {
                        @for line in &self.lines {
                            li { (swatch(line.color)) (line.name) " " i { (last(line)) } }
                        }
                    }
                }
            }
        })
    }

    fn value(&self, value: f64) -> String {
        if self.decimals == 0 && value >= 0.0 {
            thousands(value.round() as u64)
        } else {
            format!("{value:.*}", self.decimals)
        }
    }

    fn svg(&self) -> Option<Markup> {
        let points = || self.lines.iter().flat_map(|line| line.points.iter());
        if self.lines.iter().all(|line| line.points.len() < 2) {
            return None;
        }
        let values = points().map(|point| point.1);
        let low = values.clone().fold(f64::INFINITY, f64::min);
        let high = values.fold(0.0, f64::max);
        // Two digits tell the ticks of a logarithmic axis apart only over a wide range.
        let log = self.log && low > 0.0 && high > MIN_RATIO * low;
        let place = |value: f64| if log { value.log10() } else { value };
        let y = around(points().map(|point| place(point.1)));
        let end = points().fold(1.0, |end: f64, point| end.max(point.0));
        let mut out = String::new();
        let drawn = || -> Result<(), Box<dyn std::error::Error + '_>> {
            let area = SVGBackend::with_string(&mut out, SIZE).into_drawing_area();
            let mut chart = ChartBuilder::on(&area)
                .margin(8)
                .margin_right(28)
                .x_label_area_size(64)
                .y_label_area_size(92)
                .build_cartesian_2d(0.0..end, y)?;
            styled(&mut chart.configure_mesh(), 2, 24)
                .disable_x_mesh()
                .x_desc("iteration")
                .y_labels(TICKS)
                .y_label_formatter(&|y| if log { tick(two_digits(*y)) } else { tick(*y) })
                .draw()?;
            for line in &self.lines {
                let [r, g, b] = line.color;
                let style = RGBColor(r, g, b).stroke_width(4);
                let points = line.points.iter().map(|&(x, value)| (x, place(value)));
                if let [(_, level)] = line.points[..] {
                    let across = [(0.0, place(level)), (end, place(level))];
                    chart.draw_series(DashedLineSeries::new(across, 10, 8, style))?;
                    continue;
                }
                chart.draw_series(LineSeries::new(points.clone(), style))?;
                if line.points.len() <= MARKED_POINTS {
                    let marks = points.map(|point| Circle::new(point, 5, style.filled()));
                    chart.draw_series(marks)?;
                }
            }
            area.present()?;
            Ok(())
        };
        drawn().ok()?;
        // HTML needs no namespace, and the page promises to name no other address.
        Some(PreEscaped(
            out.replace(" xmlns=\"http://www.w3.org/2000/svg\"", ""),
        ))
    }
}

/// `mesh` in the style of all charts, with lines and text of these sizes, and ticks of the horizontal axis.
pub(crate) fn styled<'m, 'a, 'b, 's>(
    mesh: &'m mut Mesh<'a, 'b, 's>,
    line: u32,
    text: u32,
) -> &'m mut Mesh<'a, 'b, 's> {
    let font = (FONT, text).into_font().color(&TEXT);
    mesh.bold_line_style(GRID.stroke_width(line))
        .light_line_style(TRANSPARENT)
        .axis_style(TEXT.stroke_width(line))
        .label_style(font.clone())
        .axis_desc_style(font)
        .x_labels(TICKS)
        .x_label_formatter(&|x| tick(*x))
}

/// A small square of a colour.
pub(super) fn swatch([r, g, b]: [u8; 3]) -> Markup {
    html! { span.mark style={ "background:rgb(" (r) " " (g) " " (b) ")" } {} }
}

/// The range that shows all of `values`, with a margin.
pub(crate) fn around(values: impl Iterator<Item = f64>) -> Range<f64> {
    let none = (f64::INFINITY, f64::NEG_INFINITY);
    let (mut low, mut high) = values.fold(none, |(low, high), v| (low.min(v), high.max(v)));
    if high - low <= 1e-9 * high.abs() {
        let apart = 0.5 * high.abs().max(1e-3);
        low -= apart;
        high += apart;
    }
    let margin = 0.06 * (high - low);
    low - margin..high + margin
}

/// The value at `log10`, which a logarithmic axis names by two digits.
fn two_digits(log10: f64) -> f64 {
    let unit = 10_f64.powf(log10.floor() - 1.0);
    (10_f64.powf(log10) / unit).round() * unit
}

/// A tick's text, with as few digits as tell it from its neighbours.
pub(crate) fn tick(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude >= 1_000.0 {
        let text = thousands(magnitude.round() as u64);
        return if value < 0.0 {
            format!("−{text}")
        } else {
            text
        };
    }
    if magnitude > 1e-12 && magnitude < 1e-3 {
        return format!("{value:.0e}");
    }
    let text = format!("{value:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    text.replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_short() {
        let texts = [0.0, 0.25, -3.0, 12_000.0, 1e-6].map(tick);
        assert_eq!(texts, ["0", "0.25", "−3", "12,000", "1e-6"]);
    }

    #[test]
    fn logarithmic_ticks_have_two_digits() {
        let texts = [-1.5, -0.8, 0.0, 1.2, -4.0].map(|log10| tick(two_digits(log10)));
        assert_eq!(texts, ["0.032", "0.16", "1", "16", "1e-4"]);
    }
}

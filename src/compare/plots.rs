//! Plots of a table, as SVG files.

use super::Statistic;
use crate::report::chart::{GRID, TEXT, around, tick};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::collections::BTreeSet;

/// Pixels.
const PLOT: (u32, u32) = (720, 560);
const LEGEND_WIDTH: u32 = 300;
const LINE: i32 = 26;
const FONT: &str = "sans-serif";

/// Colours of rows, in turn.
const COLORS: [RGBColor; 10] = [
    RGBColor(47, 125, 225),
    RGBColor(194, 118, 26),
    RGBColor(138, 95, 199),
    RGBColor(27, 145, 168),
    RGBColor(181, 81, 122),
    RGBColor(111, 145, 48),
    RGBColor(156, 106, 56),
    RGBColor(207, 76, 63),
    RGBColor(128, 131, 138),
    RGBColor(180, 148, 24),
];

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = Result<(), Box<dyn std::error::Error>>;

fn color(row: usize) -> RGBColor {
    COLORS[row % COLORS.len()]
}

/// mIoU of rows against a cost.
pub(super) struct Points {
    pub title: String,
    pub x_title: &'static str,
    pub points: Vec<Point>,
}

/// A row.
pub(super) struct Point {
    name: String,
    /// Absent where the row has no such cost, or no score.
    place: Option<[f64; 2]>,
    spread: f64,
}

impl Points {
    /// Adds a row at `x` with the score `miou`, called `name` in the legend.
    pub fn add(&mut self, name: String, x: Option<f64>, miou: Option<Statistic>) {
        self.points.push(Point {
            name,
            place: x.zip(miou).map(|(x, miou)| [x, 100.0 * miou.mean]),
            spread: 100.0 * miou.and_then(|miou| miou.spread).unwrap_or(0.0),
        });
    }

    /// The plot, which `command` makes; `None` without a point.
    pub fn svg(&self, command: &str) -> Option<String> {
        let places: Vec<[f64; 2]> = self.points.iter().filter_map(|point| point.place).collect();
        if places.is_empty() {
            return None;
        }
        let right = places
            .iter()
            .fold(0.0, |right: f64, place| right.max(place[0]));
        let ends = self.points.iter().filter_map(|point| {
            let [_, y] = point.place?;
            Some([y - point.spread, y + point.spread])
        });
        let y = around(ends.flatten());
        let x = 0.0..1.12 * right.max(1e-9);
        let height = PLOT.1.max(self.points.len() as u32 * LINE as u32 + 80);
        drawing(
            (PLOT.0 + LEGEND_WIDTH, height),
            &self.title,
            command,
            |area| {
                let (left, legend) = area.split_horizontally(PLOT.0);
                let mut chart = ChartBuilder::on(&left)
                    .margin(12)
                    .x_label_area_size(56)
                    .y_label_area_size(64)
                    .build_cartesian_2d(x.clone(), y.clone())?;
                let font = (FONT, 18).into_font().color(&TEXT);
                chart
                    .configure_mesh()
                    .bold_line_style(GRID.stroke_width(1))
                    .light_line_style(TRANSPARENT)
                    .axis_style(TEXT.stroke_width(1))
                    .label_style(font.clone())
                    .axis_desc_style(font)
                    .x_desc(self.x_title)
                    .x_labels(6)
                    .y_labels(6)
                    .x_label_formatter(&|x| tick(*x))
                    .y_label_formatter(&|y| tick(*y))
                    .draw()?;
                for (row, point) in self.points.iter().enumerate() {
                    let Some([x, y]) = point.place else { continue };
                    let ends = [(x, y - point.spread), (x, y + point.spread)];
                    chart.draw_series([PathElement::new(ends, color(row).stroke_width(2))])?;
                    chart.draw_series([Circle::new((x, y), 6, color(row).filled())])?;
                    let number = (FONT, 17).into_font().color(&color(row));
                    let [x, y] = within(area, chart.backend_coord(&(x, y)));
                    area.draw_text(&(row + 1).to_string(), &number, (x + 9, y - 20))?;
                }
                let names = self.points.iter().map(|point| point.name.clone());
                draw_legend(&legend, names)
            },
        )
    }
}

/// IoU of each class in each row.
pub(super) struct Bars {
    title: String,
    classes: BTreeSet<(u16, String)>,
    /// Name, and IoU by class id.
    rows: Vec<(String, Vec<(u16, f64)>)>,
}

impl Bars {
    /// No rows yet.
    pub fn new(title: String) -> Self {
        Self {
            title,
            classes: BTreeSet::new(),
            rows: Vec::new(),
        }
    }

    /// Adds a row with the IoU, 0 to 1, of classes by id and name.
    pub fn add<'a>(&mut self, name: &str, classes: impl Iterator<Item = ((u16, &'a str), f64)>) {
        let mut values = Vec::new();
        for ((id, class), iou) in classes {
            self.classes.insert((id, class.to_owned()));
            values.push((id, 100.0 * iou));
        }
        self.rows.push((name.to_owned(), values));
    }

    /// The plot, which `command` makes; `None` without a class.
    pub fn svg(&self, command: &str) -> Option<String> {
        let classes = self.classes.len();
        let rows = self.rows.len();
        if classes == 0 {
            return None;
        }
        let height = (classes * (9 * rows + 10) + 80).max(rows * LINE as usize + 80);
        drawing(
            (PLOT.0 + LEGEND_WIDTH, height as u32),
            &self.title,
            command,
            |area| {
                let (left, legend) = area.split_horizontally(PLOT.0);
                // Classes stand at whole numbers, the first one on top.
                let mut chart = ChartBuilder::on(&left)
                    .margin(12)
                    .margin_right(20)
                    .x_label_area_size(30)
                    .y_label_area_size(150)
                    .build_cartesian_2d(0.0..100.0, classes as f64..0.0)?;
                let font = (FONT, 16).into_font().color(&TEXT);
                chart
                    .configure_mesh()
                    .disable_y_mesh()
                    .bold_line_style(GRID.stroke_width(1))
                    .light_line_style(TRANSPARENT)
                    .axis_style(TEXT.stroke_width(1))
                    .label_style(font.clone())
                    .x_labels(6)
                    .y_labels(0)
                    .x_label_formatter(&|x| tick(*x))
                    .draw()?;
                let thickness = 0.84 / rows as f64;
                let beside = font.pos(Pos::new(HPos::Right, VPos::Center));
                for (c, (id, class)) in self.classes.iter().enumerate() {
                    for (row, (_, values)) in self.rows.iter().enumerate() {
                        let Some((_, iou)) = values.iter().find(|(of, _)| of == id) else {
                            continue;
                        };
                        let top = c as f64 + 0.08 + row as f64 * thickness;
                        let corners = [(0.0, top), (*iou, top + thickness)];
                        chart.draw_series([Rectangle::new(corners, color(row).filled())])?;
                    }
                    let [x, y] = within(area, chart.backend_coord(&(0.0, c as f64 + 0.5)));
                    area.draw_text(class, &beside, (x - 8, y))?;
                }
                draw_legend(&legend, self.rows.iter().map(|(name, _)| name.clone()))
            },
        )
    }
}

/// A pixel of the drawing as one of `area`, a part of it.
fn within(area: &Area<'_>, (x, y): (i32, i32)) -> [i32; 2] {
    let (left, top) = area.get_base_pixel();
    [x - left, y - top]
}

/// Numbered names with their colours.
fn draw_legend(area: &Area<'_>, names: impl Iterator<Item = String>) -> Drawn {
    for (row, name) in names.enumerate() {
        let y = 20 + LINE * row as i32;
        area.draw(&Rectangle::new([(4, y), (16, y + 12)], color(row).filled()))?;
        let font = (FONT, 17).into_font().color(&TEXT);
        area.draw_text(&format!("{}  {name}", row + 1), &font, (26, y - 4))?;
    }
    Ok(())
}

/// An SVG of `size` with a heading, and with the command that makes it as its description. `None` where plotters fails.
fn drawing(
    size: (u32, u32),
    title: &str,
    command: &str,
    draw: impl FnOnce(&Area<'_>) -> Drawn,
) -> Option<String> {
    let mut out = String::new();
    let drawn = || -> Drawn {
        let area = SVGBackend::with_string(&mut out, size).into_drawing_area();
        area.fill(&WHITE)?;
        let inner = area.titled(title, (FONT, 20).into_font().color(&BLACK))?;
        draw(&inner)?;
        area.present()?;
        Ok(())
    };
    drawn().ok()?;
    let start = out.find('>').map_or(0, |end| end + 1);
    let described = maud::html! { desc { (command) } };
    out.insert_str(start, &described.into_string());
    Some(out)
}

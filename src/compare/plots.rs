//! Plots of a table, as SVG files.

use crate::report::chart::{FONT, TEXT, TICKS, around, row_color, styled, tick};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::collections::{BTreeMap, BTreeSet};

/// Pixels.
const PLOT: (u32, u32) = (720, 560);
const LEGEND_WIDTH: u32 = 300;
const LINE: i32 = 26;

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = Result<(), Box<dyn std::error::Error>>;

fn color(row: usize) -> RGBColor {
    let [r, g, b] = row_color(row);
    RGBColor(r, g, b)
}

/// A row: its name in the legend, its position, and the spread of its score. A row without such a cost or without a score has no
/// position.
pub(super) type Point = (String, Option<[f64; 2]>, f64);

/// mIoU of rows against the cost `x_title`, by `command`; `None` without a point.
pub(super) fn points(title: &str, x_title: &str, rows: &[Point], command: &str) -> Option<String> {
    let places = || {
        rows.iter()
            .filter_map(|(_, place, spread)| Some((place.as_ref()?, spread)))
    };
    let right = places().map(|([x, _], _)| *x).reduce(f64::max)?;
    let y = around(places().flat_map(|([_, y], spread)| [y - spread, y + spread]));
    let x = 0.0..1.12 * right.max(1e-9);
    let height = PLOT.1.max(rows.len() as u32 * LINE as u32 + 80);
    drawing(height, title, command, |area| {
        let (left, legend) = area.split_horizontally(PLOT.0);
        let mut chart = ChartBuilder::on(&left)
            .margin(12)
            .x_label_area_size(56)
            .y_label_area_size(64)
            .build_cartesian_2d(x, y)?;
        styled(&mut chart.configure_mesh(), 1, 18)
            .x_desc(x_title)
            .y_labels(TICKS)
            .y_label_formatter(&|y| tick(*y))
            .draw()?;
        for (row, (_, place, spread)) in rows.iter().enumerate() {
            let Some([x, y]) = *place else { continue };
            let ends = [(x, y - spread), (x, y + spread)];
            chart.draw_series([PathElement::new(ends, color(row).stroke_width(2))])?;
            chart.draw_series([Circle::new((x, y), 6, color(row).filled())])?;
            let number = (FONT, 17).into_font().color(&color(row));
            let [x, y] = within(area, chart.backend_coord(&(x, y)));
            area.draw_text(&(row + 1).to_string(), &number, (x + 9, y - 20))?;
        }
        draw_legend(&legend, rows.iter().map(|(name, ..)| name))
    })
}

/// A row: its name, and its IoU by class id and name.
pub(super) type ClassRow<'a> = (String, BTreeMap<(u16, &'a str), f64>);

/// IoU of each class in each row, by `command`; `None` without a class.
pub(super) fn bars(title: &str, rows: &[ClassRow<'_>], command: &str) -> Option<String> {
    let classes: BTreeSet<_> = rows.iter().flat_map(|(_, iou)| iou.keys()).collect();
    if classes.is_empty() {
        return None;
    }
    let height = (classes.len() * (9 * rows.len() + 10) + 80).max(rows.len() * LINE as usize + 80);
    drawing(height as u32, title, command, |area| {
        let (left, legend) = area.split_horizontally(PLOT.0);
        // Classes stand at whole numbers, the first one on top.
        let mut chart = ChartBuilder::on(&left)
            .margin(12)
            .margin_right(20)
            .x_label_area_size(30)
            .y_label_area_size(150)
            .build_cartesian_2d(0.0..100.0, classes.len() as f64..0.0)?;
        styled(&mut chart.configure_mesh(), 1, 16)
            .disable_y_mesh()
            .y_labels(0)
            .draw()?;
        let thickness = 0.84 / rows.len() as f64;
        let font = (FONT, 16).into_font().color(&TEXT);
        let beside = font.pos(Pos::new(HPos::Right, VPos::Center));
        for (c, class) in classes.into_iter().enumerate() {
            for (row, (_, iou)) in rows.iter().enumerate() {
                let Some(iou) = iou.get(class) else { continue };
                let top = c as f64 + 0.08 + row as f64 * thickness;
                let corners = [(0.0, top), (100.0 * iou, top + thickness)];
                chart.draw_series([Rectangle::new(corners, color(row).filled())])?;
            }
            let [x, y] = within(area, chart.backend_coord(&(0.0, c as f64 + 0.5)));
            area.draw_text(class.1, &beside, (x - 8, y))?;
        }
        draw_legend(&legend, rows.iter().map(|(name, _)| name))
    })
}

/// A pixel of the drawing as one of `area`, a part of it.
fn within(area: &Area<'_>, (x, y): (i32, i32)) -> [i32; 2] {
    let (left, top) = area.get_base_pixel();
    [x - left, y - top]
}

/// Numbered names with their colours.
fn draw_legend<'a>(area: &Area<'_>, names: impl Iterator<Item = &'a String>) -> Drawn {
    for (row, name) in names.enumerate() {
        let y = 20 + LINE * row as i32;
        area.draw(&Rectangle::new([(4, y), (16, y + 12)], color(row).filled()))?;
        let font = (FONT, 17).into_font().color(&TEXT);
        area.draw_text(&format!("{}  {name}", row + 1), &font, (26, y - 4))?;
    }
    Ok(())
}

/// An SVG of this height with a heading, and with the command that makes it as its description. `None` where plotters fails.
fn drawing(
    height: u32,
    title: &str,
    command: &str,
    draw: impl FnOnce(&Area<'_>) -> Drawn,
) -> Option<String> {
    let mut out = String::new();
    let drawn = || -> Drawn {
        let size = (PLOT.0 + LEGEND_WIDTH, height);
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

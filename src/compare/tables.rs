//! Means and spreads of the cells of a plan, as JSON, Markdown and plots.

use super::columns::{COLUMNS, Column, FIELD_COLUMNS, FRAMES, MIOU, SECONDS};
use super::plots::{ClassRow, Point, bars, points};
use super::{Cell, CellId, Plan, Statistic, TableRow};
use crate::error::Result;
use crate::files::atomic;
use crate::metrics::mean;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The tables of a plan.
pub struct Tables<'a> {
    plan: &'a Plan,
    command: &'a str,
    cells: BTreeMap<Key<'a>, &'a Cell>,
}

/// Scene, labels, row and seed of a cell.
type Key<'a> = (&'a str, &'a str, &'a str, u64);

fn key(id: &CellId) -> Key<'_> {
    (&id.scene, &id.labels, &id.row, id.seed)
}

impl<'a> Tables<'a> {
    /// Files that [`Tables::write`] always writes.
    pub const FILES: [&'static str; 2] = ["table.md", "compare.json"];

    /// The tables of the finished `cells` of `plan`, for files that `command` writes.
    pub fn new(plan: &'a Plan, cells: &'a [Cell], command: &'a str) -> Self {
        Self {
            plan,
            command,
            cells: cells.iter().map(|cell| (key(&cell.id), cell)).collect(),
        }
    }

    /// Writes `compare.json`, `table.md` and the plots into `out`; returns their paths.
    ///
    /// # Errors
    /// [`crate::Error::Io`] naming the file.
    pub fn write(&self, out: &Path) -> Result<Vec<PathBuf>> {
        let mut files = Self::FILES.map(|name| out.join(name)).to_vec();
        atomic::write_bytes(&files[0], self.markdown().as_bytes())?;
        atomic::write_json(&files[1], &self.json())?;
        for (name, svg) in self.plots() {
            let path = out.join(name);
            atomic::write_bytes(&path, svg.as_bytes())?;
            files.push(path);
        }
        Ok(files)
    }

    /// The mean of a column over `scenes`; `None` where no cell has it.
    fn statistic(
        &self,
        labels: &str,
        row: &str,
        scenes: &[&str],
        column: &Column,
    ) -> Option<Statistic> {
        let value =
            |scene: &str, seed| (column.of)(&self.cells.get(&(scene, labels, row, seed))?.figures);
        let of_scene = |scene: &&str| {
            (0..self.plan.seeds)
                .map(|seed| value(scene, seed))
                .collect()
        };
        Statistic::of(&scenes.iter().map(of_scene).collect::<Vec<_>>())
    }

    fn scenes(&self) -> Vec<&'a str> {
        self.plan.scenes.iter().map(|scene| &*scene.name).collect()
    }

    /// Finished cells of a line on `scenes`.
    fn finished(&self, labels: &str, row: &str, scenes: &[&str]) -> usize {
        let is_one = |(scene, kind, line, _): &&Key<'_>| {
            *kind == labels && *line == row && scenes.contains(scene)
        };
        self.cells.keys().filter(is_one).count()
    }

    /// The columns. Columns of feature fields are there only where a cell has such scores.
    fn columns(&self) -> Vec<&'static Column> {
        let has_field = self.cells.values().any(|cell| cell.figures.field.is_some());
        let of_fields = FIELD_COLUMNS.iter().filter(|_| has_field);
        COLUMNS.iter().chain(of_fields).collect()
    }

    fn commits(&self) -> BTreeMap<&'a str, usize> {
        let mut commits = BTreeMap::new();
        for cell in self.cells.values() {
            *commits.entry(&*cell.commit).or_default() += 1;
        }
        commits
    }

    fn json(&self) -> serde_json::Value {
        let scenes = self.scenes();
        let mut lines = Vec::new();
        for labels in &self.plan.labels {
            for row in &self.plan.rows {
                let of = |scenes: &[&str], column| {
                    self.statistic(&labels.name, &row.name, scenes, column)
                };
                let columns = self.columns().into_iter();
                let figures = columns.map(|column| (column.key, of(&scenes, column)));
                let miou = scenes.iter().map(|scene| (*scene, of(&[scene], &MIOU)));
                lines.push(serde_json::json!({
                    "labels": labels.name,
                    "row": row.name,
                    "figures": figures.collect::<BTreeMap<_, _>>(),
                    "miou": miou.collect::<BTreeMap<_, _>>(),
                }));
            }
        }
        let all = self.plan.cells();
        let is_empty = |id: &&CellId| !self.cells.contains_key(&key(id));
        let empty = all.iter().filter(is_empty).map(ToString::to_string);
        serde_json::json!({
            "title": self.plan.title,
            "plan": self.plan.path,
            "command": self.command,
            "commits": self.commits(),
            "empty": empty.collect::<Vec<_>>(),
            "lines": lines,
            "published": self.plan.published,
            "cells": self.cells.values().collect::<Vec<_>>(),
        })
    }

    /// `table.md`.
    pub fn markdown(&self) -> String {
        let scenes = self.scenes();
        let mut text = format!("# {}\n", self.plan.title);
        for labels in &self.plan.labels {
            text += &format!("\n## Labels: {}\n\n", labels.name);
            let columns = self.columns().into_iter();
            let columns = columns.map(|column| (column.title, &scenes[..], column));
            let columns: Vec<_> = columns.collect();
            text += &self.table(&labels.name, &columns);
            if scenes.len() > 1 {
                text += "\nmIoU by scene, %:\n\n";
                let columns: Vec<_> = scenes
                    .iter()
                    .map(|scene| (*scene, std::slice::from_ref(scene), &MIOU))
                    .collect();
                text += &self.table(&labels.name, &columns);
            }
        }
        text + &self.footer() + &self.published()
    }

    /// A table of rows by `columns`, with a heading, the scenes that its cells are means over, and an explanation of the columns.
    fn table(&self, labels: &str, columns: &[(&str, &[&str], &Column)]) -> String {
        let rows = &self.plan.rows;
        let found: Vec<Vec<Option<Statistic>>> = columns
            .iter()
            .map(|(_, scenes, column)| {
                let rows = rows.iter();
                rows.map(|row| self.statistic(labels, &row.name, scenes, column))
                    .collect()
            })
            .collect();
        let headings: Vec<&str> = columns.iter().map(|(heading, ..)| *heading).collect();
        let mut text = format!(
            "| | {} |\n|---|{}\n",
            headings.join(" | "),
            "---:|".repeat(columns.len())
        );
        for (r, row) in rows.iter().enumerate() {
            text += &format!("| {}", row.name);
            for ((_, scenes, column), found) in columns.iter().zip(&found) {
                let finished = self.finished(labels, &row.name, scenes);
                let all = scenes.len() * self.plan.seeds as usize;
                let shown = match &found[r] {
                    _ if finished == 0 => "empty".to_owned(),
                    None => "–".to_owned(),
                    Some(statistic) => {
                        let shown = column.shown(statistic);
                        if statistic.cells < all {
                            format!("{shown} ({} of {all})", statistic.cells)
                        } else if column.best(found, all) == Some(r) {
                            format!("**{shown}**")
                        } else {
                            shown
                        }
                    }
                };
                text += &format!(" | {shown}");
            }
            text += " |\n";
        }
        text
    }

    fn footer(&self) -> String {
        let seeds = self.plan.seeds;
        let all = self.plan.cells().len();
        let spread = if seeds > 1 {
            format!(
                "± is the standard deviation over the {seeds} seeds of stage two (of the mean over scenes). Bold: ahead of the \
                 next row by more than the larger ± of the two."
            )
        } else {
            "There is one seed, so no spread is known and nothing is bold.".to_owned()
        };
        let fields = if self.columns().len() > COLUMNS.len() {
            " CH, DB: Calinski-Harabasz (higher is better) and Davies-Bouldin index (lower is better) of rendered image features, in \
             clusters by their true class. features: seconds of extracting and lifting or distilling them, and what that learned."
        } else {
            ""
        };
        let commits = self.commits().into_iter();
        let commits = commits.map(|(commit, cells)| format!("{commit} ({cells} cells)"));
        let commits = match &commits.collect::<Vec<_>>()[..] {
            [] => "none".to_owned(),
            some => some.join(", "),
        };
        format!(
            "\nFigures are means over scenes and seeds, of held-out views; all rows of a scene share the Gaussians of one stage \
             one. {spread} frames/s: colour and labels together. seconds: training of stage two, with extraction and lifting of \
             image features where the decoder reads them; of raw labels and votes they are not measured. PSNR: after attendance \
             pruning.{fields} \"3 of 9\": a mean over those cells alone, the others are empty.\n\n\
             - plan: `{}`\n- command: `{}`\n- commit: {commits}\n- empty cells: {} of {all}\n",
            self.plan.path.display(),
            self.command,
            all - self.cells.len(),
        )
    }

    /// The figures of papers that the plan states, below a note that they are not comparable.
    fn published(&self) -> String {
        match &*self.plan.published {
            "" => String::new(),
            text => format!(
                "\n## Published\n\nThese figures are as printed by their sources. They were measured on other data, by other programs \
                 and on other machines, and are not comparable with those above.\n\n{text}\n"
            ),
        }
    }

    /// File names and texts of the plots.
    fn plots(&self) -> Vec<(String, String)> {
        let mut plots = Vec::new();
        for labels in &self.plan.labels {
            let kind = &*labels.name;
            let title = format!("{}: mIoU, %, labels {kind}", self.plan.title);
            for (name, cost, x_title) in [
                ("frames", &FRAMES, "frames a second, colour and labels"),
                ("seconds", &SECONDS, "seconds of stage two"),
            ] {
                let svg = points(&title, x_title, &self.points(kind, cost), self.command);
                plots.push((format!("miou_{name}_{kind}"), svg));
            }
            for scene in self.scenes() {
                let title = format!(
                    "{}: IoU by class, %, {scene}, labels {kind}",
                    self.plan.title
                );
                let svg = bars(&title, &self.class_iou(kind, scene), self.command);
                plots.push((format!("iou_{kind}_{scene}"), svg));
            }
        }
        plots
            .into_iter()
            .filter_map(|(name, svg)| Some((name.replace(' ', "_") + ".svg", svg?)))
            .collect()
    }

    /// mIoU against a cost. Rows that lack cells have no point, because the others are means over more scenes.
    fn points(&self, labels: &str, cost: &Column) -> Vec<Point> {
        let scenes = self.scenes();
        let all = scenes.len() * self.plan.seeds as usize;
        let point = |row: &TableRow| {
            let name = &row.name;
            let finished = self.finished(labels, name, &scenes);
            if finished < all {
                return (format!("{name}: {finished} of {all} cells"), None, 0.0);
            }
            let x = self.statistic(labels, name, &scenes, cost);
            let Some((x, y)) = x.zip(self.statistic(labels, name, &scenes, &MIOU)) else {
                return (format!("{name}: not measured"), None, 0.0);
            };
            let [x, miou] = [cost.unit * x.mean, MIOU.unit * y.mean];
            let spread = MIOU.unit * y.spread.unwrap_or(0.0);
            (format!("{name}: {miou:.1}"), Some([x, miou]), spread)
        };
        self.plan.rows.iter().map(point).collect()
    }

    /// The IoU of each class of a scene in each row, averaged over seeds.
    fn class_iou(&self, labels: &str, scene: &str) -> Vec<ClassRow<'_>> {
        let of_row = |row: &TableRow| {
            let mut by_class: BTreeMap<_, Vec<f64>> = BTreeMap::new();
            let cells = (0..self.plan.seeds)
                .filter_map(|seed| self.cells.get(&(scene, labels, &*row.name, seed)));
            for class in cells.flat_map(|cell| &cell.class_iou) {
                let values = by_class.entry((class.id, &*class.name)).or_default();
                values.push(class.iou);
            }
            let means = by_class.into_iter();
            let means =
                means.filter_map(|(class, iou)| Some((class, mean(iou.into_iter().map(Some))?)));
            (row.name.clone(), means.collect())
        };
        self.plan.rows.iter().map(of_row).collect()
    }
}

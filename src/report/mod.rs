//! The run folder's results: `metrics.json`, `classes.json`, `config.toml`, held-out pictures, and `report.html`.

pub(crate) mod chart;
mod curves;
mod from_run;
mod history;
mod metrics;
mod page;
pub mod pictures;
pub mod sheet;
mod tables;
mod units;
mod views;

pub use self::from_run::held_out_views;
pub use self::history::{BuildingHistory, History, Sample, VariantHistory};
pub use self::metrics::{Command, Metrics, TestScores, VariantScores, peak_memory_bytes};

pub(crate) use self::units::thousands;

use crate::config::{Config, Variant};
use crate::data::{Classes, LabelMap, View};
use crate::error::Result;
use crate::files::atomic;
use crate::metrics::ImageScores;
use std::path::Path;

/// The results of a run.
#[derive(Clone, Debug)]
pub struct Report<'a> {
    /// Figures, as in `metrics.json`.
    pub metrics: Metrics,
    /// Class table of the scene.
    pub classes: &'a Classes,
    /// Settings as run.
    pub config: &'a Config,
    /// Number of held-out views.
    pub held_out: usize,
    /// The held-out views that the page shows, in file order.
    pub views: Vec<HeldOutView<'a>>,
    /// Notes for the reader: what was skipped, what the figures do not say.
    pub notes: Vec<String>,
}

/// One held-out view as the trained scene shows it.
#[derive(Clone, Debug)]
pub struct HeldOutView<'a> {
    /// The photo, its truth and its raw labels.
    pub view: &'a View,
    /// Rendered colour, `[H, W, 3]`, not clamped.
    pub rgb: Vec<f32>,
    /// PSNR and SSIM against the photo.
    pub scores: ImageScores,
    /// Rendered labels by row. `Variant::Raw` is not among them: raw labels are the view's own.
    pub labels: Vec<(Variant, LabelMap)>,
}

impl HeldOutView<'_> {
    /// Writes its pictures into `dir`: `STEM.rgb.png`, `STEM.rgb_error.png` and, with labels, `STEM.label.png` (ids),
    /// `STEM.label_color.png` (with a legend) and `STEM.label_error.png` (with truth). Removes those of an earlier result
    /// that this one does not have.
    ///
    /// # Errors
    /// [`crate::Error::Io`] naming the file that could not be written; those of [`crate::data::Photo::pixels`].
    pub fn write(&self, classes: &Classes, dir: &Path) -> Result<()> {
        let stem = self.view.name.replace(['/', '\\'], "_");
        let file = |kind: &str| dir.join(format!("{stem}.{kind}.png"));
        let camera = &self.view.camera;
        let rgb = pictures::from_floats(&self.rgb, camera.width, camera.height)?;
        let save = |kind: &str, image: &image::RgbImage| pictures::write(&file(kind), image);
        save("rgb", &rgb)?;
        save("rgb_error", &self.color_error(&rgb)?)?;
        let Some((_, labels)) = self.stored() else {
            return ["label", "label_color", "label_error"]
                .into_iter()
                .try_for_each(|kind| atomic::remove(file(kind)));
        };
        labels.write(&file("label"))?;
        let colored = pictures::colored(labels, classes);
        let colored = pictures::with_legend(&colored, labels, classes);
        save("label_color", &colored)?;
        let Some(truth) = &self.view.truth else {
            return atomic::remove(file("label_error"));
        };
        let error = pictures::label_error(labels, &truth.map(), classes.ignore);
        save("label_error", &error)
    }

    /// The difference of `rgb`, the rendered view, from the photo; grey where a mask leaves pixels out.
    fn color_error(&self, rgb: &image::RgbImage) -> Result<image::RgbImage> {
        let mut error = pictures::rgb_error(rgb, &*self.view.image.pixels()?);
        if let Some(mask) = &self.view.mask {
            let [_, _, void] = pictures::AGREEMENT;
            let pixels = error.pixels_mut().enumerate();
            let left_out = pixels.filter(|(i, _)| !mask.uses(*i));
            left_out.for_each(|(_, pixel)| pixel.0 = void);
        }
        Ok(error)
    }

    /// The labels of the row that the scene stores: `ours` where present, else the last.
    fn stored(&self) -> Option<&(Variant, LabelMap)> {
        self.labels
            .iter()
            .find(|(row, _)| *row == Variant::Ours)
            .or(self.labels.last())
    }
}

impl Report<'_> {
    /// Writes `classes.json`, `config.toml`, `renders/`, `metrics.json` and `report.html` into `dir`, in this order,
    /// each under a temporary name first.
    ///
    /// `renders/` gets what [`HeldOutView::write`] makes of [`Report::views`].
    ///
    /// # Errors
    /// [`crate::Error::Io`] naming the file that could not be written; those of [`crate::data::Photo::pixels`].
    pub fn write(&self, dir: &Path) -> Result<()> {
        self.classes.write(&dir.join("classes.json"))?;
        atomic::write_bytes(dir.join("config.toml"), self.config.to_toml()?.as_bytes())?;
        for view in &self.views {
            view.write(self.classes, &dir.join("renders"))?;
        }
        atomic::write_json(dir.join("metrics.json"), &self.metrics)?;
        let path = dir.join("report.html");
        atomic::write_bytes(&path, self.html(&path)?.as_bytes())
    }

    /// `report.html` as text. `path` only serves error messages.
    ///
    /// # Errors
    /// [`crate::Error::Io`] when a picture cannot be encoded, [`crate::Error::Limit`] when one has a different size than its
    /// photo.
    pub fn html(&self, path: &Path) -> Result<String> {
        Ok(page::page(self, path)?.into_string())
    }
}

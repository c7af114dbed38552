//! The annotations that `coseg render` makes of label maps.

use clap::ValueEnum;
use coseg::data::labels::annotations::{Categories, CocoInstances, Yolo};
use coseg::data::{Classes, LabelMap};
use coseg::error::Result;
use std::path::Path;

/// Formats of annotations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum AnnotationFormat {
    Coco,
    Yolo,
    Index,
}

/// Annotations in all formats that are asked for. Those of single frames are written at once, the others by [`Annotations::finish`].
pub struct Annotations<'a> {
    formats: &'a [AnnotationFormat],
    coco: CocoInstances,
    yolo: Yolo<'a>,
    classes: &'a Classes,
    folder: &'a Path,
}

impl<'a> Annotations<'a> {
    /// No frame yet, in `folder`.
    pub fn new(
        formats: &'a [AnnotationFormat],
        categories: &'a Categories,
        classes: &'a Classes,
        folder: &'a Path,
    ) -> Self {
        Self {
            formats,
            coco: CocoInstances::new(categories),
            yolo: Yolo::new(categories),
            classes,
            folder,
        }
    }

    /// Adds the label map of the frame `name`.
    pub fn add(&mut self, name: &str, labels: &LabelMap) -> Result<()> {
        for format in self.formats {
            match format {
                AnnotationFormat::Coco => self.coco.add(format!("{name}.png"), labels),
                AnnotationFormat::Yolo => {
                    let path = self.folder.join(format!("{name}.txt"));
                    self.yolo.write(&path, labels)?;
                }
                AnnotationFormat::Index => {
                    let path = self.folder.join(format!("{name}.index.png"));
                    labels.write_indexed(&path, |id| self.classes.legend_color(id))?;
                }
            }
        }
        Ok(())
    }

    /// Writes the files of all frames together.
    pub fn finish(self) -> Result<()> {
        if self.formats.contains(&AnnotationFormat::Coco) {
            self.coco.write(&self.folder.join("instances.json"))?;
        }
        if self.formats.contains(&AnnotationFormat::Yolo) {
            self.yolo.write_names(&self.folder.join("data.yaml"))?;
        }
        Ok(())
    }
}

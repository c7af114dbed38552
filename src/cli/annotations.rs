//! The annotations that `coseg render` makes of label maps.

use super::terminal;
use clap::ValueEnum;
use coseg::data::labels::annotations::{Categories, CocoInstances, Yolo};
use coseg::data::{Classes, NamedCamera, Split, ViewPhoto};
use coseg::error::{Error, Result};
use coseg::files::{atomic, extension};
use coseg::objects::Frame;
use coseg::report::pictures;
use std::collections::BTreeMap;
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
    /// Pictures of the YOLO data set.
    images: Vec<(Split, String)>,
    /// How many of them are rendered.
    rendered: usize,
    photos: BTreeMap<String, ViewPhoto>,
    classes: &'a Classes,
    folder: &'a Path,
}

impl<'a> Annotations<'a> {
    /// No frame yet, in `folder`. The `photos` of frames are known by the names of these.
    pub fn new(
        formats: &'a [AnnotationFormat],
        categories: &'a Categories,
        classes: &'a Classes,
        folder: &'a Path,
        photos: BTreeMap<String, ViewPhoto>,
    ) -> Self {
        Self {
            formats,
            coco: CocoInstances::new(categories),
            yolo: Yolo::new(categories),
            images: Vec::new(),
            rendered: 0,
            photos,
            classes,
            folder,
        }
    }

    /// Adds the label map of a frame.
    pub fn add(&mut self, named: &NamedCamera, frame: &Frame) -> Result<()> {
        let Some(labels) = &frame.labels else {
            return Ok(());
        };
        let name = &named.name;
        for format in self.formats {
            match format {
                AnnotationFormat::Coco => {
                    let photo = self.photos.get(name).map(|photo| photo.name.clone());
                    let file = photo.unwrap_or_else(|| format!("{name}.png"));
                    self.coco.add(file, labels);
                }
                AnnotationFormat::Yolo => {
                    let path = self.folder.join(format!("labels/{name}.txt"));
                    self.yolo.write(&path, labels)?;
                    let image = self.write_image(name, frame)?;
                    self.images.push((named.split, image));
                }
                AnnotationFormat::Index => {
                    let path = self.folder.join(format!("{name}.index.png"));
                    labels.write_indexed(&path, |id| self.classes.legend_color(id))?;
                }
            }
        }
        Ok(())
    }

    /// Copies the photo of a frame into the folder `images`, where one is known that has the pixels of the map; else writes the
    /// rendered picture. Returns the file name.
    fn write_image(&mut self, name: &str, frame: &Frame) -> Result<String> {
        let folder = self.folder.join("images");
        let fits = |photo: &&ViewPhoto| photo.fits((frame.width, frame.height));
        if let Some(photo) = self.photos.get(name).filter(fits) {
            let image = format!("{name}.{}", extension(&photo.file));
            let bytes =
                std::fs::read(&photo.file).map_err(|e| Error::io(&photo.file, "read", e))?;
            atomic::write_bytes(folder.join(&image), &bytes)?;
            return Ok(image);
        }
        let image = format!("{name}.png");
        let picture = pictures::from_floats(&frame.rgb, frame.width, frame.height)?;
        pictures::write(&folder.join(&image), &picture)?;
        self.rendered += 1;
        Ok(image)
    }

    /// Writes the files of all frames together.
    pub fn finish(self) -> Result<()> {
        if self.formats.contains(&AnnotationFormat::Coco) {
            self.coco.write(&self.folder.join("instances.json"))?;
        }
        if self.formats.contains(&AnnotationFormat::Yolo) {
            self.yolo.write_lists(self.folder, &self.images)?;
            let photos = self.images.len() - self.rendered;
            let mut said = format!("{}: {photos} photos", self.folder.join("images").display());
            if self.rendered > 0 {
                said += &format!(
                    ", and {} rendered pictures of frames whose photo is not known, has lens distortion or other proportions",
                    self.rendered
                );
            }
            terminal::say(&said);
        }
        Ok(())
    }
}

//! The annotations that `coseg render` makes from label maps.

use super::terminal;
use clap::ValueEnum;
use coseg::data::labels::annotations::{Categories, CocoInstances, Yolo};
use coseg::data::{Classes, NamedCamera, Split, ViewPhoto};
use coseg::error::Result;
use coseg::files::{atomic, extension, own};
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

/// The COCO file of all frames.
const INSTANCES: &str = "instances.json";

/// Annotations in all requested formats. Files for single frames are written at once, the others by [`Annotations::finish`].
pub struct Annotations<'a> {
    formats: &'a [AnnotationFormat],
    coco: CocoInstances,
    yolo: Yolo<'a>,
    /// Pictures of the YOLO data set.
    images: Vec<(Split, String)>,
    frames: usize,
    /// Number of pictures whose map fits no photo.
    without_photo: usize,
    photos: BTreeMap<String, ViewPhoto>,
    classes: &'a Classes,
    folder: &'a Path,
}

impl<'a> Annotations<'a> {
    /// Annotations for `folder`, without frames yet. `photos` has the names of their frames as keys.
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
            frames: 0,
            without_photo: 0,
            photos,
            classes,
            folder,
        }
    }

    /// Refuses files that [`Annotations::finish`] could not write after the frames of `cameras`.
    pub fn check(&self, cameras: &[NamedCamera]) -> Result<()> {
        if self.formats.contains(&AnnotationFormat::Coco) {
            own::check(self.folder.join(INSTANCES))?;
        }
        if self.formats.contains(&AnnotationFormat::Yolo) {
            let splits: Vec<Split> = cameras.iter().map(|named| named.split).collect();
            self.yolo.check_lists(self.folder, &splits)?;
        }
        Ok(())
    }

    /// Adds the label map of a frame.
    pub fn add(&mut self, named: &NamedCamera, frame: &Frame) -> Result<()> {
        let Some(labels) = &frame.labels else {
            return Ok(());
        };
        let name = &named.name;
        let fits = |photo: &&ViewPhoto| photo.fits((frame.width, frame.height));
        let photo = self.photos.get(name).filter(fits);
        self.frames += 1;
        self.without_photo += usize::from(photo.is_none());
        for format in self.formats {
            match format {
                AnnotationFormat::Coco => {
                    let photo = photo.map(|photo| photo.name.clone());
                    let file = photo.unwrap_or_else(|| format!("{name}.png"));
                    self.coco.add(file, labels);
                }
                AnnotationFormat::Yolo => {
                    let path = self.folder.join(format!("labels/{name}.txt"));
                    self.yolo.write(&path, labels)?;
                    let image = write_image(&self.folder.join("images"), name, photo, frame)?;
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

    /// Writes the files of all frames together.
    pub fn finish(self) -> Result<()> {
        if self.formats.contains(&AnnotationFormat::Coco) {
            let path = self.folder.join(INSTANCES);
            self.coco.write(&path)?;
            self.say(&path, "names STEM.png");
        }
        if self.formats.contains(&AnnotationFormat::Yolo) {
            self.yolo.write_lists(self.folder, &self.images)?;
            self.say(&self.folder.join("images"), "rendered pictures");
        }
        Ok(())
    }

    /// Prints for how many frames `path` has the photo, and for how many it has `others` instead.
    fn say(&self, path: &Path, others: &str) {
        let photos = self.frames - self.without_photo;
        let mut said = format!("{}: {photos} photos", path.display());
        if self.without_photo > 0 {
            said += &format!(
                ", and {} {others} of frames whose photo is not known, has lens distortion or other proportions",
                self.without_photo
            );
        }
        terminal::say(&said);
    }
}

/// Copies the `photo` of a frame, if any, into `folder`, else writes the rendered picture there. Returns the file name.
fn write_image(
    folder: &Path,
    name: &str,
    photo: Option<&ViewPhoto>,
    frame: &Frame,
) -> Result<String> {
    if let Some(photo) = photo {
        let image = format!("{name}.{}", extension(&photo.file));
        atomic::write_bytes(folder.join(&image), &photo.without_orientation()?)?;
        return Ok(image);
    }
    let image = format!("{name}.png");
    let picture = pictures::from_floats(&frame.rgb, frame.width, frame.height)?;
    pictures::write(&folder.join(&image), &picture)?;
    Ok(image)
}

//! The files of a frame that `coseg render` writes.

use clap::ValueEnum;
use coseg::data::{Classes, LabelMap};
use coseg::error::Result;
use coseg::files::atomic;
use coseg::objects::Frame;
use coseg::report::pictures;
use std::path::{Path, PathBuf};

/// Kinds of image files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    Png,
    Npy,
}

/// The files of one frame.
pub struct FrameFiles<'a> {
    /// Where they are.
    pub folder: &'a Path,
    /// Name of the frame.
    pub name: &'a str,
    /// 8-bit images or float32 arrays.
    pub format: Format,
}

impl FrameFiles<'_> {
    fn file(&self, end: &str) -> PathBuf {
        self.folder.join(format!("{}.{end}", self.name))
    }

    /// Writes `values`, `[H, W, 3]` colours, as a file of `kind`.
    pub fn write_color(&self, kind: &str, size: [usize; 2], values: &[f32]) -> Result<()> {
        let [width, height] = size;
        self.write_values(kind, &[height, width, 3], values, |path| {
            pictures::write(path, &pictures::from_floats(values, width, height)?)
        })
    }

    /// Writes depths, `[H, W]` world units.
    pub fn write_depth(&self, [width, height]: [usize; 2], depth: &[f32]) -> Result<()> {
        self.write_values("depth", &[height, width], depth, |path| {
            // Casts saturate at 65,535.
            let ids = depth.iter().map(|v| (1000.0 * v).round() as u16).collect();
            LabelMap { width, height, ids }.write_wide(path)
        })
    }

    /// Writes relevancy, `[H, W]`, as a picture over the colours of `frame`: dark grey up to `least`, bright at `most`.
    pub fn write_relevancy(
        &self,
        relevancy: &[f32],
        [least, most]: [f32; 2],
        &Frame {
            width,
            height,
            ref rgb,
            ..
        }: &Frame,
    ) -> Result<()> {
        self.write_values("relevancy", &[height, width], relevancy, |path| {
            let share = |value: &f32| (value - least) / (most - least).max(f32::EPSILON);
            let shares: Vec<f32> = relevancy.iter().map(share).collect();
            pictures::write(path, &pictures::heated(rgb, &shares, width, height)?)
        })
    }

    /// Writes normals, `[H, W, 3]` world directions.
    pub fn write_normals(&self, size: [usize; 2], normals: &[f32]) -> Result<()> {
        match self.format {
            Format::Npy => self.write_color("normal", size, normals),
            Format::Png => {
                let colors: Vec<f32> = normals.iter().map(|n| 0.5 * (n + 1.0)).collect();
                self.write_color("normal", size, &colors)
            }
        }
    }

    /// Writes colour, coverage and, where the frame has them, labels.
    pub fn write(&self, frame: &Frame, classes: &Classes) -> Result<()> {
        let &Frame { width, height, .. } = frame;
        self.write_color("rgb", [width, height], &frame.rgb)?;
        self.write_values("alpha", &[height, width], &frame.alpha, |path| {
            let byte = |a: &f32| (a.clamp(0.0, 1.0) * 255.0).round() as u16;
            let ids = frame.alpha.iter().map(byte).collect();
            LabelMap { width, height, ids }.write(path)
        })?;
        let Some(labels) = &frame.labels else {
            return Ok(());
        };
        labels.write(&self.file("label.png"))?;
        if classes.is_empty() {
            return Ok(());
        }
        let path = self.file("label_color.png");
        let colored = pictures::with_legend(&pictures::colored(labels, classes), labels, classes);
        pictures::write(&path, &colored)
    }

    /// Writes `values` as an array of this `shape`, or calls `picture` for a PNG of them.
    fn write_values(
        &self,
        kind: &str,
        shape: &[usize],
        values: &[f32],
        picture: impl FnOnce(&Path) -> Result<()>,
    ) -> Result<()> {
        match self.format {
            Format::Npy => write_npy(&self.file(&format!("{kind}.npy")), shape, values),
            Format::Png => picture(&self.file(&format!("{kind}.png"))),
        }
    }
}

/// Writes a little-endian float32 array in C order.
pub fn write_npy(path: &Path, shape: &[usize], values: &[f32]) -> Result<()> {
    use npyz::WriterBuilder;
    let shape: Vec<u64> = shape.iter().map(|&n| n as u64).collect();
    atomic::write(path, |out| {
        let mut writer = npyz::WriteOptions::new()
            .default_dtype()
            .shape(&shape)
            .writer(out)
            .begin_nd()?;
        writer.extend(values.iter())?;
        writer.finish()
    })
}

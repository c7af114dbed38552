//! An initial cloud from the depth images of a recorded sequence.

use super::frame::Frame;
use crate::data::options::evenly;
use crate::data::{LabelMap, Points, Split};
use crate::error::{Result, in_order};
use glam::DVec3;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Largest number of training frames that are used, evenly chosen, and of points in the cloud.
const FRAMES: usize = 64;
const POINTS: usize = 50_000;

/// Depth images of a sequence: 16-bit grey PNG, distance along the viewing direction, 0 where it is unknown.
pub(crate) struct Depth {
    /// File of each frame of the listing, if it has one.
    pub files: Vec<Option<PathBuf>>,
    /// Value of one world unit.
    pub scale: f64,
}

impl Depth {
    /// Points on a grid over each chosen frame, except where its mask leaves pixels out, with the colours of its photo.
    /// Positions are relative to `origin`; `file` lists the frames.
    pub fn points(&self, frames: &[Frame], file: &Path, origin: DVec3) -> Result<Points> {
        let train = frames
            .iter()
            .zip(&self.files)
            .filter(|(frame, _)| frame.split == Split::Train);
        let known: Vec<_> = train
            .filter_map(|(frame, depth)| Some((frame, depth.as_ref()?)))
            .collect();
        let chosen = evenly(known.len(), FRAMES);
        let most = POINTS / chosen.len().max(1);
        let parts = chosen.into_par_iter().map(|i| {
            let (frame, depth) = known[i];
            self.of_frame(frame, depth, file, most, origin)
        });
        let mut points = Points::default();
        for part in in_order(parts)? {
            points.positions.extend(part.positions);
            points.colors.extend(part.colors);
        }
        Ok(points)
    }

    /// At most `most` points of one frame, relative to `origin`, with the colours of its photo.
    pub fn of_frame(
        &self,
        frame: &Frame,
        depth: &Path,
        file: &Path,
        most: usize,
        origin: DVec3,
    ) -> Result<Points> {
        let (image, geometry) = frame.open(file)?;
        let photo = geometry.photo(&image)?;
        let mask = frame.read_mask(&geometry)?;
        let LabelMap { width, height, ids } = LabelMap::read(depth)?;
        let camera = &geometry.camera;
        // As many columns and rows as keep the proportions of the image.
        let across = ((most * width) as f64 / height as f64)
            .sqrt()
            .floor()
            .max(1.0) as usize;
        let columns = across.min(width);
        let rows = (most / across).clamp(1, height);
        let mut points = Points::default();
        for i in 0..columns * rows {
            let column = (i % columns * 2 + 1) * width / (2 * columns);
            let row = (i / columns * 2 + 1) * height / (2 * rows);
            let value = ids[row * width + column];
            let u = (column as f64 + 0.5) * camera.width as f64 / width as f64;
            let v = (row as f64 + 0.5) * camera.height as f64 / height as f64;
            let pixel = v as usize * camera.width + u as usize;
            if value == 0 || mask.as_ref().is_some_and(|mask| !mask.uses(pixel)) {
                continue;
            }
            let position =
                camera.ray(u, v) * (f64::from(value) / self.scale) + (camera.center - origin);
            let color = photo.get_pixel(u as u32, v as u32).0;
            points.positions.push(position.to_array().map(|v| v as f32));
            points.colors.push(color.map(|c| f32::from(c) / 255.0));
        }
        Ok(points)
    }
}

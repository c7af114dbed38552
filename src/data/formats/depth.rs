//! An initial cloud from depth images, for recorded sequences that come with them.

use super::frame::Frame;
use crate::data::{LabelMap, Limits, Points, Split};
use crate::error::Result;
use glam::DVec3;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Frames that are looked at, evenly chosen among those trained on, and points of the cloud, at most.
const FRAMES: usize = 64;
const POINTS: usize = 50_000;

/// Depth images of a sequence: 16-bit grey PNG, distance along the viewing direction, 0 where it is unknown.
pub(crate) struct Depth {
    /// File of each frame of the listing, where it has one.
    pub files: Vec<Option<PathBuf>>,
    /// Value of one world unit.
    pub scale: f64,
}

impl Depth {
    /// Points on a grid over each chosen frame, without those that its mask leaves out, with the colours of its photo, relative to `origin`.
    pub fn points(
        &self,
        frames: &[Frame],
        listed_in: &Path,
        origin: DVec3,
        limits: &Limits,
    ) -> Result<Points> {
        let known = frames
            .iter()
            .zip(&self.files)
            .filter(|(frame, _)| frame.split == Split::Train);
        let known: Vec<(&Frame, &PathBuf)> = known
            .filter_map(|(frame, file)| Some((frame, file.as_ref()?)))
            .collect();
        let chosen = FRAMES.min(known.len());
        let each = POINTS / chosen.max(1);
        let made: Vec<Result<Points>> = (0..chosen)
            .into_par_iter()
            .map(|i| {
                let (frame, file) = known[i * known.len() / chosen];
                self.of_frame(frame, file, listed_in, each, origin, limits)
            })
            .collect();
        let mut points = Points::default();
        for part in made {
            let part = part?;
            points.positions.extend(part.positions);
            points.colors.extend(part.colors);
        }
        Ok(points)
    }

    /// At most `most` points of one frame, relative to `origin`, with the colours of its photo.
    pub(crate) fn of_frame(
        &self,
        frame: &Frame,
        file: &Path,
        listed_in: &Path,
        most: usize,
        origin: DVec3,
        limits: &Limits,
    ) -> Result<Points> {
        let (image, geometry) = frame.open(listed_in, limits)?;
        let photo = geometry.photo(&image)?;
        let mask = frame.read_mask(&geometry, limits)?;
        let depth = LabelMap::read(file, limits)?;
        let camera = &geometry.camera;
        // As many columns and rows as keep the proportions of the image.
        let across = ((most * depth.width) as f64 / depth.height as f64)
            .sqrt()
            .floor()
            .max(1.0) as usize;
        let (columns, rows) = (
            across.min(depth.width),
            (most / across).clamp(1, depth.height),
        );
        let mut points = Points::default();
        for i in 0..columns * rows {
            let (column, row) = (
                (i % columns * 2 + 1) * depth.width / (2 * columns),
                (i / columns * 2 + 1) * depth.height / (2 * rows),
            );
            let value = depth.ids[row * depth.width + column];
            if value == 0 {
                continue;
            }
            let u = (column as f64 + 0.5) * camera.width as f64 / depth.width as f64;
            let v = (row as f64 + 0.5) * camera.height as f64 / depth.height as f64;
            if mask
                .as_ref()
                .is_some_and(|mask| !mask.uses(v as usize * camera.width + u as usize))
            {
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

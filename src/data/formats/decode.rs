//! The scene of a listing: photos, label maps and the initial cloud are decoded.

use super::colmap;
use super::folder::scene_name;
use super::frame::Frame;
use super::frame_labels::FrameLabels;
use super::listing::{Cloud, Listing};
use super::points::MAX_STRAY;
use crate::data::photos::photo::Preprocessing;
use crate::data::{Classes, LabelRuns, LoadOptions, Photo, Points, Scene, View};
use crate::error::{Result, in_order};
use crate::splat::camera::{Camera, level_up};
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashSet;
use std::path::Path;
use std::sync::atomic::AtomicUsize;

impl Listing {
    /// World direction that points up.
    pub fn up(&self) -> DVec3 {
        if self.z_up {
            return DVec3::Z;
        }
        let cameras = self.frames.iter().map(|frame| frame.camera.clone());
        level_up(&cameras.collect::<Vec<Camera>>())
    }

    /// Decodes everything, a few files at a time. The second value says for each frame whether its labels may belong to a
    /// turned photo.
    pub fn load(&self, dir: &Path, options: &LoadOptions) -> Result<(Scene, Vec<bool>)> {
        self.check_sizes()?;
        let room = AtomicUsize::new(options.decoded_mb.saturating_mul(1 << 20));
        let origin = self.origin();
        let view = |frame| self.view(frame, options, origin, &room);
        let views = in_order(self.frames.par_iter().map(view))?;
        let (views, turned): (Vec<View>, Vec<bool>) = views.into_iter().unzip();
        let scene = Scene {
            name: scene_name(dir),
            classes: self.classes_of(&views),
            views,
            points: self.points(origin)?,
            drawn: self.raw.drawings().is_some(),
            origin,
            up: self.up(),
            unit: self.unit(),
        };
        Ok((scene, turned))
    }

    /// The view of a frame, and whether its labels may belong to a turned photo.
    fn view(
        &self,
        frame: &Frame,
        options: &LoadOptions,
        origin: DVec3,
        room: &AtomicUsize,
    ) -> Result<(View, bool)> {
        let (file, labels) = FrameLabels::open(self, frame, options)?;
        let preprocessing = Preprocessing {
            background: options.background,
            ..labels.geometry.preprocessing.clone()
        };
        let image = Photo::in_file(&file, preprocessing, room)?;
        let truth = labels.truth()?.map(LabelRuns::from);
        let raw = labels.raw()?;
        let scores = labels.scores();
        let (raw, segments) = raw.map_or((None, Vec::new()), |r| (Some(r.map.into()), r.segments));
        let (truth, raw) = match truth {
            None if self.scores_against_drawing(frame) => (raw, None),
            _ => (truth, raw),
        };
        let instances = labels.instances()?.map(LabelRuns::from);
        let camera = labels.geometry.view_camera().moved(-origin);
        let view = View {
            name: frame.name.clone(),
            split: frame.split,
            camera,
            image,
            mask: labels.mask,
            truth,
            raw,
            scores,
            segments,
            corrected: None,
            instances,
        };
        Ok((view, frame.may_be_turned(&file)))
    }

    /// The classes of the scene. Of a table for a whole dataset, only classes that occur in some view.
    fn classes_of(&self, views: &[View]) -> Classes {
        let mut classes = self.classes.clone();
        if self.occurring_classes {
            let mut occur = HashSet::new();
            for view in views {
                let raw = view.raw.iter().filter(|_| !self.raw.are_segments);
                let runs = view.truth.iter().chain(raw).flat_map(LabelRuns::runs);
                occur.extend(runs.map(|(id, _)| id));
                occur.extend(view.segments.iter().filter_map(|segment| segment.class));
            }
            classes.entries.retain(|class| occur.contains(&class.id));
        }
        classes
    }

    /// The cloud, relative to `origin`, without its strays.
    pub fn points(&self, origin: DVec3) -> Result<Points> {
        let before = self.moved.map_or(origin, |world| world.undo(origin));
        let mut points = match &self.cloud {
            Cloud::None => Points::default(),
            Cloud::Ply(path) => Points::read(path, before)?,
            Cloud::Colmap(path) => colmap::read_points(path, before)?,
            Cloud::Depth(depth) => depth.points(&self.frames, &self.file, origin)?,
        };
        if let (Some(world), Cloud::Ply(_) | Cloud::Colmap(_)) = (self.moved, &self.cloud) {
            world.turn_points(&mut points);
        }
        let left_out = points.remove_strays();
        if left_out > 0 {
            tracing::warn!(
                "{}: {left_out} points of the initial cloud are left out: they lie {MAX_STRAY} times as far out as half of all points",
                self.file.display()
            );
        }
        if let Some(region) = &self.region {
            let frames: Vec<&Frame> = self.frames.iter().collect();
            region.thin(&mut points, &frames, origin);
        }
        Ok(points)
    }
}

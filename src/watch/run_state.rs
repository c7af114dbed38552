//! What is known of a run that is watched.

use crate::data::{Classes, NamedCamera, Photo, Scene, Split};
use crate::error::Result;
use crate::progress::{CurvePoint, Event};
use crate::splat::Gaussians;
use crate::viewer::{MAX_PAGE_BYTES, Viewer};
use glam::DVec3;
use serde::Serialize;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A browser that has not asked for this long is no longer there.
const ABSENT: Duration = Duration::from_secs(4);
/// Least time between two copies of the Gaussians.
const PAUSE: Duration = Duration::from_secs(2);
/// A copy is not followed by another before this many times what it cost: the run loses 2.5 % at most.
const REST: u32 = 40;

/// A run as its browsers see it.
pub(super) struct RunState {
    pub status: Status,
    started: Instant,
    /// When a browser asked last.
    last_visit: Option<Instant>,
    /// Whether one has asked since the end.
    seen_end: bool,
    /// When the Gaussians may be copied again.
    next_copy: Instant,
    alpha_max: f64,
    scene: Arc<SceneInfo>,
    copy: Option<Arc<SceneCopy>>,
}

/// The Gaussians at some iteration and their labels, as far as the page has room for them.
pub(super) struct SceneCopy {
    gaussians: Gaussians,
    labels: Option<Vec<u16>>,
    /// Step between the Gaussians of the run that the copy holds; 1 holds all of them.
    every: usize,
}

impl SceneCopy {
    pub fn new(gaussians: &Gaussians, labels: Option<&[u16]>) -> Self {
        let every = Viewer::bytes(gaussians, false)
            .div_ceil(MAX_PAGE_BYTES)
            .max(1);
        let rows: Vec<u32> = (0..gaussians.len() as u32).step_by(every).collect();
        let pick = |labels: &[u16]| rows.iter().map(|&row| labels[row as usize]).collect();
        let mut gaussians = gaussians.select(&rows);
        // Those that are left cover the area of all.
        let larger = 0.5 * (every as f32).ln();
        let scales = gaussians.log_scales.as_flattened_mut().iter_mut();
        scales.for_each(|scale| *scale += larger);
        Self {
            gaussians,
            labels: labels.map(pick),
            every,
        }
    }
}

/// The figures, as JSON for the page.
#[derive(Default, Serialize)]
pub(super) struct Status {
    title: String,
    /// Present stage; empty before the first.
    stage: &'static str,
    done: usize,
    iterations: usize,
    /// Loss of the last iteration.
    loss: Option<f64>,
    gaussians: usize,
    seconds: f64,
    /// Whether a browser asked the run to stop.
    pub stopping: bool,
    /// Number of the copy of the Gaussians that can be shown, from 1; 0 is none.
    copy: usize,
    /// Whether its Gaussians have labels.
    labelled: bool,
    /// Step between the Gaussians of the run that the copy holds; 1 holds all of them.
    every: usize,
    /// Whether the run has ended.
    pub ended: bool,
    /// Curves of the stages that have one.
    curves: Vec<Curve>,
    /// Scored labels.
    rows: Vec<ScoredVariant>,
    views: Vec<ViewName>,
}

#[derive(Serialize)]
struct Curve {
    stage: &'static str,
    points: Vec<CurvePoint>,
    finished: bool,
}

#[derive(Serialize)]
struct ScoredVariant {
    variant: &'static str,
    miou: Option<f64>,
}

#[derive(Serialize)]
struct ViewName {
    name: String,
    split: Split,
}

/// What a page needs beside the Gaussians.
#[derive(Default)]
struct SceneInfo {
    origin: DVec3,
    up: Option<DVec3>,
    classes: Classes,
    cameras: Vec<NamedCamera>,
    photos: Vec<Photo>,
}

impl RunState {
    pub fn new(title: &str, alpha_max: f64) -> Self {
        let now = Instant::now();
        Self {
            status: Status {
                title: title.to_owned(),
                ..Status::default()
            },
            started: now,
            last_visit: None,
            seen_end: false,
            next_copy: now,
            alpha_max,
            scene: Arc::default(),
            copy: None,
        }
    }

    pub fn record(&mut self, event: &Event) {
        let status = &mut self.status;
        match event {
            Event::Started {
                stage,
                done,
                iterations,
            } => {
                status.stage = stage;
                status.done = *done;
                status.iterations = *iterations;
                status.loss = None;
                // Several variants have a stage of this name.
                status.curves.retain(|curve| curve.stage != *stage);
            }
            Event::Step {
                iteration,
                loss,
                gaussians,
            } => {
                status.done = *iteration;
                status.loss = Some(*loss).filter(|loss| loss.is_finite());
                status.gaussians = *gaussians;
            }
            Event::Viewed { done } => status.done = *done,
            Event::Evaluated(point) => self.curve().points.push(*point),
            Event::Finished => {
                let curve = status.curves.iter_mut().find(|c| c.stage == status.stage);
                if let Some(curve) = curve {
                    curve.finished = true;
                }
            }
            Event::Scored { variant, miou } => status.rows.push(ScoredVariant {
                variant,
                miou: *miou,
            }),
            Event::Reviewed(_) | Event::Begun(_) | Event::Stored { .. } => {}
        }
    }

    /// The curve of the present stage.
    fn curve(&mut self) -> &mut Curve {
        let Status { stage, curves, .. } = &mut self.status;
        let place = curves.iter().position(|curve| curve.stage == *stage);
        let place = place.unwrap_or_else(|| {
            curves.push(Curve {
                stage,
                points: Vec::new(),
                finished: false,
            });
            curves.len() - 1
        });
        &mut curves[place]
    }

    pub fn set_scene(&mut self, scene: &Scene) {
        let views = scene.views.iter();
        let cameras = scene.cameras();
        let name = |camera: &NamedCamera| ViewName {
            name: camera.name.clone(),
            split: camera.split,
        };
        self.status.views = cameras.iter().map(name).collect();
        self.scene = Arc::new(SceneInfo {
            origin: scene.origin,
            up: scene.known_up(),
            classes: scene.classes.clone(),
            photos: views.map(|view| view.image.clone()).collect(),
            cameras,
        });
    }

    /// The figures now. Counts as a visit.
    pub fn visit(&mut self) -> &Status {
        self.last_visit = Some(Instant::now());
        self.seen_end = self.status.ended;
        if !self.status.ended {
            self.status.seconds = self.started.elapsed().as_secs_f64();
        }
        &self.status
    }

    /// Whether a browser is there that has yet to see the end.
    pub fn awaits_visit(&self) -> bool {
        !self.seen_end && self.is_watched()
    }

    fn is_watched(&self) -> bool {
        self.last_visit
            .is_some_and(|visit| visit.elapsed() < ABSENT)
    }

    /// Whether a browser is there, and the run has rested from the last copy.
    pub fn wants_gaussians(&self) -> bool {
        self.is_watched() && Instant::now() >= self.next_copy
    }

    pub fn set_copy(&mut self, copy: SceneCopy) {
        self.status.copy += 1;
        self.status.labelled = copy.labels.is_some();
        self.status.every = copy.every;
        self.copy = Some(Arc::new(copy));
    }

    /// Lets the run go on undisturbed after work that took `cost`.
    pub fn rest(&mut self, cost: Duration) {
        let next = Instant::now() + (REST * cost).max(PAUSE);
        self.next_copy = self.next_copy.max(next);
    }

    /// Makes the page of the last copy, which takes time without the lock. `None` before the first copy.
    pub fn page(&self) -> Option<impl FnOnce() -> Result<String> + use<>> {
        let copy = self.copy.clone()?;
        let scene = self.scene.clone();
        let title = self.status.title.clone();
        let alpha_max = self.alpha_max;
        Some(move || {
            let viewer = Viewer {
                features: &[],
                title: &title,
                scene: "",
                names: None,
                sha256: "",
                gaussians: &copy.gaussians,
                origin: scene.origin,
                labels: copy.labels.as_deref(),
                classes: &scene.classes,
                cameras: &scene.cameras,
                up: scene.up,
                alpha_max,
            };
            viewer.picture()
        })
    }

    /// The photo of view `index`.
    pub fn photo(&self, index: usize) -> Option<Photo> {
        self.scene.photos.get(index).cloned()
    }
}

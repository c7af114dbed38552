//! Whether poses are read the way they were written: the wrong convention trains to mush without an error.
//!
//! A pose is a rotation and a translation, which may be camera-to-world or world-to-camera, in OpenGL or in OpenCV axes.
//! The layout says which; a folder that was put together by hand may hold another one. The initial cloud tells: read
//! rightly, its points lie in the photos, and have the colours of the pixels that they fall on.

use crate::config::Layout;
use crate::data::formats::listing::{Cloud, Listing};
use crate::data::{Limits, Points, Scene};
use crate::error::Error;
use crate::splat::camera::Camera;
use glam::{DMat3, DVec3};
use image::RgbImage;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Cameras, photos and points that are looked at, at most, evenly chosen.
const CAMERAS: usize = 256;
const PHOTOS: usize = 16;
const POINTS: usize = 4_096;
/// Fewer points than this say nothing.
const TOO_FEW_POINTS: usize = 100;
/// Cells across and down a photo, in each of which the nearest point is compared: it may hide the others.
const CELLS: usize = 24;
/// Points that a photo must hold to be compared.
const COMPARED: usize = 8;

/// Agreement ([`Fit::agreement`]) below which poses are clearly misread, and above which they are clearly read rightly.
///
/// Measured on two captures of objects, three of rooms and the built-in room, written in each of the four conventions,
/// whole and thinned out to every 3rd, 10th and 40th photo, with points of a cloud or of depth images: read rightly 0.81
/// to 0.91, wrongly at most 0.18; of 200 points alone rightly 0.50 and more, wrongly at most 0.32. An alarm needs both
/// sides to fail: colours that are made up, or change with the exposure, only keep it silent.
const MISREAD: f64 = 0.3;
const READ: f64 = 0.5;
/// The same for the share of the points that some photo holds, which is all that a cloud without colours tells. Measured
/// on the same: rightly 0.95 to 1.00 (0.38 by three photos of a room), wrongly 0.00 to 1.00, as rooms have points on all
/// sides. Of wrong readings above the first bound nothing is told.
const UNSEEN: f64 = 0.5;
const SEEN: f64 = 0.9;
/// That share where points and photos have nothing to do with each other.
const ELSEWHERE: f64 = 0.02;

/// What the cloud says against the poses.
#[derive(Debug)]
pub(crate) enum Verdict {
    /// They are of another convention.
    Misread(Error),
    /// They fit in none: a sentence.
    Unrelated(String),
}

/// How a rotation and a translation are meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Convention {
    /// They take world to camera coordinates, not back.
    to_camera: bool,
    /// Camera axes are x right, y down, z forward; else x right, y up, z backward.
    opencv: bool,
}

impl Convention {
    pub const ALL: [Self; 4] = [
        Self {
            to_camera: false,
            opencv: false,
        },
        Self {
            to_camera: true,
            opencv: false,
        },
        Self {
            to_camera: false,
            opencv: true,
        },
        Self {
            to_camera: true,
            opencv: true,
        },
    ];

    /// That of a layout.
    pub fn of(layout: Layout) -> Self {
        match layout {
            Layout::Auto | Layout::Transforms => Self {
                to_camera: false,
                opencv: false,
            },
            Layout::Colmap => Self {
                to_camera: true,
                opencv: true,
            },
            Layout::Replica | Layout::Scannet => Self {
                to_camera: false,
                opencv: true,
            },
        }
    }

    pub fn name(self) -> &'static str {
        match (self.to_camera, self.opencv) {
            (false, false) => "camera-to-world in OpenGL axes",
            (true, false) => "world-to-camera in OpenGL axes",
            (false, true) => "camera-to-world in OpenCV axes",
            (true, true) => "world-to-camera in OpenCV axes",
        }
    }

    fn description(self) -> String {
        let axes = if self.opencv {
            "y down, looking along z"
        } else {
            "y up, looking along -z"
        };
        format!("{} (x right, {axes})", self.name())
    }

    /// From our axes to these, and back.
    fn axes(self) -> DMat3 {
        if self.opencv {
            DMat3::IDENTITY
        } else {
            DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0))
        }
    }

    /// Rotation and translation of `camera`.
    pub fn write(self, camera: &Camera) -> (DMat3, DVec3) {
        let rotation = self.axes() * camera.rotation;
        match self.to_camera {
            true => (rotation, -(rotation * camera.center)),
            false => (rotation.transpose(), camera.center),
        }
    }

    /// `camera` with this pose.
    pub fn read(self, (rotation, translation): (DMat3, DVec3), camera: &Camera) -> Camera {
        let (rotation, center) = match self.to_camera {
            true => (rotation, -(rotation.transpose() * translation)),
            false => (rotation.transpose(), translation),
        };
        Camera {
            rotation: self.axes() * rotation,
            center,
            ..camera.clone()
        }
    }

    /// How poses of this convention become those of a layout, another one.
    pub fn help(self, layout: Layout) -> String {
        let wanted = Self::of(layout);
        let matrix = match layout {
            Layout::Auto | Layout::Transforms => "transform_matrix",
            Layout::Colmap => "pose",
            Layout::Replica | Layout::Scannet => "matrix",
        };
        // The camera's side of the matrix.
        let lines = if wanted.to_camera { "rows" } else { "columns" };
        match (
            self.to_camera != wanted.to_camera,
            self.opencv != wanted.opencv,
        ) {
            (true, false) => format!("invert each {matrix}"),
            (true, true) => {
                format!("invert each {matrix}, then negate its second and third {lines}")
            }
            (false, _) => format!("negate the second and third {lines} of each {matrix}"),
        }
    }
}

/// A camera in world units, and perhaps its photo.
struct Shot {
    camera: Camera,
    photo: Option<Arc<RgbImage>>,
}

/// A point with its colour, sRGB in 0..1.
struct Anchor {
    position: DVec3,
    color: [f32; 3],
    /// The shot whose depth image shows it; `position` is in the axes of its camera, else in the world.
    source: Option<usize>,
}

/// How well points and photos fit.
#[derive(Clone, Copy, Debug)]
struct Fit {
    /// Share of the points that a photo holds, median over the cameras.
    typical: f64,
    /// Share of the points that some photo holds.
    seen: f64,
    /// Correlation between colours of points and of the pixels they fall on, each photo's means taken out, times the
    /// share of the photos that hold points.
    agreement: f64,
}

/// What the points of a listing say. Those of depth images lie where the poses put them, and are made anew.
pub(crate) fn of_listing(listing: &Listing, points: &Points, limits: &Limits) -> Option<Verdict> {
    let posed: Vec<usize> = (0..listing.frames.len())
        .filter(|&i| listing.frames[i].posed)
        .collect();
    if posed.is_empty()
        || (!matches!(listing.cloud, Cloud::Depth(_)) && points.len() < TOO_FEW_POINTS)
    {
        return None;
    }
    let depth = if let Cloud::Depth(depth) = &listing.cloud {
        Some(depth)
    } else {
        None
    };
    let chosen = evenly(posed.len(), if depth.is_some() { PHOTOS } else { CAMERAS });
    let photos = evenly(chosen.len(), PHOTOS);
    let shots: Vec<Shot> = (0..chosen.len())
        .into_par_iter()
        .map(|place| {
            let frame = &listing.frames[posed[chosen[place]]];
            let opened = photos
                .contains(&place)
                .then(|| frame.open(&listing.file, limits).ok())
                .flatten();
            match opened
                .and_then(|(file, geometry)| Some((geometry.photo(&file).ok()?, geometry.camera)))
            {
                Some((photo, camera)) => Shot {
                    camera,
                    photo: Some(Arc::new(photo)),
                },
                None => Shot {
                    camera: frame.camera.clone(),
                    photo: None,
                },
            }
        })
        .collect();
    let Some(depth) = depth else {
        return judge(
            listing.layout,
            &listing.file,
            &shots,
            &anchors(points, listing.origin()),
        );
    };
    let made = shots.par_iter().enumerate().map(|(place, shot)| {
        let i = posed[chosen[place]];
        let Some(file) = &depth.files[i] else {
            return Vec::new();
        };
        let (frame, most) = (&listing.frames[i], POINTS / shots.len());
        let points = depth
            .of_frame(frame, file, &listing.file, most, shot.camera.center, limits)
            .unwrap_or_default();
        let turn = |anchor: Anchor| {
            let position = shot.camera.rotation * anchor.position;
            Anchor {
                position,
                source: Some(place),
                ..anchor
            }
        };
        anchors(&points, DVec3::ZERO)
            .into_iter()
            .map(turn)
            .collect()
    });
    let made: Vec<Vec<Anchor>> = made.collect();
    judge(
        listing.layout,
        &listing.file,
        &shots,
        &made.into_iter().flatten().collect::<Vec<_>>(),
    )
}

/// What the points of a scene say, which must not come from depth images. `file` is the one that lists its frames.
pub(crate) fn of_scene(layout: Layout, file: &Path, scene: &Scene) -> Option<Verdict> {
    // Before photos are decoded for it.
    if scene.points.len() < TOO_FEW_POINTS {
        return None;
    }
    let chosen = evenly(scene.views.len(), CAMERAS);
    let photos = evenly(chosen.len(), PHOTOS);
    let shot = |(place, i): (usize, &usize)| {
        let view = &scene.views[*i];
        let camera = Camera {
            center: view.camera.center + scene.origin,
            ..view.camera.clone()
        };
        Shot {
            camera,
            photo: photos
                .contains(&place)
                .then(|| view.image.pixels().ok())
                .flatten(),
        }
    };
    let shots: Vec<Shot> = chosen.par_iter().enumerate().map(shot).collect();
    judge(layout, file, &shots, &anchors(&scene.points, scene.origin))
}

/// At most `most` of `n` places, evenly chosen.
pub(crate) fn evenly(n: usize, most: usize) -> Vec<usize> {
    let taken = n.min(most);
    (0..taken).map(|i| i * n / taken).collect()
}

fn anchors(points: &Points, origin: DVec3) -> Vec<Anchor> {
    let anchor = |i: usize| {
        let position = DVec3::from(points.positions[i].map(f64::from)) + origin;
        Anchor {
            position,
            color: points.colors[i],
            source: None,
        }
    };
    evenly(points.len(), POINTS)
        .into_iter()
        .map(anchor)
        .collect()
}

fn judge(layout: Layout, file: &Path, shots: &[Shot], anchors: &[Anchor]) -> Option<Verdict> {
    if anchors.len() < TOO_FEW_POINTS {
        return None;
    }
    let given = Convention::of(layout);
    let as_given = fit(given, given, shots, anchors);
    if as_given.agreement >= MISREAD {
        return None;
    }
    let others = Convention::ALL.into_iter().filter(|other| *other != given);
    let others: Vec<(Convention, Fit)> = others
        .map(|other| (other, fit(given, other, shots, anchors)))
        .collect();
    let best = |of: fn(&Fit) -> f64| {
        others
            .iter()
            .copied()
            .max_by(|a, b| of(&a.1).total_cmp(&of(&b.1)))
    };
    let (by_color, by_color_fit) = best(|fit| fit.agreement)?;
    if by_color_fit.agreement > READ {
        let found = format!(
            "poses by which a photo holds {:.0} % of the initial points (median), whose colours correlate with its own by {:.2}",
            100.0 * as_given.typical,
            as_given.agreement
        );
        let meant = format!(
            "{:.0} % and {:.2}",
            100.0 * by_color_fit.typical,
            by_color_fit.agreement
        );
        return Some(misread(layout, file, &found, &meant, by_color));
    }
    // From here on colours say nothing, and points of depth images are in front of cameras whatever these are.
    if by_color_fit.agreement >= MISREAD || anchors.iter().any(|anchor| anchor.source.is_some()) {
        return None;
    }
    let (by_place, by_place_fit) = best(|fit| {
        if fit.seen > SEEN {
            1.0 + fit.typical
        } else {
            fit.seen
        }
    })?;
    if as_given.seen < UNSEEN
        && by_place_fit.seen > SEEN
        && by_place_fit.typical > 2.0 * as_given.typical
    {
        let found = format!(
            "poses by which the photos hold {:.0} % of the initial points",
            100.0 * as_given.seen
        );
        return Some(misread(
            layout,
            file,
            &found,
            &format!("{:.0} %", 100.0 * by_place_fit.seen),
            by_place,
        ));
    }
    let unrelated = as_given.seen < ELSEWHERE && by_place_fit.seen <= SEEN;
    unrelated.then(|| {
        Verdict::Unrelated(format!(
            "{}: the photos hold {:.1} % of the initial points, whichever way the poses are read: points and poses may \
             be in different coordinates",
            file.display(),
            100.0 * as_given.seen
        ))
    })
}

/// The fault of poses that are meant in another convention; `found` says how they fit as they are, `fit` how as meant.
fn misread(layout: Layout, file: &Path, found: &str, fit: &str, meant: Convention) -> Verdict {
    let (path, field) = match layout {
        Layout::Auto | Layout::Transforms => (file.to_owned(), "transform_matrix of the frames"),
        Layout::Colmap => (file.to_owned(), "QW QX QY QZ TX TY TZ of the images"),
        Layout::Replica => (file.to_owned(), "rows"),
        Layout::Scannet => (
            file.ancestors()
                .nth(2)
                .map_or(PathBuf::new(), |dir| dir.join("pose")),
            "matrices",
        ),
    };
    let found = format!("{found}; {fit} if they are {}", meant.name());
    Verdict::Misread(Error::input(
        path,
        field,
        found,
        Convention::of(layout).description(),
        meant.help(layout),
    ))
}

/// How well points and photos fit when poses that were taken for `given` are read as `other`.
fn fit(given: Convention, other: Convention, shots: &[Shot], anchors: &[Anchor]) -> Fit {
    let cameras: Vec<Camera> = shots
        .iter()
        .map(|s| other.read(given.write(&s.camera), &s.camera))
        .collect();
    let world = |anchor: &Anchor| match anchor.source {
        Some(i) => cameras[i].rotation.transpose() * anchor.position + cameras[i].center,
        None => anchor.position,
    };
    let positions: Vec<DVec3> = anchors.iter().map(world).collect();
    let look = |(i, shot): (usize, &Shot)| {
        look(i, &cameras[i], shot.photo.as_deref(), anchors, &positions)
    };
    let looked: Vec<Looked> = shots.par_iter().enumerate().map(look).collect();
    let mut shares: Vec<f64> = looked.iter().map(|l| l.share).collect();
    shares.sort_by(f64::total_cmp);
    let seen = (0..anchors.len())
        .filter(|&i| looked.iter().any(|l| l.held[i]))
        .count();
    let compared: Vec<[f64; 3]> = looked.iter().filter_map(|l| l.moments).collect();
    let sums = compared
        .iter()
        .fold([0.0; 3], |sum, m| std::array::from_fn(|i| sum[i] + m[i]));
    let photos = shots.iter().filter(|shot| shot.photo.is_some()).count();
    let correlation = sums[0] / (sums[1] * sums[2]).sqrt().max(1e-9);
    Fit {
        typical: shares.get(shares.len() / 2).copied().unwrap_or(0.0),
        seen: seen as f64 / anchors.len().max(1) as f64,
        agreement: correlation * compared.len() as f64 / photos.max(1) as f64,
    }
}

/// What a camera has of the points.
struct Looked {
    /// Whether each lies in the image.
    held: Vec<bool>,
    /// Share of those that do, points of its own depth image left out.
    share: f64,
    /// Products of the deviations of colours of points and pixels: of both, of the points', of the pixels'. None without
    /// a photo, or too few points in it.
    moments: Option<[f64; 3]>,
}

fn look(
    i: usize,
    camera: &Camera,
    photo: Option<&RgbImage>,
    anchors: &[Anchor],
    positions: &[DVec3],
) -> Looked {
    let (w, h) = (camera.width as f64, camera.height as f64);
    let mut held = vec![false; anchors.len()];
    let mut nearest: Vec<Option<(f64, usize, [f64; 2])>> = vec![None; CELLS * CELLS];
    let mut own = 0;
    for (k, (anchor, position)) in anchors.iter().zip(positions).enumerate() {
        if anchor.source == Some(i) {
            own += 1;
            continue;
        }
        let Some((u, v, z)) = camera.project(*position) else {
            continue;
        };
        if !(u >= 0.0 && v >= 0.0 && u < w && v < h) {
            continue;
        }
        held[k] = true;
        let cell = (v / h * CELLS as f64) as usize * CELLS + (u / w * CELLS as f64) as usize;
        if let Some(place) = nearest
            .get_mut(cell)
            .filter(|place| place.is_none_or(|(depth, ..)| z < depth))
        {
            *place = Some((z, k, [u, v]));
        }
    }
    let share =
        held.iter().filter(|held| **held).count() as f64 / (anchors.len() - own).max(1) as f64;
    let pairs = photo.map(|photo| {
        let of = |(_, k, [u, v]): &(f64, usize, [f64; 2])| {
            let pixel = photo.get_pixel(
                (*u as u32).min(photo.width() - 1),
                (*v as u32).min(photo.height() - 1),
            );
            Pair {
                point: anchors[*k].color.map(f64::from),
                pixel: pixel.0.map(|c| f64::from(c) / 255.0),
            }
        };
        nearest.iter().flatten().map(of).collect::<Vec<_>>()
    });
    Looked {
        held,
        share,
        moments: pairs
            .filter(|pairs| pairs.len() >= COMPARED)
            .map(|pairs| moments(&pairs)),
    }
}

/// Colours of a point and of the pixel that it falls on.
struct Pair {
    point: [f64; 3],
    pixel: [f64; 3],
}

fn moments(pairs: &[Pair]) -> [f64; 3] {
    let n = pairs.len().max(1) as f64;
    let mut sums = [0.0; 3];
    for c in 0..3 {
        let mean =
            |of: fn(&Pair) -> [f64; 3]| pairs.iter().map(|pair| of(pair)[c]).sum::<f64>() / n;
        let (point, pixel) = (mean(|pair| pair.point), mean(|pair| pair.pixel));
        for pair in pairs {
            let (a, b) = (pair.point[c] - point, pair.pixel[c] - pixel);
            [a * b, a * a, b * b]
                .iter()
                .zip(&mut sums)
                .for_each(|(term, sum)| *sum += term);
        }
    }
    sums
}

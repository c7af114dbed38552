//! Checks that poses are read in the convention in which they were written. With a wrong one, training fails without an error.
//!
//! A pose is a rotation and a translation, which may be camera-to-world or world-to-camera, in OpenGL or in OpenCV axes.
//! The layout defines which; a folder that was put together by hand may hold another one. The initial cloud shows it: with
//! the right convention its points lie in the photos, and have the colours of the pixels that they fall on.

use super::convention::Convention;
use crate::config::Layout;
use crate::data::formats::frame::Frame;
use crate::data::formats::listing::{Cloud, Listing};
use crate::data::options::evenly;
use crate::data::{Limits, Points, Scene};
use crate::error::{Error, invalid};
use crate::splat::camera::Camera;
use glam::DVec3;
use image::RgbImage;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Largest number of cameras, photos and points that are examined, evenly chosen.
const CAMERAS: usize = 256;
const PHOTOS: usize = 16;
const POINTS: usize = 4_096;
/// With fewer points there is no verdict.
const TOO_FEW_POINTS: usize = 100;
/// Cells across and down a photo. Only the nearest point of a cell is compared, because it may hide the others.
const CELLS: usize = 24;
/// Points that a photo must hold to be compared.
const COMPARED: usize = 8;

/// Agreement ([`Fit::agreement`]) below which the convention is clearly wrong, and above which it is clearly right.
///
/// Measured on two captures of objects, three of rooms and the built-in room, written in each of the four conventions,
/// whole and thinned out to every 3rd, 10th and 40th photo, with points of a cloud or of depth images: 0.81 to 0.91 in the
/// right convention, at most 0.18 in a wrong one; with only 200 points at least 0.50 and at most 0.32. A fault needs both
/// bounds: made-up colours, or colours that change with the exposure, only hide it.
const MISREAD: f64 = 0.3;
const READ: f64 = 0.5;
/// The same for the share of the points that some photo holds, which is all that a cloud without colours shows. Measured
/// on the same captures: 0.95 to 1.00 in the right convention (0.38 for three photos of a room), 0.00 to 1.00 in a wrong
/// one, as rooms have points on all sides. Wrong conventions above the first bound are not reported.
const UNSEEN: f64 = 0.5;
const SEEN: f64 = 0.9;
/// The share below which points and photos are unrelated.
const ELSEWHERE: f64 = 0.02;

/// A conflict between the cloud and the poses.
#[derive(Debug)]
pub(crate) enum Verdict {
    /// The poses follow another convention.
    Misread(Error),
    /// They fit in no convention. This is a notice.
    Unrelated(String),
}

/// A camera in world units, with its photo if that is compared.
struct Shot {
    camera: Camera,
    photo: Option<Arc<RgbImage>>,
}

/// A point with its colour, sRGB in 0..1.
struct Anchor {
    position: DVec3,
    color: [f32; 3],
    /// The shot whose depth image shows it; `position` is then in the axes of its camera, else in the world.
    source: Option<usize>,
}

/// How well points and photos fit.
#[derive(Clone, Copy, Debug)]
struct Fit {
    convention: Convention,
    /// Share of the points that a photo holds, median over the cameras.
    typical: f64,
    /// Share of the points that some photo holds.
    seen: f64,
    /// Correlation between colours of points and of the pixels they fall on, each photo's means taken out, times the
    /// share of the photos that hold points.
    agreement: f64,
}

/// Compares the points of a listing with its poses. Points of depth images depend on the poses and are computed again.
pub(crate) fn of_listing(listing: &Listing, points: &Points, limits: &Limits) -> Option<Verdict> {
    let posed: Vec<&Frame> = listing.frames.iter().filter(|frame| frame.posed).collect();
    let depth = match &listing.cloud {
        Cloud::Depth(depth) => Some(depth),
        _ => None,
    };
    if posed.is_empty() || (depth.is_none() && points.len() < TOO_FEW_POINTS) {
        return None;
    }
    let most = if depth.is_some() { PHOTOS } else { CAMERAS };
    let chosen = evenly(posed.len(), most);
    let shots = shots(chosen.len(), |place, with_photo| {
        let frame = posed[chosen[place]];
        let open = || {
            let (file, geometry) = frame.open(&listing.file, limits).ok()?;
            let photo = Some(Arc::new(geometry.photo(&file).ok()?));
            Some(Shot {
                camera: geometry.camera,
                photo,
            })
        };
        let camera = frame.camera.clone();
        with_photo.then(open).flatten().unwrap_or(Shot {
            camera,
            photo: None,
        })
    });
    let Some(depth) = depth else {
        return judge(
            listing.layout,
            &listing.file,
            &shots,
            &anchors(points, listing.origin()),
        );
    };
    let files: Vec<_> = listing
        .frames
        .iter()
        .zip(&depth.files)
        .filter(|(frame, _)| frame.posed)
        .collect();
    let made = shots.par_iter().enumerate().map(|(place, shot)| {
        let (frame, Some(file)) = files[chosen[place]] else {
            return Vec::new();
        };
        let most = POINTS / shots.len();
        let points = depth.of_frame(frame, file, &listing.file, most, shot.camera.center, limits);
        let mut anchors = anchors(&points.unwrap_or_default(), DVec3::ZERO);
        for anchor in &mut anchors {
            anchor.position = shot.camera.rotation * anchor.position;
            anchor.source = Some(place);
        }
        anchors
    });
    let made: Vec<Vec<Anchor>> = made.collect();
    let made: Vec<Anchor> = made.into_iter().flatten().collect();
    judge(listing.layout, &listing.file, &shots, &made)
}

/// Compares the points of a scene, which must not come from depth images, with its poses. `file` lists its frames.
pub(crate) fn of_scene(layout: Layout, file: &Path, scene: &Scene) -> Option<Verdict> {
    // Before photos are decoded for it.
    if scene.points.len() < TOO_FEW_POINTS {
        return None;
    }
    let chosen = evenly(scene.views.len(), CAMERAS);
    let shots = shots(chosen.len(), |place, with_photo| {
        let view = &scene.views[chosen[place]];
        let camera = view.camera.moved(scene.origin);
        let photo = with_photo.then(|| view.image.pixels().ok()).flatten();
        Shot { camera, photo }
    });
    judge(layout, file, &shots, &anchors(&scene.points, scene.origin))
}

/// `count` shots, some of them with photos, by their places.
fn shots(count: usize, shot: impl Fn(usize, bool) -> Shot + Sync) -> Vec<Shot> {
    let photos = evenly(count, PHOTOS);
    (0..count)
        .into_par_iter()
        .map(|place| shot(place, photos.contains(&place)))
        .collect()
}

fn anchors(points: &Points, origin: DVec3) -> Vec<Anchor> {
    let anchor = |i: usize| Anchor {
        position: DVec3::from(points.positions[i].map(f64::from)) + origin,
        color: points.colors[i],
        source: None,
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
    let of_layout = Convention::of(layout);
    let as_read = Fit::new(of_layout, of_layout, shots, anchors);
    if as_read.agreement >= MISREAD {
        return None;
    }
    let others: Vec<Fit> = of_layout
        .others()
        .map(|other| Fit::new(of_layout, other, shots, anchors))
        .collect();
    let best = |by: fn(&Fit) -> f64| others.iter().max_by(|a, b| by(a).total_cmp(&by(b)));
    let by_color = best(|fit| fit.agreement)?;
    if by_color.agreement > READ {
        let found = format!(
            "poses by which a photo holds {:.0} % of the initial points (median), whose colours correlate with its own by \
             {:.2}; {:.0} % and {:.2}",
            100.0 * as_read.typical,
            as_read.agreement,
            100.0 * by_color.typical,
            by_color.agreement
        );
        return Some(misread(layout, file, &found, by_color.convention));
    }
    // From here on colours say nothing, and points of depth images are in front of cameras in any convention.
    if by_color.agreement >= MISREAD || anchors.iter().any(|anchor| anchor.source.is_some()) {
        return None;
    }
    let by_place = best(|fit| {
        if fit.seen > SEEN {
            1.0 + fit.typical
        } else {
            fit.seen
        }
    })?;
    let is_better = by_place.seen > SEEN && by_place.typical > 2.0 * as_read.typical;
    if as_read.seen < UNSEEN && is_better {
        let (seen, other) = (100.0 * as_read.seen, 100.0 * by_place.seen);
        let found = format!(
            "poses by which the photos hold {seen:.0} % of the initial points; {other:.0} %"
        );
        return Some(misread(layout, file, &found, by_place.convention));
    }
    (as_read.seen < ELSEWHERE && by_place.seen <= SEEN).then(|| {
        Verdict::Unrelated(format!(
            "{}: the photos hold {:.1} % of the initial points, in every convention of poses: points and poses may be in \
             different coordinates",
            file.display(),
            100.0 * as_read.seen
        ))
    })
}

/// The fault of poses in another convention; `found` says how well both conventions fit.
fn misread(layout: Layout, file: &Path, found: &str, meant: Convention) -> Verdict {
    let mut path = file.to_owned();
    let field = match layout {
        Layout::Auto | Layout::Transforms => "transform_matrix of the frames",
        Layout::Colmap => "QW QX QY QZ TX TY TZ of the images",
        Layout::Replica => "rows",
        Layout::Scannet => {
            path = file
                .ancestors()
                .nth(2)
                .map_or(PathBuf::new(), |dir| dir.join("pose"));
            "matrices"
        }
    };
    Verdict::Misread(
        invalid!(path, "{field}"; found "{found} if they are {}", meant.name();
        expected "{}", Convention::of(layout).description(); help "{}", meant.help(layout)),
    )
}

impl Fit {
    /// How well points and photos fit when poses that were read as `as_read` are read in another convention.
    fn new(
        as_read: Convention,
        convention: Convention,
        shots: &[Shot],
        anchors: &[Anchor],
    ) -> Self {
        let cameras: Vec<Camera> = shots
            .iter()
            .map(|shot| convention.reread(as_read, &shot.camera))
            .collect();
        let world = |anchor: &Anchor| match anchor.source {
            Some(i) => cameras[i].rotation.transpose() * anchor.position + cameras[i].center,
            None => anchor.position,
        };
        let positions: Vec<DVec3> = anchors.iter().map(world).collect();
        let look = |(i, shot): (usize, &Shot)| {
            ShotFit::new(i, &cameras[i], shot.photo.as_deref(), anchors, &positions)
        };
        let fits: Vec<ShotFit> = shots.par_iter().enumerate().map(look).collect();
        let mut shares: Vec<f64> = fits.iter().map(|fit| fit.share).collect();
        shares.sort_by(f64::total_cmp);
        let seen = (0..anchors.len())
            .filter(|&i| fits.iter().any(|fit| fit.held[i]))
            .count();
        let moments: Vec<DVec3> = fits.iter().filter_map(|fit| fit.moments).collect();
        let sum: DVec3 = moments.iter().sum();
        let photos = shots.iter().filter(|shot| shot.photo.is_some()).count();
        let correlation = sum.x / (sum.y * sum.z).sqrt().max(1e-9);
        Self {
            convention,
            typical: shares.get(shares.len() / 2).copied().unwrap_or(0.0),
            seen: seen as f64 / anchors.len().max(1) as f64,
            agreement: correlation * moments.len() as f64 / photos.max(1) as f64,
        }
    }
}

/// Which points a shot shows.
struct ShotFit {
    /// Whether each lies in the image.
    held: Vec<bool>,
    /// Share of those that do, points of its own depth image left out.
    share: f64,
    /// Sums of products of the deviations of colours: of points and pixels, of points, of pixels. None without a photo, or
    /// with too few points in it.
    moments: Option<DVec3>,
}

impl ShotFit {
    fn new(
        i: usize,
        camera: &Camera,
        photo: Option<&RgbImage>,
        anchors: &[Anchor],
        positions: &[DVec3],
    ) -> Self {
        let (w, h) = (camera.width as f64, camera.height as f64);
        let mut held = vec![false; anchors.len()];
        let mut nearest: BTreeMap<[usize; 2], (f64, usize, [f64; 2])> = BTreeMap::new();
        let mut own = 0;
        for (k, (anchor, position)) in anchors.iter().zip(positions).enumerate() {
            if anchor.source == Some(i) {
                own += 1;
                continue;
            }
            let place = camera.project(*position);
            let Some((u, v, z)) =
                place.filter(|(u, v, _)| *u >= 0.0 && *v >= 0.0 && *u < w && *v < h)
            else {
                continue;
            };
            held[k] = true;
            let cell = [v / h, u / w].map(|share| (share * CELLS as f64) as usize);
            let nearest = nearest.entry(cell).or_insert((z, k, [u, v]));
            if z < nearest.0 {
                *nearest = (z, k, [u, v]);
            }
        }
        let count = held.iter().filter(|held| **held).count();
        let share = count as f64 / (anchors.len() - own).max(1) as f64;
        let photo = photo.filter(|_| nearest.len() >= COMPARED);
        let moments = photo.map(|photo| {
            let pairs = nearest.values().map(|(_, k, [u, v])| {
                let x = (*u as u32).min(photo.width() - 1);
                let y = (*v as u32).min(photo.height() - 1);
                let pixel = photo.get_pixel(x, y).0.map(|c| f64::from(c) / 255.0);
                (
                    DVec3::from(anchors[*k].color.map(f64::from)),
                    DVec3::from(pixel),
                )
            });
            moments(&pairs.collect::<Vec<_>>())
        });
        Self {
            held,
            share,
            moments,
        }
    }
}

/// Sums over the colours of points and pixels, as in [`ShotFit::moments`].
fn moments(pairs: &[(DVec3, DVec3)]) -> DVec3 {
    let count = pairs.len() as f64;
    let point = pairs.iter().map(|(point, _)| point).sum::<DVec3>() / count;
    let pixel = pairs.iter().map(|(_, pixel)| pixel).sum::<DVec3>() / count;
    let deviations = pairs.iter().map(|(a, b)| (*a - point, *b - pixel));
    deviations
        .map(|(a, b)| DVec3::new(a.dot(b), a.dot(a), b.dot(b)))
        .sum()
}

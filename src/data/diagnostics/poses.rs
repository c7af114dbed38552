//! Checks that poses are read in the convention in which they were written. With a wrong one, training fails without an error.
//!
//! A pose is a rotation and a translation, which may be camera-to-world or world-to-camera, in OpenGL or in OpenCV axes. The layout
//! defines the convention. A folder that was put together by hand may hold another one. The initial cloud shows it: with the right
//! convention its points lie in the photos, and have the colours of the pixels that they fall on.

use super::convention::Convention;
use crate::config::Layout;
use crate::data::Points;
use crate::data::formats::listing::{Cloud, Listing};
use crate::data::options::evenly;
use crate::error::{Error, invalid};
use crate::splat::camera::Camera;
use glam::DVec3;
use image::RgbImage;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Cameras, photos and points that are examined, at most. They are chosen evenly.
const MAX_CAMERAS: usize = 256;
const MAX_PHOTOS: usize = 16;
const MAX_POINTS: usize = 4_096;
/// Fewer points give no verdict.
const MIN_POINTS: usize = 100;
/// Cells across and down a photo. Only the nearest point in a cell is compared, because it may hide the others.
const GRID_CELLS: usize = 24;
/// A photo is compared if points lie in this many of its cells.
const MIN_COMPARED: usize = 8;

/// Agreement ([`Fit::agreement`]) below which the convention is clearly wrong, and above which it is clearly right.
///
/// Measured on two captures of objects, three of rooms and the built-in room, written in each of the four conventions,
/// whole and thinned out to every 3rd, 10th and 40th photo, with points of a cloud or of depth images: 0.81 to 0.91 in the
/// right convention, at most 0.18 in a wrong one; with only 200 points at least 0.50 and at most 0.32. A fault needs both
/// bounds: made-up colours, or colours that change with the exposure, only hide it.
const MAX_WRONG_AGREEMENT: f64 = 0.3;
const MIN_RIGHT_AGREEMENT: f64 = 0.5;
/// The same bounds for the share of the points that some photo shows. A cloud without colours gives only this share. Measured on
/// the same captures: 0.95 to 1.00 in the right convention (0.38 for three photos of a room), 0.00 to 1.00 in a wrong one, as
/// rooms have points on all sides. Wrong conventions above the first bound are not reported.
const MAX_WRONG_SEEN: f64 = 0.5;
const MIN_RIGHT_SEEN: f64 = 0.9;
/// Below this share, points and photos are unrelated.
const MAX_UNRELATED_SEEN: f64 = 0.02;
/// If no photo has points in more cells than this, the points are far away and make one spot: they are in another unit than the poses.
const MAX_CELLS_OF_SPOT: usize = 4;

/// A conflict between the cloud and the poses.
#[derive(Debug)]
pub(crate) enum Verdict {
    /// The poses follow another convention.
    Misread(Error),
    /// They fit in no convention. This is a notice.
    Unrelated(String),
}

/// A camera in world units, with its photo if colours are compared there.
struct CheckedView {
    camera: Camera,
    photo: Option<Arc<RgbImage>>,
}

/// A point with its colour, sRGB in 0..1.
struct CheckedPoint {
    position: DVec3,
    color: [f32; 3],
    /// The view whose depth image shows it; `position` is then in the axes of its camera, else in the world.
    source: Option<usize>,
}

/// How well points and photos fit.
#[derive(Clone, Copy, Debug)]
struct Fit {
    convention: Convention,
    /// Share of the points that a photo shows, median over the cameras.
    median_share: f64,
    /// Share of the points that some photo shows.
    seen_share: f64,
    /// Cells with points in the photo that has most of them.
    most_cells: usize,
    /// Correlation between colours of points and of the pixels they fall on, each photo's means taken out, times the
    /// share of the photos that hold points.
    agreement: f64,
}

/// Compares the points of a listing with its poses. Points of depth images depend on the poses and are computed again. `photo` opens
/// the photo of a frame, with the camera for it.
pub(crate) fn of_listing(
    listing: &Listing,
    points: &Points,
    photo: impl Fn(usize) -> Option<(Camera, Arc<RgbImage>)> + Sync,
) -> Option<Verdict> {
    let frames = &listing.frames;
    let posed: Vec<usize> = (0..frames.len()).filter(|&i| frames[i].posed).collect();
    let depth = match &listing.cloud {
        Cloud::Depth(depth) => Some(depth),
        _ => None,
    };
    if posed.is_empty() || (depth.is_none() && points.len() < MIN_POINTS) {
        return None;
    }
    let most = depth.map_or(MAX_CAMERAS, |_| MAX_PHOTOS);
    let chosen = evenly(posed.len(), most).into_iter();
    let chosen: Vec<usize> = chosen.map(|i| posed[i]).collect();
    let with_photo = evenly(chosen.len(), MAX_PHOTOS);
    let view = |(index, &frame): (usize, &usize)| {
        let opened = with_photo.contains(&index).then(|| photo(frame)).flatten();
        let (camera, photo) = opened.unzip();
        CheckedView {
            camera: camera.unwrap_or_else(|| frames[frame].camera.clone()),
            photo,
        }
    };
    let views: Vec<CheckedView> = chosen.par_iter().enumerate().map(view).collect();
    let Some(depth) = depth else {
        let points = checked_points(points, listing.origin());
        return verdict(listing.layout, &listing.file, &views, &points);
    };
    let made = views.par_iter().enumerate().map(|(index, view)| {
        let frame = chosen[index];
        let Some(file) = &depth.files[frame] else {
            return Vec::new();
        };
        let most = MAX_POINTS / views.len();
        let center = view.camera.center;
        let points = depth.of_frame(&frames[frame], file, &listing.file, most, center);
        let mut points = checked_points(&points.unwrap_or_default(), DVec3::ZERO);
        for point in &mut points {
            point.position = view.camera.rotation * point.position;
            point.source = Some(index);
        }
        points
    });
    let made: Vec<Vec<CheckedPoint>> = made.collect();
    let made: Vec<CheckedPoint> = made.into_iter().flatten().collect();
    verdict(listing.layout, &listing.file, &views, &made)
}

fn checked_points(points: &Points, origin: DVec3) -> Vec<CheckedPoint> {
    let point = |i: usize| CheckedPoint {
        position: DVec3::from(points.positions[i].map(f64::from)) + origin,
        color: points.colors[i],
        source: None,
    };
    let chosen = evenly(points.len(), MAX_POINTS).into_iter();
    chosen.map(point).collect()
}

fn verdict(
    layout: Layout,
    file: &Path,
    views: &[CheckedView],
    points: &[CheckedPoint],
) -> Option<Verdict> {
    if points.len() < MIN_POINTS {
        return None;
    }
    let of_layout = Convention::of(layout);
    let as_read = Fit::new(of_layout, of_layout, views, points);
    if as_read.agreement >= MAX_WRONG_AGREEMENT {
        return None;
    }
    let others: Vec<Fit> = of_layout
        .others()
        .map(|other| Fit::new(of_layout, other, views, points))
        .collect();
    let best = |score: fn(&Fit) -> f64| others.iter().max_by(|a, b| score(a).total_cmp(&score(b)));
    let by_agreement = best(|fit| fit.agreement)?;
    if by_agreement.agreement > MIN_RIGHT_AGREEMENT {
        let found = format!(
            "poses by which a photo holds {:.0} % of the initial points (median), whose colours correlate with its own by \
             {:.2}; {:.0} % and {:.2}",
            100.0 * as_read.median_share,
            as_read.agreement,
            100.0 * by_agreement.median_share,
            by_agreement.agreement
        );
        return Some(misread(layout, file, &found, by_agreement.convention));
    }
    // From here on colours say nothing, and points of depth images are in front of cameras in any convention.
    if by_agreement.agreement >= MAX_WRONG_AGREEMENT
        || points.iter().any(|point| point.source.is_some())
    {
        return None;
    }
    let by_seen = best(|fit| match fit.seen_share {
        share if share > MIN_RIGHT_SEEN => 1.0 + fit.median_share,
        share => share,
    })?;
    let is_better =
        by_seen.seen_share > MIN_RIGHT_SEEN && by_seen.median_share > 2.0 * as_read.median_share;
    if as_read.seen_share < MAX_WRONG_SEEN && is_better {
        let seen = 100.0 * as_read.seen_share;
        let other = 100.0 * by_seen.seen_share;
        let found = format!(
            "poses by which the photos hold {seen:.0} % of the initial points; {other:.0} %"
        );
        return Some(misread(layout, file, &found, by_seen.convention));
    }
    if (1..=MAX_CELLS_OF_SPOT).contains(&as_read.most_cells) && as_read.seen_share > MIN_RIGHT_SEEN
    {
        return Some(Verdict::Unrelated(format!(
            "{}: the initial points make a single spot in each photo: points and poses may be in different units",
            file.display()
        )));
    }
    (as_read.seen_share < MAX_UNRELATED_SEEN && by_seen.seen_share <= MIN_RIGHT_SEEN).then(|| {
        Verdict::Unrelated(format!(
            "{}: the photos hold {:.1} % of the initial points, in every convention of poses: points and poses may be in \
             different coordinates",
            file.display(),
            100.0 * as_read.seen_share
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
            let scene = file.ancestors().nth(2);
            path = scene.map_or(PathBuf::new(), |dir| dir.join("pose"));
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
        views: &[CheckedView],
        points: &[CheckedPoint],
    ) -> Self {
        let cameras: Vec<Camera> = views
            .iter()
            .map(|view| convention.reread(as_read, &view.camera))
            .collect();
        let world = |point: &CheckedPoint| match point.source {
            Some(i) => cameras[i].rotation.transpose() * point.position + cameras[i].center,
            None => point.position,
        };
        let positions: Vec<DVec3> = points.iter().map(world).collect();
        let look = |(i, view): (usize, &CheckedView)| {
            ViewFit::new(i, &cameras[i], view.photo.as_deref(), points, &positions)
        };
        let fits: Vec<ViewFit> = views.par_iter().enumerate().map(look).collect();
        let mut shares: Vec<f64> = fits.iter().map(|fit| fit.share).collect();
        shares.sort_by(f64::total_cmp);
        let seen = (0..points.len())
            .filter(|&i| fits.iter().any(|fit| fit.inside[i]))
            .count();
        let moments: Vec<DVec3> = fits.iter().filter_map(|fit| fit.moments).collect();
        let sum: DVec3 = moments.iter().sum();
        let photos = views.iter().filter(|view| view.photo.is_some()).count();
        let correlation = sum.x / (sum.y * sum.z).sqrt().max(1e-9);
        Self {
            convention,
            median_share: shares.get(shares.len() / 2).copied().unwrap_or(0.0),
            seen_share: seen as f64 / points.len().max(1) as f64,
            most_cells: fits.iter().map(|fit| fit.cells).max().unwrap_or(0),
            agreement: correlation * moments.len() as f64 / photos.max(1) as f64,
        }
    }
}

/// How well the points fit one view.
struct ViewFit {
    /// For each point, whether it lies in the image.
    inside: Vec<bool>,
    /// Share of the points that lie in the image, without those of its own depth image.
    share: f64,
    /// Cells of the image with points.
    cells: usize,
    /// Sums of products of the deviations of colours: of points and pixels, of points, of pixels. None without a photo, or
    /// with too few points in it.
    moments: Option<DVec3>,
}

impl ViewFit {
    fn new(
        i: usize,
        camera: &Camera,
        photo: Option<&RgbImage>,
        points: &[CheckedPoint],
        positions: &[DVec3],
    ) -> Self {
        let (w, h) = (camera.width as f64, camera.height as f64);
        let mut inside = vec![false; points.len()];
        let mut nearest: BTreeMap<[usize; 2], (f64, usize, [f64; 2])> = BTreeMap::new();
        let mut own = 0;
        for (k, (point, position)) in points.iter().zip(positions).enumerate() {
            if point.source == Some(i) {
                own += 1;
                continue;
            }
            let projected = camera.project(*position);
            let Some((u, v, z)) =
                projected.filter(|(u, v, _)| *u >= 0.0 && *v >= 0.0 && *u < w && *v < h)
            else {
                continue;
            };
            inside[k] = true;
            let cell = [v / h, u / w].map(|share| (share * GRID_CELLS as f64) as usize);
            let nearest = nearest.entry(cell).or_insert((z, k, [u, v]));
            if z < nearest.0 {
                *nearest = (z, k, [u, v]);
            }
        }
        let count = inside.iter().filter(|inside| **inside).count();
        let share = count as f64 / (points.len() - own).max(1) as f64;
        let cells = nearest.len();
        let photo = photo.filter(|_| cells >= MIN_COMPARED);
        let moments = photo.map(|photo| {
            let pairs = nearest.values().map(|(_, k, [u, v])| {
                let x = (*u as u32).min(photo.width() - 1);
                let y = (*v as u32).min(photo.height() - 1);
                let pixel = photo.get_pixel(x, y).0.map(|c| f64::from(c) / 255.0);
                let point = points[*k].color.map(f64::from);
                (DVec3::from(point), DVec3::from(pixel))
            });
            moments(&pairs.collect::<Vec<_>>())
        });
        Self {
            inside,
            share,
            cells,
            moments,
        }
    }
}

/// Sums over the colours of points and pixels, as in [`ViewFit::moments`].
fn moments(pairs: &[(DVec3, DVec3)]) -> DVec3 {
    let count = pairs.len() as f64;
    let point = pairs.iter().map(|(point, _)| point).sum::<DVec3>() / count;
    let pixel = pairs.iter().map(|(_, pixel)| pixel).sum::<DVec3>() / count;
    let deviations = pairs.iter().map(|(a, b)| (*a - point, *b - pixel));
    deviations
        .map(|(a, b)| DVec3::new(a.dot(b), a.dot(a), b.dot(b)))
        .sum()
}

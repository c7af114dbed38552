//! Finds the convention of poses in which neighbouring photos show the same things. Used if there is no cloud.
//!
//! Blocks of a small copy of a photo are searched in the next one at several depths (a plane sweep). With the right convention they
//! are found. With another one they are compared along wrong lines, and found by chance only.

use super::convention::Convention;
use crate::data::bilinear::among;
use crate::data::formats::frame::Frame;
use crate::data::formats::listing::Listing;
use crate::data::options::evenly;
use crate::splat::camera::Camera;
use glam::DVec3;
use image::RgbImage;
use image::imageops::{grayscale, thumbnail};
use rayon::prelude::*;

/// Most pairs of neighbouring photos that are compared. They are chosen evenly.
const MAX_PAIRS: usize = 12;
/// Fewer pairs than this give no verdict.
const MIN_PAIRS: usize = 4;
/// Width of a small photo, pixels.
const PHOTO_PIXELS: u32 = 96;
/// Width of a block, pixels.
const BLOCK_PIXELS: usize = 8;
/// Number of depths. Their inverses are evenly spaced, from 0 (infinitely far) on.
const DEPTHS: usize = 24;
/// The nearest depth, in distances between the two cameras.
const NEAREST_DEPTH: f64 = 1.5;
/// Standard deviation of a block, as a share of white, below which it looks like any other.
const MIN_DEVIATION: f64 = 0.02;
/// Correlation from which two blocks are alike.
const MIN_CORRELATION: f64 = 0.8;

/// Share of the blocks that a convention has to find again before it is reported.
///
/// Measured on two captures of objects and three of rooms: the right convention finds 0.47 to 0.82 of the blocks, a wrong one 0.07
/// to 0.56, at most 0.69 of the right share. With every 2nd, 4th and 12th photo the right one finds 0.08 to 0.78, and a wrong one
/// never more than the first bound: sparse captures give no answer. Neither does a video whose camera hardly moves: its frames are
/// alike in every convention.
const MIN_FOUND: f64 = 0.45;
/// It also has to find this many times the share that the layout's own convention finds.
const MIN_FOUND_RATIO: f64 = 1.4;
/// Share of the blocks that the next photo has to show in that convention.
const MIN_SHOWN: f64 = 0.25;

/// A notice if neighbouring photos fit better in a different convention than in that of the layout. It names the other one only where
/// they clearly do.
pub(super) fn better_convention(listing: &Listing) -> Option<String> {
    let frames = listing
        .frames
        .iter()
        .filter(|frame| frame.posed && frame.present);
    let mut frames: Vec<&Frame> = frames.collect();
    // Photos are mostly numbered in the order they were taken in, with or without leading zeros.
    frames.sort_by_key(|frame| (frame.name.len(), &frame.name));
    let small = |frame: &Frame| {
        let (file, geometry) = frame.open(&listing.file).ok()?;
        Some(SmallPhoto::new(
            &geometry.photo(&file).ok()?,
            &geometry.camera,
        ))
    };
    let first = evenly(frames.len().saturating_sub(1), MAX_PAIRS);
    let pairs = first
        .par_iter()
        .filter_map(|&i| Some([small(frames[i])?, small(frames[i + 1])?]));
    let pairs: Vec<[SmallPhoto; 2]> = pairs.collect();
    if pairs.len() < MIN_PAIRS {
        return None;
    }
    let of_layout = Convention::of(listing.layout);
    let as_read = Blocks::count(&pairs, of_layout, of_layout).share();
    let others = of_layout
        .others()
        .map(|other| (other, Blocks::count(&pairs, of_layout, other)));
    let (other, blocks) = others.max_by(|a, b| a.1.share().total_cmp(&b.1.share()))?;
    let share = blocks.share();
    let is_shown = blocks.shown as f64 > MIN_SHOWN * blocks.all as f64;
    let file = listing.file.display();
    if share > MIN_FOUND && share > MIN_FOUND_RATIO * as_read && is_shown {
        return Some(format!(
            "{file}: the poses may be {}: {:.0} % of a photo are then found again in the next one, and {:.0} % as they are; if \
             so, {}",
            other.name(),
            100.0 * share,
            100.0 * as_read,
            other.help(listing.layout)
        ));
    }
    // Where nothing tells, the layout's convention still fits best if it is the right one, except for the sparsest captures.
    (share > as_read).then(|| {
        format!(
            "{file}: the axes of the poses could not be checked: too little of a photo is found again in the next one ({:.0} %), and \
             the scene has no initial points, which would tell",
            100.0 * as_read
        )
    })
}

/// A small copy of a photo, grey in 0..1, with its camera.
struct SmallPhoto {
    camera: Camera,
    grey: Vec<f64>,
}

impl SmallPhoto {
    fn new(photo: &RgbImage, camera: &Camera) -> Self {
        let height =
            f64::from(PHOTO_PIXELS) * f64::from(photo.height()) / f64::from(photo.width().max(1));
        let height = (height.round() as u32).clamp(1, 8 * PHOTO_PIXELS);
        let grey = grayscale(&thumbnail(photo, PHOTO_PIXELS, height));
        Self {
            camera: camera.resized(PHOTO_PIXELS as usize, height as usize),
            grey: grey
                .pixels()
                .map(|pixel| f64::from(pixel.0[0]) / 255.0)
                .collect(),
        }
    }

    /// Bilinear, between the centres of pixels only.
    fn at(&self, u: f64, v: f64) -> Option<f64> {
        let (w, h) = (self.camera.width, self.camera.height);
        let (x, y) = (u - 0.5, v - 0.5);
        if !(x >= 0.0 && y >= 0.0 && x < (w - 1) as f64 && y < (h - 1) as f64) {
            return None;
        }
        let first = y as usize * w + x as usize;
        let corners = [first, first + 1, first + w, first + w + 1].map(|i| self.grey[i]);
        Some(among(corners, x.fract(), y.fract()))
    }
}

/// Numbers of blocks.
#[derive(Clone, Copy, Debug, Default)]
struct Blocks {
    /// Blocks that are not flat.
    all: usize,
    /// Blocks among `all` that the next photo shows at some depth.
    shown: usize,
    /// Blocks among `shown` that look alike there.
    alike: usize,
}

impl Blocks {
    fn share(self) -> f64 {
        self.alike as f64 / self.shown.max(1) as f64
    }

    /// The blocks of all pairs, with poses that were read as `as_read` reread as `other`.
    fn count(pairs: &[[SmallPhoto; 2]], as_read: Convention, other: Convention) -> Self {
        let of_pair = |[from, to]: &[SmallPhoto; 2]| {
            let [camera, next] = [from, to].map(|photo| other.reread(as_read, &photo.camera));
            Self::of_pair(from, to, &camera, &next)
        };
        let add = |a: Self, b: Self| Self {
            all: a.all + b.all,
            shown: a.shown + b.shown,
            alike: a.alike + b.alike,
        };
        pairs.par_iter().map(of_pair).reduce(Self::default, add)
    }

    fn of_pair(from: &SmallPhoto, to: &SmallPhoto, camera: &Camera, next: &Camera) -> Self {
        let turn = next.rotation * camera.rotation.transpose();
        let shift = next.to_camera(camera.center);
        let nearest = NEAREST_DEPTH * shift.length();
        let inverse_depth = |i: usize| i as f64 / (DEPTHS - 1) as f64 / nearest;
        // Cameras at one place see the same at every depth.
        let depths = (0..DEPTHS).map(|i| if nearest > 0.0 { inverse_depth(i) } else { 0.0 });
        let columns = camera.width / BLOCK_PIXELS;
        let mut blocks = Self::default();
        for block in 0..columns * (camera.height / BLOCK_PIXELS) {
            let left = block % columns * BLOCK_PIXELS;
            let top = block / columns * BLOCK_PIXELS;
            let pixels = (0..BLOCK_PIXELS * BLOCK_PIXELS)
                .map(|i| (left + i % BLOCK_PIXELS, top + i / BLOCK_PIXELS));
            let own: Vec<f64> = pixels
                .clone()
                .map(|(x, y)| from.grey[y * camera.width + x])
                .collect();
            if variance(&own) < MIN_DEVIATION * MIN_DEVIATION {
                continue;
            }
            let ray = |(x, y): (usize, usize)| {
                let x = (x as f64 + 0.5 - camera.cx) / camera.fx;
                let y = (y as f64 + 0.5 - camera.cy) / camera.fy;
                turn * DVec3::new(x, y, 1.0)
            };
            let rays: Vec<DVec3> = pixels.map(ray).collect();
            let seen = |inverse_depth: f64| -> Option<Vec<f64>> {
                let point = |ray: &DVec3| {
                    let p = *ray + shift * inverse_depth;
                    let (u, v) = (next.fx * p.x / p.z + next.cx, next.fy * p.y / p.z + next.cy);
                    if p.z > 0.0 { to.at(u, v) } else { None }
                };
                rays.iter().map(point).collect()
            };
            let best = depths
                .clone()
                .filter_map(|depth| Some(correlation(&own, &seen(depth)?)))
                .reduce(f64::max);
            blocks.all += 1;
            blocks.shown += usize::from(best.is_some());
            blocks.alike += usize::from(best.is_some_and(|best| best > MIN_CORRELATION));
        }
        blocks
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn covariance(a: &[f64], b: &[f64]) -> f64 {
    let (mean_a, mean_b) = (mean(a), mean(b));
    let products = a.iter().zip(b).map(|(a, b)| (a - mean_a) * (b - mean_b));
    products.sum::<f64>() / a.len().max(1) as f64
}

fn variance(values: &[f64]) -> f64 {
    covariance(values, values)
}

/// Correlation of two blocks; near 0 where a block is flat.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    covariance(a, b) / (variance(a) * variance(b) + 1e-8).sqrt()
}

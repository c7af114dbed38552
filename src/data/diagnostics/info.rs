//! The contents of a scene folder as figures and thumbnails. Only a few images are in memory at once.

use super::notices;
use crate::config::Layout;
use crate::data::formats::folder::scene_name;
use crate::data::formats::frame::Frame;
use crate::data::formats::frame_labels::FrameLabels;
use crate::data::formats::listing::Listing;
use crate::data::labels::raw::RawMap;
use crate::data::options::evenly;
use crate::data::{Classes, LabelMap, LoadOptions, Split};
use crate::error::{Result, in_order};
use glam::DVec3;
use image::RgbImage;
use image::imageops::{FilterType, resize};
use rayon::prelude::*;
use serde::Serialize;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::Path;

/// A scene in figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Info {
    /// Name of the folder.
    pub name: String,
    /// How it is laid out.
    pub layout: Layout,
    /// Training views.
    pub train: usize,
    /// Held-out views.
    pub test: usize,
    /// Width, height and number of the photos of each size, most first.
    pub sizes: Vec<(usize, usize, usize)>,
    /// Photos with lens distortion, which loading removes.
    pub distorted: usize,
    /// Views with masks that leave out pixels.
    pub masked: usize,
    /// Share of the pixels of all views that masks leave out, 0 to 1.
    pub left_out: f64,
    /// Where the cameras are.
    pub cameras: CameraBox,
    /// Points of the initial cloud.
    pub points: usize,
    /// Views with true labels.
    pub labelled: usize,
    /// Views with raw labels.
    pub raw_labelled: usize,
    /// Segments of all raw labels if their ids are valid only within a view (`data.association`); else 0.
    pub segments: usize,
    /// Share of the pixels of the raw labels that lie in these segments, 0 to 1.
    pub in_segments: f64,
    /// Views with true instances.
    pub instances: usize,
    /// The classes, and last the ignored id.
    pub classes: Vec<ClassShare>,
    /// What loading leaves out or assumes.
    pub notices: Vec<String>,
}

/// Positions of all cameras, in world units as the folder has them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CameraBox {
    /// Smallest coordinates.
    pub low: [f64; 3],
    /// Largest coordinates.
    pub high: [f64; 3],
    /// Mean, which is the origin of the loaded scene.
    pub mean: [f64; 3],
    /// Largest distance from the mean.
    pub extent: f64,
}

/// How much of the label maps a class covers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClassShare {
    /// Id in the label maps.
    pub id: u16,
    /// Name for people.
    pub name: String,
    /// Share of the pixels of the true labels, 0 to 1.
    pub truth: f64,
    /// Share of the pixels of the raw labels, 0 to 1. Segments without a class are of none of the classes, and not unlabelled.
    pub raw: f64,
    /// Views in whose true or raw labels it occurs.
    pub views: usize,
}

/// Indices into the counts of [`FrameInfo::of_classes`].
const TRUTH: usize = 0;
const RAW: usize = 1;

/// What a frame holds.
#[derive(Default)]
struct FrameInfo {
    size: (usize, usize),
    distorted: bool,
    /// Pixels of the view, after reduction.
    pixels: usize,
    /// Pixels that a mask leaves out.
    left_out: usize,
    /// Pixels of each class in the true labels and in the raw ones.
    of_classes: BTreeMap<u16, [u64; 2]>,
    /// Raw segments, where ids are not classes.
    segments: usize,
    /// Pixels in them.
    in_segments: u64,
    /// Pixels in those of no known class.
    classless: u64,
    /// Pixels of the raw labels.
    raw_pixels: u64,
}

/// Reads the headers of all photos and all label maps.
///
/// # Errors
/// As [`crate::data::load`].
pub fn info(dir: &Path, options: &LoadOptions) -> Result<Info> {
    let mut listing = listing(dir, options)?;
    let read = |frame| FrameInfo::new(&listing, frame, options);
    let frames = in_order(listing.frames.par_iter().map(read))?;
    let no_file = listing.no_label_file.as_ref().map(ToString::to_string);
    let notices = no_file.into_iter().chain(listing.raw.unmatched_classes());
    listing.notices.extend(notices);
    let mut sizes = BTreeMap::new();
    for frame in &frames {
        *sizes.entry(frame.size).or_insert(0) += 1;
    }
    let mut sizes: Vec<_> = sizes.into_iter().map(|((w, h), n)| (w, h, n)).collect();
    sizes.sort_by_key(|&(.., n)| Reverse(n));
    let left_out = frames.iter().map(|f| f.left_out);
    let pixels = frames.iter().map(|f| f.pixels);
    let in_segments = frames.iter().map(|f| f.in_segments);
    let raw_pixels = frames.iter().map(|f| f.raw_pixels);
    let count = |is: fn(&&Frame) -> bool| listing.frames.iter().filter(is).count();
    Ok(Info {
        name: scene_name(dir),
        layout: listing.layout,
        train: count(|frame| frame.split == Split::Train),
        test: count(|frame| frame.split == Split::Test),
        sizes,
        distorted: frames.iter().filter(|frame| frame.distorted).count(),
        masked: frames.iter().filter(|frame| frame.left_out > 0).count(),
        left_out: left_out.sum::<usize>() as f64 / pixels.sum::<usize>().max(1) as f64,
        cameras: camera_box(&listing),
        points: listing.points(listing.origin())?.len(),
        labelled: count(|frame| frame.truth.is_some()),
        raw_labelled: count(|frame| frame.raw.is_some()),
        segments: frames.iter().map(|frame| frame.segments).sum(),
        in_segments: in_segments.sum::<u64>() as f64 / raw_pixels.sum::<u64>().max(1) as f64,
        instances: count(|frame| frame.instances.is_some()),
        classes: class_shares(&listing, &frames),
        notices: listing.notices,
    })
}

fn class_shares(listing: &Listing, frames: &[FrameInfo]) -> Vec<ClassShare> {
    // Pixels of each class, and its views.
    let mut sums: BTreeMap<u16, ([u64; 2], usize)> = BTreeMap::new();
    let mut all = [0; 2];
    all[RAW] = frames.iter().map(|frame| frame.classless).sum();
    for (id, count) in frames.iter().flat_map(|frame| &frame.of_classes) {
        let (sum, views) = sums.entry(*id).or_default();
        *views += 1;
        for kind in [TRUTH, RAW] {
            sum[kind] += count[kind];
            all[kind] += count[kind];
        }
    }
    let share = |id: u16, name: &str| {
        let (sum, views) = sums.get(&id).copied().unwrap_or_default();
        let share = |kind: usize| sum[kind] as f64 / all[kind].max(1) as f64;
        ClassShare {
            id,
            name: name.to_owned(),
            truth: share(TRUTH),
            raw: share(RAW),
            views,
        }
    };
    let Classes { entries, ignore } = &listing.classes;
    let mut classes: Vec<_> = entries
        .iter()
        .map(|class| share(class.id, &class.name))
        .collect();
    classes.retain(|class| !listing.occurring_classes || class.views > 0);
    if !entries.is_empty() {
        classes.push(share(*ignore, "unlabelled"));
    }
    classes
}

fn listing(dir: &Path, options: &LoadOptions) -> Result<Listing> {
    let listing = notices::list_sound(dir, options)?;
    listing.check_sizes()?;
    Ok(listing)
}

impl FrameInfo {
    fn new(listing: &Listing, frame: &Frame, options: &LoadOptions) -> Result<Self> {
        let (file, labels) = FrameLabels::open(listing, frame, options)?;
        let camera = labels.geometry.view_camera();
        let mut info = Self {
            size: file.size,
            distorted: !frame.lens.is_pinhole(),
            pixels: camera.width * camera.height,
            left_out: labels.mask.as_ref().map_or(0, |mask| mask.left_out()),
            ..Self::default()
        };
        for (id, pixels) in pixels_by_id(&labels.truth()?.unwrap_or_default()) {
            info.of_classes.entry(id).or_default()[TRUTH] = pixels;
        }
        let Some(RawMap { map, segments }) = labels.raw()? else {
            return Ok(info);
        };
        for (id, pixels) in pixels_by_id(&map) {
            info.raw_pixels += pixels;
            let class = if !listing.raw.are_segments {
                Some(id)
            } else if id == listing.unlabelled() {
                Some(listing.classes.ignore)
            } else {
                info.segments += 1;
                info.in_segments += pixels;
                let segment = segments.iter().find(|segment| segment.id == id);
                segment.and_then(|segment| segment.class)
            };
            match class {
                Some(id) => info.of_classes.entry(id).or_default()[RAW] += pixels,
                None => info.classless += pixels,
            }
        }
        Ok(info)
    }
}

fn pixels_by_id(map: &LabelMap) -> impl Iterator<Item = (u16, u64)> {
    let mut all = vec![0_u64; 1 << 16];
    map.ids.iter().for_each(|&id| all[usize::from(id)] += 1);
    (0..=u16::MAX).zip(all).filter(|(_, n)| *n > 0)
}

fn camera_box(listing: &Listing) -> CameraBox {
    let (mean, extent) = listing.spread();
    let centers = || listing.frames.iter().map(|frame| frame.camera.center);
    CameraBox {
        low: centers().fold(DVec3::INFINITY, DVec3::min).to_array(),
        high: centers().fold(DVec3::NEG_INFINITY, DVec3::max).to_array(),
        mean: mean.to_array(),
        extent,
    }
}

/// A small copy of a view.
#[derive(Clone, Debug)]
pub struct Thumbnail {
    /// Name of the view.
    pub name: String,
    /// Train or test.
    pub split: Split,
    /// The photo, undistorted; black where a mask leaves pixels out.
    pub photo: RgbImage,
    /// Raw labels, if any; of the photo's size.
    pub raw: Option<LabelMap>,
    /// Whether the ids of raw labels are segments of this view.
    pub are_segments: bool,
    /// True labels, if any; of the photo's size.
    pub truth: Option<LabelMap>,
}

/// At most `count` views, `width` pixels wide, and the class table for their labels. They are chosen evenly, among views with raw
/// labels if there are any.
///
/// # Errors
/// As [`crate::data::load`].
pub fn thumbnails(
    dir: &Path,
    options: &LoadOptions,
    count: usize,
    width: u32,
) -> Result<(Vec<Thumbnail>, Classes)> {
    let listing = listing(dir, options)?;
    // Where a few photos are labelled, those are what one looks for.
    let is_raw = |i: &usize| listing.frames[*i].raw.is_some();
    let mut shown: Vec<usize> = (0..listing.frames.len()).filter(is_raw).collect();
    if shown.is_empty() {
        shown.extend(0..listing.frames.len());
    }
    let chosen = evenly(shown.len(), count);
    let made = in_order(chosen.into_par_iter().map(|i| {
        let frame = &listing.frames[shown[i]];
        let (file, labels) = FrameLabels::open(&listing, frame, options)?;
        let mut photo = labels.geometry.photo(&file)?;
        if let Some(mask) = &labels.mask {
            mask.fill(&mut photo, 3, 0);
        }
        let height = u64::from(photo.height()) * u64::from(width) / u64::from(photo.width().max(1));
        let height = height.clamp(1, 4 * u64::from(width)) as u32;
        let photo = resize(&photo, width.max(1), height, FilterType::Triangle);
        let size = (photo.width() as usize, photo.height() as usize);
        let small = |map: LabelMap| map.resized(size.0, size.1);
        let raw = labels.raw()?.map(|raw| small(raw.map));
        let truth = labels.truth()?.map(small);
        Ok(Thumbnail {
            name: frame.name.clone(),
            split: frame.split,
            photo,
            raw,
            are_segments: listing.raw.are_segments,
            truth,
        })
    }))?;
    Ok((made, listing.classes))
}

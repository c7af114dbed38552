//! What a scene folder holds, in figures and small pictures, without holding all of it in memory.

use crate::data::formats::frame::Frame;
use crate::data::formats::layout;
use crate::data::formats::listing::{Listing, Maps, Problems, in_order, scene_name};
use crate::data::labels::raw::RawMap;
use crate::data::{Classes, LabelMap, LoadOptions, Split};
use crate::error::Result;
use glam::DVec3;
use image::RgbImage;
use image::imageops::{FilterType, resize};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// A scene in figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Info {
    /// Name of the folder.
    pub name: String,
    /// How it is laid out.
    pub layout: &'static str,
    /// Training views.
    pub train: usize,
    /// Held-out views.
    pub test: usize,
    /// Width, height and number of the photos of each size, most first.
    pub sizes: Vec<(usize, usize, usize)>,
    /// Photos with lens distortion, which loading takes out.
    pub distorted: usize,
    /// Views of which masks leave pixels out.
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
    /// Segments of all raw labels, where their ids mean something within a view only (`data.association`); else 0.
    pub segments: usize,
    /// Views with true instances.
    pub instances: usize,
    /// The classes, and last the ignored id.
    pub classes: Vec<ClassShare>,
    /// What loading leaves out or takes for granted.
    pub notices: Vec<String>,
}

/// Positions of all cameras, in world units as the folder has them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CameraBox {
    /// Smallest coordinates.
    pub low: [f64; 3],
    /// Largest coordinates.
    pub high: [f64; 3],
    /// Mean, which loading takes for the origin.
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
    /// Share of the pixels of the raw labels, 0 to 1.
    pub raw: f64,
    /// Views in whose true or raw labels it occurs.
    pub views: usize,
}

/// What a frame holds.
struct Looked {
    size: (usize, usize),
    distorted: bool,
    /// Pixels as they are used, and how many of them a mask leaves out.
    pixels: [usize; 2],
    /// Pixels of each class in the true and in the raw labels.
    counts: [BTreeMap<u16, u64>; 2],
    /// Raw segments, where ids are not classes.
    segments: usize,
}

/// Reads the headers of all photos and all label maps.
///
/// # Errors
/// As [`crate::data::load`].
pub fn info(dir: &Path, options: &LoadOptions) -> Result<Info> {
    let listing = listing(dir, options)?;
    let known = listing.classes.lookup();
    let looked = in_order(
        listing
            .frames
            .par_iter()
            .map(|frame| look(&listing, frame, &known, options)),
    )?;
    let mut sizes = BTreeMap::new();
    let mut views = BTreeMap::new();
    let mut pixels: [BTreeMap<u16, u64>; 2] = Default::default();
    for Looked { size, counts, .. } in &looked {
        *sizes.entry(*size).or_insert(0) += 1;
        let mut ids: Vec<&u16> = counts.iter().flat_map(BTreeMap::keys).collect();
        ids.sort_unstable();
        ids.dedup();
        ids.into_iter()
            .for_each(|id| *views.entry(*id).or_insert(0) += 1);
        for (sum, counts) in pixels.iter_mut().zip(counts) {
            counts
                .iter()
                .for_each(|(id, n)| *sum.entry(*id).or_insert(0) += n);
        }
    }
    let [all, left_out] = [0, 1].map(|i| looked.iter().map(|l| l.pixels[i]).sum::<usize>());
    let mut sizes: Vec<_> = sizes.into_iter().map(|((w, h), n)| (w, h, n)).collect();
    sizes.sort_by_key(|&(.., n)| std::cmp::Reverse(n));
    let totals = [0, 1].map(|i| pixels[i].values().sum::<u64>().max(1) as f64);
    let share = |id: u16, name: String| ClassShare {
        id,
        name,
        truth: pixels[0].get(&id).copied().unwrap_or(0) as f64 / totals[0],
        raw: pixels[1].get(&id).copied().unwrap_or(0) as f64 / totals[1],
        views: views.get(&id).copied().unwrap_or(0),
    };
    let Classes { entries, ignore } = &listing.classes;
    let listed = entries
        .iter()
        .filter(|class| !listing.occurring_classes || views.contains_key(&class.id));
    let mut classes: Vec<ClassShare> = listed
        .map(|class| share(class.id, class.name.clone()))
        .collect();
    if !entries.is_empty() {
        classes.push(share(*ignore, "unlabelled".into()));
    }
    let count = |of: fn(&&Frame) -> bool| listing.frames.iter().filter(of).count();
    Ok(Info {
        name: scene_name(dir),
        layout: listing.layout.name(),
        train: count(|frame| frame.split == Split::Train),
        test: count(|frame| frame.split == Split::Test),
        sizes,
        distorted: looked.iter().filter(|l| l.distorted).count(),
        masked: looked.iter().filter(|l| l.pixels[1] > 0).count(),
        left_out: left_out as f64 / all.max(1) as f64,
        cameras: camera_box(&listing),
        points: listing.points(listing.origin(), &options.limits)?.len(),
        labelled: count(|frame| frame.truth.is_some()),
        raw_labelled: count(|frame| frame.raw.is_some()),
        segments: looked.iter().map(|l| l.segments).sum(),
        instances: count(|frame| frame.instances.is_some()),
        classes,
        notices: listing.notices,
    })
}

fn listing(dir: &Path, options: &LoadOptions) -> Result<Listing> {
    let mut problems = Problems::default();
    let listing = layout::list(dir, options, &mut problems)?;
    problems.none()?;
    listing.check_sizes(&options.limits)?;
    Ok(listing)
}

fn look(listing: &Listing, frame: &Frame, known: &[u16], options: &LoadOptions) -> Result<Looked> {
    let (file, geometry) = frame.open(&listing.file, &options.limits)?;
    let geometry = geometry.within(options.max_side);
    let mut counts: [BTreeMap<u16, u64>; 2] = Default::default();
    let mut segments = 0;
    let mask = frame.read_mask(&geometry, &options.limits)?;
    let maps = Maps {
        listing,
        frame,
        geometry: &geometry,
        known,
        limits: &options.limits,
        mask: mask.as_ref(),
    };
    if let Some(map) = maps.truth()? {
        counts[0] = pixels_by_id(&map);
    }
    if let Some(RawMap {
        map,
        segments: told,
    }) = maps.raw()?
    {
        let pixels = pixels_by_id(&map);
        if listing.raw.are_segments() {
            segments = pixels.keys().filter(|id| **id != 0).count();
            for (id, n) in pixels {
                let class = told
                    .iter()
                    .find(|segment| segment.id == id)
                    .and_then(|segment| segment.class);
                *counts[1]
                    .entry(class.unwrap_or(listing.classes.ignore))
                    .or_default() += n;
            }
        } else {
            counts[1] = pixels;
        }
    }
    let seen = geometry.seen();
    let pixels = [
        seen.width * seen.height,
        mask.map_or(0, |mask| mask.left_out()),
    ];
    Ok(Looked {
        size: file.size,
        distorted: !frame.lens.is_pinhole(),
        pixels,
        counts,
        segments,
    })
}

fn pixels_by_id(map: &LabelMap) -> BTreeMap<u16, u64> {
    let mut all = vec![0_u64; 1 << 16];
    map.ids.iter().for_each(|&id| all[usize::from(id)] += 1);
    (0..=u16::MAX).zip(all).filter(|(_, n)| *n > 0).collect()
}

fn camera_box(listing: &Listing) -> CameraBox {
    let mean = listing.origin();
    let centers = || listing.frames.iter().map(|frame| frame.camera.center);
    CameraBox {
        low: centers().fold(DVec3::INFINITY, DVec3::min).to_array(),
        high: centers().fold(DVec3::NEG_INFINITY, DVec3::max).to_array(),
        mean: mean.to_array(),
        extent: centers().map(|c| c.distance(mean)).fold(0.0, f64::max),
    }
}

/// A view made small.
#[derive(Clone, Debug)]
pub struct Thumbnail {
    /// Name of the view.
    pub name: String,
    /// Train or test.
    pub split: Split,
    /// The photo, undistorted; black where a mask leaves pixels out.
    pub photo: RgbImage,
    /// True labels, where there are none the raw ones; of the photo's size.
    pub labels: Option<LabelMap>,
}

/// At most `count` views, evenly chosen, `width` pixels wide, and the class table for their labels.
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
    let known = listing.classes.lookup();
    let all = listing.frames.len();
    let chosen: Vec<&Frame> = (0..count.min(all))
        .map(|i| &listing.frames[i * all / count.min(all)])
        .collect();
    let made = in_order(chosen.into_par_iter().map(|frame| {
        let (file, geometry) = frame.open(&listing.file, &options.limits)?;
        let geometry = geometry.within(options.max_side);
        let mut photo = geometry.photo(&file)?;
        let mask = frame.read_mask(&geometry, &options.limits)?;
        let mask = mask.as_ref();
        mask.into_iter()
            .for_each(|mask| mask.fill(&mut photo, 3, 0));
        let height = (u64::from(photo.height()) * u64::from(width)
            / u64::from(photo.width().max(1)))
        .clamp(1, 4 * u64::from(width));
        let photo = resize(&photo, width.max(1), height as u32, FilterType::Triangle);
        let (listing, limits) = (&listing, &options.limits);
        let maps = Maps {
            listing,
            frame,
            geometry: &geometry,
            known: &known,
            limits,
            mask,
        };
        let mut labels = maps.truth()?;
        if labels.is_none() {
            labels = maps.raw()?.map(|raw| raw.map);
        }
        let labels = labels.map(|map| map.resized(photo.width() as usize, photo.height() as usize));
        Ok(Thumbnail {
            name: frame.name.clone(),
            split: frame.split,
            photo,
            labels,
        })
    }))?;
    Ok((made, listing.classes))
}

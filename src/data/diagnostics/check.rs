//! Finds all faults of a scene folder in one pass.

use super::{notices, photometric_poses, poses};
use crate::config::Layout;
use crate::data::formats::camera_checks::check_intrinsics;
use crate::data::formats::folder::Problems;
use crate::data::formats::frame::Frame;
use crate::data::formats::frame_labels::FrameLabels;
use crate::data::formats::listing::Listing;
use crate::data::{LoadOptions, Split};
use crate::error::Error;
use rayon::prelude::*;
use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;

/// What [`check`] found.
#[derive(Debug, Default)]
pub struct Checked {
    /// The layout of the folder, if it could be determined.
    pub layout: Option<Layout>,
    /// Number of frames that were checked.
    pub frames: usize,
    /// All faults, in the order of frames and then of the files of the scene.
    pub problems: Vec<Error>,
    /// What loading leaves out or assumes.
    pub notices: Vec<String>,
}

/// Decodes every file that [`crate::data::load`] would read and continues after each fault. Only a few images are in memory at
/// once.
pub fn check(dir: &Path, options: &LoadOptions) -> Checked {
    let mut problems = Problems::default();
    let mut checked = Checked::default();
    let listing = notices::list(dir, options, &mut problems);
    if let Some(mut listing) = problems.ok(listing) {
        checked.layout = Some(listing.layout);
        checked.frames = listing.frames.len();
        checked.notices = std::mem::take(&mut listing.notices);
        if let Some(fault) = listing.no_label_file.take() {
            problems.push(fault);
        }
        checked
            .notices
            .extend(check_listing(&listing, options, &mut problems));
    }
    checked.problems = problems.all();
    checked
}

/// Checks the files of a listing. Faults go to `problems`; notices are returned.
fn check_listing(listing: &Listing, options: &LoadOptions, problems: &mut Problems) -> Vec<String> {
    problems.ok(listing.check_sizes());
    let frames = &listing.frames;
    for frame in frames.iter().filter(|frame| frame.posed) {
        problems.ok(check_intrinsics(&listing.file, &frame.name, &frame.camera));
    }
    let check = |frame| FrameCheck::new(listing, frame, options);
    let checks: Vec<_> = frames.par_iter().map(check).collect();
    let checked = frames.iter().zip(&checks);
    let train = checked.filter(|(frame, _)| frame.split == Split::Train);
    let void = train.filter_map(|(frame, check)| Some((&*frame.name, check.void?)));
    let void = notices::void_raw(void);
    let turned = frames.iter().zip(checks.iter().map(|check| check.turned));
    let notices = [
        notices::turned(turned),
        notices::inverted_masks(checks.iter().filter_map(|check| check.masked)),
        void.as_ref()
            .filter(|void| !void.are_all)
            .map(|void| void.notice()),
        listing.raw.unmatched_classes(),
    ];
    let mut notices: Vec<String> = notices.into_iter().flatten().collect();
    let nothing = void.filter(|void| void.are_all);
    nothing
        .iter()
        .for_each(|void| problems.push(void.fault(&listing.file)));
    checks
        .into_iter()
        .flat_map(|check| check.faults)
        .for_each(|fault| problems.push(fault));
    // A cloud of depth images opens photos again: a fault need not be reported twice.
    let reported: HashSet<String> = problems.messages().collect();
    match listing.points(listing.origin()) {
        Err(fault) if reported.contains(&fault.to_string()) => {}
        Err(fault) => problems.push(fault),
        Ok(points) if points.is_empty() => {
            notices.extend(notices::empty_cloud(&listing.cloud));
            // Other faults of the cameras come first.
            if notices::cameras(listing).is_empty() {
                notices.extend(photometric_poses::better_convention(listing));
            }
        }
        Ok(points) => {
            let photo = |i: usize| {
                let (file, geometry) = frames[i].open(&listing.file).ok()?;
                let photo = Arc::new(geometry.photo(&file).ok()?);
                Some((geometry.camera, photo))
            };
            match poses::of_listing(listing, &points, photo) {
                Some(poses::Verdict::Misread(fault)) => problems.push(fault),
                Some(poses::Verdict::Unrelated(notice)) => notices.push(notice),
                None => {}
            }
        }
    }
    notices
}

/// Findings in the files of a frame.
#[derive(Default)]
struct FrameCheck {
    faults: Vec<Error>,
    /// Whether its raw labels have no labelled pixel; `None` if there are none that can be read.
    void: Option<bool>,
    /// If it has a mask, its pixels and the pixels that the mask leaves out.
    masked: Option<[usize; 2]>,
    /// Whether its labels may belong to a turned photo, which sizes alone do not show.
    turned: bool,
}

impl FrameCheck {
    fn new(listing: &Listing, frame: &Frame, options: &LoadOptions) -> Self {
        let mut problems = Problems::default();
        let mut check = Self::default();
        let opened = frame.present.then(|| frame.open(&listing.file));
        let geometry = match opened.and_then(|opened| problems.ok(opened)) {
            Some((file, geometry)) => {
                problems.ok(geometry.photo(&file));
                check.turned = frame.may_be_turned(&file);
                Some(geometry)
            }
            // Label maps are as large as the photo should be.
            None => frame.own_geometry().ok(),
        };
        if let Some(geometry) = geometry.map(|geometry| geometry.limited_to(options.max_side)) {
            let mask = problems.ok(frame.read_mask(&geometry)).flatten();
            check.masked = mask
                .as_ref()
                .map(|mask| [mask.width() * mask.height(), mask.left_out()]);
            let labels = FrameLabels {
                listing,
                frame,
                geometry,
                mask,
            };
            problems.ok(labels.truth());
            let raw = problems.ok(labels.raw()).flatten();
            check.void = raw.map(|raw| raw.map.ids.iter().all(|&id| id == listing.unlabelled()));
            problems.ok(labels.instances());
            let scores = labels.scores();
            scores.map(|scores| problems.ok(scores.read(&listing.classes)));
        }
        check.faults = problems.all();
        check
    }
}

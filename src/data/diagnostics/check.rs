//! Everything that is wrong with a scene folder, at once.

use super::{cautions, poses, sweep};
use crate::config::Layout;
use crate::data::formats::frame::Frame;
use crate::data::formats::layout;
use crate::data::formats::listing::{Listing, Maps, Problems};
use crate::data::{LoadOptions, Split};
use crate::error::Error;
use rayon::prelude::*;
use std::collections::HashSet;
use std::path::Path;

/// What [`check`] found.
#[derive(Debug)]
pub struct Checked {
    /// How the folder is laid out, where that could be told.
    pub layout: Option<Layout>,
    /// Frames that were looked at.
    pub frames: usize,
    /// All faults, in the order of frames and then of the files of the scene.
    pub problems: Vec<Error>,
    /// What loading leaves out or takes for granted.
    pub notices: Vec<String>,
}

/// Looks at every file that [`crate::data::load`] would read, decodes it, and goes on after each fault. Needs memory for a
/// few images only.
pub fn check(dir: &Path, options: &LoadOptions) -> Checked {
    let mut problems = Problems::default();
    let mut listing = match layout::list(dir, options, &mut problems) {
        Ok(listing) => listing,
        Err(fault) => {
            problems.push(fault);
            return Checked {
                layout: None,
                frames: 0,
                problems: problems.all(),
                notices: Vec::new(),
            };
        }
    };
    let limits = &options.limits;
    problems.keep(listing.check_sizes(limits));
    // Without a class table, which is a fault that was told, no id can be wrong.
    let known = if listing.classes.is_empty() {
        vec![0; 1 << 16]
    } else {
        listing.classes.lookup()
    };
    let mut found = Vec::new();
    listing
        .frames
        .par_iter()
        .map(|frame| check_frame(&listing, frame, &known, options))
        .collect_into_vec(&mut found);
    let train = listing
        .frames
        .iter()
        .zip(&found)
        .filter(|(frame, _)| frame.split == Split::Train);
    let void =
        cautions::void_raw(train.filter_map(|(frame, found)| Some((&*frame.name, found.void?))));
    let masked = cautions::inverted(found.iter().filter_map(|found| found.masked));
    let turned = cautions::turned(
        listing
            .frames
            .iter()
            .zip(found.iter().map(|found| found.turned)),
    );
    let mut notices: Vec<String> = turned.into_iter().chain(masked).chain(void).collect();
    found
        .into_iter()
        .flat_map(|found| found.faults)
        .for_each(|fault| problems.push(fault));
    // A cloud from depth opens photos again: the same fault need not be told twice.
    let told: HashSet<String> = problems.messages().collect();
    match listing.points(listing.origin(), limits) {
        Err(fault) if told.contains(&fault.to_string()) => {}
        Err(fault) => problems.push(fault),
        Ok(points) if points.is_empty() => {
            notices.extend(cautions::empty_cloud(&listing.cloud));
            // Cameras that are wrong in themselves are to be mended first.
            if cautions::of_cameras(&listing).is_empty() {
                notices.extend(sweep::better_convention(&listing, limits));
            }
        }
        Ok(points) => match poses::of_listing(&listing, &points, limits) {
            Some(poses::Verdict::Misread(fault)) => problems.push(fault),
            Some(poses::Verdict::Unrelated(notice)) => notices.push(notice),
            None => {}
        },
    }
    listing.notices.append(&mut notices);
    Checked {
        layout: Some(listing.layout),
        frames: listing.frames.len(),
        problems: problems.all(),
        notices: listing.notices,
    }
}

/// What was found of a frame.
struct Found {
    faults: Vec<Error>,
    /// Whether all of its raw labels are unlabelled pixels, where it has any that can be read.
    void: Option<bool>,
    /// Its pixels and how many of them its mask leaves out, where it leaves some out.
    masked: Option<[usize; 2]>,
    /// Whether its labels may be of a photo that was turned, and no size tells.
    turned: bool,
}

fn check_frame(listing: &Listing, frame: &Frame, known: &[u16], options: &LoadOptions) -> Found {
    let limits = &options.limits;
    let mut problems = Problems::default();
    let opened = if frame.present {
        problems.keep(frame.open(&listing.file, limits))
    } else {
        None
    };
    let mut turned = false;
    let geometry = match opened {
        Some((file, geometry)) => {
            problems.keep(geometry.photo(&file));
            turned = frame.is_turned_unseen(&file);
            Some(geometry)
        }
        // Label maps are as large as the photo should be.
        None => frame
            .geometry((frame.camera.width, frame.camera.height))
            .ok(),
    };
    let geometry = geometry.map(|geometry| geometry.within(options.max_side));
    let (mut void, mut masked) = (None, None);
    if let Some(geometry) = &geometry {
        let mask = problems.keep(frame.read_mask(geometry, limits)).flatten();
        let mask = mask.as_ref();
        masked = mask.map(|mask| [mask.width() * mask.height(), mask.left_out()]);
        let maps = Maps {
            listing,
            frame,
            geometry,
            known,
            limits,
            mask,
        };
        problems.keep(maps.truth());
        let raw = problems.keep(maps.raw()).flatten();
        void = raw.map(|raw| raw.map.ids.iter().all(|&id| id == listing.unlabelled()));
        problems.keep(maps.instances());
    }
    Found {
        faults: problems.all(),
        void,
        masked,
        turned,
    }
}

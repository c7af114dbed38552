//! Everything that is wrong with a scene folder, at once.

use super::listing::{Frame, Listing, Problems};
use super::{LoadOptions, layout};
use crate::config::Layout;
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

/// Looks at every file that [`super::load`] would read, decodes it, and goes on after each fault. Needs memory for a
/// few images only.
pub fn check(dir: &Path, options: &LoadOptions) -> Checked {
    let mut problems = Problems::default();
    let listing = match layout::list(dir, options, &mut problems) {
        Ok(listing) => listing,
        Err(fault) => {
            problems.push(fault);
            return Checked { layout: None, frames: 0, problems: problems.all(), notices: Vec::new() };
        }
    };
    let limits = &options.limits;
    problems.keep(listing.check_sizes(limits));
    // Without a class table, which is a fault that was told, no id can be wrong.
    let known = if listing.classes.is_empty() { vec![0; 1 << 16] } else { listing.classes.lookup() };
    let mut found = Vec::new();
    listing.frames.par_iter().map(|frame| check_frame(&listing, frame, &known, options)).collect_into_vec(&mut found);
    found.into_iter().flatten().for_each(|fault| problems.push(fault));
    // A cloud from depth opens photos again: the same fault need not be told twice.
    let told: HashSet<String> = problems.messages().collect();
    if let Err(fault) = listing.points(listing.origin(), limits)
        && !told.contains(&fault.to_string())
    {
        problems.push(fault);
    }
    Checked {
        layout: Some(listing.layout),
        frames: listing.frames.len(),
        problems: problems.all(),
        notices: listing.notices,
    }
}

fn check_frame(listing: &Listing, frame: &Frame, known: &[u16], options: &LoadOptions) -> Vec<Error> {
    let limits = &options.limits;
    let mut problems = Problems::default();
    let opened = if frame.present { problems.keep(frame.open(&listing.file, limits)) } else { None };
    let geometry = match opened {
        Some((file, geometry)) => {
            problems.keep(geometry.photo(&file));
            Some(geometry)
        }
        // Label maps are as large as the photo should be.
        None => frame.geometry((frame.camera.width, frame.camera.height)).ok(),
    };
    if let Some(geometry) = &geometry {
        problems.keep(listing.truth(frame, geometry, known, limits));
        problems.keep(listing.raw(frame, geometry, known, limits));
        problems.keep(listing.instances(frame, geometry, limits));
    }
    problems.all()
}

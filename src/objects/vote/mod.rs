//! The vote: each Gaussian takes the class with the largest summed alpha' T over the raw labels of the training views.
//!
//! This is the closed-form baseline that a trained decoder has to beat (FlashSplat solves the same table as a linear
//! programme). Labels are lifted by the adjoint of blending, one channel a class.

mod tables;
mod view_votes;
mod votes;

pub use self::votes::Votes;

use self::tables::VoteTables;
use self::view_votes::ViewVotes;
use crate::data::{Classes, View};
use crate::error::Result;
use crate::memory;
use crate::ranks;
use crate::raster::{Settings, SplatTensors};
use crate::splat::Gaussians;
use burn::tensor::Device;

/// Steps of expectation maximisation in [`refined_vote`]. More of them fit the errors of the labels.
const REFINEMENTS: usize = 2;

/// Collects the votes of all `views` that have raw labels, on `device`: one vote of each labelled pixel for its class.
///
/// # Errors
/// Those of [`SplatView::blend_adjoint`](crate::raster::SplatView::blend_adjoint); [`crate::Error::Limit`] for more votes than
/// fit into memory.
pub fn vote<'a>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    classes: &Classes,
    settings: &Settings,
    device: &Device,
) -> Result<Votes> {
    let cast = |view: &View| Ok(ViewVotes::of_labels(view, classes));
    collect(gaussians, views, classes, cast, None, settings, device)
}

/// Votes for labels with errors: as [`vote`], but labelled pixels of views with scores divide their vote among classes as the
/// segmenter does, and with `distance` the votes of a view on a Gaussian are multiplied by its distance from the camera. Near views
/// have the most pixels of a Gaussian, but a network sees too little of an object in them.
///
/// # Errors
/// Those of [`vote`] and of [`ViewScores::read`](crate::data::ViewScores::read).
pub fn weighted_vote<'a>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    classes: &Classes,
    distance: bool,
    settings: &Settings,
    device: &Device,
) -> Result<Votes> {
    let weighted = distance.then_some(gaussians);
    let cast = |view: &View| ViewVotes::of_scores(view, classes, weighted, device);
    collect(gaussians, views, classes, cast, None, settings, device)
}

/// The [`weighted_vote`] after `REFINEMENTS` steps of expectation maximisation (Dempster et al. 1977), which undo the blur of
/// blending. The label of a pixel is taken as drawn from the blended class shares `sum_j w_j p_jc` of its Gaussians. Its vote for
/// class c counts `w_i p_ic / sum_j w_j p_jc` on Gaussian i, where the shares p are those of the votes before. From equal shares, a
/// step gives the votes without refinement, divided by the coverage of their pixels.
///
/// # Errors
/// Those of [`weighted_vote`].
pub fn refined_vote<'a>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    classes: &Classes,
    distance: bool,
    settings: &Settings,
    device: &Device,
) -> Result<Votes> {
    let views: Vec<&View> = views.collect();
    let views = || views.iter().copied();
    let mut votes = weighted_vote(gaussians, views(), classes, distance, settings, device)?;
    let weighted = distance.then_some(gaussians);
    for _ in 0..REFINEMENTS {
        let shares = Some(votes.shares());
        let cast = |view: &View| ViewVotes::of_scores(view, classes, weighted, device);
        votes = collect(gaussians, views(), classes, cast, shares, settings, device)?;
    }
    Ok(votes)
}

/// Sums what the views with raw labels `cast`. With `shares`, a vote counts in the Gaussians of its pixel by these, see
/// [`refined_vote`]. [Ranks](crate::ranks) divide the views.
fn collect<'a>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    classes: &Classes,
    cast: impl Fn(&View) -> Result<ViewVotes>,
    shares: Option<Votes>,
    settings: &Settings,
    device: &Device,
) -> Result<Votes> {
    let classes = classes.len();
    if gaussians.is_empty() || classes == 0 {
        return Ok(Votes {
            table: Vec::new(),
            classes,
        });
    }
    // The sums on the device, and what is read back or comes from the round before.
    memory::check_scores(gaussians.len(), classes, 2)?;
    let splats = SplatTensors::new(gaussians, device);
    let mut tables = VoteTables::new(&splats, classes);
    for view in ranks::share(views.filter(|view| view.raw.is_some())) {
        let seen = splats.seen_by(&view.camera, settings);
        tables.add(&seen, &cast(view)?, shares.as_ref())?;
    }
    let mut votes = tables.read()?;
    ranks::sum(&mut votes.table);
    Ok(votes)
}

//! Blocks of a scene that is larger than a machine: a grid over the floor, and for each cell the frames that show it.
//!
//! [`split`] plans them, [`Block::write`] makes a folder of each, and [`crate::data::load`] reads such a folder as a scene: the photos
//! of the block, and its part of the initial cloud.

pub use super::formats::block::{BLOCK, Block, Grid, Reading, Region, block_name};

use super::formats::block::{PointSample, nearest};
use crate::data::formats::folder::Problems;
use crate::data::formats::frame::Frame;
use crate::data::formats::layout;
use crate::data::formats::listing::Listing;
use crate::data::{LoadOptions, Points, Split};
use crate::error::{Result, ensure};
use crate::files;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashMap;
use std::path::Path;

/// A frame belongs to a block if it was taken in the block's region, or if the block's core fills at least this share of the cells
/// of the photo that show points.
const MIN_SHARE: f64 = 0.25;

/// A block that was planned and is not written yet.
#[derive(Clone, Debug)]
pub struct PlannedBlock {
    /// The block; its [`Block::scene`] is an absolute path.
    pub block: Block,
    /// Points of the initial cloud that its training starts from.
    pub points: usize,
}

/// Splits the scene in folder `dir` into `counts` columns and rows of blocks. Photos are not decoded, unless the initial cloud
/// has to be made from depth images.
///
/// # Errors
/// As [`crate::data::load`] for the list of frames and the cloud; [`crate::Error::Argument`] for a folder that is a block itself, and
/// as [`Grid::new`].
pub fn split(dir: &Path, options: &LoadOptions, counts: [usize; 2]) -> Result<Vec<PlannedBlock>> {
    ensure!(Block::in_folder(dir)?.is_none(), argument "--data"; found "{}, a block", dir.display();
        expected "a whole scene"; help "split the scene into more blocks");
    let mut listing = Problems::first_of(|problems| layout::list(dir, options, problems))?;
    listing.check_sizes()?;
    let train = listing
        .frames
        .iter()
        .filter(|frame| frame.split == Split::Train);
    let places: Vec<DVec3> = train.map(|frame| frame.camera.center).collect();
    let grid = Grid::new(counts, &places, listing.up())?;
    let origin = listing.origin();
    let points = listing.points(origin)?;
    let members = members(&listing, &points, origin, &grid);
    let scene = files::absolute(dir)?;
    let reading = Reading::of(options, listing.layout);
    let frames = std::mem::take(&mut listing.frames);
    let planned = grid.indices().zip(&members).map(|(index, members)| {
        let shown: Vec<&Frame> = members.iter().map(|&i| &frames[i]).collect();
        let names = |split: Split| {
            let of_split = shown.iter().filter(|frame| frame.split == split);
            of_split.map(|frame| frame.name.clone()).collect()
        };
        let mut start = points.clone();
        grid.extended(index).thin(&mut start, &shown, origin);
        let mut block = Block::new(scene.clone(), reading.clone(), grid.clone(), index);
        block.train = names(Split::Train);
        block.test = names(Split::Test);
        PlannedBlock {
            block,
            points: start.len(),
        }
    });
    Ok(planned.collect())
}

/// For each block of the grid the frames that belong to it, by number.
fn members(listing: &Listing, points: &Points, origin: DVec3, grid: &Grid) -> Vec<Vec<usize>> {
    let places = PointSample::new(points, origin).positions;
    let cells: Vec<[usize; 2]> = places.iter().map(|place| grid.cell(*place)).collect();
    let regions: Vec<_> = grid.indices().map(|index| grid.extended(index)).collect();
    let blocks_of = |frame: &Frame| -> Vec<bool> {
        let shown = nearest(&frame.camera, &places);
        let mut counts: HashMap<[usize; 2], usize> = HashMap::new();
        shown
            .iter()
            .for_each(|&point| *counts.entry(cells[point]).or_default() += 1);
        let least = MIN_SHARE * shown.len().max(1) as f64;
        let belongs = grid.indices().zip(&regions).map(|(index, region)| {
            let count = counts.get(&index).copied().unwrap_or(0);
            count as f64 >= least || region.contains(frame.camera.center)
        });
        belongs.collect()
    };
    let blocks: Vec<Vec<bool>> = listing.frames.par_iter().map(blocks_of).collect();
    let members = |block: usize| (0..blocks.len()).filter(|&i| blocks[i][block]).collect();
    (0..regions.len()).map(members).collect()
}

//! Blocks of a scene that is larger than a machine: a grid over the floor, and for each cell the frames that show it.
//!
//! [`split`] plans them, [`Block::write`] makes a folder of each, and [`crate::data::load`] reads such a folder as a scene: the photos
//! of the block, and its part of the initial cloud.

mod file;
mod grid;
mod plan;
mod region;
mod visibility;

pub use self::file::{BLOCK, Block, Reading};
pub use self::grid::{Grid, block_name};
pub use self::plan::{PlannedBlock, split};
pub use self::region::Region;

//! Folders of blocks: each names the folder of the whole scene, and the frames that show its cell of a grid over the floor.

mod file;
mod grid;
mod region;
mod visibility;

pub use self::file::{BLOCK, Block, Reading};
pub use self::grid::{Grid, block_name};
pub use self::region::Region;
pub(crate) use self::visibility::{PointSample, nearest};

/// Help for a block that does not fit its scene.
pub(super) const AGAIN: &str = "split the scene again";

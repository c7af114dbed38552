//! Bounds on what a scene may claim, checked before anything of that size is allocated.

use crate::error::{Error, Result};

/// Largest sizes that loaders accept; raise a field to load more.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Frames of one scene.
    pub views: usize,
    /// Pixels of one image.
    pub image_pixels: u64,
    /// Rows of a point cloud or Gaussian file.
    pub points: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            views: 65_536,
            image_pixels: 1 << 27,
            points: 1 << 28,
        }
    }
}

impl Limits {
    /// An [`Error::Limit`] when `found` is larger than `limit`.
    pub(crate) fn check(what: impl Into<String>, found: u64, limit: u64, help: &str) -> Result<()> {
        if found <= limit {
            return Ok(());
        }
        Err(Error::Limit {
            what: what.into(),
            found: found.to_string(),
            limit: limit.to_string(),
            help: help.into(),
        })
    }
}

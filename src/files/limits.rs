//! Limits on sizes that files declare, checked before memory is allocated.

use crate::error::{Result, ensure};
use smart_default::SmartDefault;
use std::path::Path;

/// Largest sizes that loaders accept; raise a field to load more.
#[derive(Clone, Debug, PartialEq, Eq, SmartDefault)]
pub struct Limits {
    /// Frames of one scene.
    #[default(65_536)]
    pub views: usize,
    /// Pixels of one image.
    #[default(1 << 27)]
    pub image_pixels: u64,
    /// Rows of a point cloud or Gaussian file.
    #[default(1 << 28)]
    pub points: u64,
}

impl Limits {
    /// Refuses more than [`Limits::views`] frames in the file at `path`.
    pub(crate) fn check_views(&self, path: &Path, count: usize) -> Result<()> {
        let help = "thin out with data.stride or data.max_frames";
        check_limit(path, "frames", count as u64, self.views as u64, help)
    }

    /// Refuses an image at `path` with more than [`Limits::image_pixels`] pixels.
    pub(crate) fn check_pixels(&self, path: &Path, width: usize, height: usize) -> Result<()> {
        let pixels = (width as u64).saturating_mul(height as u64);
        check_limit(
            path,
            "pixels",
            pixels,
            self.image_pixels,
            "lower the size of the image",
        )
    }

    /// Refuses more than [`Limits::points`] points in the file at `path`.
    pub(crate) fn check_points(&self, path: &Path, count: u64) -> Result<()> {
        check_limit(path, "points", count, self.points, "thin the cloud out")
    }
}

/// An [`crate::Error::Limit`] when `found` is larger than `limit`.
pub(crate) fn check_limit(
    path: &Path,
    what: &str,
    found: u64,
    limit: u64,
    help: &str,
) -> Result<()> {
    ensure!(found <= limit, limit "{}: {what}", path.display(); found "{found}"; expected "{limit}"; help "{help}");
    Ok(())
}

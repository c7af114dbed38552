//! Limits on sizes that files declare, checked before memory is allocated.

use crate::error::{Result, ensure};
use std::path::Path;

/// Frames of one scene, at most.
pub const MAX_VIEWS: u64 = 65_536;
/// Pixels of one image, at most.
pub const MAX_IMAGE_PIXELS: u64 = 1 << 27;
/// Rows of a point cloud or Gaussian file, at most.
pub const MAX_POINTS: u64 = 1 << 28;

/// Refuses more than [`MAX_VIEWS`] frames in the file at `path`.
pub(crate) fn check_views(path: &Path, count: usize) -> Result<()> {
    let help = "thin out with data.stride or data.max_frames";
    check_limit(path, "frames", count as u64, MAX_VIEWS, help)
}

/// Refuses an image at `path` with more than [`MAX_IMAGE_PIXELS`] pixels.
pub(crate) fn check_pixels(path: &Path, width: usize, height: usize) -> Result<()> {
    let pixels = (width as u64).saturating_mul(height as u64);
    let help = "lower the size of the image";
    check_limit(path, "pixels", pixels, MAX_IMAGE_PIXELS, help)
}

/// Refuses more than [`MAX_POINTS`] points in the file at `path`.
pub(crate) fn check_points(path: &Path, count: u64) -> Result<()> {
    check_limit(path, "points", count, MAX_POINTS, "thin the cloud out")
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_at_the_limits_pass_and_larger_ones_are_refused() {
        let path = Path::new("a.file");
        let refused = |result: Result<()>, what: &str| {
            let error = result.expect_err(what);
            let message = error.to_string();
            assert!(matches!(error, crate::Error::Limit { .. }), "{message}");
            let named = format!("a.file: {what}");
            assert!(
                message.contains(&named) && message.contains("exceeds the limit"),
                "{message}"
            );
        };
        check_views(path, 65_536).expect("frames");
        refused(check_views(path, 65_537), "frames");
        check_pixels(path, 1 << 14, 1 << 13).expect("pixels");
        refused(check_pixels(path, 1 << 14, (1 << 13) + 1), "pixels");
        refused(check_pixels(path, usize::MAX, usize::MAX), "pixels");
        check_points(path, 1 << 28).expect("points");
        refused(check_points(path, (1 << 28) + 1), "points");
    }
}

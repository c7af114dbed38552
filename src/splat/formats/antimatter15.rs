//! The `.splat` files of antimatter15's viewer: 32 bytes a Gaussian, without a header and without view-dependent colour.
//!
//! A row has the position and the standard deviations as six floats, the colour and the opacity as four bytes, and the quaternion
//! w, x, y, z as four bytes, 128 for 0.

use super::{PlyScene, logit, scene_of};
use crate::error::{Result, ensure};
use crate::files;
use crate::splat::{Gaussians, SH_0};
use std::path::Path;

/// Bytes of a Gaussian.
const ROW: usize = 32;

/// Reads such a file.
///
/// # Errors
/// [`crate::Error::Input`], [`crate::Error::Limit`], [`crate::Error::Io`].
pub(super) fn read(path: &Path) -> Result<PlyScene> {
    let bytes = files::read(path)?;
    let (rows, rest) = bytes.as_chunks::<ROW>();
    ensure!(rest.is_empty(), path, "size"; found "{} bytes", bytes.len(); expected "a multiple of {ROW}";
        help "the file is cut off, or of another format; export it again");
    files::check_points(path, rows.len() as u64)?;
    let mut gaussians = Gaussians::default();
    for row in rows {
        let (floats, bytes) = row.split_at(24);
        let words = floats.as_chunks::<4>().0.iter();
        let mut floats = words.copied().map(f32::from_le_bytes);
        let mut three = || [0; 3].map(|_| floats.next().unwrap_or_default());
        gaussians.means.push(three());
        // A flat Gaussian has a standard deviation of 0, whose logarithm is infinite.
        let log = |v: f32| {
            if v <= 0.0 {
                f32::MIN_POSITIVE.ln()
            } else {
                v.ln()
            }
        };
        gaussians.log_scales.push(three().map(log));
        let color = |&v: &u8| (f32::from(v) / 255.0 - 0.5) / SH_0;
        gaussians.sh.extend(bytes[..3].iter().map(color));
        gaussians.opacity_logits.push(logit(bytes[3]));
        let part = |i: usize| (f32::from(bytes[i]) - 128.0) / 128.0;
        gaussians.rotations.push([4, 5, 6, 7].map(part));
    }
    scene_of(path, gaussians)
}

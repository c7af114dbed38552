//! Features from within a semantic segmenter in an ONNX file: one tensor of the network, and the same over larger areas.

use super::{FeatureMap, SCALES};
use crate::error::Result;
use crate::segmenter::Tap;
use image::RgbImage;

/// Changes with the arithmetic: cached maps of another version are computed again.
pub(super) const VERSION: &str = "segmenter 2";

/// The maps of a photo, fine to coarse: the tensor, and its means over areas of 2, 4 and 8 cells a side.
///
/// # Errors
/// As [`Tap::map`].
pub(super) fn maps(tap: &Tap, photo: &RgbImage) -> Result<[FeatureMap; SCALES]> {
    let found = tap.map(photo)?;
    let mut map = FeatureMap {
        height: found.height,
        width: found.width,
        channels: found.channels,
        data: found.values,
        steps: None,
    };
    let mut maps: [FeatureMap; SCALES] = Default::default();
    for scale in &mut maps {
        // An odd map shares its middle cells between two.
        let coarser = map.resized(map.height.div_ceil(2), map.width.div_ceil(2));
        *scale = std::mem::replace(&mut map, coarser);
    }
    Ok(maps)
}

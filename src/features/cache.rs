//! On-disk cache of feature maps, keyed by what they depend on.
//!
//! One file for each image, named by the SHA-256 of its size, its pixels and the extractor's key (version of the arithmetic,
//! hash of the weights). It holds the four maps and where their cells are. A damaged entry is computed
//! again.

use super::{FeatureMap, SCALES, Steps, each_scale};
use crate::checkpoint::{Checkpoint, Scalar};
use crate::error::Result;
use crate::files::own;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// Kind of the files.
const KIND: &str = "feature maps";

/// Where the maps of `image` lie within `dir`.
pub fn entry(dir: &Path, image: &image::RgbImage, extractor: &str) -> PathBuf {
    let mut hash = Sha256::new();
    let (width, height) = image.dimensions();
    hash.update(format!("coseg maps 3\n{extractor}\n{width} {height}\n"));
    hash.update(image.as_raw());
    dir.join(format!("{:x}.safetensors", hash.finalize()))
}

/// The maps stored at `path`. None if there are none, or with a warning where they are damaged.
pub fn load(path: &Path) -> Option<[FeatureMap; SCALES]> {
    if !path.exists() {
        return None;
    }
    let maps = read(path);
    if let Err(error) = &maps {
        let file = path.display();
        tracing::warn!("{file}: cached features are computed again, as they are damaged ({error})");
    }
    maps.ok()
}

fn read(path: &Path) -> Result<[FeatureMap; SCALES]> {
    let mut file = Checkpoint::load(path, KIND)?;
    let steps: [Option<[f64; 2]>; SCALES] = file.get("steps")?;
    each_scale(|n| {
        let name = format!("scale{}", n + 1);
        let &[height, width, channels] = file.shape(&name)? else {
            return Err(file.wrong(name, "another shape", "[H, W, C]"));
        };
        Ok(FeatureMap {
            height,
            width,
            channels,
            data: file.take(&name, &[height, width, channels])?,
            steps: steps[n].map(|[stride, offset]| Steps::new(stride, offset)),
        })
    })
}

/// Writes `maps` to `path`, whole or not at all.
///
/// # Errors
/// [`crate::Error::Io`]; what stood there before is kept.
pub fn store(path: &Path, maps: &[FeatureMap; SCALES]) -> Result<()> {
    let mut file = Checkpoint::new(KIND);
    for (n, map) in (1..).zip(maps) {
        let shape = [map.height, map.width, map.channels];
        file.put(format!("scale{n}"), &shape, map.data.clone())?;
    }
    let steps = maps.each_ref().map(|map| map.steps);
    file.set(
        "steps",
        &steps.map(|steps| steps.map(|s| [s.stride, s.offset])),
    )?;
    // A damaged entry, and nothing else, has this name.
    own::allow(path);
    file.save(path)
}

/// SHA-256 of the maps of a view.
pub fn digest(maps: &[FeatureMap; SCALES]) -> String {
    let mut hash = Sha256::new();
    for map in maps {
        let height = map.height;
        let width = map.width;
        let channels = map.channels;
        hash.update(format!("{height} {width} {channels} {:?}\n", map.steps));
        hash.update(f32::to_bytes(&map.data));
    }
    format!("{:x}", hash.finalize())
}

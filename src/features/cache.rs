//! On-disk cache of feature maps, keyed by what they depend on.
//!
//! One file for each image, named by the SHA-256 of its size, its pixels and the extractor's key (version of the arithmetic,
//! hash of the weights). It holds the maps of all scales and where their cells are. A damaged entry is computed
//! again.

use super::{FeatureMap, Steps};
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
    hash.update(format!("coseg maps 4\n{extractor}\n{width} {height}\n"));
    hash.update(image.as_raw());
    dir.join(format!("{:x}.safetensors", hash.finalize()))
}

/// The maps stored at `path`. None if there are none, or with a warning where they are damaged.
pub fn load(path: &Path) -> Option<Vec<FeatureMap>> {
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

fn read(path: &Path) -> Result<Vec<FeatureMap>> {
    let mut file = Checkpoint::load(path, KIND)?;
    let steps: Vec<Option<[f64; 2]>> = file.get("steps")?;
    let maps = steps.into_iter().enumerate().map(|(n, steps)| {
        let name = format!("scale{}", n + 1);
        let &[height, width, channels] = file.shape(&name)? else {
            return Err(file.wrong(name, "another shape", "[H, W, C]"));
        };
        Ok(FeatureMap {
            height,
            width,
            channels,
            data: file.take(&name, &[height, width, channels])?,
            steps: steps.map(|[stride, offset]| Steps::new(stride, offset)),
        })
    });
    maps.collect()
}

/// Writes `maps` to `path`, whole or not at all.
///
/// # Errors
/// [`crate::Error::Io`]; what stood there before is kept.
pub fn store(path: &Path, maps: &[FeatureMap]) -> Result<()> {
    let mut file = Checkpoint::new(KIND);
    for (n, map) in (1..).zip(maps) {
        let shape = [map.height, map.width, map.channels];
        file.put(format!("scale{n}"), &shape, map.data.clone())?;
    }
    let steps = maps.iter().map(|map| map.steps);
    let steps: Vec<_> = steps
        .map(|steps| steps.map(|s| [s.stride, s.offset]))
        .collect();
    file.set("steps", &steps)?;
    // A damaged entry, and nothing else, has this name.
    own::allow(path);
    file.save(path)
}

/// SHA-256 of the maps of a view.
pub fn digest(maps: &[FeatureMap]) -> String {
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

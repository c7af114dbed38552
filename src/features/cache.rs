//! On-disk cache of feature maps, keyed by what they depend on.
//!
//! One safetensors file an image, named by the SHA-256 of its size, its pixels and the extractor's key (version of the
//! arithmetic, hash of the weights). The file holds the four maps, where their cells are, and a
//! SHA-256 of these bytes; it is written under a temporary name, synced and renamed. An entry that does not check is
//! computed again with a warning.

use super::{FeatureMap, SCALES, Steps};
use crate::data::atomic;
use crate::error::{Error, Result};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use sha2::{Digest, Sha256};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Key of the metadata: the SHA-256 of sizes, bytes and steps, a space, and the steps as JSON.
const KEY: &str = "maps";

/// Where the maps of `image` lie within `dir`.
pub fn entry(dir: &Path, image: &image::RgbImage, extractor: &str) -> PathBuf {
    let mut hash = Sha256::new();
    hash.update(format!(
        "coseg maps 2\n{extractor}\n{} {}\n",
        image.width(),
        image.height()
    ));
    hash.update(image.as_raw());
    dir.join(format!("{:x}.safetensors", hash.finalize()))
}

/// The maps stored at `path`; `None` when there are none or they are damaged (warned of).
pub fn load(path: &Path) -> Option<[FeatureMap; SCALES]> {
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return None,
        Err(error) => {
            tracing::warn!(
                "{}: cached features cannot be read ({error}); computing them again",
                path.display()
            );
            return None;
        }
    };
    let maps = parse(&bytes);
    if maps.is_none() {
        tracing::warn!(
            "{}: cached features are damaged; computing them again",
            path.display()
        );
    }
    maps
}

fn parse(bytes: &[u8]) -> Option<[FeatureMap; SCALES]> {
    let (_, header) = SafeTensors::read_metadata(bytes).ok()?;
    let (stored, placed) = header.metadata().as_ref()?.get(KEY)?.split_once(' ')?;
    let steps: [Option<[f64; 2]>; SCALES] = serde_json::from_str(placed).ok()?;
    let tensors = SafeTensors::deserialize(bytes).ok()?;
    let mut maps = Vec::with_capacity(SCALES);
    let mut hash = Sha256::new();
    for n in 1..=SCALES {
        let view = tensors.tensor(&format!("scale{n}")).ok()?;
        let &[height, width, channels] = view.shape() else {
            return None;
        };
        if view.dtype() != Dtype::F32 {
            return None;
        }
        digest(&mut hash, [height, width, channels], view.data());
        let data: Vec<f32> = view
            .data()
            .as_chunks::<4>()
            .0
            .iter()
            .map(|b| f32::from_le_bytes(*b))
            .collect();
        let steps = steps[n - 1].map(|[stride, offset]| Steps { stride, offset });
        let map = FeatureMap {
            height,
            width,
            channels,
            data,
            steps,
        };
        map.check("cached map").ok()?;
        maps.push(map);
    }
    hash.update(placed);
    if *stored != format!("{:x}", hash.finalize()) {
        return None;
    }
    maps.try_into().ok()
}

/// Writes `maps` to `path`, whole or not at all.
///
/// # Errors
/// [`Error::Io`]; what stood there before is kept.
pub fn store(path: &Path, maps: &[FeatureMap; SCALES]) -> Result<()> {
    let bytes: Vec<Vec<u8>> = maps
        .iter()
        .map(|m| m.data.iter().flat_map(|x| x.to_le_bytes()).collect())
        .collect();
    let mut hash = Sha256::new();
    let mut views = Vec::with_capacity(SCALES);
    for (n, (map, bytes)) in maps.iter().zip(&bytes).enumerate() {
        let shape = [map.height, map.width, map.channels];
        digest(&mut hash, shape, bytes);
        let view = TensorView::new(Dtype::F32, shape.to_vec(), bytes)
            .map_err(|e| Error::io(path, "encode", std::io::Error::other(e.to_string())))?;
        views.push((format!("scale{}", n + 1), view));
    }
    let steps: [_; SCALES] = maps
        .each_ref()
        .map(|m| m.steps.map(|s| [s.stride, s.offset]));
    let steps = serde_json::json!(steps).to_string();
    hash.update(&steps);
    // One entry: several would lie in any order, and the same maps are to give the same bytes.
    let metadata = HashMap::from([(KEY.to_owned(), format!("{:x} {steps}", hash.finalize()))]);
    let file = safetensors::serialize(views, Some(metadata))
        .map_err(|e| Error::io(path, "encode", std::io::Error::other(e.to_string())))?;
    atomic::write_bytes(path, &file)
}

fn digest(hash: &mut Sha256, shape: [usize; 3], bytes: &[u8]) {
    hash.update(format!("{shape:?}"));
    hash.update(bytes);
}

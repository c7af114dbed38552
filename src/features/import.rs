//! Feature maps from files: `STEM.1.npy` to `STEM.4.npy`, or `STEM.safetensors` with `scale1` to `scale4`. Their cells
//! divide the image evenly.

use super::{FeatureMap, SCALES};
use crate::error::{Error, Result};
use half::f16;
use npyz::{DType, Endianness, NpyFile, Order, TypeChar};
use safetensors::tensor::{Dtype, SafeTensors};
use std::path::Path;

/// What a map file must hold, for error messages.
const WANTED: &str = "an [H, W, C] array of f32 or f16, none of them 0";

/// The four maps of view `stem`.
///
/// # Errors
/// [`Error::Input`] when files are absent, truncated, of another type or shape; [`Error::NonFinite`] on NaN or infinity.
pub fn read(dir: &Path, stem: &str) -> Result<[FeatureMap; SCALES]> {
    let bundle = dir.join(format!("{stem}.safetensors"));
    let maps = if bundle.exists() {
        read_bundle(&bundle)?
    } else {
        let mut maps = Vec::with_capacity(SCALES);
        for n in 1..=SCALES {
            let path = dir.join(format!("{stem}.{n}.npy"));
            if !path.exists() {
                return Err(Error::input(
                    dir,
                    format!("view {stem}, scale {n}"),
                    format!("neither {stem}.{n}.npy nor {stem}.safetensors"),
                    "one of them for every view",
                    "write the missing maps or correct features.source.import",
                ));
            }
            maps.push(read_npy(&path)?);
        }
        maps
    };
    maps.try_into()
        .map_err(|_| Error::config("features.source.import", stem, "four maps", "report this"))
}

fn read_npy(path: &Path) -> Result<FeatureMap> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    let bad = |field: &str, found: String| {
        Error::input(path, field, found, WANTED, "write the map again")
    };
    // A header length past the end of the file would be allocated before it is missed.
    let start = match bytes.get(..12) {
        Some(h) if h[6] == 1 => 10 + usize::from(u16::from_le_bytes([h[8], h[9]])),
        Some(h) => 12 + u32::from_le_bytes([h[8], h[9], h[10], h[11]]) as usize,
        None => return Err(bad("header", format!("{} bytes", bytes.len()))),
    };
    if start > bytes.len() {
        return Err(bad(
            "header",
            format!("a header of {start} bytes in a file of {}", bytes.len()),
        ));
    }
    let file = NpyFile::new(&bytes[..]).map_err(|e| bad("header", e.to_string()))?;
    let shape: Vec<usize> = file
        .shape()
        .iter()
        .map(|&n| usize::try_from(n).unwrap_or(usize::MAX))
        .collect();
    let (element, big_endian) = match file.dtype() {
        DType::Plain(t) if t.type_char() == TypeChar::Float && matches!(t.size_field(), 2 | 4) => {
            (t.size_field() as usize, t.endianness() == Endianness::Big)
        }
        other => return Err(bad("dtype", other.descr())),
    };
    let [height, width, channels] =
        check_shape(&shape).ok_or_else(|| bad("shape", format!("{shape:?}")))?;
    let order = file.order();
    let count = height * width * channels;
    let Some(raw) = bytes.get(start..start + element * count) else {
        return Err(bad(
            "data",
            format!("{} bytes for shape {shape:?}", bytes.len() - start),
        ));
    };
    let values: Vec<f32> = match (element, big_endian) {
        (4, false) => raw
            .as_chunks()
            .0
            .iter()
            .map(|b| f32::from_le_bytes(*b))
            .collect(),
        (4, true) => raw
            .as_chunks()
            .0
            .iter()
            .map(|b| f32::from_be_bytes(*b))
            .collect(),
        (_, false) => raw
            .as_chunks()
            .0
            .iter()
            .map(|b| f16::from_le_bytes(*b).to_f32())
            .collect(),
        (_, true) => raw
            .as_chunks()
            .0
            .iter()
            .map(|b| f16::from_be_bytes(*b).to_f32())
            .collect(),
    };
    let data = match order {
        Order::C => values,
        Order::Fortran => {
            let at = |y: usize, x: usize, c: usize| values[(c * width + x) * height + y];
            let cells = (0..height).flat_map(|y| (0..width).map(move |x| (y, x)));
            cells
                .flat_map(|(y, x)| (0..channels).map(move |c| (y, x, c)))
                .map(|(y, x, c)| at(y, x, c))
                .collect()
        }
    };
    finite(
        path,
        "data",
        FeatureMap {
            height,
            width,
            channels,
            data,
            steps: None,
        },
    )
}

fn read_bundle(path: &Path) -> Result<Vec<FeatureMap>> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    let tensors = SafeTensors::deserialize(&bytes).map_err(|e| {
        Error::input(
            path,
            "header",
            e.to_string(),
            "a safetensors file with scale1 to scale4",
            "write the file again",
        )
    })?;
    (1..=SCALES)
        .map(|n| {
            let name = format!("scale{n}");
            let bad = |found: String| {
                Error::input(path, name.clone(), found, WANTED, "write the map again")
            };
            let view = tensors
                .tensor(&name)
                .map_err(|_| bad(format!("no such tensor among {:?}", tensors.names())))?;
            let [height, width, channels] = check_shape(view.shape())
                .ok_or_else(|| bad(format!("shape {:?}", view.shape())))?;
            let bytes = view.data();
            let data: Vec<f32> = match view.dtype() {
                Dtype::F32 => bytes
                    .as_chunks::<4>()
                    .0
                    .iter()
                    .map(|b| f32::from_le_bytes(*b))
                    .collect(),
                Dtype::F16 => bytes
                    .as_chunks::<2>()
                    .0
                    .iter()
                    .map(|b| f16::from_le_bytes(*b).to_f32())
                    .collect(),
                other => return Err(bad(format!("{other:?}"))),
            };
            finite(
                path,
                &name,
                FeatureMap {
                    height,
                    width,
                    channels,
                    data,
                    steps: None,
                },
            )
        })
        .collect()
}

/// The three sizes when none is 0 and their product is a sane number of values.
fn check_shape(shape: &[usize]) -> Option<[usize; 3]> {
    let &[h, w, c] = shape else { return None };
    let count = h.checked_mul(w)?.checked_mul(c)?;
    (count > 0 && count < 1 << 40).then_some([h, w, c])
}

fn finite(path: &Path, field: &str, map: FeatureMap) -> Result<FeatureMap> {
    match map.check(&format!("{} {field}", path.display())) {
        Ok(()) => Ok(map),
        Err(error) => Err(error),
    }
}

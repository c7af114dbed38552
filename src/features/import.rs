//! Feature maps from files: `STEM.1.npy` to `STEM.4.npy`, or `STEM.safetensors` with `scale1` to `scale4`. Their cells
//! divide the image evenly. Where fewer scales are read, the files of these are enough.

use super::{FeatureMap, SCALES};
use crate::error::{Result, ensure, invalid};
use crate::files::{self, extension};
use crate::weights::floats;
use ndarray::{ArrayView3, ShapeBuilder};
use npyz::{DType, Endianness, NpyFile, Order, TypeChar};
use safetensors::{Dtype, SafeTensors};
use std::path::{Path, PathBuf};

/// What a map file must hold, for error messages.
const WANTED: &str = "an [H, W, C] array of f32 or f16, none of them 0";

/// Refuses a folder without the files of view `stem` at the first `scales` scales.
///
/// # Errors
/// [`crate::Error::Input`].
pub fn expect(dir: &Path, stem: &str, scales: usize) -> Result<()> {
    if dir.join(format!("{stem}.safetensors")).exists() {
        return Ok(());
    }
    for n in 1..=scales {
        ensure!(dir.join(format!("{stem}.{n}.npy")).exists(), dir, "view {stem}, scale {n}";
            found "neither {stem}.{n}.npy nor {stem}.safetensors";
            expected "one of them for every view";
            help "write the missing maps, or name the folder that has them");
    }
    Ok(())
}

/// The maps of view `stem` at the first `scales` scales.
///
/// # Errors
/// [`crate::Error::Input`] when files are absent, truncated, of another type or shape; [`crate::Error::NonFinite`] on NaN or infinity.
pub fn read(dir: &Path, stem: &str, scales: usize) -> Result<Vec<FeatureMap>> {
    expect(dir, stem, scales)?;
    let bundle = dir.join(format!("{stem}.safetensors"));
    if bundle.exists() {
        return read_bundle(&bundle, scales, scales);
    }
    let maps = (1..=scales).map(|n| read_npy(&dir.join(format!("{stem}.{n}.npy"))));
    maps.collect()
}

/// The files of view `stem`: the bundle, or the maps of one to four scales. None if there are none.
pub fn found(dir: &Path, stem: &str) -> Vec<PathBuf> {
    let bundle = dir.join(format!("{stem}.safetensors"));
    if bundle.exists() {
        return vec![bundle];
    }
    let maps = (1..=SCALES).map(|n| dir.join(format!("{stem}.{n}.npy")));
    maps.take_while(|path| path.exists()).collect()
}

/// The maps of view `stem` at the scales that there are, one to four.
///
/// # Errors
/// As [`read`].
pub fn read_found(dir: &Path, stem: &str) -> Result<Vec<FeatureMap>> {
    match &found(dir, stem)[..] {
        [] => expect(dir, stem, 1).map(|()| Vec::new()),
        [bundle] if extension(bundle) == "safetensors" => read_bundle(bundle, 1, SCALES),
        maps => maps.iter().map(|path| read_npy(path)).collect(),
    }
}

fn read_npy(path: &Path) -> Result<FeatureMap> {
    let bytes = files::read(path)?;
    let bad = |field: &str, found: String| invalid!(path, "{field}"; found "{found}"; expected "{WANTED}"; help "write the map again");
    vet_header(&bytes).map_err(|found| bad("header", found))?;
    let mut rest = &bytes[..];
    let file = NpyFile::new(&mut rest).map_err(|e| bad("header", e.to_string()))?;
    let shape: Vec<usize> = file.shape().iter().map(|&n| n as usize).collect();
    let [height, width, channels] =
        check_shape(&shape).ok_or_else(|| bad("shape", format!("{shape:?}")))?;
    let dtype = file.dtype();
    let order = file.order();
    let (size, is_big_endian) = match &dtype {
        DType::Plain(t) if t.type_char() == TypeChar::Float => {
            (t.size_field() as usize, t.endianness() == Endianness::Big)
        }
        _ => return Err(bad("dtype", dtype.descr())),
    };
    let stored = match size {
        2 => Dtype::F16,
        4 => Dtype::F32,
        _ => return Err(bad("dtype", dtype.descr())),
    };
    let raw = rest.get(..size * height * width * channels);
    let raw = raw.ok_or_else(|| bad("data", format!("{} bytes", rest.len())));
    let mut raw = raw?.to_vec();
    if is_big_endian {
        raw.chunks_exact_mut(size).for_each(<[u8]>::reverse);
    }
    let values = floats(&raw, stored).unwrap_or_default();
    let data = match order {
        Order::C => values,
        Order::Fortran => {
            let map = ArrayView3::from_shape((height, width, channels).f(), &values);
            map.map_or_else(|_| Vec::new(), |map| map.iter().copied().collect())
        }
    };
    checked(path, "data", [height, width, channels], data)
}

/// The maps of a safetensors file, of `least` to `most` scales.
fn read_bundle(path: &Path, least: usize, most: usize) -> Result<Vec<FeatureMap>> {
    let bytes = files::read(path)?;
    let tensors = SafeTensors::deserialize(&bytes).map_err(|e| {
        invalid!(path, "header"; found "{e}"; expected "a safetensors file with scale1 to scale4";
            help "write the file again")
    })?;
    let mut maps = Vec::new();
    for n in 1..=most {
        let name = format!("scale{n}");
        if n > least && !tensors.names().contains(&name.as_str()) {
            break;
        }
        let bad = |found| {
            invalid!(path, "{}", name; found "{found}"; expected "{WANTED}";
            help "write the map again")
        };
        let tensor = tensors
            .tensor(&name)
            .map_err(|_| bad(format!("no such tensor among {:?}", tensors.names())))?;
        let shape = check_shape(tensor.shape())
            .ok_or_else(|| bad(format!("shape {:?}", tensor.shape())))?;
        let data = floats(tensor.data(), tensor.dtype())
            .ok_or_else(|| bad(format!("{:?}", tensor.dtype())))?;
        maps.push(checked(path, &name, shape, data)?);
    }
    Ok(maps)
}

/// Refuses the header of an NPY file that is not a dictionary of plain values, before the parser sees it: a header can claim
/// gigabytes, which the parser would allocate, and it takes time exponential in the depth of nested brackets.
fn vet_header(bytes: &[u8]) -> Result<(), String> {
    // Magic and version, then the length, which has two bytes in version 1.
    let start = if bytes.get(6) == Some(&1) { 10 } else { 12 };
    let length = bytes.get(8..start).unwrap_or_default();
    let length = length
        .iter()
        .rev()
        .fold(0, |sum, byte| sum << 8 | usize::from(*byte));
    let Some(header) = bytes.get(start..start.saturating_add(length)) else {
        return Err(format!("a header of {length} bytes"));
    };
    let count = |brackets: &[u8]| header.iter().filter(|byte| brackets.contains(byte)).count();
    let [dictionaries, tuples, lists] = [b"{", b"(", b"["].map(|bracket| count(bracket));
    if dictionaries > 1 || tuples > 1 || lists > 0 {
        return Err("nested values".to_owned());
    }
    Ok(())
}

/// The three sizes, if none is 0 and their product is plausible.
fn check_shape(shape: &[usize]) -> Option<[usize; 3]> {
    let &[h, w, c] = shape else { return None };
    let count = h.checked_mul(w)?.checked_mul(c)?;
    (count > 0 && count < 1 << 40).then_some([h, w, c])
}

/// The map of these values, if all are finite.
fn checked(
    path: &Path,
    field: &str,
    [height, width, channels]: [usize; 3],
    data: Vec<f32>,
) -> Result<FeatureMap> {
    let map = FeatureMap {
        height,
        width,
        channels,
        data,
        steps: None,
    };
    map.check(&format!("{} {field}", path.display()))?;
    Ok(map)
}

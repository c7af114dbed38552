//! Labels in binary glTF of Gaussians, as the vertex attribute `_LABEL`.
//!
//! Format: <https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html>, 'GLB File Format' and 'Meshes'. Attributes whose names begin
//! with an underscore belong to applications. Each value begins at a multiple of four bytes.

use crate::error::{Result, ensure, invalid};
use crate::splat::{Gaussians, median};
use glam::DVec3;
use serde_json::{Map, Value, json};
use std::path::Path;

/// The first eight bytes: the name of the format, and its version 2.
const MAGIC: &[u8; 8] = b"glTF\x02\0\0\0";
const JSON: &[u8; 4] = b"JSON";
const BINARY: &[u8; 4] = b"BIN\0";
/// Numbers of the format: an array of vertex attributes, 16-bit integers, floats.
const ARRAY_BUFFER: u64 = 34_962;
const UNSIGNED_SHORT: u64 = 5_123;
const FLOAT: u64 = 5_126;
/// Bytes of a position, and of a label with its padding.
const POSITION: usize = 12;
const LABEL: usize = 4;
/// Difference of coordinates, as a share of the largest, that rounding to float explains. One rounding makes an eighth of it.
const ROUNDING: f64 = 4.0 * f32::EPSILON as f64;

/// The bytes `glb` of the file `path` with one of the `labels` for each vertex of the first primitive. The vertices must be the
/// `gaussians` with `origin` added, in their order; signs of coordinates may differ, as axes are turned. `names` of labels become
/// `extras.labels` of the mesh.
///
/// # Errors
/// [`crate::Error::Input`] for bytes that are not such a file, for vertices in another order, and for a scene so far from zero that
/// rounding hides their order.
pub fn with_labels(
    path: &Path,
    glb: &[u8],
    (gaussians, origin): (&Gaussians, DVec3),
    labels: &[u16],
    names: Map<String, Value>,
) -> Result<Vec<u8>> {
    let damaged = || {
        invalid!(path, "content"; found "no mesh with float positions"; expected "binary glTF 2.0 of Gaussians";
            help "write a .ply or .spz file")
    };
    let (mut gltf, binary) = chunks(glb).ok_or_else(damaged)?;
    let found = vertices(&gltf, binary).ok_or_else(damaged)?;
    ensure!(labels.len() == gaussians.len(), argument "labels"; found "{}", labels.len();
        expected "{}, one for each Gaussian", gaussians.len(); help "give the labels of this scene");
    check_order(path, &found, gaussians, origin)?;
    let mut binary = binary.to_vec();
    binary.resize(binary.len().next_multiple_of(LABEL), 0);
    let offset = binary.len();
    for label in labels {
        binary.extend([label.to_le_bytes(), [0; 2]].concat());
    }
    declare(&mut gltf, offset, labels.len(), names).ok_or_else(damaged)?;
    joined(&gltf, &binary).ok_or_else(|| {
        invalid!(path, "length"; found "4 GiB or more"; expected "less"; help "write a .ply or .spz file")
    })
}

/// Refuses `vertices` that are not the `gaussians` with `origin` added, in their order, and those that are too rounded to tell.
fn check_order(
    path: &Path,
    vertices: &[[f32; 3]],
    gaussians: &Gaussians,
    origin: DVec3,
) -> Result<()> {
    let positions = gaussians.positions(origin);
    // Centres near zero may have come there by adding the origin to a rounded one.
    let rounding = |p: &DVec3| ROUNDING * p.abs().max(origin.abs()).max_element();
    let (moved, apart) = (median(positions.iter().map(rounding)), spacing(gaussians));
    ensure!(moved <= apart || positions.len() < 2, path, "POSITION";
        found "Gaussians {apart:.2e} apart, so far from zero that float may round them by {moved:.2e}";
        expected "neighbours that rounding leaves apart"; help "write a .ply file, which has such positions as double");
    let is_same = |(a, b): (&[f32; 3], &DVec3)| {
        let apart = DVec3::from(a.map(f64::from)).abs() - b.abs();
        apart.abs().max_element() <= rounding(b)
    };
    let is_ordered =
        vertices.len() == positions.len() && vertices.iter().zip(&positions).all(is_same);
    ensure!(is_ordered, path, "POSITION"; found "{} vertices, in another order", vertices.len();
        expected "the {} Gaussians of the scene, in its order", positions.len(); help "write a .ply or .spz file");
    Ok(())
}

/// Median distance of Gaussians that follow each other in [`Gaussians::spatial_order`].
fn spacing(gaussians: &Gaussians) -> f64 {
    let center = |row: u32| DVec3::from(gaussians.means[row as usize].map(f64::from));
    let order = gaussians.spatial_order();
    median(
        order
            .windows(2)
            .map(|pair| center(pair[0]).distance(center(pair[1]))),
    )
}

/// The JSON and the binary data of a file.
fn chunks(glb: &[u8]) -> Option<(Value, &[u8])> {
    let (_, rest) = glb.strip_prefix(MAGIC)?.split_first_chunk::<4>()?;
    let (text, rest) = chunk(rest, JSON)?;
    let (binary, _) = chunk(rest, BINARY)?;
    Some((serde_json::from_slice(text).ok()?, binary))
}

/// The content of the chunk at the beginning of `bytes`, which must be of this `kind`, and what follows.
fn chunk<'a>(bytes: &'a [u8], kind: &[u8; 4]) -> Option<(&'a [u8], &'a [u8])> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    let rest = rest.strip_prefix(kind)?;
    rest.split_at_checked(u32::from_le_bytes(*length) as usize)
}

/// The positions of the first primitive.
fn vertices(gltf: &Value, binary: &[u8]) -> Option<Vec<[f32; 3]>> {
    let number = |value: &Value| usize::try_from(value.as_u64()?).ok();
    let primitive = &gltf["meshes"][0]["primitives"][0];
    let accessor = &gltf["accessors"][number(&primitive["attributes"]["POSITION"])?];
    let view = &gltf["bufferViews"][number(&accessor["bufferView"])?];
    let is_float = accessor["componentType"] == FLOAT && accessor["type"] == "VEC3";
    let is_packed = number(&view["byteStride"]).is_none_or(|stride| stride == POSITION);
    if !(is_float && is_packed && view["buffer"] == 0) {
        return None;
    }
    let offsets = [view, accessor].map(|part| number(&part["byteOffset"]).unwrap_or(0));
    let bytes = binary.get(offsets[0].checked_add(offsets[1])?..)?;
    let bytes = bytes.get(..number(&accessor["count"])?.checked_mul(POSITION)?)?;
    let floats = bytes.as_chunks::<4>().0.iter();
    let floats: Vec<f32> = floats.map(|bytes| f32::from_le_bytes(*bytes)).collect();
    Some(floats.as_chunks::<3>().0.to_vec())
}

/// Declares `count` labels from the byte `offset` of the binary data to its end.
fn declare(gltf: &mut Value, offset: usize, count: usize, names: Map<String, Value>) -> Option<()> {
    let views = gltf["bufferViews"].as_array_mut()?;
    let view = views.len();
    let length = LABEL * count;
    views.push(json!({
        "buffer": 0, "byteOffset": offset, "byteLength": length, "byteStride": LABEL, "target": ARRAY_BUFFER
    }));
    let accessors = gltf["accessors"].as_array_mut()?;
    accessors.iter_mut().for_each(round_bounds);
    let accessor = accessors.len();
    accessors.push(json!({
        "bufferView": view, "componentType": UNSIGNED_SHORT, "count": count, "type": "SCALAR"
    }));
    let buffer = gltf["buffers"].get_mut(0)?.as_object_mut()?;
    buffer.insert("byteLength".into(), json!(offset + length));
    let mesh = gltf["meshes"].get_mut(0)?.as_object_mut()?;
    if !names.is_empty() {
        let extras = mesh.entry("extras").or_insert_with(|| json!({}));
        extras
            .as_object_mut()?
            .insert("labels".into(), names.into());
    }
    let attributes = mesh["primitives"].get_mut(0)?["attributes"].as_object_mut()?;
    attributes.insert("_LABEL".into(), json!(accessor));
    Some(())
}

/// Bounds of floats as floats: reading JSON may change the last bit of a double.
fn round_bounds(accessor: &mut Value) {
    if accessor["componentType"] != FLOAT {
        return;
    }
    for key in ["min", "max"] {
        let bounds = accessor.get_mut(key).and_then(Value::as_array_mut);
        for bound in bounds.into_iter().flatten() {
            if let Some(value) = bound.as_f64() {
                *bound = json!(f64::from(value as f32));
            }
        }
    }
}

/// A file of these parts; `None` where it is too long for the format.
fn joined(gltf: &Value, binary: &[u8]) -> Option<Vec<u8>> {
    let mut text = gltf.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut body = Vec::with_capacity(text.len() + binary.len() + 16);
    for (content, kind) in [(&text[..], JSON), (binary, BINARY)] {
        body.extend(u32::try_from(content.len()).ok()?.to_le_bytes());
        body.extend(kind);
        body.extend(content);
    }
    let length = u32::try_from(MAGIC.len() + 4 + body.len()).ok()?;
    Some([&MAGIC[..], &length.to_le_bytes(), &body].concat())
}

//! Small binary glTF files of Gaussians, as splat-transform writes them.

use coseg::splat::Gaussians;
use glam::DVec3;
use serde_json::{Value, json};

/// The parts of a file.
pub struct Glb {
    pub json: Value,
    pub binary: Vec<u8>,
}

/// The centres as vertices, with x and y turned as splat-transform turns them, and colours. The binary data is not a multiple of
/// four bytes long, and padded.
pub fn glb(gaussians: &Gaussians, origin: DVec3) -> Vec<u8> {
    let turned = |mean: &[f32; 3]| {
        let [x, y, z] = (DVec3::from(mean.map(f64::from)) + origin)
            .as_vec3()
            .to_array();
        [-x, -y, z]
    };
    let positions: Vec<[f32; 3]> = gaussians.means.iter().map(turned).collect();
    let count = positions.len();
    let mut binary: Vec<u8> = positions
        .iter()
        .flatten()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    binary.resize(binary.len() + 4 * count + 2, 255);
    let bound = |pick: fn(f32, f32) -> f32| {
        [0, 1, 2].map(|axis| f64::from(positions.iter().map(|p| p[axis]).reduce(pick).unwrap()))
    };
    let gltf = json!({
        "asset": { "version": "2.0" },
        "meshes": [{ "primitives": [{ "attributes": { "COLOR_0": 1, "POSITION": 0 }, "mode": 0 }] }],
        "buffers": [{ "byteLength": binary.len() }],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": 12 * count },
            { "buffer": 0, "byteOffset": 12 * count, "byteLength": 4 * count },
        ],
        "accessors": [
            {
                "bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3",
                "min": bound(f32::min), "max": bound(f32::max),
            },
            { "bufferView": 1, "componentType": 5121, "count": count, "type": "VEC4", "normalized": true },
        ],
    });
    let mut text = gltf.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let length = (28 + text.len() + binary.len()) as u32;
    let mut bytes = [&b"glTF\x02\0\0\0"[..], &length.to_le_bytes()].concat();
    for (content, kind) in [(&text, b"JSON"), (&binary, b"BIN\0")] {
        bytes.extend((content.len() as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(content);
    }
    bytes
}

/// The content of the chunk whose header is at the byte `at`.
pub fn slice(bytes: &[u8], at: usize) -> &[u8] {
    let length = number(bytes, at);
    &bytes[at + 8..at + 8 + length]
}

fn number(bytes: &[u8], at: usize) -> usize {
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize
}

/// The parts of a file whose lengths, kinds and paddings are as the format wants them.
pub fn parsed(bytes: &[u8]) -> Glb {
    assert_eq!(&bytes[..8], b"glTF\x02\0\0\0");
    assert_eq!(number(bytes, 8), bytes.len());
    let text = slice(bytes, 12);
    assert_eq!((&bytes[16..20], text.len() % 4), (&b"JSON"[..], 0));
    let at = 20 + text.len();
    let binary = slice(bytes, at);
    assert_eq!(
        (&bytes[at + 4..at + 8], binary.len() % 4),
        (&b"BIN\0"[..], 0)
    );
    assert_eq!(at + 8 + binary.len(), bytes.len());
    Glb {
        json: serde_json::from_slice(text).unwrap(),
        binary: binary.to_vec(),
    }
}

impl Glb {
    /// The floats of the vertex attribute `name`, one vertex after the other.
    pub fn floats(&self, name: &str) -> Vec<f32> {
        let number = |value: &Value| value.as_u64().unwrap() as usize;
        let attributes = &self.json["meshes"][0]["primitives"][0]["attributes"];
        let accessor = &self.json["accessors"][number(&attributes[name])];
        assert_eq!(accessor["componentType"], 5126, "{name}");
        let view = &self.json["bufferViews"][number(&accessor["bufferView"])];
        let bytes = &self.binary[number(&view["byteOffset"])..][..number(&view["byteLength"])];
        let words = bytes.as_chunks::<4>().0.iter();
        words.copied().map(f32::from_le_bytes).collect()
    }

    /// The values of `_LABEL`, which must lie as the format wants vertex attributes to lie: each at a multiple of four bytes.
    pub fn labels(&self) -> Vec<u16> {
        let number = |value: &Value| value.as_u64().unwrap() as usize;
        let attributes = &self.json["meshes"][0]["primitives"][0]["attributes"];
        let accessor = &self.json["accessors"][number(&attributes["_LABEL"])];
        let kind = (&accessor["componentType"], &accessor["type"]);
        assert_eq!(kind, (&json!(5123), &json!("SCALAR")));
        let view = &self.json["bufferViews"][number(&accessor["bufferView"])];
        let [start, length, stride] =
            ["byteOffset", "byteLength", "byteStride"].map(|key| number(&view[key]));
        assert_eq!((start % 4, stride % 4, number(&view["buffer"])), (0, 0, 0));
        let count = number(&accessor["count"]);
        assert!(length >= stride * (count - 1) + 2 && start + length <= self.binary.len());
        let label = |i: usize| {
            let at = start + i * stride;
            u16::from_le_bytes(self.binary[at..at + 2].try_into().unwrap())
        };
        (0..count).map(label).collect()
    }
}

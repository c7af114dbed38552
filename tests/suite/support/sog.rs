//! Small `.sog` files.

use image::codecs::webp::WebPEncoder;
use image::{ExtendedColorType, ImageEncoder};
use serde_json::{Value, json};
use std::io::{Cursor, Write};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

/// The parts of a file, by name.
pub type Parts = Vec<(&'static str, Vec<u8>)>;

/// A lossless WebP of these texels.
pub fn webp(width: usize, texels: &[[u8; 4]]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let height = texels.len() / width;
    let encoder = WebPEncoder::new_lossless(&mut bytes);
    let texels = texels.as_flattened();
    let (width, height) = (width as u32, height as u32);
    let written = encoder.write_image(texels, width, height, ExtendedColorType::Rgba8);
    written.expect("WebP");
    bytes
}

/// `meta.json` of two Gaussians of SH degree 1. Codebooks count in quarters from -32.
pub fn meta() -> Value {
    let codebook: Vec<f64> = (0..256).map(|i| f64::from(i) / 4.0 - 32.0).collect();
    json!({
        "version": 2,
        "count": 2,
        "means": { "mins": [-1.0, 0.0, 0.0], "maxs": [1.0, 2.0, 4.0], "files": ["low.webp", "high.webp"] },
        "scales": { "codebook": codebook, "files": ["scales.webp"] },
        "quats": { "files": ["quats.webp"] },
        "sh0": { "codebook": codebook, "files": ["sh0.webp"] },
        "shN": { "count": 2, "bands": 1, "codebook": codebook, "files": ["palette.webp", "labels.webp"] },
    })
}

/// The parts of the file of [`meta`].
pub fn parts() -> Parts {
    let mut palette = vec![[0; 4]; 64 * 3];
    // Row 1 of the palette: the three coefficients of degree 1.
    palette[3] = [128, 132, 136, 255];
    palette[4] = [124, 120, 116, 255];
    palette[5] = [129, 130, 131, 255];
    vec![
        ("meta.json", meta().to_string().into_bytes()),
        ("low.webp", webp(2, &[[0, 255, 0, 255], [255, 0, 255, 255]])),
        (
            "high.webp",
            webp(2, &[[0, 255, 0, 255], [255, 0, 255, 255]]),
        ),
        ("scales.webp", webp(2, &[[108, 112, 116, 255], [120; 4]])),
        ("quats.webp", webp(2, &[[255, 0, 255, 254], [0, 0, 0, 7]])),
        (
            "sh0.webp",
            webp(2, &[[130, 126, 128, 51], [128, 128, 128, 255]]),
        ),
        ("palette.webp", webp(64 * 3, &palette)),
        ("labels.webp", webp(2, &[[1, 0, 0, 255], [0, 0, 0, 255]])),
    ]
}

/// The file of these parts.
pub fn packed(parts: &Parts) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in parts {
        let options =
            SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
        zip.start_file(*name, options).expect("zip");
        zip.write_all(bytes).expect("zip");
    }
    zip.finish().expect("zip").into_inner()
}

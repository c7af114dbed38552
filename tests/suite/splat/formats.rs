//! Gaussians in compressed formats: how exact they are, the bytes of a row, and files that are refused.

use crate::support::rounding::{errors, gaussians, worst};
use crate::support::spz::version_4;
use coseg::splat::SH_0;
use coseg::splat::formats::{self, Format};
use coseg::splat::ply::{self, PlyScene};
use flate2::Compression;
use flate2::write::GzEncoder;
use glam::DVec3;
use std::fs;
use std::io::Write;
use std::path::Path;

fn read(path: &Path) -> PlyScene {
    formats::read(path).expect("readable")
}

fn refused(path: &Path) -> String {
    let error = formats::read(path).expect_err("refused");
    error.to_string()
}

#[test]
fn values_stay_within_the_steps_of_the_format() {
    let dir = tempfile::tempdir().expect("folder");
    // Half a step each. The positions of a chunk of a compressed PLY span the whole scene here.
    let spz = [
        1.2e-6,
        0.5 / 16.0,
        0.5 / 255.0,
        0.5 / 255.0 * SH_0 / 0.15,
        0.5 / 8.0,
        0.3,
    ];
    let ply = [
        20.0 / 1023.0,
        4.0 / 1023.0,
        0.5 / 255.0,
        0.5 / 255.0,
        0.5 / 32.0,
        0.3,
    ];
    for (format, name, steps) in [
        (Format::Spz, "a.spz", spz),
        (Format::CompressedPly, "a.compressed.ply", ply),
    ] {
        let path = dir.path().join(name);
        for (n, sh_degree) in [(1, 0), (256, 1), (257, 2), (3_000, 3)] {
            let scene = gaussians(n, sh_degree);
            let labels: Vec<u16> = (0..n).map(|i| (i * 97 % 65_536) as u16).collect();
            let origin = DVec3::new(0.25, -1.5, 4.0);
            formats::write(&path, format, &scene, origin, Some(&labels)).expect("write");
            let found = read(&path);
            let order = scene.spatial_order();
            let ordered: Vec<u16> = order.iter().map(|&row| labels[row as usize]).collect();
            assert_eq!(found.labels, Some(ordered), "{name}, {n}");
            assert_eq!(found.origin, DVec3::ZERO);
            let mut expected = scene.select(&order);
            let world = |mean: &[f32; 3]| {
                (DVec3::from(mean.map(f64::from)) + origin)
                    .as_vec3()
                    .to_array()
            };
            expected.means = expected.means.iter().map(world).collect();
            let errors = errors(&found.gaussians, &expected);
            let holds = errors
                .iter()
                .zip(steps)
                .all(|(error, step)| *error <= 1.001 * step);
            assert!(holds, "{name}, {n}: {errors:?} of {steps:?}");
            // What was rounded once stays as it is.
            formats::write(&path, format, &found.gaussians, DVec3::ZERO, None).expect("write");
            let again = read(&path);
            assert_eq!(again.labels, None, "the labels of the earlier file go");
            assert_eq!(again.gaussians.len(), n);
        }
    }
    let path = dir.path().join("exact.ply");
    let scene = gaussians(9, 1);
    formats::write(&path, Format::Ply, &scene, DVec3::ZERO, Some(&[7; 9])).expect("write");
    let found = read(&path);
    assert_eq!((found.gaussians, found.labels), (scene, Some(vec![7; 9])));
}

fn gzip(content: &[u8]) -> Vec<u8> {
    let mut out = GzEncoder::new(Vec::new(), Compression::fast());
    out.write_all(content).expect("gzip");
    out.finish().expect("gzip")
}

/// The content of a .spz file of one Gaussian, by hand.
fn spz_by_hand(version: u8) -> Vec<u8> {
    let mut content = b"NGSP".to_vec();
    content.extend([version, 0, 0, 0, 1, 0, 0, 0, 1, 12, 0, 0]);
    // 1, -2 and 0.5 in steps of 1 / 4096.
    content.extend([0x00, 0x10, 0x00, 0x00, 0xE0, 0xFF, 0x00, 0x08, 0x00]);
    content.push(51);
    content.extend([0, 255, 51]);
    content.extend([80, 96, 160]);
    if version == 2 {
        content.extend([255, 0, 102]);
    } else {
        // y is the largest; then x, z and w, each a sign and nine bits.
        let bits: u32 = 1 << 30 | 511 << 20 | 1 << 19;
        content.extend(bits.to_le_bytes());
    }
    content.extend([128, 0, 192, 128, 128, 128, 64, 128, 128]);
    content
}

#[test]
fn the_bytes_of_a_spz_file_mean_what_they_should() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("a.spz");
    fs::write(&path, gzip(&spz_by_hand(3))).expect("write");
    let g = read(&path).gaussians;
    assert_eq!(g.means, [[1.0, -2.0, 0.5]]);
    assert_eq!(g.log_scales, [[-5.0, -4.0, 0.0]]);
    assert!((g.opacity_logits[0] - 0.25_f32.ln()).abs() < 1e-5);
    let sh = [
        -0.5 / 0.15,
        0.5 / 0.15,
        -0.3 / 0.15,
        0.0,
        -1.0,
        0.5,
        0.0,
        0.0,
        0.0,
        -0.5,
        0.0,
        0.0,
    ];
    assert!(worst(&g.sh, &sh) < 1e-5, "{:?}", g.sh);
    let half = 0.5_f32.sqrt();
    assert!(
        worst(&g.rotations[0], &[0.0, half, half, 0.0]) < 1e-5,
        "{:?}",
        g.rotations
    );
    fs::write(&path, version_4(&spz_by_hand(3))).expect("write");
    assert_eq!(read(&path).gaussians, g);
    fs::write(&path, gzip(&spz_by_hand(2))).expect("write");
    let older = read(&path).gaussians;
    assert_eq!(older.sh, g.sh);
    assert!(
        worst(&older.rotations[0], &[0.0, 1.0, -1.0, -0.2]) < 1e-5,
        "{:?}",
        older.rotations
    );
}

#[test]
fn the_bytes_of_a_splat_file_mean_what_they_should() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("a.splat");
    let mut bytes: Vec<u8> = [1.0_f32, -2.0, 0.5, 1.0, 0.0, 2.0]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    bytes.extend([255, 0, 51, 204, 128, 192, 128, 0]);
    fs::write(&path, &bytes).expect("write");
    let g = read(&path).gaussians;
    assert_eq!(g.means, [[1.0, -2.0, 0.5]]);
    assert_eq!(g.log_scales, [[0.0, f32::MIN_POSITIVE.ln(), 2.0_f32.ln()]]);
    assert!((g.opacity_logits[0] - 4.0_f32.ln()).abs() < 1e-5);
    assert!(worst(&g.base_colors()[0], &[1.0, 0.0, 0.2]) < 1e-5);
    assert_eq!(g.rotations, [[0.0, 0.5, 0.0, -1.0]]);
    bytes.extend(f32::NAN.to_le_bytes());
    fs::write(&path, &bytes).expect("write");
    assert!(refused(&path).contains("36 bytes, expected a multiple of 32"));
    bytes.extend([0; 28]);
    fs::write(&path, &bytes).expect("write");
    assert!(refused(&path).contains("row 1: found a value of means"));
}

/// Where `text` is in a file.
fn place(bytes: &[u8], text: &str) -> usize {
    let mut places = bytes.windows(text.len());
    places.position(|w| w == text.as_bytes()).expect("the text")
}

/// The file with another text of the same length.
fn replaced(mut bytes: Vec<u8>, old: &str, new: &str) -> Vec<u8> {
    let at = place(&bytes, old);
    bytes[at..at + old.len()].copy_from_slice(new.as_bytes());
    bytes
}

#[test]
fn files_that_cannot_be_used_are_refused() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("a.spz");
    let whole = spz_by_hand(3);
    let with = |at: usize, byte: u8| {
        let mut changed = whole.clone();
        changed[at] = byte;
        gzip(&changed)
    };
    let packed = gzip(&whole);
    for (bytes, found) in [
        (b"NGSP\x04\0\0\0".to_vec(), "content: found 8 bytes"),
        (
            [
                &version_4(&whole)[..8],
                &[0xFF, 0xFF, 0xFF, 0],
                &version_4(&whole)[12..],
            ]
            .concat(),
            "found 16777215 Gaussians",
        ),
        (
            version_4(&whole)[..140].to_vec(),
            "content: found 140 bytes",
        ),
        (b"ply\n".to_vec(), "found a PLY file"),
        (with(4, 9), "found version 9"),
        (with(12, 4), "SH degree: found 4"),
        (with(13, 99), "fractional bits: found 99"),
        // 255 times 2^24 Gaussians; two of which one is there.
        (with(11, 255), "exceeds the limit"),
        (with(8, 2), "the file is cut off"),
        (packed[..packed.len() - 9].to_vec(), "content: found"),
        (Vec::new(), "found an"),
    ] {
        fs::write(&path, bytes).expect("write");
        let message = refused(&path);
        assert!(message.contains(found), "{found}: {message}");
    }
    // A changed bit of the content shows in the checksum.
    let mut flipped = gzip(&whole);
    let middle = flipped.len() - 7;
    flipped[middle] ^= 1;
    fs::write(&path, flipped).expect("write");
    assert!(refused(&path).contains("content"));
    let compressed = dir.path().join("a.compressed.ply");
    formats::write(
        &compressed,
        Format::CompressedPly,
        &gaussians(300, 1),
        DVec3::ZERO,
        None,
    )
    .expect("write");
    let whole = fs::read(&compressed).expect("read");
    let bounds = place(&whole, "end_header\n") + 11;
    let mut infinite = whole.clone();
    infinite[bounds..bounds + 4].copy_from_slice(&f32::INFINITY.to_le_bytes());
    // One chunk instead of two, and coefficients of one Gaussian less.
    let fewer = [&whole[..bounds], &whole[bounds + 72..]].concat();
    let fewer = replaced(fewer, "chunk 2", "chunk 1");
    let short = whole[..whole.len() - 9].to_vec();
    let short = replaced(short, "sh 300", "sh 299");
    for (bytes, found) in [
        (infinite, "chunk, row 0: found a bound"),
        (fewer, "element chunk: found 1 rows"),
        (short, "element sh: found 299 rows, expected 300"),
        (whole[..whole.len() - 1].to_vec(), "cut off"),
    ] {
        fs::write(&compressed, bytes).expect("write");
        let message = refused(&compressed);
        assert!(message.contains(found), "{found}: {message}");
    }
}

#[test]
fn positions_that_floats_lose_are_refused() {
    let dir = tempfile::tempdir().expect("folder");
    let scene = gaussians(20, 0);
    for (format, name) in [
        (Format::Spz, "a.spz"),
        (Format::CompressedPly, "a.compressed.ply"),
    ] {
        let path = dir.path().join(name);
        let far = DVec3::new(4.5e5, 5.4e6, 100.0);
        let error = formats::write(&path, format, &scene, far, None).expect_err("refused");
        assert!(error.to_string().contains("write a .ply file"), "{error}");
        assert!(!path.exists());
        // A single small Gaussian is not.
        formats::write(
            &path,
            format,
            &scene.select(&[3]),
            DVec3::new(0.1, 7.3, 0.0),
            None,
        )
        .expect("write");
    }
    let mut far = scene;
    far.means[0][0] = 1e7;
    let error = formats::write(
        &dir.path().join("b.spz"),
        Format::Spz,
        &far,
        DVec3::ZERO,
        None,
    );
    let error = error.expect_err("refused").to_string();
    assert!(error.contains("at most 8388607"), "{error}");
}

#[test]
fn labels_of_another_file_are_refused() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("a.spz");
    let scene = gaussians(20, 0);
    formats::write(&path, Format::Spz, &scene, DVec3::ZERO, Some(&[4; 20])).expect("write");
    let other = dir.path().join("b.spz");
    formats::write(
        &other,
        Format::Spz,
        &scene.select(&[1, 2]),
        DVec3::ZERO,
        None,
    )
    .expect("write");
    fs::copy(&other, &path).expect("copy");
    let message = refused(&path);
    assert!(
        message.contains("a.spz.labels.json: sha256: found that of another file"),
        "{message}"
    );
    let plain = dir.path().join("c.ply");
    ply::write(&plain, &scene, DVec3::ZERO, None).expect("write");
    let sha256 = coseg::files::sha256(&plain).expect("readable");
    let text = format!("{{\"sha256\": \"{sha256}\", \"labels\": [1, 2]}}");
    fs::write(dir.path().join("c.ply.labels.json"), text).expect("write");
    assert!(refused(&plain).contains("labels: found 2, expected 20"));
}

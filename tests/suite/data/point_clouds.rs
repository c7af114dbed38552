//! Point clouds as PLY, in every encoding and colour type.

use coseg::data::Points;
use glam::DVec3;
use std::fs;

/// A point cloud of two rows in each encoding.
fn cloud(encoding: &str, colors: &str, rows: [[f64; 6]; 2]) -> Vec<u8> {
    let mut out = format!(
        "ply\nformat {encoding} 1.0\nelement camera 1\nproperty list uchar int ids\nelement vertex 2\n"
    );
    for name in ["x", "y", "z"] {
        out += &format!("property float {name}\n");
    }
    for name in ["red", "green", "blue"] {
        out += &format!("property {colors} {name}\n");
    }
    out += "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
    let mut bytes = out.into_bytes();
    let big = encoding == "binary_big_endian";
    let order = |mut v: Vec<u8>| {
        if big {
            v.reverse();
        }
        v
    };
    if encoding == "ascii" {
        bytes.extend_from_slice(b"2 8 9\n");
        for row in rows {
            bytes.extend(row.map(|v| v.to_string()).join(" ").bytes().chain([b'\n']));
        }
        bytes.extend_from_slice(b"1 0\n");
        return bytes;
    }
    bytes.push(2);
    for id in [8_i32, 9] {
        bytes.extend(order(id.to_le_bytes().into()));
    }
    for row in rows {
        for v in &row[..3] {
            bytes.extend(order((*v as f32).to_le_bytes().into()));
        }
        for v in &row[3..] {
            match colors {
                "uchar" => bytes.push(*v as u8),
                "ushort" => bytes.extend(order((*v as u16).to_le_bytes().into())),
                _ => bytes.extend(order((*v as f32).to_le_bytes().into())),
            }
        }
    }
    bytes.push(1);
    bytes.extend(order(0_i32.to_le_bytes().into()));
    bytes
}

#[test]
fn clouds_are_read_in_every_encoding_and_colour_type() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("points.ply");
    for encoding in ["ascii", "binary_little_endian", "binary_big_endian"] {
        for (colors, full) in [
            ("uchar", 255.0),
            ("ushort", 65_535.0),
            ("float", 1.0),
            ("float", 255.0),
        ] {
            let rows = [
                [1.0, 2.0, 3.0, full, 0.0, 0.2 * full],
                [4.0, 5.0, 6.5, 0.0, full, 0.0],
            ];
            fs::write(&path, cloud(encoding, colors, rows)).expect("write");
            let points = Points::read(&path, DVec3::new(1.0, 2.0, 3.0)).expect("points");
            assert_eq!(
                points.positions,
                [[0.0; 3], [3.0, 3.0, 3.5]],
                "{encoding} {colors}"
            );
            assert_eq!(
                points.colors,
                [[1.0, 0.0, 0.2], [0.0, 1.0, 0.0]],
                "{encoding} {colors}"
            );
        }
    }
    fs::write(
        &path,
        cloud(
            "binary_big_endian",
            "uchar",
            [[f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0]; 2],
        ),
    )
    .expect("write");
    let message = Points::read(&path, DVec3::ZERO)
        .expect_err("an error")
        .to_string();
    assert!(message.contains("row 0, column x"), "{message}");
    fs::write(
        &path,
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
        end_header\n1 2 3",
    )
    .expect("write");
    let points = Points::read(&path, DVec3::ZERO).expect("points");
    assert_eq!(
        (points.positions, points.colors),
        (vec![[1.0, 2.0, 3.0]], vec![[0.5; 3]])
    );
}

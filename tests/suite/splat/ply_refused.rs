//! Gaussian scenes as PLY that are refused.

use super::ply::{ascii, gaussians};
use coseg::Error;
use coseg::data::Points;
use coseg::splat::ply::{read, write};
use glam::DVec3;
use std::fs;

#[test]
fn an_origin_from_which_no_position_is_finite_is_refused() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("scene.ply");
    ascii(&path, |_| {});
    let text = fs::read_to_string(&path).expect("read");
    for (origin, is_usable) in [
        ("1e38 0 0", true),
        ("1e99 0 0", false),
        ("0 -1e39 0", false),
    ] {
        let comment = format!("coseg origin {origin}");
        fs::write(&path, text.replace("made by hand", &comment)).expect("write");
        match read(&path) {
            Ok(scene) => assert!(
                is_usable
                    && scene
                        .gaussians
                        .means
                        .as_flattened()
                        .iter()
                        .all(|v| v.is_finite()),
                "{origin}: {:?}",
                scene.gaussians.means
            ),
            Err(error) => {
                assert!(
                    !is_usable && matches!(error, Error::Input { .. }),
                    "{error}"
                );
                let message = error.to_string();
                for part in ["scene.ply", "comment coseg origin", "finite"] {
                    assert!(message.contains(part), "{part:?} is not in: {message}");
                }
            }
        }
    }
}

#[test]
fn broken_gaussian_files_are_refused_by_name() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("scene.ply");
    type Change = fn(&mut Vec<(String, String)>);
    let cases: [(Change, &[&str]); 9] = [
        (|p| p.retain(|(n, _)| n != "rot_2"), &["rot_2", "column"]),
        (|p| p.retain(|(n, _)| n != "x"), &["`x`", "column"]),
        (
            |p| p.push(("f_rest_0".into(), "0".into())),
            &["1 columns f_rest", "0, 9, 24 or 45"],
        ),
        (
            |p| p.extend((1..10).map(|i| (format!("f_rest_{i}"), "0".into()))),
            &["`f_rest_0`", "column"],
        ),
        (
            |p| p[2].1 = "NaN".into(),
            &["rows 0 to 0", "Line 20", "nan and inf"],
        ),
        (
            |p| p[8].1 = "1e39".into(),
            &["row 0", "f_dc_2", "inf", "finite"],
        ),
        (|p| p[7].1 = "seven".into(), &["rows 0 to 0", "damaged"]),
        (
            |p| p.push(("label".into(), "70000".into())),
            &["row 0", "label", "70000", "65535"],
        ),
        (
            |p| p.push(("label".into(), "1.5".into())),
            &["row 0", "label", "1.5", "65535"],
        ),
    ];
    for (change, parts) in cases {
        ascii(&path, change);
        let message = read(&path).expect_err("an error").to_string();
        for part in parts.iter().chain(&["scene.ply"]) {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
    }
    write(&path, &gaussians(3, 0), DVec3::ZERO, None).expect("write");
    let mut bytes = fs::read(&path).expect("read");
    let opacity_of_row_1 = bytes.len() - 17 * 4 - 8 * 4;
    bytes[opacity_of_row_1..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
    fs::write(&path, bytes).expect("write");
    let message = read(&path).expect_err("an error").to_string();
    assert!(
        message.contains("row 1, column opacity: found NaN"),
        "{message}"
    );
    let message = read(&dir.path().join("none.ply"))
        .expect_err("an error")
        .to_string();
    assert!(message.contains("none.ply"), "{message}");
    fs::write(&path, "ply\nformat ascii 1.0\nelement face 0\nend_header\n").expect("write");
    let message = read(&path).expect_err("an error").to_string();
    assert!(
        message.contains("[face]") && message.contains("`vertex`"),
        "{message}"
    );
    // More rows than the limit or than the file holds: refused before anything of that size is allocated.
    for (rows, part) in [
        ("1000000000000", "exceeds the limit"),
        ("200000000", "cut off"),
        ("99999999999999999999", "header"),
    ] {
        let text = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {rows}\nproperty float x\nproperty float y\n\
            property float z\nend_header\n"
        );
        fs::write(&path, text).expect("write");
        let message = Points::read(&path, DVec3::ZERO)
            .expect_err("an error")
            .to_string();
        assert!(message.contains(part), "{message}");
    }
    // A column name used twice makes rows longer than the parser takes them for.
    let mut twice = b"ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\n\
        property float z\nproperty float x\nend_header\n"
        .to_vec();
    twice.extend([0; 64]);
    fs::write(&path, twice).expect("write");
    let message = Points::read(&path, DVec3::ZERO)
        .expect_err("an error")
        .to_string();
    assert!(message.contains("used twice"), "{message}");
}

#[test]
fn unusable_scenes_are_not_written() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("scene.ply");
    let mut scene = gaussians(3, 1);
    scene.rotations[2][1] = f32::NAN;
    let message = write(&path, &scene, DVec3::ZERO, None)
        .expect_err("an error")
        .to_string();
    assert!(message.contains("rotations, row 2"), "{message}");
    let mut scene = gaussians(3, 1);
    scene.sh[2 * 12 + 5] = f32::INFINITY;
    let message = write(&path, &scene, DVec3::ZERO, None)
        .expect_err("an error")
        .to_string();
    assert!(message.contains("sh, row 2"), "{message}");
    let mut scene = gaussians(3, 1);
    assert!(write(&path, &scene, DVec3::ZERO, Some(&[1, 2])).is_err());
    scene.log_scales.pop();
    assert!(write(&path, &scene, DVec3::ZERO, None).is_err());
    assert!(!path.exists());
}

#[test]
fn a_ply_cut_anywhere_is_an_error() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("scene.ply");
    write(
        &path,
        &gaussians(7, 1),
        DVec3::new(0.0, 1e7, 0.0),
        Some(&[3; 7]),
    )
    .expect("write");
    let binary = fs::read(&path).expect("read");
    ascii(&path, |_| {});
    let text = fs::read(&path).expect("read");
    // The last number of an ascii file can be cut within its digits unnoticed.
    let noticed = text.len() - 5;
    for (whole, certain) in [(&binary, binary.len()), (&text, noticed)] {
        for length in 0..whole.len() {
            fs::write(&path, &whole[..length]).expect("write");
            let result = read(&path);
            assert!(
                length >= certain || result.is_err(),
                "cut to {length} of {} bytes",
                whole.len()
            );
        }
    }
}

#[test]
fn files_that_are_taken_for_scenes_are_named() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("scene.ply");
    let header = |columns: &[&str]| {
        let columns: String = columns
            .iter()
            .map(|c| format!("property float {c}\n"))
            .collect();
        format!("ply\nformat ascii 1.0\nelement vertex 1\n{columns}end_header\n")
    };
    let cases = [
        (String::new(), "an empty file"),
        ("some notes\n".to_owned(), "another kind of file"),
        ("{}".to_owned(), "JSON"),
        (
            header(&["packed_position", "packed_rotation"]),
            "elements [vertex], expected an element `chunk`",
        ),
        (
            header(&["x", "y", "z", "red", "green", "blue"]),
            "a point cloud",
        ),
        (
            header(&["x", "y", "z"]).replace(
                "end_header",
                "element face 0\nproperty list uchar int vertex_indices\nend_header",
            ),
            "a mesh",
        ),
        (
            "ply\nformat ascii 1.0\nelement vertex x\n".to_owned(),
            "line 3",
        ),
    ];
    for (text, found) in cases {
        fs::write(&path, text).expect("write");
        let message = read(&path).expect_err("an error").to_string();
        assert!(
            message.contains(found) && !message.contains("ParseError"),
            "{message}"
        );
    }
}

//! Gaussian scenes as PLY: the layout, and files that are refused.

use coseg::Error;
use coseg::data::{Limits, Points};
use coseg::splat::Gaussians;
use coseg::splat::ply::{PlyScene, read, write};
use glam::DVec3;
use std::fs;
use std::path::Path;

/// `n` Gaussians within about 10 units of zero, every value different.
fn gaussians(n: usize, sh_degree: usize) -> Gaussians {
    let wave = |i: usize, k: usize| (0.37 * i as f32 + 1.9 * k as f32).sin();
    let coefficients = 3 * (sh_degree + 1).pow(2);
    Gaussians {
        means: (0..n)
            .map(|i| [10.0 * wave(i, 0), 7.0 * wave(i, 1), 3.0 * wave(i, 2)])
            .collect(),
        log_scales: (0..n)
            .map(|i| [wave(i, 3) - 4.0, wave(i, 4), wave(i, 5)])
            .collect(),
        rotations: (0..n)
            .map(|i| [wave(i, 6), wave(i, 7), wave(i, 8), wave(i, 9)])
            .collect(),
        opacity_logits: (0..n).map(|i| 5.0 * wave(i, 10)).collect(),
        sh: (0..n * coefficients).map(|i| wave(i, 11)).collect(),
        sh_degree,
    }
}

fn reread(path: &Path) -> PlyScene {
    read(path, &Limits::default()).expect("readable")
}

fn header(path: &Path) -> String {
    let bytes = fs::read(path).expect("read");
    let end = bytes
        .windows(11)
        .position(|w| w == b"end_header\n")
        .expect("end")
        + 11;
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}

#[test]
fn scenes_survive_their_file_bit_for_bit() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("scene.ply");
    for sh_degree in 0..4 {
        for n in [0, 1, 5_000] {
            let scene = gaussians(n, sh_degree);
            let labels: Vec<u16> = (0..n).map(|i| (i * 97 % 65_536) as u16).collect();
            for labels in [None, Some(&labels[..])] {
                write(&path, &scene, DVec3::ZERO, labels).expect("write");
                let found = reread(&path);
                assert_eq!(found.gaussians, scene, "degree {sh_degree}, {n}");
                assert_eq!(found.labels.as_deref(), labels);
                assert_eq!(found.origin, DVec3::ZERO);
            }
        }
    }
}

#[test]
fn the_layout_is_that_of_3dgs() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("scene.ply");
    let scene = gaussians(2, 1);
    write(&path, &scene, DVec3::ZERO, Some(&[7, 300])).expect("write");
    let header = header(&path);
    let columns: Vec<_> = header
        .lines()
        .filter_map(|l| l.strip_prefix("property "))
        .collect();
    let mut want: Vec<String> = ["x", "y", "z", "nx", "ny", "nz"]
        .map(|n| format!("float {n}"))
        .into();
    want.extend((0..3).map(|i| format!("float f_dc_{i}")));
    want.extend((0..9).map(|i| format!("float f_rest_{i}")));
    want.push("float opacity".into());
    want.extend((0..3).map(|i| format!("float scale_{i}")));
    want.extend((0..4).map(|i| format!("float rot_{i}")));
    want.push("ushort label".into());
    assert_eq!(columns, want);
    assert!(
        header.starts_with("ply\nformat binary_little_endian 1.0\n"),
        "{header}"
    );
    // Row 1, by hand: f_rest is channel-major, the host's SH is coefficient-major.
    let bytes = fs::read(&path).expect("read");
    assert_eq!(bytes.len(), header.len() + 2 * (26 * 4 + 2));
    let row = &bytes[header.len() + 26 * 4 + 2..];
    let float =
        |i: usize| f32::from_le_bytes([row[4 * i], row[4 * i + 1], row[4 * i + 2], row[4 * i + 3]]);
    let sh = |k: usize, c: usize| scene.sh[12 + k * 3 + c];
    assert_eq!([float(0), float(1), float(2)], scene.means[1]);
    assert_eq!([float(3), float(4), float(5)], [0.0; 3]);
    for c in 0..3 {
        assert_eq!(float(6 + c), sh(0, c));
        for k in 1..4 {
            assert_eq!(float(9 + 3 * c + k - 1), sh(k, c));
        }
    }
    assert_eq!(float(18), scene.opacity_logits[1]);
    assert_eq!(
        [float(22), float(23), float(24), float(25)],
        scene.rotations[1]
    );
    assert_eq!(row[104..106], [44, 1]);
}

#[test]
fn far_origins_keep_their_precision() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("scene.ply");
    let scene = gaussians(1_000, 0);
    for (origin, kind) in [
        (DVec3::new(0.5, -2.25, 10.0), "float"),
        (DVec3::new(1e6 + 0.1, -2e6, 30.0), "double"),
        (DVec3::new(4.5e5, 5.4e6, 100.0), "double"),
    ] {
        write(&path, &scene, origin, None).expect("write");
        assert!(
            header(&path).contains(&format!("property {kind} x\n")),
            "{origin}"
        );
        let found = reread(&path);
        assert_eq!(found.origin, origin);
        let error = |a: &[f32; 3], b: &[f32; 3]| {
            a.iter()
                .zip(b)
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f32::max)
        };
        let worst = found
            .gaussians
            .means
            .iter()
            .zip(&scene.means)
            .map(|(a, b)| error(a, b))
            .fold(0.0, f32::max);
        assert!(worst < 2e-6, "{origin}: {worst}");
    }
    // Files of other tools record no origin: the mean is taken for far scenes, nothing is moved in near ones.
    write(&path, &scene, DVec3::new(1e6, -2e6, 30.0), None).expect("write");
    let bytes = fs::read(&path).expect("read");
    let at = bytes
        .windows(12)
        .position(|w| w == b"coseg origin")
        .expect("comment");
    let mut anonymous = bytes;
    anonymous[at..at + 5].copy_from_slice(b"other");
    fs::write(&path, anonymous).expect("write");
    let found = reread(&path);
    assert!(
        (found.origin - DVec3::new(1e6, -2e6, 30.0)).length() < 12.0,
        "{}",
        found.origin
    );
    for (a, b) in found.gaussians.means.iter().zip(&scene.means) {
        let back = DVec3::from(a.map(f64::from)) + found.origin - DVec3::new(1e6, -2e6, 30.0);
        assert!((back - DVec3::from(b.map(f64::from))).length() < 3e-6);
    }
}

/// One Gaussian of degree 0 in ascii, with `edit` applied to (name, value) pairs.
fn ascii(path: &Path, edit: impl Fn(&mut Vec<(String, String)>)) {
    let names = [
        "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
    ];
    let mut columns: Vec<_> = names
        .iter()
        .chain(&["rot_0", "rot_1", "rot_2", "rot_3"])
        .map(|n| (*n).to_owned())
        .collect();
    columns.reverse();
    let mut pairs: Vec<_> = columns
        .into_iter()
        .enumerate()
        .map(|(i, n)| (n, format!("{}.5", i)))
        .collect();
    edit(&mut pairs);
    let properties: String = pairs
        .iter()
        .map(|(n, _)| format!("property float {n}\n"))
        .collect();
    let values: Vec<_> = pairs.iter().map(|(_, v)| v.as_str()).collect();
    let header = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 1\n";
    fs::write(
        path,
        format!("{header}{properties}end_header\n{}\n", values.join(" ")),
    )
    .expect("write");
}

#[test]
fn columns_may_come_in_any_order_and_with_others_between() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("scene.ply");
    ascii(&path, |pairs| {
        pairs.insert(3, ("segment_confidence".into(), "-7e3".into()));
        pairs.push(("label".into(), "12".into()));
    });
    let scene = reread(&path);
    assert_eq!(scene.gaussians.means, [[13.5, 12.5, 11.5]]);
    assert_eq!(scene.gaussians.sh, [10.5, 9.5, 8.5]);
    assert_eq!(scene.gaussians.opacity_logits, [7.5]);
    assert_eq!(scene.gaussians.rotations, [[3.5, 2.5, 1.5, 0.5]]);
    // splat-transform writes every column as float.
    assert_eq!(scene.labels, Some(vec![12]));
}

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
        match read(&path, &Limits::default()) {
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
        let message = read(&path, &Limits::default())
            .expect_err("an error")
            .to_string();
        for part in parts.iter().chain(&["scene.ply"]) {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
    }
    write(&path, &gaussians(3, 0), DVec3::ZERO, None).expect("write");
    let mut bytes = fs::read(&path).expect("read");
    let opacity_of_row_1 = bytes.len() - 17 * 4 - 8 * 4;
    bytes[opacity_of_row_1..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
    fs::write(&path, bytes).expect("write");
    let message = read(&path, &Limits::default())
        .expect_err("an error")
        .to_string();
    assert!(
        message.contains("row 1, column opacity: found NaN"),
        "{message}"
    );
    let message = read(&dir.path().join("none.ply"), &Limits::default())
        .expect_err("an error")
        .to_string();
    assert!(message.contains("none.ply"), "{message}");
    fs::write(&path, "ply\nformat ascii 1.0\nelement face 0\nend_header\n").expect("write");
    let message = read(&path, &Limits::default())
        .expect_err("an error")
        .to_string();
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
        let message = Points::read(&path, DVec3::ZERO, &Limits::default())
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
    let message = Points::read(&path, DVec3::ZERO, &Limits::default())
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
            let result = read(&path, &Limits::default());
            assert!(
                length >= certain || result.is_err(),
                "cut to {length} of {} bytes",
                whole.len()
            );
        }
    }
}

#[test]
fn infinite_logits_are_opacities_of_almost_0_and_1() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("scene.ply");
    for (logit, expected) in [("1e39", 1.0), ("-1e39", 0.0)] {
        ascii(&path, |p| p[7].1 = logit.into());
        let found = reread(&path).gaussians.opacity_logits[0];
        let opacity = 1.0 / (1.0 + (-found).exp());
        assert!(
            found.is_finite() && (opacity - expected).abs() < 2e-6,
            "{found}"
        );
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
            "ply\nformat ascii 1.0\nelement vertex x\n".to_owned(),
            "line 3",
        ),
    ];
    for (text, found) in cases {
        fs::write(&path, text).expect("write");
        let message = read(&path, &Limits::default())
            .expect_err("an error")
            .to_string();
        assert!(
            message.contains(found) && !message.contains("ParseError"),
            "{message}"
        );
    }
}

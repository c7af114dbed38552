//! Gaussian scenes as PLY: the layout, and what survives a file.
use coseg::splat::Gaussians;
use coseg::splat::ply::{PlyScene, read, write};
use glam::DVec3;
use std::fs;
use std::path::Path;

/// `n` Gaussians within about 10 units of zero, every value different.
pub(super) fn gaussians(n: usize, sh_degree: usize) -> Gaussians {
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
    read(path).expect("readable")
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
pub(super) fn ascii(path: &Path, edit: impl Fn(&mut Vec<(String, String)>)) {
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

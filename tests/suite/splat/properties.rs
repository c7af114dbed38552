//! Properties of scenes in PLY files: what is written comes back, and no damage panics.

use coseg::Error;
use coseg::data::Points;
use coseg::splat::Gaussians;
use coseg::splat::ply::{read, write};
use glam::DVec3;
use proptest::array::{uniform3, uniform4};
use proptest::collection::vec;
use proptest::num::f32::{NEGATIVE, NORMAL, POSITIVE, SUBNORMAL, ZERO};
use proptest::prelude::*;
use proptest::sample::Index;
use std::fs;
use std::path::Path;

fn any_finite() -> impl Strategy<Value = f32> + Copy {
    POSITIVE | NEGATIVE | NORMAL | SUBNORMAL | ZERO
}

/// Up to `most` Gaussians of any degree, at `places`, of any finite numbers.
fn gaussians(
    most: usize,
    places: impl Strategy<Value = f32> + Clone,
) -> impl Strategy<Value = Gaussians> {
    (0..4_usize, 0..=most).prop_flat_map(move |(sh_degree, n)| {
        let number = any_finite();
        let coefficients = n * 3 * (sh_degree + 1).pow(2);
        let columns = (
            vec(uniform3(places.clone()), n),
            vec(uniform3(number), n),
            vec(uniform4(number), n),
            vec(number, n),
            vec(number, coefficients),
        );
        columns.prop_map(
            move |(means, log_scales, rotations, opacity_logits, sh)| Gaussians {
                means,
                log_scales,
                rotations,
                opacity_logits,
                sh,
                sh_degree,
            },
        )
    })
}

/// Gaussians, with a label for each or none.
type Labelled = (Gaussians, Option<Vec<u16>>);

fn scenes(
    most: usize,
    places: impl Strategy<Value = f32> + Clone,
) -> impl Strategy<Value = Labelled> {
    gaussians(most, places).prop_flat_map(|gaussians| {
        let labels = proptest::option::of(vec(any::<u16>(), gaussians.len()));
        (Just(gaussians), labels)
    })
}

/// Near, and so far out that positions are stored as double.
fn origins() -> impl Strategy<Value = DVec3> {
    prop_oneof![Just(DVec3::ZERO), Just(DVec3::new(0.0, 1e7, 0.0))]
}

/// The bytes of the file of a scene at `path`, and those of the same scene in ascii.
fn files(path: &Path, (gaussians, labels): &Labelled, origin: DVec3) -> [Vec<u8>; 2] {
    write(path, gaussians, origin, labels.as_deref()).expect("written");
    let binary = fs::read(path).expect("read");
    let end = b"end_header\n";
    let at = binary.windows(end.len()).position(|window| window == end);
    let (header, mut rows) = binary.split_at(at.expect("a header") + end.len());
    let header = std::str::from_utf8(header).expect("text");
    let mut ascii = header.replace("binary_little_endian", "ascii");
    let [doubles, floats, shorts] = ["double", "float", "ushort"]
        .map(|kind| header.matches(&format!("property {kind} ")).count());
    while !rows.is_empty() {
        let mut take = |width: usize| rows.split_off(..width).expect("a row");
        for value in take(8 * doubles).as_chunks().0 {
            ascii += &format!("{} ", f64::from_le_bytes(*value));
        }
        for value in take(4 * floats).as_chunks().0 {
            ascii += &format!("{} ", f32::from_le_bytes(*value));
        }
        for value in take(2 * shorts).as_chunks().0 {
            ascii += &u16::from_le_bytes(*value).to_string();
        }
        ascii += "\n";
    }
    [binary, ascii.into_bytes()]
}

/// Whether `bytes` are a scene. Read as a scene and as a cloud, they have finite numbers or an error that names the file.
fn is_read(path: &Path, bytes: &[u8]) -> Result<bool, TestCaseError> {
    fs::write(path, bytes).expect("written");
    let scene = read(path);
    let cloud = Points::read(path, DVec3::ZERO);
    for error in [scene.as_ref().err(), cloud.as_ref().err()]
        .into_iter()
        .flatten()
    {
        let of_files = matches!(error, Error::Input { .. } | Error::Limit { .. });
        prop_assert!(
            of_files && error.to_string().contains("scene.ply"),
            "{error:?}"
        );
    }
    if let Ok(scene) = &scene {
        let rows = scene.gaussians.len();
        prop_assert!(
            scene
                .gaussians
                .means
                .as_flattened()
                .iter()
                .all(|v| v.is_finite())
        );
        prop_assert!(
            scene
                .labels
                .as_ref()
                .is_none_or(|labels| labels.len() == rows)
        );
    }
    if let Ok(cloud) = cloud {
        prop_assert!(cloud.positions.as_flattened().iter().all(|v| v.is_finite()));
    }
    Ok(scene.is_ok())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn scenes_come_back(scene in scenes(40, any_finite())) {
        let dir = tempfile::tempdir().expect("folder");
        let path = dir.path().join("scene.ply");
        for bytes in files(&path, &scene, DVec3::ZERO) {
            fs::write(&path, bytes).expect("written");
            let found = read(&path).expect("readable");
            prop_assert_eq!(found.origin, DVec3::ZERO);
            prop_assert_eq!(&(found.gaussians, found.labels), &scene);
        }
    }

    #[test]
    fn cut_files_are_refused(scene in scenes(6, -100.0..100.0_f32), origin in origins(), cuts in vec(any::<Index>(), 20)) {
        let dir = tempfile::tempdir().expect("folder");
        let path = dir.path().join("scene.ply");
        let [binary, ascii] = files(&path, &scene, origin);
        for cut in cuts {
            let length = cut.index(binary.len());
            // Of a scene of nothing the last line end can be missing.
            let noticed = !scene.0.is_empty() || length + 1 < binary.len();
            prop_assert!(!(is_read(&path, &binary[..length])? && noticed), "cut to {length}");
            // The last number can be cut within its digits unnoticed.
            is_read(&path, &ascii[..cut.index(ascii.len())])?;
        }
    }

    #[test]
    fn changed_bytes_do_not_panic(
        scene in scenes(6, -100.0..100.0_f32),
        origin in origins(),
        damages in vec(vec((any::<Index>(), any::<u8>()), 1..4), 40),
    ) {
        let dir = tempfile::tempdir().expect("folder");
        let path = dir.path().join("scene.ply");
        for whole in files(&path, &scene, origin) {
            for damage in &damages {
                let mut damaged = whole.clone();
                for (at, byte) in damage {
                    damaged[at.index(whole.len())] = *byte;
                }
                is_read(&path, &damaged)?;
            }
        }
    }
}

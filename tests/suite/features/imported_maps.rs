//! Feature maps of other programs: npy and safetensors, whole, then hostile.

use crate::support::feature_maps::write_npy;
use crate::support::lifting::extract;
use crate::support::pictures::{picture, pictures, scene, view};
use coseg::config::{FeatureConfig, FeatureSource};
use coseg::data::{Classes, Split};

fn ramp(count: usize, seed: usize) -> Vec<f32> {
    (0..count)
        .map(|i| ((i * 37 + seed * 101) % 997) as f32 / 997.0)
        .collect()
}

#[test]
fn maps_are_imported_from_npy_and_safetensors() {
    use safetensors::tensor::{Dtype, TensorView};
    let dir = tempfile::tempdir().expect("temporary folder");
    let scene = pictures(3);
    let shapes = [[12_usize, 16, 5], [12, 16, 6], [6, 8, 7], [3, 4, 80]];
    let values: Vec<Vec<f32>> = (0..4)
        .map(|n| ramp(shapes[n].iter().product(), n))
        .collect();
    for stem in ["v0", "v1"] {
        for n in 0..4 {
            write_npy(
                &dir.path().join(format!("{stem}.{}.npy", n + 1)),
                &shapes[n].map(|x| x as u64),
                &values[n],
            );
        }
    }
    // The third view in half precision.
    let bytes: Vec<Vec<u8>> = values
        .iter()
        .map(|v| {
            v.iter()
                .flat_map(|&x| half::f16::from_f32(x).to_le_bytes())
                .collect()
        })
        .collect();
    let tensors = (0..4).map(|n| {
        (
            format!("scale{}", n + 1),
            TensorView::new(Dtype::F16, shapes[n].to_vec(), &bytes[n]).expect("view"),
        )
    });
    std::fs::write(
        dir.path().join("v2.safetensors"),
        safetensors::serialize(tensors, None).expect("serialize"),
    )
    .expect("write");
    let config = FeatureConfig {
        source: FeatureSource::Import(dir.path().to_owned()),
        ..FeatureConfig::default()
    };
    let set = extract(&scene, &config, 0, &crate::support::device()).expect("imported");
    assert_eq!(set.name, format!("imported {}", dir.path().display()));
    for (n, [h, w, _]) in shapes.into_iter().enumerate() {
        let map = &set.views[0].maps[n];
        assert_eq!((map.height, map.width, map.channels), (h, w, 64));
        assert!(set.views[0].maps[n] == set.views[1].maps[n]);
        let difference = map
            .data
            .iter()
            .zip(&set.views[2].maps[n].data)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        assert!(difference < 2e-2, "half precision: {difference}");
    }
    assert!(
        set.views[0].maps[0]
            .data
            .chunks_exact(64)
            .all(|c| c[5..].iter().all(|&x| x == 0.0)),
        "5 channels, padded"
    );
}

/// An npy file of version 1 with this header and these bytes.
fn npy(descr: &str, fortran: bool, shape: &str, bytes: Vec<u8>) -> Vec<u8> {
    let order = if fortran { "True" } else { "False" };
    let text = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': ({shape}), }}\n");
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((text.len() as u16).to_le_bytes());
    file.extend(text.bytes());
    file.extend(bytes);
    file
}

#[test]
fn npy_maps_of_any_order_and_float_are_the_same() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let one = scene(
        vec![view("a", Split::Train, picture(16, 16, 0), None)],
        Classes::default(),
    );
    let config = FeatureConfig {
        source: FeatureSource::Import(dir.path().to_owned()),
        ..FeatureConfig::default()
    };
    let (height, width, channels) = (3, 4, 2);
    // Numbers that half precision holds exactly.
    let value = |y: usize, x: usize, c: usize| ((y * 5 + x * x * 3 + c * 7) % 13) as f32 - 4.5;
    let mut row_major = Vec::new();
    for y in 0..height {
        for x in 0..width {
            row_major.extend((0..channels).map(|c| value(y, x, c)));
        }
    }
    let mut column_major = Vec::new();
    for c in 0..channels {
        for x in 0..width {
            column_major.extend((0..height).map(|y| value(y, x, c)));
        }
    }
    let shape = format!("{height}, {width}, {channels}");
    let maps = |descr: &str, fortran: bool, bytes: Vec<u8>| {
        for n in 1..=4 {
            let file = npy(descr, fortran, &shape, bytes.clone());
            std::fs::write(dir.path().join(format!("a.{n}.npy")), file).expect("write");
        }
        extract(&one, &config, 0, &crate::support::device())
    };
    fn bytes<const N: usize>(values: &[f32], to: impl Fn(f32) -> [u8; N]) -> Vec<u8> {
        values.iter().flat_map(|&v| to(v)).collect()
    }
    let plain = maps("<f4", false, bytes(&row_major, f32::to_le_bytes)).expect("maps");
    let half = |v: f32| half::f16::from_f32(v);
    for (descr, fortran, bytes) in [
        (">f4", false, bytes(&row_major, f32::to_be_bytes)),
        ("<f2", false, bytes(&row_major, |v| half(v).to_le_bytes())),
        (">f2", false, bytes(&row_major, |v| half(v).to_be_bytes())),
        ("<f4", true, bytes(&column_major, f32::to_le_bytes)),
    ] {
        let found = maps(descr, fortran, bytes).expect("maps");
        assert!(found.views == plain.views, "{descr} {fortran}");
    }
    let error = maps("<f8", false, vec![0; 8 * 24]).expect_err("f64");
    crate::support::assert_names(&error, &["a.1.npy", "dtype", "f8"]);
}

#[test]
fn hostile_maps_are_refused_by_name() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let one = scene(
        vec![view("a", Split::Train, picture(16, 16, 0), None)],
        Classes::default(),
    );
    let config = FeatureConfig {
        source: FeatureSource::Import(dir.path().to_owned()),
        ..FeatureConfig::default()
    };
    let file = |n: usize| dir.path().join(format!("a.{n}.npy"));
    let good = || (1..=4).for_each(|n| write_npy(&file(n), &[2, 3, 4], &ramp(24, n)));
    let error = || {
        extract(&one, &config, 0, &crate::support::device())
            .expect_err("hostile")
            .to_string()
    };
    assert!(error().contains("view a, scale 1"), "absent");
    good();
    extract(&one, &config, 0, &crate::support::device()).expect("good maps");
    let bytes = std::fs::read(file(3)).expect("map");
    for cut in [0, 5, 9, 40, bytes.len() - 3] {
        std::fs::write(file(3), &bytes[..cut]).expect("write");
        assert!(error().contains("a.3.npy"), "cut at {cut}: {}", error());
    }
    good();
    let mut nan = ramp(24, 1);
    nan[13] = f32::NAN;
    write_npy(&file(2), &[2, 3, 4], &nan);
    assert!(
        error().contains("a.2.npy") && error().contains("row 3"),
        "{}",
        error()
    );
    good();
    write_npy(&file(2), &[6, 4], &ramp(24, 1));
    assert!(error().contains("shape"), "{}", error());
    write_npy(&file(2), &[0, 3, 4], &[]);
    assert!(error().contains("shape"), "{}", error());
    // A header that promises petabytes, and one longer than the file.
    let text = b"{'descr': '<f4', 'fortran_order': False, 'shape': (900000, 900000, 64), }\n";
    let mut huge = b"\x93NUMPY\x01\x00".to_vec();
    huge.extend((text.len() as u16).to_le_bytes());
    huge.extend(text);
    std::fs::write(file(2), &huge).expect("write");
    assert!(error().contains("a.2.npy"), "{}", error());
    std::fs::write(file(2), b"\x93NUMPY\x02\x00\xff\xff\xff\xffabc").expect("write");
    assert!(error().contains("header"), "{}", error());
    good();
    std::fs::write(
        dir.path().join("a.safetensors"),
        b"\xff\xff\xff\xff\xff\xff\xff\x7f{}",
    )
    .expect("write");
    assert!(error().contains("a.safetensors"), "{}", error());
}

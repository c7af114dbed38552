//! Properties of all loaders: what is written comes back, both forms of a COLMAP model are one, and no bytes panic.

use coseg::data::formats::transforms::{load_cameras, write_cameras};
use coseg::data::{
    self, Class, Classes, LabelMap, LabelRuns, LoadOptions, NamedCamera, ObjectOf, Points, Split,
    read_cameras,
};
use coseg::splat::camera::Camera;
use glam::{DMat4, DQuat, DVec3};
use proptest::collection::{btree_map, vec};
use proptest::prelude::*;
use std::fs;
use std::path::Path;

fn quaternions() -> impl Strategy<Value = DQuat> {
    let axis =
        vec(-1.0..1.0_f64, 3).prop_filter("an axis", |v| DVec3::from_slice(v).length() > 0.1);
    (axis, -3.0..3.0_f64).prop_map(|(axis, angle)| {
        DQuat::from_axis_angle(DVec3::from_slice(&axis).normalize(), angle)
    })
}

fn cameras() -> impl Strategy<Value = Camera> {
    let intrinsics = (
        1.0..2e3_f64,
        1.0..2e3_f64,
        0.0..1e3_f64,
        0.0..1e3_f64,
        1..900_usize,
        1..900_usize,
    );
    let intrinsics = intrinsics.prop_map(|(fx, fy, cx, cy, width, height)| Camera {
        cx,
        cy,
        ..Camera::centred([fx, fy], [width, height])
    });
    (quaternions(), vec(-1e3..1e3_f64, 3), intrinsics).prop_map(|(rotation, center, intrinsics)| {
        let pose = DMat4::from_rotation_translation(rotation, DVec3::from_slice(&center));
        intrinsics.with_opencv_pose(&pose).expect("a rotation")
    })
}

fn assert_same(a: &Camera, b: &Camera) {
    let numbers = |c: &Camera| {
        let mut all = c.rotation.to_cols_array().to_vec();
        all.extend(c.center.to_array());
        all.extend([c.fx, c.fy, c.cx, c.cy]);
        all
    };
    assert_eq!((a.width, a.height), (b.width, b.height));
    let equal = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-9 * (1.0 + a.abs());
    assert!(numbers(a).iter().zip(&numbers(b)).all(equal), "{a:?} {b:?}");
}

fn label_maps() -> impl Strategy<Value = LabelMap> {
    let ids = prop_oneof![0..4_u16, any::<u16>()];
    (1..40_usize, 1..40_usize).prop_flat_map(move |(width, height)| {
        vec(ids.clone(), width * height).prop_map(move |ids| LabelMap { width, height, ids })
    })
}

fn class_tables() -> impl Strategy<Value = Classes> {
    let object = proptest::option::of((any::<u16>(), any::<bool>()));
    let class = ("[a-z \"\\\\é]{1,12}", any::<[u8; 3]>(), object);
    let tables = (any::<u16>(), btree_map(any::<u16>(), class, 0..20));
    tables.prop_map(|(ignore, mut classes)| {
        classes.remove(&ignore);
        let entries = classes.into_iter().map(|(id, (name, color, object))| {
            let object_of = object.map(|(class, thing)| ObjectOf { class, thing });
            Class {
                id,
                name,
                color,
                object_of,
            }
        });
        Classes {
            entries: entries.collect(),
            ignore,
        }
    })
}

/// Writes `cameras` as a COLMAP model in both forms, into the folders `bin` and `txt` of `dir`.
fn write_colmap(dir: &Path, cameras: &[Camera]) {
    let count = (cameras.len() as u64).to_le_bytes();
    let (mut models, mut images) = (count.to_vec(), count.to_vec());
    let (mut model_lines, mut image_lines) = (String::new(), String::new());
    for (camera, id) in cameras.iter().zip(1_u32..) {
        let rotation = DQuat::from_mat3(&camera.rotation);
        let translation = -(camera.rotation * camera.center);
        let pose = [
            rotation.w,
            rotation.x,
            rotation.y,
            rotation.z,
            translation.x,
            translation.y,
            translation.z,
        ];
        let params = [camera.fx, camera.fy, camera.cx, camera.cy];
        models.extend(id.to_le_bytes());
        models.extend(1_i32.to_le_bytes());
        models.extend(
            [camera.width as u64, camera.height as u64]
                .map(u64::to_le_bytes)
                .concat(),
        );
        models.extend(params.map(f64::to_le_bytes).concat());
        images.extend(id.to_le_bytes());
        images.extend(pose.map(f64::to_le_bytes).concat());
        images.extend(id.to_le_bytes());
        images.extend(format!("{id:03}.png\0").bytes());
        images.extend(0_u64.to_le_bytes());
        let words = |values: &[f64]| {
            values
                .iter()
                .map(|v| format!("{v:?}"))
                .collect::<Vec<_>>()
                .join(" ")
        };
        model_lines += &format!(
            "{id} PINHOLE {} {} {}\n",
            camera.width,
            camera.height,
            words(&params)
        );
        image_lines += &format!("{id} {} {id} {id:03}.png\n\n", words(&pose));
    }
    for form in ["bin", "txt"] {
        fs::create_dir_all(dir.join(form).join("images")).expect("folder");
        fs::create_dir_all(dir.join(form).join("sparse/0")).expect("folder");
    }
    let write = |path: &str, bytes: &[u8]| fs::write(dir.join(path), bytes).expect("write");
    write("bin/sparse/0/cameras.bin", &models);
    write("bin/sparse/0/images.bin", &images);
    write("txt/sparse/0/cameras.txt", model_lines.as_bytes());
    write("txt/sparse/0/images.txt", image_lines.as_bytes());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn transforms_come_back(cameras in vec((cameras(), any::<bool>()), 1..5)) {
        let named = |(i, (camera, test)): (usize, (Camera, bool))| {
            let split = if test { Split::Test } else { Split::Train };
            NamedCamera { name: format!("v{i}"), split, camera }
        };
        let cameras: Vec<_> = cameras.into_iter().enumerate().map(named).collect();
        let dir = tempfile::tempdir().expect("folder");
        let path = dir.path().join("transforms.json");
        write_cameras(&path, &cameras).expect("write");
        let read = load_cameras(&path, None).expect("read");
        prop_assert_eq!(read.len(), cameras.len());
        for (a, b) in cameras.iter().zip(&read) {
            prop_assert_eq!((&a.name, a.split), (&b.name, b.split));
            assert_same(&a.camera, &b.camera);
        }
    }

    #[test]
    fn both_forms_of_a_colmap_model_are_one(cameras in vec(cameras(), 1..5)) {
        let dir = tempfile::tempdir().expect("folder");
        write_colmap(dir.path(), &cameras);
        let options = LoadOptions { max_side: 0, ..LoadOptions::default() };
        let read = |form| data::load_cameras(&dir.path().join(form), &options, None).expect("cameras");
        let (binary, text) = (read("bin"), read("txt"));
        prop_assert_eq!(&binary, &text);
        prop_assert_eq!(binary.len(), cameras.len());
        binary.iter().zip(&cameras).for_each(|(read, camera)| assert_same(&read.camera, camera));
    }

    #[test]
    fn label_maps_come_back(map in label_maps()) {
        let dir = tempfile::tempdir().expect("folder");
        let path = dir.path().join("map.png");
        map.write(&path).expect("write");
        prop_assert_eq!(&LabelMap::read(&path).expect("read"), &map);
        let runs = LabelRuns::from(map.clone());
        prop_assert!(runs.runs().count() <= map.ids.len());
        prop_assert_eq!(runs.runs().map(|(_, length)| length).sum::<usize>(), map.ids.len());
        prop_assert_eq!(runs.map(), map);
    }

    #[test]
    fn class_tables_come_back(classes in class_tables()) {
        let dir = tempfile::tempdir().expect("folder");
        let path = dir.path().join("classes.json");
        classes.write(&path).expect("write");
        prop_assert_eq!(Classes::read(&path).expect("read"), classes);
    }

    #[test]
    fn no_bytes_panic(bytes in vec(any::<u8>(), 0..300), kind in 0..5_usize) {
        // What follows a right beginning gets farther.
        let start: &[u8] = match kind {
            0 => b"",
            1 => b"{\"frames\": [",
            2 => b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\n",
            3 => b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR",
            _ => &[1, 0, 0, 0, 0, 0, 0, 0],
        };
        let bytes = [start, &bytes].concat();
        let dir = tempfile::tempdir().expect("folder");
        let at = |name: &str| dir.path().join(name);
        fs::create_dir_all(at("colmap/sparse/0")).expect("folder");
        fs::create_dir_all(at("colmap/images")).expect("folder");
        let model = ["cameras", "images", "points3D"].map(|part| format!("colmap/sparse/0/{part}"));
        for name in ["transforms.json", "classes.json", "map.png", "cloud.ply", "cameras.json"] {
            fs::write(at(name), &bytes).expect("write");
        }
        let options = LoadOptions::default();
        let _ = read_cameras(&at("cameras.json"), None);
        let _ = load_cameras(&at("transforms.json"), None);
        let _ = data::load(dir.path(), &options);
        let _ = Classes::read(&at("classes.json"));
        let _ = LabelMap::read(&at("map.png"));
        let _ = Points::read(&at("cloud.ply"), DVec3::ZERO);
        for form in ["txt", "bin"] {
            model.iter().for_each(|part| fs::write(at(&format!("{part}.{form}")), &bytes).expect("write"));
            prop_assert!(data::load(&at("colmap"), &options).is_err());
            let checked = data::check(&at("colmap"), &options);
            prop_assert!(!checked.problems.is_empty());
        }
    }
}

//! COLMAP folders: one small model in both forms, then in many broken ones.

use crate::support::colmap::{
    Calibrated, HEIGHT, POINTS, VIEWS, WIDTH, binary, name, photo, pinhole, pose, scene, text,
};
use coseg::config::Layout;
use coseg::data::{Limits, LoadOptions, Split, View, load, load_cameras, locate};
use coseg::splat::camera::Camera;
use glam::{DMat3, DQuat, DVec3};
use std::fs;
use std::path::Path;
use std::sync::Arc;

fn pixels(view: &View) -> Arc<image::RgbImage> {
    view.image.pixels().expect("photo")
}

#[track_caller]
fn expect_error(dir: &Path, options: &LoadOptions, parts: &[&str]) {
    crate::support::assert_names(&load(dir, options).expect_err("an error"), parts);
}

#[test]
fn colmap_models_load_in_both_forms() {
    let options = LoadOptions::default();
    let [a, b] = [binary, text].map(|write| {
        let dir = scene(write, &pinhole());
        assert_eq!(
            locate(dir.path(), &options).expect("layout"),
            Layout::Colmap
        );
        load(dir.path(), &options).expect("scene")
    });
    assert_eq!((&a.points, a.origin), (&b.points, b.origin));
    let names: Vec<_> = a.views.iter().map(|v| v.name.as_str()).collect();
    let expected = [0, 2, 4, 6, 8, 1, 3, 5, 7].map(|i| format!("cam{}_photo {i}", i % 2));
    assert_eq!(names, expected);
    for (i, (x, y)) in a.views.iter().zip(&b.views).enumerate() {
        assert_eq!((&x.name, x.split, &x.camera), (&y.name, y.split, &y.camera));
        assert_eq!((pixels(x), &x.truth, &x.raw), (pixels(y), &y.truth, &y.raw));
        assert_eq!(
            x.split,
            if i % 8 == 0 {
                Split::Test
            } else {
                Split::Train
            }
        );
    }
    let view = &a.views[1];
    assert_eq!(*pixels(view), photo(2));
    assert_eq!(view.truth.as_ref().expect("truth").map().ids[0], 1);
    assert_eq!(view.raw.as_ref().expect("raw").map().ids[0], 1);
    assert!(
        a.views[6].raw.is_none() && a.views[6].truth.is_some(),
        "photo 3 has no raw labels"
    );
    // World-to-camera as it stands in the file, though the centre is kept instead of the translation.
    let (q, t) = pose(2);
    let Camera {
        rotation,
        center,
        fx,
        fy,
        cx,
        cy,
        ..
    } = &view.camera;
    assert_eq!((*fx, *fy, *cx, *cy), (20.0, 21.0, 8.5, 6.25));
    let off = *rotation - DMat3::from_quat(q);
    assert!(
        off.to_cols_array().iter().all(|v| v.abs() < 1e-12),
        "{rotation}"
    );
    let world = DVec3::new(0.4, 0.1, 5.0);
    let seen = *rotation * (world - a.origin - *center);
    assert!((seen - (q * world + t)).length() < 1e-12, "{seen}");
    let mean = a.views.iter().map(|v| v.camera.center).sum::<DVec3>();
    assert!(mean.length() < 1e-12);
    // Cameras alone need no photos.
    let dir = scene(text, &pinhole());
    fs::remove_file(dir.path().join("images").join(name(2))).expect("remove");
    let cameras = load_cameras(dir.path(), &options, Some(Split::Train)).expect("cameras");
    assert_eq!(
        (cameras.len(), cameras[0].name.as_str()),
        (7, "cam0_photo 2")
    );
    assert!((cameras[0].camera.center - a.origin - *center).length() < 1e-12);
    for (k, (position, color, _)) in POINTS.iter().enumerate() {
        let found = DVec3::from(a.points.positions[k].map(f64::from)) + a.origin;
        assert!((found - DVec3::from(*position)).length() < 1e-6, "{found}");
        assert_eq!(a.points.colors[k], color.map(|c| f32::from(c) / 255.0));
    }
}

#[test]
fn colmap_options_thin_scale_and_name_folders() {
    let dir = scene(binary, &pinhole());
    let options = LoadOptions {
        stride: 2,
        ..LoadOptions::default()
    };
    let names: Vec<_> = load(dir.path(), &options)
        .expect("scene")
        .views
        .into_iter()
        .map(|v| v.name)
        .collect();
    assert_eq!(
        names,
        [
            "cam0_photo 0",
            "cam0_photo 4",
            "cam0_photo 8",
            "cam1_photo 3",
            "cam1_photo 7"
        ]
    );
    let options = LoadOptions {
        max_frames: 3,
        ..LoadOptions::default()
    };
    assert_eq!(load(dir.path(), &options).expect("scene").views.len(), 3);
    // Photos of half the size in a folder that is named: cameras follow, label maps too.
    for i in 0..VIEWS {
        let path = dir.path().join("images_2").join(name(i));
        fs::create_dir_all(path.parent().expect("parent")).expect("folder");
        image::RgbImage::new(WIDTH / 2, HEIGHT / 2)
            .save(path)
            .expect("photo");
    }
    let half = LoadOptions {
        images: "images_2".into(),
        ..LoadOptions::default()
    };
    let view = &load(dir.path(), &half).expect("scene").views[1];
    let Camera {
        fx,
        fy,
        cx,
        cy,
        width,
        height,
        ..
    } = view.camera;
    assert_eq!(
        (fx, fy, cx, cy, width, height),
        (10.0, 10.5, 4.25, 3.125, 8, 6)
    );
    assert_eq!(
        view.truth
            .as_ref()
            .map(|t| (t.width(), t.height(), t.map().ids.len())),
        Some((8, 6, 48))
    );
    // A model right in sparse, and without points.
    for part in ["cameras", "images"] {
        let name = format!("{part}.bin");
        fs::rename(
            dir.path().join("sparse/0").join(&name),
            dir.path().join("sparse").join(&name),
        )
        .expect("move");
    }
    assert!(
        load(dir.path(), &LoadOptions::default())
            .expect("scene")
            .points
            .is_empty()
    );
    // Photos in nerfstudio's way: the model it was made from does not make the folder ambiguous.
    fs::create_dir(dir.path().join("colmap")).expect("folder");
    fs::rename(dir.path().join("sparse"), dir.path().join("colmap/sparse")).expect("move");
    for part in ["cameras.bin", "images.bin"] {
        fs::rename(
            dir.path().join("colmap/sparse").join(part),
            dir.path().join("colmap/sparse/0").join(part),
        )
        .expect("move");
    }
    assert_eq!(
        locate(dir.path(), &options).expect("layout"),
        Layout::Colmap
    );
    fs::write(dir.path().join("transforms.json"), "{}").expect("write");
    assert_eq!(
        locate(dir.path(), &options).expect("layout"),
        Layout::Transforms
    );
}

#[test]
fn colmap_models_that_are_no_pinhole_are_refused_by_name() {
    for (number, name) in [
        (5, "OPENCV_FISHEYE"),
        (6, "FULL_OPENCV"),
        (7, "FOV"),
        (10, "THIN_PRISM_FISHEYE"),
        (99, "99"),
    ] {
        let dir = scene(binary, &Calibrated(number, vec![20.0; 12]));
        expect_error(
            dir.path(),
            &LoadOptions::default(),
            &["cameras.bin", "MODEL", name, "image_undistorter"],
        );
    }
    let dir = scene(text, &Calibrated(5, vec![20.0; 8]));
    expect_error(
        dir.path(),
        &LoadOptions::default(),
        &[
            "cameras.txt",
            "line 3",
            "OPENCV_FISHEYE",
            "image_undistorter",
        ],
    );
}

#[test]
fn broken_colmap_models_are_refused_by_name() {
    let options = LoadOptions::default();
    for (params, parts) in [
        (vec![f64::NAN, 21.0, 8.5, 6.25], ["PARAMS", "NaN"]),
        (vec![-20.0, 21.0, 8.5, 6.25], ["focal length", "-20"]),
        (vec![20.0, 21.0, 8.5, 1e300], ["principal point", "1e300"]),
    ] {
        let dir = scene(binary, &Calibrated(1, params));
        expect_error(
            dir.path(),
            &options,
            &[&["cameras.bin", "camera 7"][..], &parts].concat(),
        );
    }
    let dir = scene(text, &pinhole());
    let path = dir.path().join("sparse/0/images.txt");
    let whole = fs::read_to_string(&path).expect("read");
    let first = whole.lines().nth(1).expect("line").to_owned();
    let words: Vec<&str> = first.split(' ').collect();
    for (column, value, parts) in [
        (1, "2.0", vec!["line 2", "QW", "length"]),
        (2, "nan", vec!["line 2", "QW"]),
        (6, "inf", vec!["line 2", "TX", "finite"]),
        (6, "1,5", vec!["line 2", "TX", "1,5"]),
        (8, "8", vec!["line 2", "CAMERA_ID", "8", "cameras.txt"]),
        (8, "-1", vec!["line 2", "CAMERA_ID", "-1"]),
        (9, "../../secret", vec!["NAME", "secret", "below"]),
        (
            9,
            "cam1/photo",
            vec!["line 4", "cam1/photo 7.png", "line 18", "repeated"],
        ),
    ] {
        let mut changed: Vec<String> = words.iter().map(|w| (*w).to_owned()).collect();
        changed[column] = value.into();
        let mut line = changed.join(" ");
        let mut broken = whole.replacen(&first, &line, 1);
        if value == "cam1/photo" {
            // The last image takes the name of another.
            line = whole.lines().nth(3).expect("line").to_owned();
            broken = whole.replacen("cam0/photo 0.png", "cam1/photo 7.png", 1);
            assert!(line.ends_with("cam1/photo 7.png"), "{line}");
        }
        fs::write(&path, broken).expect("write");
        expect_error(
            dir.path(),
            &options,
            &parts.iter().map(|p| &**p).collect::<Vec<_>>(),
        );
    }
    fs::write(&path, &whole).expect("write");
    fs::remove_file(dir.path().join("images").join(name(4))).expect("remove");
    expect_error(dir.path(), &options, &["cam0/photo 4.png", "no such file"]);
    image::RgbImage::new(12, 16)
        .save(dir.path().join("images").join(name(4)))
        .expect("photo");
    expect_error(
        dir.path(),
        &options,
        &["photo 4.png", "12x16", "16x12", "images.txt"],
    );
    photo(4)
        .save(dir.path().join("images").join(name(4)))
        .expect("photo");
    let points = dir.path().join("sparse/0/points3D.txt");
    fs::write(&points, "0 1 2 1e300 1 2 3 0.5\n").expect("write");
    expect_error(
        dir.path(),
        &options,
        &["points3D.txt", "line 1", "z", "finite"],
    );
    fs::write(&points, "0 1 2 3 1 2 300 0.5\n").expect("write");
    expect_error(
        dir.path(),
        &options,
        &["points3D.txt", "line 1", "R G B", "300"],
    );
    fs::rename(dir.path().join("images"), dir.path().join("images_8")).expect("move");
    expect_error(
        dir.path(),
        &options,
        &[
            "images: found no such folder, but images_8",
            "--set data.images=images_8",
        ],
    );
    fs::remove_file(dir.path().join("sparse/0/cameras.txt")).expect("remove");
    expect_error(
        dir.path(),
        &options,
        &["sparse/0", "cameras.bin or cameras.txt"],
    );
}

#[test]
fn any_truncated_colmap_file_is_an_error() {
    let dir = scene(binary, &pinhole());
    let options = LoadOptions::default();
    for file in ["cameras.bin", "images.bin", "points3D.bin"] {
        let path = dir.path().join("sparse/0").join(file);
        let whole = fs::read(&path).expect("read");
        for length in 0..whole.len() {
            fs::write(&path, &whole[..length]).expect("write");
            let error = load(dir.path(), &options).err();
            let error = error
                .unwrap_or_else(|| panic!("{file} cut to {length} of {} bytes loads", whole.len()));
            assert!(
                error.to_string().contains(file) && error.to_string().contains("byte"),
                "{length}: {error}"
            );
        }
        fs::write(&path, [&whole[..], &[0]].concat()).expect("write");
        expect_error(dir.path(), &options, &[file, "1 bytes more"]);
        fs::write(&path, whole).expect("write");
    }
}

#[test]
fn claims_that_the_file_cannot_hold_are_refused() {
    let dir = scene(binary, &pinhole());
    let options = LoadOptions::default();
    for (file, what) in [
        ("cameras.bin", "cameras"),
        ("images.bin", "images"),
        ("points3D.bin", "points"),
    ] {
        let path = dir.path().join("sparse/0").join(file);
        let whole = fs::read(&path).expect("read");
        for count in [u64::MAX, 1 << 40, 1000] {
            let mut broken = whole.clone();
            broken[..8].copy_from_slice(&count.to_le_bytes());
            fs::write(&path, broken).expect("write");
            expect_error(
                dir.path(),
                &options,
                &[
                    file,
                    &format!("number of {what}"),
                    &count.to_string(),
                    "byte 0",
                ],
            );
        }
        fs::write(&path, whole).expect("write");
    }
    let limits = Limits {
        points: 1,
        ..Limits::default()
    };
    expect_error(
        dir.path(),
        &LoadOptions {
            limits,
            ..options.clone()
        },
        &["points3D.bin", "exceeds the limit"],
    );
    let limits = Limits {
        views: 8,
        ..Limits::default()
    };
    expect_error(
        dir.path(),
        &LoadOptions {
            limits,
            ..options.clone()
        },
        &["frames", "exceeds the limit", "stride"],
    );
}

#[test]
fn damaged_colmap_files_never_panic() {
    let mut state = 1_u64;
    for (write, ending) in [(binary as fn(&Path, &Calibrated), "bin"), (text, "txt")] {
        let dir = scene(
            write,
            &Calibrated(4, vec![20.0, 21.0, 8.5, 6.25, -0.1, 0.01, 1e-3, -1e-3]),
        );
        for file in ["cameras", "images", "points3D"] {
            let path = dir.path().join("sparse/0").join(format!("{file}.{ending}"));
            let whole = fs::read(&path).expect("read");
            for _ in 0..200 {
                let mut damaged = whole.clone();
                for _ in 0..2 {
                    state = state
                        .wrapping_mul(6_364_136_223_846_793_005)
                        .wrapping_add(1_442_695_040_888_963_407);
                    let at = (state >> 33) as usize % damaged.len();
                    damaged[at] = (state >> 25) as u8;
                }
                fs::write(&path, &damaged).expect("write");
                if let Ok(scene) = load(dir.path(), &LoadOptions::default()) {
                    assert!(
                        scene
                            .points
                            .positions
                            .iter()
                            .flatten()
                            .all(|v| v.is_finite())
                    );
                    assert!(scene.views.iter().all(|v| v.camera.center.is_finite()));
                }
            }
            fs::write(&path, whole).expect("write");
        }
    }
}

#[test]
fn a_real_scene_is_the_same_as_a_colmap_model() {
    let Some(shared) = crate::support::shared_dir() else {
        return;
    };
    let source = shared.join("data/house_living");
    let transforms = load(
        &source,
        &LoadOptions {
            max_frames: 12,
            ..LoadOptions::default()
        },
    )
    .expect("scene");
    let dir = tempfile::tempdir().expect("folder");
    fs::create_dir_all(dir.path().join("sparse/0")).expect("folder");
    fs::create_dir(dir.path().join("images")).expect("folder");
    let mut images = String::new();
    for (i, view) in transforms.views.iter().enumerate() {
        pixels(view)
            .save(dir.path().join(format!("images/{}.png", view.name)))
            .expect("photo");
        let q = DQuat::from_mat3(&view.camera.rotation);
        let t = -(view.camera.rotation * (view.camera.center + transforms.origin));
        let pose = [q.w, q.x, q.y, q.z, t.x, t.y, t.z]
            .map(|v| v.to_string())
            .join(" ");
        images += &format!("{i} {pose} 1 {}.png\n\n", view.name);
    }
    let Camera {
        fx,
        fy,
        cx,
        cy,
        width,
        height,
        ..
    } = transforms.views[0].camera;
    let camera = format!("1 OPENCV {width} {height} {fx} {fy} {cx} {cy} 0 0 0 0\n");
    fs::write(dir.path().join("sparse/0/cameras.txt"), camera).expect("cameras");
    fs::write(dir.path().join("sparse/0/images.txt"), images).expect("images");
    let mut points = String::new();
    for (p, c) in transforms
        .points
        .positions
        .iter()
        .zip(&transforms.points.colors)
    {
        let p = (DVec3::from(p.map(f64::from)) + transforms.origin)
            .to_array()
            .map(|v| v.to_string())
            .join(" ");
        let [r, g, b] = c.map(|v| (v * 255.0).round() as u8);
        points += &format!("1 {p} {r} {g} {b} 0.5\n");
    }
    fs::write(dir.path().join("sparse/0/points3D.txt"), points).expect("points");
    let model = load(dir.path(), &LoadOptions::default()).expect("scene");
    assert!((model.origin - transforms.origin).length() < 1e-9);
    assert_eq!(
        (model.views.len(), model.points.len()),
        (transforms.views.len(), transforms.points.len())
    );
    for view in &transforms.views {
        let other = model
            .views
            .iter()
            .find(|v| v.name == view.name)
            .expect("view");
        let off = other.camera.rotation - view.camera.rotation;
        assert!(off.to_cols_array().iter().all(|v| v.abs() < 1e-6), "{off}");
        assert!(
            (other.camera.center - view.camera.center).length() < 1e-6
                && pixels(other) == pixels(view)
        );
        assert_eq!(
            (other.camera.fx, other.camera.cy),
            (view.camera.fx, view.camera.cy),
            "no distortion, nothing scaled"
        );
    }
    let points = model
        .points
        .positions
        .iter()
        .flatten()
        .zip(transforms.points.positions.iter().flatten());
    assert!(points.into_iter().all(|(a, b)| (a - b).abs() < 1e-5));
}

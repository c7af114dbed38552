//! COLMAP folders: one small model in both forms, and a real one.

use crate::support::colmap::{
    HEIGHT, POINTS, VIEWS, WIDTH, binary, name, photo, pinhole, pose, scene, text,
};
use coseg::config::Layout;
use coseg::data::{LoadOptions, Split, View, WorldUnit, load, load_cameras, locate};
use coseg::splat::camera::Camera;
use glam::{DMat3, DQuat, DVec3};
use std::fs;
use std::sync::Arc;

fn pixels(view: &View) -> Arc<image::RgbImage> {
    view.image.pixels().expect("photo")
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
    assert_eq!(transforms.unit, WorldUnit::Metre);
    assert!(matches!(model.unit, WorldUnit::Arbitrary { extent } if extent > 0.0));
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

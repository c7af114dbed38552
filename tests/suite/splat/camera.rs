//! Cameras that a run writes beside its scene.

use coseg::data::formats::transforms::{load_cameras, write_cameras};
use coseg::data::{NamedCamera, Split};
use coseg::splat::camera::Camera;

#[test]
fn cameras_that_are_written_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("runs/cameras.json");
    let rotation =
        glam::DMat3::from_quat(glam::DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -1.1, 2.0));
    let camera = |i: usize| Camera {
        rotation,
        center: glam::DVec3::new(1e6 + i as f64, -0.3, 7.25),
        fx: 81.5,
        fy: 79.25 + i as f64,
        cx: 40.125,
        cy: 30.0,
        width: 80 + i,
        height: 64,
    };
    let views = [("a.b", Split::Train), ("cam1/7", Split::Test)];
    let named = |(i, &(name, split)): (usize, &(&str, Split))| NamedCamera {
        name: name.into(),
        split,
        camera: camera(i),
    };
    let cameras: Vec<NamedCamera> = views.iter().enumerate().map(named).collect();
    write_cameras(&path, &cameras).unwrap();
    let read = load_cameras(&path, None).unwrap();
    assert_eq!(
        read.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(),
        ["a.b", "cam1_7"]
    );
    for (read, written) in read.iter().zip(&cameras) {
        let (a, b) = (&read.camera, &written.camera);
        assert_eq!(
            (a.width, a.height, a.fx, a.fy, a.cx, a.cy),
            (b.width, b.height, b.fx, b.fy, b.cx, b.cy)
        );
        assert!(
            (a.center - b.center).length() < 1e-9 && a.rotation.abs_diff_eq(b.rotation, 1e-12),
            "{a:?}, {b:?}"
        );
        assert_eq!(read.split, written.split);
    }
}

//! Poses written in a different convention than the layout's are found by the initial cloud, and right ones never are.

use crate::support::capture::{
    CONVENTIONS, Capture, Convention, matrix, name, one_problem, suspected, without_cloud,
};
use crate::support::colmap::image_line;
use crate::support::transforms_json::edit;
use coseg::data::{LoadOptions, check, load};
use glam::{DMat3, DMat4, DQuat, DVec3};
use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// Writes a COLMAP model of photos that lie in `dir`, its poses in a convention that may not be COLMAP's.
fn colmap(capture: &Capture, dir: &Path, convention: Convention) {
    let folder = dir.join("sparse/0");
    fs::create_dir_all(&folder).unwrap();
    let mut cameras = String::new();
    let mut images = String::new();
    let mut points = String::new();
    for (i, (path, c)) in capture.shots.iter().enumerate() {
        writeln!(
            cameras,
            "{i} PINHOLE {} {} {} {} {} {}",
            c.width, c.height, c.fx, c.fy, c.cx, c.cy
        )
        .unwrap();
        let m = matrix(c, convention);
        let q = DQuat::from_mat3(&DMat3::from_mat4(m));
        let t = m.w_axis;
        let name = path.file_name().unwrap().to_str().unwrap();
        images += &image_line(i + 1, (q, t.truncate()), i, name);
    }
    let cloud = fs::read_to_string(&capture.cloud).unwrap();
    for (i, line) in cloud
        .lines()
        .skip_while(|line| *line != "end_header")
        .skip(1)
        .enumerate()
    {
        writeln!(points, "{i} {line} 0.5").unwrap();
    }
    for (name, text) in [
        ("cameras", cameras),
        ("images", images),
        ("points3D", points),
    ] {
        fs::write(folder.join(format!("{name}.txt")), text).unwrap();
    }
}

#[test]
fn a_room_written_in_any_convention() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let capture = Capture::room(dir, 20);
    let options = LoadOptions::default();
    for convention in CONVENTIONS {
        capture.transforms(dir, convention, 1);
        let checked = check(dir, &options);
        eprintln!("{convention:?}: {:?}", checked.problems);
        let help = match convention {
            (false, false) => {
                assert!(
                    checked.problems.is_empty() && checked.notices.is_empty(),
                    "{checked:?}"
                );
                continue;
            }
            (true, false) => "; invert each transform_matrix",
            (false, true) => "; negate the second and third columns of each transform_matrix",
            (true, true) => {
                "; invert each transform_matrix, then negate its second and third columns"
            }
        };
        let expected = "expected camera-to-world in OpenGL axes (x right, y up, looking along -z)";
        one_problem(
            &checked,
            &[
                "transforms.json: transform_matrix of the frames",
                name(convention),
                expected,
            ],
        );
        assert!(
            checked.problems[0].to_string().ends_with(help),
            "{checked:?}"
        );
    }
}

#[test]
fn a_cloud_without_colours_tells_by_places_alone() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let mut capture = Capture::room(dir, 20);
    capture.cloud = dir.join("cube.ply");
    cube(&capture.cloud, 0.0);
    for (i, (_, camera)) in capture.shots.iter_mut().enumerate() {
        let angle = 0.3 * i as f64;
        let eye = DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.5);
        let pose = DMat4::look_at_rh(eye, DVec3::splat(0.45), DVec3::Z);
        camera.rotation =
            DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)) * DMat3::from_mat4(pose);
        camera.center = eye;
    }
    for convention in CONVENTIONS {
        capture.transforms(dir, convention, 1);
        let checked = check(dir, &LoadOptions::default());
        if convention == (false, false) {
            assert!(
                checked.problems.is_empty() && checked.notices.is_empty(),
                "{checked:?}"
            );
            continue;
        }
        one_problem(&checked, &["hold 0 % of", "; 100 % if", name(convention)]);
    }
    let only_notes = |part: &str| {
        let checked = check(dir, &LoadOptions::default());
        let is_noted = checked.notices.iter().any(|notice| notice.contains(part));
        assert!(
            checked.problems.is_empty() && is_noted,
            "{part}: {checked:?}"
        );
    };
    // Points of another place altogether.
    capture.transforms(dir, (false, false), 1);
    cube(&capture.cloud, 900.0);
    only_notes("in every convention of poses");
    // Poses in millimetres, points in metres.
    cube(&capture.cloud, 0.0);
    for (_, camera) in &mut capture.shots {
        camera.center *= 1e3;
    }
    capture.transforms(dir, (false, false), 1);
    only_notes("different units");
}

/// A cloud without colours: a cube of side 1 to look at from all sides, raised by `height`.
fn cube(path: &Path, height: f64) {
    let mut text = "ply\nformat ascii 1.0\nelement vertex 1000\nproperty float x\nproperty float y\nproperty float z\n\
        end_header\n"
        .to_owned();
    for i in 0..1000 {
        let [x, y, z] = [i % 10, i / 10 % 10, i / 100].map(|step| 0.1 * f64::from(step));
        writeln!(text, "{x} {y} {}", z + height).unwrap();
    }
    fs::write(path, text).unwrap();
}

#[test]
fn the_help_for_colmap_models_fits_colmap() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    fs::create_dir(dir.join("images")).unwrap();
    let capture = Capture::room(&dir.join("images"), 20);
    for (convention, help) in [
        ((true, true), None),
        ((false, true), Some("; invert each pose")),
        (
            (true, false),
            Some("; negate the second and third rows of each pose"),
        ),
        (
            (false, false),
            Some("; invert each pose, then negate its second and third rows"),
        ),
    ] {
        colmap(&capture, dir, convention);
        let checked = check(dir, &LoadOptions::default());
        let Some(help) = help else {
            assert!(checked.problems.is_empty(), "{checked:?}");
            continue;
        };
        one_problem(
            &checked,
            &[
                "images.txt: QW QX",
                name(convention),
                "expected world-to-camera in OpenCV axes",
            ],
        );
        assert!(
            checked.problems[0].to_string().ends_with(help),
            "{checked:?}"
        );
    }
}

#[test]
fn matrices_that_follow_the_help_are_right() {
    // What the messages say, done to the matrices.
    let camera = crate::support::plates::camera(2);
    let flip = DMat4::from_diagonal(glam::DVec4::new(1.0, -1.0, -1.0, 1.0));
    let close = |a: DMat4, b: DMat4| (a - b).to_cols_array().iter().all(|v| v.abs() < 1e-12);
    let [gl, to_gl, cv, to_cv] = CONVENTIONS.map(|convention| matrix(&camera, convention));
    assert!(
        close(to_gl.inverse(), gl) && close(cv * flip, gl) && close(to_cv.inverse() * flip, gl),
        "transforms.json"
    );
    assert!(
        close(cv.inverse(), to_cv)
            && close(flip * to_gl, to_cv)
            && close(flip * gl.inverse(), to_cv),
        "COLMAP"
    );
    assert!(
        close(to_cv.inverse(), cv) && close(gl * flip, cv) && close(to_gl.inverse() * flip, cv),
        "sequences"
    );
}

#[test]
fn without_a_cloud_neighbouring_photos_tell() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let capture = Capture::room(dir, 120);
    for convention in CONVENTIONS {
        capture.transforms(dir, convention, 1);
        without_cloud(dir);
        let found = suspected(dir);
        if convention == (false, false) {
            assert!(found.is_empty(), "{found:?}");
            continue;
        }
        let wanted = name(convention).replace("if they are", "may be");
        assert!(
            found.len() == 1 && found[0].contains(&wanted) && found[0].contains("transform_matrix"),
            "{found:?}"
        );
    }
}

#[test]
fn poses_that_nothing_tells_of_are_told_where_they_do_not_fit_best() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    // Too few photos to name another convention.
    let capture = Capture::room(dir, 20);
    for convention in CONVENTIONS {
        capture.transforms(dir, convention, 1);
        without_cloud(dir);
        assert_eq!(suspected(dir), [""; 0]);
        let notices = check(dir, &LoadOptions::default()).notices;
        let unchecked =
            |notice: &&String| notice.contains("axes of the poses could not be checked");
        let told = notices.iter().filter(unchecked).count();
        assert_eq!(
            told,
            usize::from(convention != (false, false)),
            "{notices:?}"
        );
    }
}

#[test]
fn loading_warns() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let capture = Capture::room(dir, 20);
    capture.transforms(dir, (true, true), 1);
    let said = warnings(|| _ = load(dir, &LoadOptions::default()).unwrap());
    assert!(
        said.contains("invert each transform_matrix, then negate its second and third columns"),
        "{said}"
    );
    capture.transforms(dir, (false, false), 1);
    assert_eq!(
        warnings(|| _ = load(dir, &LoadOptions::default()).unwrap()),
        ""
    );
    // A file that holds no points.
    let cloud = fs::read_to_string(&capture.cloud).unwrap();
    let header = cloud.split_inclusive("end_header\n").next().unwrap();
    let header = header.lines().map(|l| {
        if l.starts_with("element") {
            "element vertex 0"
        } else {
            l
        }
    });
    fs::write(&capture.cloud, header.collect::<Vec<_>>().join("\n") + "\n").unwrap();
    let said = warnings(|| _ = load(dir, &LoadOptions::default()).unwrap());
    assert!(
        said.contains("room.ply holds no points: Gaussians start at random places"),
        "{said}"
    );
    assert!(
        check(dir, &LoadOptions::default())
            .notices
            .iter()
            .any(|n| n.contains("room.ply holds no points"))
    );
    // And one that is there but not named.
    fs::copy(&capture.cloud, dir.join("sparse_pc.ply")).unwrap();
    edit(dir, |v| {
        _ = v.as_object_mut().unwrap().remove("ply_file_path")
    });
    let notices = check(dir, &LoadOptions::default()).notices;
    assert!(
        notices
            .iter()
            .any(|n| n.contains("\"ply_file_path\": \"sparse_pc.ply\"")),
        "{notices:?}"
    );
}

/// What `work` says in warnings.
fn warnings(work: impl FnOnce()) -> String {
    #[derive(Clone, Default)]
    struct Said(Arc<Mutex<Vec<u8>>>);
    impl std::io::Write for Said {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().extend(bytes);
            Ok(bytes.len())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let said = Said::default();
    let writer = said.clone();
    let subscriber = tracing_subscriber::fmt()
        .with_ansi(false)
        .with_writer(move || writer.clone())
        .finish();
    tracing::subscriber::with_default(subscriber, work);
    let bytes = said.0.lock().unwrap().clone();
    String::from_utf8(bytes).unwrap()
}

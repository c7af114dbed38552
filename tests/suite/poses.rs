//! Poses written in another convention than the layout's are found by the initial cloud, and right ones never are.

use crate::data_check::edit;
use coseg::camera::Camera;
use coseg::data::builtin::{BuiltinOptions, scene_with};
use coseg::data::transforms::load_cameras;
use coseg::data::{Checked, LoadOptions, check, load};
use glam::{DMat3, DMat4, DQuat, DVec3};
use serde_json::json;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// World-to-camera or not, OpenCV axes or OpenGL.
type Convention = (bool, bool);
const CONVENTIONS: [Convention; 4] = [(false, false), (true, false), (false, true), (true, true)];

/// What the program calls a convention.
fn name((to_camera, opencv): Convention) -> &'static str {
    match (to_camera, opencv) {
        (false, false) => "if they are camera-to-world in OpenGL axes",
        (true, false) => "if they are world-to-camera in OpenGL axes",
        (false, true) => "if they are camera-to-world in OpenCV axes",
        (true, true) => "if they are world-to-camera in OpenCV axes",
    }
}

/// The matrix of `camera` as a convention has it.
fn matrix(camera: &Camera, (to_camera, opencv): Convention) -> DMat4 {
    let mut matrix = camera.to_opengl();
    if opencv {
        matrix = DMat4::from_cols(matrix.x_axis, -matrix.y_axis, -matrix.z_axis, matrix.w_axis);
    }
    if to_camera { matrix.inverse() } else { matrix }
}

fn rows(matrix: DMat4) -> Vec<[f64; 4]> {
    (0..4).map(|r| matrix.row(r).to_array()).collect()
}

/// Photos with their cameras, and the file of an initial cloud.
struct Capture {
    shots: Vec<(PathBuf, Camera)>,
    cloud: PathBuf,
}

impl Capture {
    /// The built-in room, small, with its photos and points in `dir`.
    fn room(dir: &Path) -> Self {
        let options = BuiltinOptions { width: 96, height: 72, train_views: 20, test_views: 2, ..Default::default() };
        let scene = scene_with(&options).unwrap();
        let mut shots = Vec::new();
        for view in &scene.views {
            let path = dir.join(format!("{}.png", view.name));
            view.image.pixels().unwrap().save(&path).unwrap();
            shots.push((path, Camera { center: view.camera.center + scene.origin, ..view.camera.clone() }));
        }
        let mut text = format!(
            "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
             property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
            scene.points.len()
        );
        for (p, c) in scene.points.positions.iter().zip(&scene.points.colors) {
            let p = DVec3::from(p.map(f64::from)) + scene.origin;
            let [r, g, b] = c.map(|c| (c * 255.0).round() as u8);
            writeln!(text, "{} {} {} {r} {g} {b}", p.x, p.y, p.z).unwrap();
        }
        let cloud = dir.join("room.ply");
        fs::write(&cloud, text).unwrap();
        Self { shots, cloud }
    }

    /// A scene folder elsewhere.
    fn of(dir: &Path, transforms: &str) -> Self {
        let manifest = crate::cli::read_json(&dir.join(transforms));
        let cameras = load_cameras(&dir.join(transforms), None).unwrap();
        let paths = manifest["frames"].as_array().unwrap().iter().map(|f| dir.join(f["file_path"].as_str().unwrap()));
        Self { shots: paths.zip(cameras.into_iter().map(|c| c.camera)).collect(), cloud: dir.join("points.ply") }
    }

    /// Writes `transforms.json` in a convention that may not be its own. Every `stride`-th photo.
    fn transforms(&self, dir: &Path, convention: Convention, stride: usize) {
        let frame = |(path, c): &(PathBuf, Camera)| {
            json!({
                "file_path": path, "transform_matrix": rows(matrix(c, convention)), "w": c.width, "h": c.height,
                "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy,
            })
        };
        let frames: Vec<_> = self.shots.iter().step_by(stride).map(frame).collect();
        let file = json!({ "ply_file_path": self.cloud, "frames": frames });
        fs::write(dir.join("transforms.json"), file.to_string()).unwrap();
    }
}

/// Writes a COLMAP model of photos that lie in `dir`, its poses in a convention that may not be COLMAP's.
fn colmap(capture: &Capture, dir: &Path, convention: Convention) {
    let folder = dir.join("sparse/0");
    fs::create_dir_all(&folder).unwrap();
    let (mut cameras, mut images, mut points) = (String::new(), String::new(), String::new());
    for (i, (path, c)) in capture.shots.iter().enumerate() {
        writeln!(cameras, "{i} PINHOLE {} {} {} {} {} {}", c.width, c.height, c.fx, c.fy, c.cx, c.cy).unwrap();
        let m = matrix(c, convention);
        let (q, t) = (DQuat::from_mat3(&DMat3::from_mat4(m)), m.w_axis);
        let name = path.file_name().unwrap().to_str().unwrap();
        writeln!(images, "{} {} {} {} {} {} {} {} {i} {name}\n", i + 1, q.w, q.x, q.y, q.z, t.x, t.y, t.z).unwrap();
    }
    let cloud = fs::read_to_string(&capture.cloud).unwrap();
    for (i, line) in cloud.lines().skip_while(|line| *line != "end_header").skip(1).enumerate() {
        writeln!(points, "{i} {line} 0.5").unwrap();
    }
    for (name, text) in [("cameras", cameras), ("images", images), ("points3D", points)] {
        fs::write(folder.join(format!("{name}.txt")), text).unwrap();
    }
}

/// The one problem of a folder, which must hold all of `parts`.
#[track_caller]
fn one_problem(checked: &Checked, parts: &[&str]) {
    assert_eq!(checked.problems.len(), 1, "{checked:?}");
    crate::assert_names(&checked.problems[0], parts);
}

#[test]
fn a_room_written_in_any_convention() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let capture = Capture::room(dir);
    let options = LoadOptions::default();
    for convention in CONVENTIONS {
        capture.transforms(dir, convention, 1);
        let checked = check(dir, &options);
        eprintln!("{convention:?}: {:?}", checked.problems);
        let mend = match convention {
            (false, false) => {
                assert!(checked.problems.is_empty() && checked.notices.is_empty(), "{checked:?}");
                continue;
            }
            (true, false) => "; invert each transform_matrix",
            (false, true) => "; negate the second and third columns of each transform_matrix",
            (true, true) => "; invert each transform_matrix, then negate its second and third columns",
        };
        let expected = "expected camera-to-world in OpenGL axes (x right, y up, looking along -z)";
        one_problem(&checked, &["transforms.json: transform_matrix of the frames", name(convention), expected]);
        assert!(checked.problems[0].to_string().ends_with(mend), "{checked:?}");
    }
}

#[test]
fn a_cloud_without_colours_tells_by_places_alone() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let mut capture = Capture::room(dir);
    capture.cloud = dir.join("cube.ply");
    cube(&capture.cloud, 0.0);
    for (i, (_, camera)) in capture.shots.iter_mut().enumerate() {
        let angle = 0.3 * i as f64;
        let eye = DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.5);
        let pose = DMat4::look_at_rh(eye, DVec3::splat(0.45), DVec3::Z);
        camera.rotation = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)) * DMat3::from_mat4(pose);
        camera.center = eye;
    }
    for convention in CONVENTIONS {
        capture.transforms(dir, convention, 1);
        let checked = check(dir, &LoadOptions::default());
        if convention == (false, false) {
            assert!(checked.problems.is_empty() && checked.notices.is_empty(), "{checked:?}");
            continue;
        }
        one_problem(&checked, &["hold 0 % of", "; 100 % if", name(convention)]);
    }
    // Points of another place altogether.
    capture.transforms(dir, (false, false), 1);
    cube(&capture.cloud, 900.0);
    let checked = check(dir, &LoadOptions::default());
    assert!(checked.problems.is_empty(), "{checked:?}");
    assert!(checked.notices.iter().any(|n| n.contains("whichever way the poses are read")), "{checked:?}");
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
fn colmap_models_are_mended_as_colmap_has_them() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    fs::create_dir(dir.join("images")).unwrap();
    let capture = Capture::room(&dir.join("images"));
    for (convention, mend) in [
        ((true, true), None),
        ((false, true), Some("; invert each pose")),
        ((true, false), Some("; negate the second and third rows of each pose")),
        ((false, false), Some("; invert each pose, then negate its second and third rows")),
    ] {
        colmap(&capture, dir, convention);
        let checked = check(dir, &LoadOptions::default());
        let Some(mend) = mend else {
            assert!(checked.problems.is_empty(), "{checked:?}");
            continue;
        };
        one_problem(&checked, &["images.txt: QW QX", name(convention), "expected world-to-camera in OpenCV axes"]);
        assert!(checked.problems[0].to_string().ends_with(mend), "{checked:?}");
    }
}

#[test]
fn mended_matrices_are_right() {
    // What the messages say, done to the matrices.
    let camera = crate::plates::camera(2);
    let flip = DMat4::from_diagonal(glam::DVec4::new(1.0, -1.0, -1.0, 1.0));
    let close = |a: DMat4, b: DMat4| (a - b).to_cols_array().iter().all(|v| v.abs() < 1e-12);
    let [gl, to_gl, cv, to_cv] = CONVENTIONS.map(|convention| matrix(&camera, convention));
    assert!(close(to_gl.inverse(), gl) && close(cv * flip, gl) && close(to_cv.inverse() * flip, gl), "transforms.json");
    assert!(close(cv.inverse(), to_cv) && close(flip * to_gl, to_cv) && close(flip * gl.inverse(), to_cv), "COLMAP");
    assert!(close(to_cv.inverse(), cv) && close(gl * flip, cv) && close(to_gl.inverse() * flip, cv), "sequences");
}

#[test]
fn real_captures_give_no_false_alarm() {
    let Some(shared) = crate::shared_dir() else { return };
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    for (scene, transforms) in [
        ("fox", "transforms_4.json"),
        ("tabletop_bin", "transforms.json"),
        ("house_living", "transforms.json"),
        ("house_kitchen", "transforms.json"),
        ("studio", "transforms.json"),
    ] {
        let mut capture = Capture::of(&shared.join("data").join(scene), transforms);
        let colored = capture.cloud.clone();
        let bare = dir.join("bare.ply");
        without_colors(&colored, &bare);
        for stride in [1, 3, 10, 40] {
            for cloud in [&colored, &bare] {
                capture.cloud = cloud.clone();
                capture.transforms(dir, (false, false), stride);
                let checked = check(dir, &LoadOptions::default());
                assert!(checked.problems.is_empty() && checked.notices.is_empty(), "{scene} {stride}: {checked:?}");
            }
        }
        for convention in [(true, false), (false, true), (true, true)] {
            for stride in [1, 10] {
                capture.cloud = colored.clone();
                capture.transforms(dir, convention, stride);
                let checked = check(dir, &LoadOptions::default());
                eprintln!("{scene} {stride}: {}", checked.problems[0]);
                one_problem(&checked, &[name(convention)]);
            }
            // By places alone not all are found, and none is taken for another.
            capture.cloud = bare.clone();
            capture.transforms(dir, convention, 1);
            let found = check(dir, &LoadOptions::default()).problems;
            eprintln!("{scene} without colours: {found:?}");
            assert!(found.iter().all(|fault| fault.to_string().contains(name(convention))), "{scene}: {found:?}");
        }
    }
}

/// A copy of a cloud of floats whose colours have names that nothing reads.
fn without_colors(cloud: &Path, copy: &Path) {
    let mut bytes = fs::read(cloud).unwrap();
    for (color, other) in [("red", "rad"), ("green", "grean"), ("blue", "bluu")] {
        let wanted = format!("uchar {color}\n");
        let at = bytes.windows(wanted.len()).position(|window| window == wanted.as_bytes()).unwrap();
        bytes[at..at + wanted.len()].copy_from_slice(format!("uchar {other}\n").as_bytes());
    }
    fs::write(copy, bytes).unwrap();
}

#[test]
fn depth_images_tell_as_a_cloud_does() {
    let Some(shared) = crate::shared_dir() else { return };
    for scene in ["house_living", "house_kitchen", "studio"] {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        let capture = Capture::of(&shared.join("data").join(scene), "transforms.json");
        for sub in ["color", "pose", "intrinsic", "depth"] {
            fs::create_dir(dir.join(sub)).unwrap();
        }
        let c = &capture.shots[0].1;
        let intrinsics = format!("{} 0 {} 0\n0 {} {} 0\n0 0 1 0\n0 0 0 1\n", c.fx, c.cx, c.fy, c.cy);
        fs::write(dir.join("intrinsic/intrinsic_color.txt"), intrinsics).unwrap();
        for (i, (photo, _)) in capture.shots.iter().enumerate() {
            let kind = photo.extension().unwrap().to_str().unwrap();
            fs::copy(photo, dir.join(format!("color/{i}.{kind}"))).unwrap();
            let depth = photo.parent().unwrap().with_file_name("depth").join(photo.file_name().unwrap());
            fs::copy(depth.with_extension("png"), dir.join(format!("depth/{i}.png"))).unwrap();
        }
        for (convention, mend) in [
            ((false, true), None),
            ((true, true), Some("; invert each matrix")),
            ((false, false), Some("; negate the second and third columns of each matrix")),
            ((true, false), Some("; invert each matrix, then negate its second and third columns")),
        ] {
            for (i, (_, camera)) in capture.shots.iter().enumerate() {
                let lines =
                    rows(matrix(camera, convention)).into_iter().map(|row| row.map(|v| v.to_string()).join(" "));
                fs::write(dir.join(format!("pose/{i}.txt")), lines.collect::<Vec<_>>().join("\n")).unwrap();
            }
            let checked = check(dir, &LoadOptions::default());
            eprintln!("{scene} {convention:?}: {:?}", checked.problems);
            let Some(mend) = mend else {
                assert!(checked.problems.is_empty(), "{checked:?}");
                continue;
            };
            one_problem(&checked, &["pose: matrices", name(convention)]);
            assert!(checked.problems[0].to_string().ends_with(mend), "{checked:?}");
        }
    }
}

#[test]
fn loading_warns() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let capture = Capture::room(dir);
    capture.transforms(dir, (true, true), 1);
    let said = warnings(|| _ = load(dir, &LoadOptions::default()).unwrap());
    assert!(said.contains("invert each transform_matrix, then negate its second and third columns"), "{said}");
    capture.transforms(dir, (false, false), 1);
    assert_eq!(warnings(|| _ = load(dir, &LoadOptions::default()).unwrap()), "");
    // A file that holds no points.
    let cloud = fs::read_to_string(&capture.cloud).unwrap();
    let header = cloud.split_inclusive("end_header\n").next().unwrap();
    let header = header.lines().map(|l| if l.starts_with("element") { "element vertex 0" } else { l });
    fs::write(&capture.cloud, header.collect::<Vec<_>>().join("\n") + "\n").unwrap();
    let said = warnings(|| _ = load(dir, &LoadOptions::default()).unwrap());
    assert!(said.contains("room.ply holds no points: Gaussians start at random places"), "{said}");
    assert!(check(dir, &LoadOptions::default()).notices.iter().any(|n| n.contains("room.ply holds no points")));
    // And one that is there but not named.
    fs::copy(&capture.cloud, dir.join("sparse_pc.ply")).unwrap();
    edit(dir, |v| _ = v.as_object_mut().unwrap().remove("ply_file_path"));
    let notices = check(dir, &LoadOptions::default()).notices;
    assert!(notices.iter().any(|n| n.contains("\"ply_file_path\": \"sparse_pc.ply\"")), "{notices:?}");
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
    let subscriber = tracing_subscriber::fmt().with_ansi(false).with_writer(move || writer.clone()).finish();
    tracing::subscriber::with_default(subscriber, work);
    let bytes = said.0.lock().unwrap().clone();
    String::from_utf8(bytes).unwrap()
}

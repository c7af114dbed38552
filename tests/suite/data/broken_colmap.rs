//! COLMAP models that are refused: of another camera, broken, cut off and damaged.

use crate::support::colmap::{Calibrated, VIEWS, binary, name, photo, pinhole, scene, text};
use crate::support::damage::Damage;
use coseg::data::{LoadOptions, check, load};
use coseg::files::{MAX_POINTS, MAX_VIEWS};
use std::fs;
use std::io::Write;
use std::path::Path;

#[track_caller]
fn expect_error(dir: &Path, options: &LoadOptions, parts: &[&str]) {
    crate::support::assert_names(&load(dir, options).expect_err("an error"), parts);
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
fn faults_of_a_colmap_camera_are_those_of_the_images_that_use_it() {
    let options = LoadOptions::default();
    let dir = scene(text, &pinhole());
    let path = dir.path().join("sparse/0/cameras.txt");
    let unused = "8 PINHOLE 16 12 -20.0 21.0 8.5 6.25\n";
    let cameras = fs::read_to_string(&path).expect("read") + unused;
    fs::write(&path, cameras).expect("write");
    load(dir.path(), &options).expect("no image has camera 8");
    let dir = scene(text, &Calibrated(1, vec![-20.0, 21.0, 8.5, 6.25]));
    let problems = check(dir.path(), &options).problems;
    let of_camera = |problem: &String| problem.contains("PARAMS, focal length: found -20");
    let messages = problems.iter().map(ToString::to_string);
    assert_eq!(messages.filter(of_camera).count(), VIEWS, "{problems:?}");
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
    // Files that are as long as they say, and have no content.
    for (file, what, count) in [
        ("images.bin", "images", 64 * MAX_VIEWS + 1),
        ("points3D.bin", "points", MAX_POINTS + 1),
    ] {
        let dir = scene(binary, &pinhole());
        let path = dir.path().join("sparse/0").join(file);
        let claim = fs::File::create(&path).expect("create");
        (&claim).write_all(&count.to_le_bytes()).expect("write");
        claim.set_len(8 + 100 * count).expect("a sparse file");
        let count = count.to_string();
        expect_error(
            dir.path(),
            &options,
            &[file, what, &count, "exceeds the limit"],
        );
    }
    let dir = scene(text, &pinhole());
    let lines = (0..=MAX_VIEWS).map(|i| format!("{i} 1 0 0 0 {i} 0 0 7 cam0/{i}.png\n\n"));
    let path = dir.path().join("sparse/0/images.txt");
    fs::write(path, lines.collect::<String>()).expect("write");
    expect_error(
        dir.path(),
        &options,
        &["frames", "65537", "exceeds the limit", "stride"],
    );
}

#[test]
fn damaged_colmap_files_never_panic() {
    let mut damage = Damage::new(2);
    for (write, ending) in [(binary as fn(&Path, &Calibrated), "bin"), (text, "txt")] {
        let dir = scene(
            write,
            &Calibrated(4, vec![20.0, 21.0, 8.5, 6.25, -0.1, 0.01, 1e-3, -1e-3]),
        );
        for file in ["cameras", "images", "points3D"] {
            let path = dir.path().join("sparse/0").join(format!("{file}.{ending}"));
            let whole = fs::read(&path).expect("read");
            for _ in 0..200 {
                let damaged = damage.of(&whole);
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

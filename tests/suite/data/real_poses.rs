//! Conventions of poses on real captures: what is found, and that right ones give no alarm.

use crate::support::capture::{
    CONVENTIONS, Capture, matrix, name, one_problem, rows, suspected, without_cloud,
};
use coseg::data::formats::transforms::load_cameras;
use coseg::data::{LoadOptions, check};
use std::fs;
use std::path::Path;

/// Folders of real captures, and their files of cameras.
const SCENES: [(&str, &str); 5] = [
    ("fox", "transforms_4.json"),
    ("tabletop_bin", "transforms.json"),
    ("house_living", "transforms.json"),
    ("house_kitchen", "transforms.json"),
    ("studio", "transforms.json"),
];

/// A scene folder elsewhere.
fn capture_of(dir: &Path, transforms: &str) -> Capture {
    let manifest = crate::support::program::read_json(&dir.join(transforms));
    let cameras = load_cameras(&dir.join(transforms), None).unwrap();
    let paths = manifest["frames"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| dir.join(f["file_path"].as_str().unwrap()));
    Capture {
        shots: paths.zip(cameras.into_iter().map(|c| c.camera)).collect(),
        cloud: dir.join("points.ply"),
    }
}

#[test]
fn real_captures_give_no_false_alarm() {
    let Some(shared) = crate::support::shared_dir() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    for (scene, transforms) in SCENES {
        let mut capture = capture_of(&shared.join("data").join(scene), transforms);
        let colored = capture.cloud.clone();
        let bare = dir.join("bare.ply");
        without_colors(&colored, &bare);
        for stride in [1, 3, 10, 40] {
            for cloud in [&colored, &bare] {
                capture.cloud = cloud.clone();
                capture.transforms(dir, (false, false), stride);
                let checked = check(dir, &LoadOptions::default());
                assert!(
                    checked.problems.is_empty() && checked.notices.is_empty(),
                    "{scene} {stride}: {checked:?}"
                );
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
            assert!(
                found
                    .iter()
                    .all(|fault| fault.to_string().contains(name(convention))),
                "{scene}: {found:?}"
            );
        }
    }
}

/// A copy of a cloud of floats whose colours have names that nothing reads.
fn without_colors(cloud: &Path, copy: &Path) {
    let mut bytes = fs::read(cloud).unwrap();
    for (color, other) in [("red", "rad"), ("green", "grean"), ("blue", "bluu")] {
        let wanted = format!("uchar {color}\n");
        let at = bytes
            .windows(wanted.len())
            .position(|window| window == wanted.as_bytes())
            .unwrap();
        bytes[at..at + wanted.len()].copy_from_slice(format!("uchar {other}\n").as_bytes());
    }
    fs::write(copy, bytes).unwrap();
}

#[test]
fn real_captures_without_a_cloud_give_no_false_alarm() {
    let Some(shared) = crate::support::shared_dir() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    for (scene, transforms) in SCENES {
        let capture = capture_of(&shared.join("data").join(scene), transforms);
        for convention in CONVENTIONS {
            for stride in [1, 2, 4, 12] {
                capture.transforms(dir, convention, stride);
                without_cloud(dir);
                let found = suspected(dir);
                eprintln!("{scene} {convention:?} {stride}: {}", found.len());
                let wanted = name(convention).replace("if they are", "may be");
                assert!(
                    found.iter().all(|notice| notice.contains(&wanted)),
                    "{scene} {convention:?}: {found:?}"
                );
                let none = convention == (false, false);
                assert!(!none || found.is_empty(), "{scene} {stride}: {found:?}");
                assert!(
                    none || stride > 1 || !found.is_empty(),
                    "{scene} {convention:?}"
                );
            }
        }
    }
}

#[test]
fn depth_images_tell_as_a_cloud_does() {
    let Some(shared) = crate::support::shared_dir() else {
        return;
    };
    for scene in ["house_living", "house_kitchen", "studio"] {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        let capture = capture_of(&shared.join("data").join(scene), "transforms.json");
        for sub in ["color", "pose", "intrinsic", "depth"] {
            fs::create_dir(dir.join(sub)).unwrap();
        }
        let c = &capture.shots[0].1;
        let intrinsics = format!(
            "{} 0 {} 0\n0 {} {} 0\n0 0 1 0\n0 0 0 1\n",
            c.fx, c.cx, c.fy, c.cy
        );
        fs::write(dir.join("intrinsic/intrinsic_color.txt"), intrinsics).unwrap();
        for (i, (photo, _)) in capture.shots.iter().enumerate() {
            let kind = photo.extension().unwrap().to_str().unwrap();
            fs::copy(photo, dir.join(format!("color/{i}.{kind}"))).unwrap();
            let depth = photo
                .parent()
                .unwrap()
                .with_file_name("depth")
                .join(photo.file_name().unwrap());
            fs::copy(
                depth.with_extension("png"),
                dir.join(format!("depth/{i}.png")),
            )
            .unwrap();
        }
        for (convention, help) in [
            ((false, true), None),
            ((true, true), Some("; invert each matrix")),
            (
                (false, false),
                Some("; negate the second and third columns of each matrix"),
            ),
            (
                (true, false),
                Some("; invert each matrix, then negate its second and third columns"),
            ),
        ] {
            for (i, (_, camera)) in capture.shots.iter().enumerate() {
                let lines = rows(matrix(camera, convention))
                    .into_iter()
                    .map(|row| row.map(|v| v.to_string()).join(" "));
                fs::write(
                    dir.join(format!("pose/{i}.txt")),
                    lines.collect::<Vec<_>>().join("\n"),
                )
                .unwrap();
            }
            let checked = check(dir, &LoadOptions::default());
            eprintln!("{scene} {convention:?}: {:?}", checked.problems);
            let Some(help) = help else {
                assert!(checked.problems.is_empty(), "{checked:?}");
                continue;
            };
            one_problem(&checked, &["pose: matrices", name(convention)]);
            assert!(
                checked.problems[0].to_string().ends_with(help),
                "{checked:?}"
            );
        }
    }
}

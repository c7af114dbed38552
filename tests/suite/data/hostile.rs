//! Scene folders with faults that once passed, or took the machine with them.

use crate::support::colmap::{self, pinhole};
use crate::support::program::text;
use crate::support::small_scene::{edit, scene};
use coseg::data::{Checked, LoadOptions, check, load};
use flate2::{Compress, Compression, FlushCompress};
use serde_json::json;
use std::fs;
use std::path::Path;
use std::process::Command;

fn checked(dir: &Path) -> Checked {
    check(dir, &LoadOptions::default())
}

/// Expects that checking names one fault with all of `parts`.
#[track_caller]
fn finds(dir: &Path, parts: &[&str]) {
    let problems = checked(dir).problems;
    let messages: Vec<String> = problems.iter().map(ToString::to_string).collect();
    let named = |message: &String| parts.iter().all(|part| message.contains(part));
    assert!(messages.iter().any(named), "{parts:?}: {messages:?}");
}

/// A zlib stream of 4 GB of zeros, except for its checksum.
#[cfg(target_os = "linux")]
fn bomb() -> Vec<u8> {
    const PART: usize = 1 << 26;
    let mut part = Vec::with_capacity(PART / 100);
    let mut packer = Compress::new(Compression::best(), false);
    packer
        .compress_vec(&vec![0; PART], &mut part, FlushCompress::Full)
        .expect("packed");
    assert_eq!(packer.total_in(), PART as u64);
    [&[0x78, 0x01][..], &part.repeat(64)].concat()
}

#[cfg(target_os = "linux")]
#[test]
fn a_colour_profile_of_gigabytes_is_not_unpacked() {
    let dir = scene();
    let path = dir.path().join("images/v1.png");
    let whole = fs::read(&path).expect("photo");
    let data = [&b"profile\0\0"[..], &bomb()].concat();
    let mut checksum = flate2::Crc::new();
    checksum.update(b"iCCP");
    checksum.update(&data);
    let length = (data.len() as u32).to_be_bytes();
    let sum = checksum.sum().to_be_bytes();
    let chunk = [&length[..], b"iCCP", &data, &sum].concat();
    // After the signature and the header.
    fs::write(&path, [&whole[..33], &chunk, &whole[33..]].concat()).expect("write");
    let output = Command::new("sh")
        .args(["-c", "ulimit -v 3000000; exec \"$@\"", "sh"])
        .args([env!("CARGO_BIN_EXE_coseg"), "data", "check"])
        .arg(dir.path())
        .env("RAYON_NUM_THREADS", "2")
        .output()
        .expect("a shell");
    let said = text(&output.stdout) + &text(&output.stderr);
    assert!(said.contains("no problems"), "{said}");
}

#[test]
fn tables_and_cameras_without_sense_are_faults() {
    let dir = scene();
    fs::write(dir.path().join("classes.json"), "{}").expect("write");
    finds(dir.path(), &["classes.json", "found no class"]);
    for (key, value) in [("fl_x", 1e7), ("fl_y", 0.01), ("cx", 4000.0)] {
        let dir = scene();
        edit(&dir, |v| v[key] = json!(value));
        finds(dir.path(), &["v0: intrinsics", "field of view"]);
    }
    let dir = scene();
    edit(&dir, |v| {
        v["frames"][1]["transform_matrix"][0][3] = json!(1e30)
    });
    finds(
        dir.path(),
        &["frames[1]", "transform_matrix", "row 0, column 3", "1e30"],
    );
}

#[test]
fn a_camera_twice_in_a_model_is_a_fault() {
    let dir = colmap::scene(colmap::text, &pinhole());
    let path = dir.path().join("sparse/0/cameras.txt");
    let text = fs::read_to_string(&path).expect("cameras");
    let last = text.lines().last().expect("a camera");
    fs::write(&path, format!("{text}{last}\n")).expect("write");
    finds(
        dir.path(),
        &[
            "cameras.txt",
            "CAMERA_ID",
            "7, which an earlier camera has too",
        ],
    );
}

#[test]
fn stray_points_are_left_out() {
    let dir = scene();
    let point = |i: usize| format!("{} {} {} 0 0 0\n", i % 5, i / 5, 1e6 + i as f64);
    let points: String = (0..40).map(point).collect();
    let header = "ply\nformat ascii 1.0\nelement vertex 41\nproperty double x\nproperty double y\nproperty double z\n\
        property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n";
    let file = dir.path().join("points.ply");
    fs::write(&file, format!("{header}{points}1e8 0 0 255 255 255\n")).expect("write");
    let loaded = load(dir.path(), &LoadOptions::default()).expect("a scene");
    assert_eq!(loaded.points.len(), 40);
    assert!(
        loaded.points.colors.iter().all(|color| *color == [0.0; 3]),
        "colours go with their points"
    );
    // Far, but not a thousand times as far as half of them.
    fs::write(&file, format!("{header}{points}9e3 0 1e6 255 255 255\n")).expect("write");
    let loaded = load(dir.path(), &LoadOptions::default()).expect("a scene");
    assert_eq!(loaded.points.len(), 41);
}

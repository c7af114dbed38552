//! `coseg from-photos` with the real ffmpeg, colmap and pycolmap, where they are there.

use crate::support::program::{listed, text, utf8};
use crate::support::programs::Sandbox;
use crate::support::{shared_dir, skip_without_program};
use std::fs;
use std::path::Path;
use std::process::Command;

/// Whether `command` succeeds; says that a part of the test is left out where it does not.
fn is_there(command: &mut Command, name: &str) -> bool {
    let there = command.output().is_ok_and(|output| output.status.success());
    if !there {
        eprintln!("SKIPPED: {name} is absent");
    }
    there
}

/// Makes a video of `count` frames of ffmpeg's source `picture`.
fn film(picture: &str, count: &str, file: &Path) {
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.args([
        "-v",
        "error",
        "-f",
        "lavfi",
        "-i",
        picture,
        "-frames:v",
        count,
    ]);
    ffmpeg.args(["-fps_mode", "passthrough", "-c:v", "mpeg4", "-q:v", "1"]);
    let made = ffmpeg.arg(file).output().unwrap();
    assert!(made.status.success(), "{}", text(&made.stderr));
}

#[test]
fn ffmpeg_gives_the_frames_that_were_chosen() {
    if !is_there(Command::new("ffmpeg").arg("-version"), "ffmpeg") {
        return;
    }
    let sandbox = Sandbox::new();
    sandbox.script("colmap", "exit 0");
    sandbox.script("ffmpeg", "exec ffmpeg \"$@\"");
    // Each third frame is sharp, at uneven times; the number of the frame is its brightness.
    let picture = "color=c=black:s=64x48:r=90,format=yuv420p,geq=lum='20+10*N+(mod(X,2)*30)*eq(mod(N,3),1)':cb=128:cr=128,\
        setpts=N+floor(N*N/6)";
    let video = sandbox.path("100% test: ä.mp4");
    film(picture, "12", &video);
    sandbox.fails(&video, &["--frames", "4"], &["none of 4 photos"]);
    let room = sandbox.path("room");
    let images = room.join("images");
    assert_eq!(listed(&images).len(), 4);
    for (i, name) in listed(&images).iter().enumerate() {
        let frame = image::open(images.join(name)).unwrap().into_luma8();
        let dark = frame.get_pixel(10, 10).0[0].min(frame.get_pixel(11, 10).0[0]);
        // From limited to full range.
        let expected = (20.0 + 10.0 * (3 * i + 1) as f64 - 16.0) * 255.0 / 219.0;
        assert!(
            (f64::from(dark) - expected).abs() < 8.0,
            "{name}: {dark} instead of {expected}"
        );
    }
    // More frames than ffmpeg takes terms.
    let long = sandbox.path("long.mp4");
    film("testsrc=s=64x48:r=30,format=yuv420p", "260", &long);
    fs::remove_dir_all(&room).unwrap();
    sandbox.fails(&long, &["--frames", "250"], &["none of 250 photos"]);
    fs::remove_dir_all(&room).unwrap();
    fs::write(&long, "no film").unwrap();
    sandbox.fails(
        &long,
        &[],
        &["ffmpeg failed", "Invalid data", "that it can play"],
    );
}

#[test]
fn colmap_and_pycolmap_find_the_poses_of_real_photos() {
    let Some(shared) = shared_dir() else {
        return;
    };
    let fox = shared.join("data/fox/images_4");
    let python = std::env::var("COSEG_PYTHON").unwrap_or("python3".to_owned());
    let pycolmap = is_there(
        Command::new(&python).args(["-c", "import pycolmap"]),
        "pycolmap",
    );
    let colmap = is_there(Command::new("colmap").arg("help"), "colmap");
    if !pycolmap && !colmap {
        skip_without_program("neither pycolmap nor colmap is there");
    }
    for (arguments, _) in [(&["--python", &*python][..], pycolmap), (&[], colmap)]
        .iter()
        .filter(|(_, there)| *there)
    {
        let sandbox = Sandbox::new();
        sandbox.script("colmap", "exec colmap \"$@\"");
        let photos = sandbox.path("fox");
        fs::create_dir(&photos).unwrap();
        for name in listed(&fox).iter().take(6) {
            fs::copy(fox.join(name), photos.join(name)).unwrap();
        }
        let said = sandbox.succeeds(&photos, arguments);
        assert!(
            said.contains("6 frames, no problems"),
            "{}: {said}",
            utf8(&photos)
        );
    }
}

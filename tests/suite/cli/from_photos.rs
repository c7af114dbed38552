//! `coseg from-photos`, with scripts in the place of colmap, Python and ffmpeg, and with these programs where they are there.

use crate::support::exif_photo::photo;
use crate::support::onnx::Onnx;
use crate::support::plates::{HEIGHT, WIDTH};
use crate::support::program::{fails, listed, read_json, text, utf8};
use crate::support::programs::Sandbox;
use crate::support::snapshot::snapshot;
use coseg::data::{LabelMap, LoadOptions, check, load};
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

/// Steps as the scripts note them, for COLMAP and its Python package.
const STEPS: [&str; 3] = ["features", "matches", "poses"];

#[test]
fn photos_become_a_scene_folder_once() {
    for python in [false, true] {
        let sandbox = Sandbox::new();
        let photos = sandbox.photos();
        let room = sandbox.path("room");
        if python {
            sandbox.pycolmap();
        } else {
            sandbox.colmap();
        }
        let said = sandbox.succeeds(&photos, &[]);
        let by = if python {
            "pycolmap of python3"
        } else {
            "poses by colmap"
        };
        for part in [by, "6 photos", "no problems", "coseg train --data"] {
            assert!(said.contains(part), "{part:?} is not in: {said}");
        }
        assert_eq!(sandbox.log(), STEPS);
        assert_eq!(listed(&room), ["from-photos.json", "images", "sparse"]);
        assert!(!room.join(".from-photos").exists(), "COLMAP's own files");
        for name in listed(&photos) {
            let [given, copied] =
                [&photos, &room.join("images")].map(|dir| fs::read(dir.join(&name)).unwrap());
            assert_eq!(given, copied, "{name}");
        }
        assert_eq!(check(&room, &LoadOptions::default()).frames, 6);
        // What is done is not done again.
        assert!(sandbox.succeeds(&photos, &[]).contains("6 photos"));
        assert_eq!(sandbox.log(), STEPS);
        fs::remove_file(photos.join("Bild ö 0.png")).unwrap();
        sandbox.fails(&photos, &[], &["--out", "made from", "another folder"]);
        assert_eq!(listed(&room.join("images")).len(), 6);
    }
}

#[test]
fn a_segmenter_labels_the_photos() {
    let sandbox = Sandbox::new();
    sandbox.colmap();
    let (photos, room) = (sandbox.photos(), sandbox.path("room"));
    sandbox.fails(&photos, &["--contract", "net"], &["no segmenter"]);
    let model = Onnx::write_sound(sandbox.0.path(), WIDTH, HEIGHT);
    let given = ["--segmenter", utf8(&model)];
    let said = sandbox.succeeds(&photos, &given);
    let next = "--set data.raw_labels=labels_segmenter";
    assert!(said.contains(next), "{said}");
    let options = LoadOptions {
        raw_labels: Some("labels_segmenter".to_owned()),
        ..LoadOptions::default()
    };
    let scene = load(&room, &options).unwrap();
    let names = scene.classes.entries.iter().map(|class| &*class.name);
    let names: Vec<&str> = names.collect();
    assert_eq!(names, ["crimson", "lime", "navy", "plaster"]);
    for (i, view) in scene.views.iter().enumerate() {
        assert!(view.scores.is_some(), "{}", view.name);
        let raw = view.raw.as_ref().unwrap().map().ids;
        let truth = LabelMap::read(&sandbox.path(&format!("all/labels/v{i}.png"))).unwrap();
        let pairs = truth.ids.iter().zip(raw).filter(|(truth, _)| **truth != 0);
        // Red, green, blue and the wall, in the order of the network's names.
        let same = pairs.clone().filter(|(truth, raw)| {
            let index = scene.classes.index(*raw);
            index == Some(usize::from(**truth) - 1)
        });
        let agreement = same.count() as f64 / pairs.count() as f64;
        assert!(agreement > 0.85, "{}: {agreement}", view.name);
    }
    // What is done is not done again.
    let map = room.join("labels_segmenter").join("Bild ö 0.png");
    let written = || fs::metadata(&map).unwrap().modified().unwrap();
    let before = written();
    sandbox.succeeds(&photos, &given);
    assert_eq!(
        (before, sandbox.log()),
        (written(), STEPS.map(str::to_owned).to_vec())
    );
}

#[test]
fn a_folder_that_is_refused_stays_as_it_was() {
    let sandbox = Sandbox::new();
    sandbox.colmap();
    let photos = sandbox.photos();
    let room = sandbox.path("room");
    fs::create_dir(&room).unwrap();
    let none = sandbox.path("none");
    sandbox.fails(&none, &[], &["no such file or folder"]);
    assert!(room.is_dir() && snapshot(&room).is_empty());
    fs::write(room.join("mine.txt"), "mine").unwrap();
    let before = snapshot(&room);
    sandbox.fails(&photos, &[], &["--out", "mine.txt", "another folder"]);
    assert!(snapshot(&room) == before, "{:?}", snapshot(&room));
    // The lock of somebody else, and a folder that was not there.
    fs::write(room.join(".coseg-lock"), "4711\n").unwrap();
    sandbox.fails(&photos, &[], &["--out", "mine.txt"]);
    assert!(room.join(".coseg-lock").exists());
    fs::remove_dir_all(&room).unwrap();
    sandbox.fails(&none, &[], &["no such file or folder"]);
    assert!(!room.exists());
}

#[test]
fn one_lens_is_asked_for() {
    let sandbox = Sandbox::new();
    sandbox.colmap();
    sandbox.succeeds(&sandbox.photos(), &[]);
    let arguments = fs::read_to_string(sandbox.path("arguments")).unwrap();
    for part in [
        "single_camera 1",
        "--SiftExtraction.use_gpu 0",
        "camera_model OPENCV",
        "database.db",
        "room/images",
    ] {
        assert!(arguments.contains(part), "{arguments}");
    }
}

#[test]
fn photos_are_turned_by_their_orientation_where_that_gives_one_size() {
    let exif = |dir: &Path, name: &str| {
        use image::ImageDecoder;
        let reader = image::ImageReader::open(dir.join(name)).unwrap();
        let mut decoder = reader.into_decoder().unwrap();
        let size = decoder.dimensions();
        (
            size,
            decoder.orientation().unwrap().to_exif(),
            decoder.exif_metadata().unwrap().is_some(),
        )
    };
    // Sizes and orientations of two photos, and what becomes of the first.
    for (sizes, orientations, size) in [
        ([(30, 20); 2], [6, 6], (20, 30)),
        ([(30, 20), (20, 30)], [6, 1], (20, 30)),
        ([(30, 20); 2], [6, 1], (30, 20)),
        ([(30, 20); 2], [3, 1], (30, 20)),
    ] {
        let sandbox = Sandbox::new();
        sandbox.script("colmap", "exit 0");
        let photos = sandbox.path("photos");
        fs::create_dir(&photos).unwrap();
        for i in 0..2 {
            photo(&photos.join(format!("{i}.jpg")), sizes[i], orientations[i]);
        }
        let given = fs::read(photos.join("0.jpg")).unwrap();
        sandbox.fails(&photos, &[], &["none of 2 photos", "texture"]);
        let images = sandbox.path("room/images");
        assert_eq!(
            exif(&images, "0.jpg"),
            (size, 1, true),
            "{sizes:?} {orientations:?}"
        );
        assert_eq!(fs::read(photos.join("0.jpg")).unwrap(), given);
        let differ = |a: &Path, b: &Path| {
            let [a, b] = [a, b].map(|dir| image::open(dir.join("0.jpg")).unwrap().into_rgb8());
            let off = a.iter().zip(b.iter()).map(|(a, b)| a.abs_diff(*b)).max();
            off.unwrap_or_default()
        };
        if orientations == [6, 1] && sizes[0] == sizes[1] {
            assert_eq!(differ(&photos, &images), 0, "a mix keeps its pixels");
        }
        if orientations[0] == 3 {
            assert!(differ(&photos, &images) > 10, "upside down");
        }
    }
    let sandbox = Sandbox::new();
    sandbox.colmap();
    let photos = sandbox.path("photos");
    fs::create_dir(&photos).unwrap();
    for (i, size) in [(30, 20), (30, 20), (30, 24)].into_iter().enumerate() {
        photo(&photos.join(format!("{i}.jpg")), size, 1);
    }
    sandbox.fails(&photos, &[], &["2 of 30x20, 1 of 30x24", "one size"]);
    photo(&photos.join("2.jpeg"), (30, 20), 1);
    sandbox.fails(&photos, &[], &["2.jpeg and 2.jpg", "before the extension"]);
}

#[test]
fn what_is_missing_is_named_with_its_remedy() {
    let sandbox = Sandbox::new();
    let photos = sandbox.photos();
    sandbox.fails(
        &photos,
        &[],
        &[
            "no such program: colmap",
            "python3 has no pycolmap",
            "pip install pycolmap",
        ],
    );
    sandbox.script("python3", "exit 1");
    sandbox.fails(
        &photos,
        &["--python", "python3"],
        &["pycolmap", "python3 cannot import it", "pip install"],
    );
    sandbox.colmap();
    let video = sandbox.path("walk.mp4");
    fs::write(&video, "film").unwrap();
    sandbox.fails(
        &video,
        &[],
        &["no such program: ffmpeg", "apt-get install ffmpeg"],
    );
    sandbox.fails(
        &sandbox.path("nothing"),
        &[],
        &["no such file or folder", "nothing"],
    );
    let heic = sandbox.path("heic");
    fs::create_dir(&heic).unwrap();
    sandbox.fails(&heic, &[], &["0 PNG or JPEG files", "two or more"]);
    fs::write(heic.join("a.HEIC"), b"\0\0\0\x18ftypheic").unwrap();
    sandbox.fails(&heic, &[], &["1 HEIC files", "mogrify"]);
    for command in [&["data", "check"][..], &["train", "--data"]] {
        let message = fails(&[command, &[utf8(&heic)]].concat(), 1);
        assert!(
            message.contains("1 HEIC photos") && message.contains("from-photos"),
            "{message}"
        );
        let message = fails(&[command, &[utf8(&video)]].concat(), 1);
        assert!(message.contains("from-photos VIDEO"), "{message}");
    }
    let message = fails(&["data", "info", utf8(&heic.join("a.HEIC"))], 1);
    assert!(
        message.contains("mogrify") && message.contains("from-photos"),
        "{message}"
    );
    fs::copy(heic.join("a.HEIC"), heic.join("a.jpg")).unwrap();
    fs::copy(heic.join("a.HEIC"), heic.join("b.jpg")).unwrap();
    sandbox.fails(&heic, &[], &["a.jpg", "found HEIC", "mogrify"]);
    fs::remove_dir_all(sandbox.path("room")).unwrap();
    fs::create_dir(sandbox.path("room")).unwrap();
    fs::write(sandbox.path("room/mine.txt"), "years of work").unwrap();
    sandbox.fails(&photos, &[], &["--out", "mine.txt", "new folder"]);
    assert!(sandbox.log().is_empty());
}

#[test]
fn videos_beside_the_photos_are_named() {
    let sandbox = Sandbox::new();
    let photos = sandbox.photos();
    sandbox.colmap();
    for name in ["IMG_2.MOV", "IMG_3.mp4", "._IMG_1.MOV"] {
        fs::write(photos.join(name), "film").unwrap();
    }
    let output = sandbox.run(&photos, &[]);
    let warnings = text(&output.stderr);
    assert!(output.status.success(), "{warnings}");
    for part in ["2 videos", "IMG_2.MOV", "coseg from-photos VIDEO"] {
        assert!(warnings.contains(part), "{part}: {warnings}");
    }
    assert_eq!(listed(&sandbox.path("room/images")).len(), 6);
}

#[test]
fn a_program_that_fails_is_quoted_and_continued() {
    let sandbox = Sandbox::new();
    let photos = sandbox.photos();
    sandbox.script(
        "colmap",
        "test $1 != help || exit 0; for i in 1 2 3 4 5 6 7 8; do echo \"line $i\"; done; \
         echo 'no room' >&2; echo 'at least two images are needed' >&2; exit 3",
    );
    sandbox.fails(
        &photos,
        &[],
        &[
            "colmap failed (exit status: 3)",
            "line 8",
            "no room",
            "at least two images are needed",
            "continues",
        ],
    );
    let images = sandbox.path("room/images");
    let first = fs::metadata(images.join("Bild ö 0.png"))
        .unwrap()
        .modified()
        .unwrap();
    sandbox.colmap();
    sandbox.succeeds(&photos, &[]);
    let again = fs::metadata(images.join("Bild ö 0.png"))
        .unwrap()
        .modified()
        .unwrap();
    assert_eq!(
        (first, sandbox.log()),
        (again, STEPS.map(str::to_owned).to_vec())
    );
}

#[test]
fn a_stop_ends_the_programs_too() {
    let sandbox = Sandbox::new();
    let photos = sandbox.photos();
    let begun = sandbox.path("begun");
    let stopped = sandbox.path("stopped");
    let left = sandbox.path("left");
    // A child that outlives the stop says so.
    let wait = format!(
        "test $1 != help || exit 0; \
         (for i in $(seq 600); do test -e '{}' && touch '{}' && exit; sleep 0.1; done) & touch '{}'; wait",
        utf8(&stopped),
        utf8(&left),
        utf8(&begun)
    );
    sandbox.script("colmap", &wait);
    let out = sandbox.path("room");
    let mut running = sandbox
        .command(&[utf8(&photos), "--out", utf8(&out)])
        .spawn()
        .unwrap();
    let started = Instant::now();
    while !begun.exists() {
        assert!(started.elapsed() < Duration::from_secs(60));
        std::thread::sleep(Duration::from_millis(20));
    }
    let stop = format!("kill -INT {}", running.id());
    assert!(
        Command::new("sh")
            .args(["-c", &stop])
            .status()
            .unwrap()
            .success()
    );
    assert_eq!(running.wait().unwrap().code(), Some(130));
    fs::write(&stopped, "").unwrap();
    std::thread::sleep(Duration::from_millis(2000));
    assert!(!left.exists(), "what COLMAP started goes on");
    sandbox.colmap();
    sandbox.succeeds(&photos, &[]);
}

#[test]
fn the_sharpest_frames_of_a_video_are_taken() {
    let sandbox = Sandbox::new();
    let photos = sandbox.photos();
    let video = sandbox.path("Gang 1.mp4");
    fs::write(&video, "film").unwrap();
    sandbox.colmap();
    let dir = utf8(sandbox.0.path()).to_owned();
    let model = fs::read_to_string(sandbox.path("model/images.txt")).unwrap();
    let frames = (0..3).fold(model, |text, i| {
        text.replace(
            &format!("Bild ö {i}.png"),
            &format!("frame_000{}.jpg", i + 1),
        )
    });
    let three: Vec<&str> = frames.lines().take(6).collect();
    fs::write(sandbox.path("model/images.txt"), three.join("\n")).unwrap();
    for i in 0..3 {
        let photo = image::open(photos.join(format!("Bild ö {i}.png"))).unwrap();
        photo
            .into_rgb8()
            .save(sandbox.path(&format!("frame_000{}.jpg", i + 1)))
            .unwrap();
    }
    // Seven frames, and the sharpness of each.
    sandbox.script(
        "ffmpeg",
        &format!(
            "echo \"$*\" >>'{dir}/ffmpeg'
            case \"$*\" in
            *signalstats*) for v in 3 1 2 5 4 0 7; do echo \"lavfi.signalstats.YAVG=$v\"; done;;
            *select=*) cp '{dir}'/frame_*.jpg .;; esac"
        ),
    );
    let said = sandbox.succeeds(&video, &["--frames", "3"]);
    assert!(said.contains("3 photos"), "{said}");
    let calls = fs::read_to_string(sandbox.path("ffmpeg")).unwrap();
    assert!(
        calls.contains("(eq(n,0)+(eq(n,3)+eq(n,6)))") && calls.contains("file:/"),
        "{calls}"
    );
    let record = read_json(&sandbox.path("room/from-photos.json"));
    assert_eq!(record["photos"], 3);
    sandbox.fails(&video, &["--frames", "4"], &["masks or frames"]);
}

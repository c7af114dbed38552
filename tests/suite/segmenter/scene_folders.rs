//! What no command writes into: folders of photos, and labels that others made.

use crate::support::onnx::plates;
use crate::support::program::{fails, utf8};
use crate::support::snapshot::snapshot;

#[test]
fn no_command_writes_into_a_scene() {
    let (folder, dir, model) = plates();
    let ply = dir.join("plates.ply");
    let [data, ply, model] = [&dir, &ply, &model].map(|path| utf8(path).to_owned());
    // The labels of a COLMAP scene lie where `associate` puts its own.
    let outs = ["", "images", "labels", "raw", "images/../labels"]
        .map(|name| utf8(&dir.join(name)).to_owned());
    let before = snapshot(&dir);
    for out in &outs {
        let lines: [&[&str]; 5] = [
            &["associate", "--scene", &ply, "--data", &data],
            &["vote", "--scene", &ply, "--data", &data],
            &["render", "--scene", &ply, "--cameras", &data],
            &["train", "--data", &data],
            &["train", "--data", &data, "--segmenter", &model],
        ];
        for line in lines {
            let line = [line, &["--out", out]].concat();
            let message = fails(&line, 1);
            assert!(message.contains("--out"), "{line:?}: {message}");
            assert!(snapshot(&dir) == before, "{line:?}");
        }
    }
    // Nor a new file beside photos, with classes and cameras of its own.
    let file = utf8(&dir.join("new.ply")).to_owned();
    let [frame, pixel] = [["--frame", "v3"], ["--pixel", "40,30"]];
    let select = [
        &["--cameras", &data][..],
        &frame,
        &pixel,
        &["--name", "lamp"],
    ]
    .concat();
    for (command, more) in [
        ("edit", &["--paint"][..]),
        ("separate", &[]),
        ("select", &select),
        ("export", &[]),
    ] {
        let line = [command, "--scene", &ply, "--out", &file, "--force"];
        let message = fails(&[&line[..], more].concat(), 1);
        assert!(message.contains("holds files of a scene"), "{message}");
        assert!(snapshot(&dir) == before, "{command}");
    }
    std::fs::create_dir(dir.join("depth")).expect("folder");
    std::fs::write(dir.join("depth/v0.png"), "not read").expect("write");
    let before = snapshot(&dir);
    for file in [
        "images/v0.png",
        "transforms.json",
        "classes.json",
        "depth/v0.png",
    ] {
        let file = utf8(&dir.join(file)).to_owned();
        assert!(fails(&["data", "info", &data, "--sheet", &file], 1).contains("--sheet"));
        assert!(snapshot(&dir) == before, "{file}");
    }
    // Labels that others made stay where they are.
    let taken = folder.path().join("taken");
    std::fs::create_dir_all(taken.join("labels")).expect("folder");
    std::fs::write(taken.join("labels/v0.png"), "mine").expect("write");
    let message = fails(
        &[
            "associate",
            "--scene",
            &ply,
            "--data",
            &data,
            "--out",
            utf8(&taken),
        ],
        1,
    );
    assert!(message.contains("did not write"), "{message}");
}

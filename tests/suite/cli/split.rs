//! `coseg split`, a training of each block, `coseg merge` and `coseg eval`.

use crate::support::hall::hall;
use crate::support::program::{fails, listed, succeeds, utf8};
use std::fs;
use std::path::PathBuf;

#[test]
fn blocks_are_trained_and_merged() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    hall(&at("hall"), false);
    let split = |counts: &str| {
        [
            "split",
            "--data",
            utf8(&at("hall")),
            "--blocks",
            counts,
            "--out",
            utf8(&at("blocks")),
        ]
        .map(str::to_owned)
    };
    let words = |words: &[String]| {
        words
            .iter()
            .map(String::as_str)
            .collect::<Vec<_>>()
            .join("\n")
    };
    let run = |arguments: &[String]| succeeds(&words(arguments).lines().collect::<Vec<_>>());
    let said = run(&split("2x1"));
    assert!(
        said.contains("0_0: ")
            && said.contains(&format!(
                "coseg train --data {}",
                at("blocks/1_0").display()
            )),
        "{said}"
    );
    assert_eq!(listed(&at("blocks")), ["0_0", "1_0"]);
    // Again, over its own files.
    assert_eq!(run(&split("2x1")), said);
    let refused =
        |arguments: &[String], code| fails(&words(arguments).lines().collect::<Vec<_>>(), code);
    assert!(refused(&split("1x1"), 1).contains("block 1_0 of another split"));
    assert!(refused(&split("0x2"), 1).contains("--blocks"));
    refused(&split("2"), 2);
    let runs: Vec<PathBuf> = ["0_0", "1_0"].map(|name| at("runs").join(name)).into();
    for (name, run) in ["0_0", "1_0"].iter().zip(&runs) {
        let data = at("blocks").join(name);
        succeeds(&[
            "train",
            "--data",
            utf8(&data),
            "--out",
            utf8(run),
            "--set",
            "building.iterations=20",
            "--set",
            "segmentation.rows=vote",
        ]);
    }
    let merged = at("merged");
    let said = succeeds(&[
        "merge",
        "--out",
        utf8(&merged),
        utf8(&runs[1]),
        utf8(&runs[0]),
    ]);
    assert!(
        said.contains("0_0: ") && said.contains("are in the core"),
        "{said}"
    );
    for file in [
        "scene.ply",
        "classes.json",
        "cameras.json",
        "config.toml",
        "identities.safetensors",
    ] {
        assert!(merged.join(file).is_file(), "{file}");
    }
    let scores = succeeds(&["eval", utf8(&merged)]);
    assert!(scores.contains("3 held-out views"), "{scores}");
    let message = fails(&["merge", "--out", utf8(&merged), utf8(&runs[1])], 1);
    assert!(message.contains("no run on 0_0"), "{message}");
}

#[test]
fn files_of_others_stay() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    hall(&at("hall"), false);
    let split = |out: &str| {
        let out = at(out);
        fails(
            &[
                "split",
                "--data",
                utf8(&at("hall")),
                "--blocks",
                "2x1",
                "--out",
                utf8(&out),
            ],
            1,
        )
    };
    fs::create_dir_all(at("blocks/1_0")).unwrap();
    fs::write(at("blocks/1_0/block.json"), "mine").unwrap();
    let message = split("blocks");
    assert!(
        message.contains("1_0/block.json, which this command did not write"),
        "{message}"
    );
    assert_eq!(fs::read(at("blocks/1_0/block.json")).unwrap(), b"mine");
    assert!(!at("blocks/0_0").exists(), "nothing is written");
    assert!(split("hall").contains("holds files of a scene"));
    fs::create_dir_all(at("merged")).unwrap();
    fs::write(at("merged/config.toml"), "mine").unwrap();
    let message = fails(&["merge", "--out", utf8(&at("merged")), "run"], 1);
    assert!(
        message.contains("config.toml, which this command did not write"),
        "{message}"
    );
}

//! `coseg split`, a training of each block, `coseg merge` and `coseg eval`.

use crate::support::hall::hall;
use crate::support::program::{fails, listed, succeeds, utf8};
use std::fs;
use std::path::{Path, PathBuf};

/// The arguments that split the scene in `data`.
fn split<'a>(data: &'a Path, counts: &'a str, out: &'a Path) -> [&'a str; 7] {
    let [data, out] = [data, out].map(utf8);
    ["split", "--data", data, "--blocks", counts, "--out", out]
}

#[test]
fn blocks_are_trained_and_merged() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scene = at("hall");
    let blocks = at("blocks");
    hall(&scene, false);
    let said = succeeds(&split(&scene, "2x1", &blocks));
    let line = format!("coseg train --data {}", blocks.join("1_0").display());
    assert!(said.contains("0_0: ") && said.contains(&line), "{said}");
    assert_eq!(listed(&blocks), ["0_0", "1_0"]);
    // Again, over its own files.
    assert_eq!(succeeds(&split(&scene, "2x1", &blocks)), said);
    let message = fails(&split(&scene, "1x1", &blocks), 1);
    assert!(message.contains("block 1_0 of another split"), "{message}");
    let message = fails(&split(&scene, "0x2", &blocks), 1);
    assert!(message.contains("--blocks"), "{message}");
    fails(&split(&scene, "2", &blocks), 2);
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
    let written = [
        "cameras.json",
        "classes.json",
        "config.toml",
        "identities.safetensors",
        "scene.ply",
    ];
    assert_eq!(listed(&merged), written);
    // Again, over its own files.
    succeeds(&[
        "merge",
        "--out",
        utf8(&merged),
        utf8(&runs[0]),
        utf8(&runs[1]),
    ]);
    let scores = succeeds(&["eval", utf8(&merged)]);
    assert!(scores.contains("3 held-out views"), "{scores}");
    let message = fails(&["merge", "--out", utf8(&merged), utf8(&runs[1])], 1);
    assert!(message.contains("no run on 0_0"), "{message}");
}

#[test]
fn files_of_others_stay() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scene = at("hall");
    hall(&scene, false);
    let refused = |out: &str| fails(&split(&scene, "2x1", &at(out)), 1);
    fs::create_dir_all(at("blocks/1_0")).unwrap();
    fs::write(at("blocks/1_0/block.json"), "mine").unwrap();
    let message = refused("blocks");
    assert!(
        message.contains("1_0/block.json, which this command did not write"),
        "{message}"
    );
    assert_eq!(fs::read(at("blocks/1_0/block.json")).unwrap(), b"mine");
    assert!(!at("blocks/0_0").exists(), "nothing is written");
    assert!(refused("hall").contains("holds files of a scene"));
    fs::create_dir_all(at("merged")).unwrap();
    fs::write(at("merged/config.toml"), "mine").unwrap();
    let message = fails(&["merge", "--out", utf8(&at("merged")), "run"], 1);
    assert!(
        message.contains("config.toml, which this command did not write"),
        "{message}"
    );
}

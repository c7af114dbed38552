//! The program as a user runs it: help, exit codes and messages.

use crate::support::plates::{plates, scene};
use crate::support::program::{fails, succeeds, utf8, warnings};
use coseg::splat::ply;
use glam::DVec3;

#[test]
fn help_names_every_command_and_shows_examples() {
    let help = succeeds(&["--help"]);
    for word in [
        "train",
        "label",
        "from-photos",
        "data",
        "eval",
        "render",
        "view",
        "vote",
        "associate",
        "objects",
        "select",
        "edit",
        "prune",
        "split",
        "merge",
        "bench",
        "compare",
        "export",
        "completions",
        "Examples:",
        "Exit code",
    ] {
        assert!(help.contains(word), "{word}");
    }
    for command in [
        "train",
        "label",
        "from-photos",
        "data",
        "eval",
        "render",
        "vote",
        "associate",
        "objects",
        "select",
        "edit",
        "prune",
        "split",
        "merge",
        "bench",
        "export",
        "completions",
    ] {
        let help = succeeds(&[command, "--help"]);
        assert!(help.contains("Example"), "{command}");
        let wide: Vec<&str> = help
            .lines()
            .filter(|line| line.chars().count() > 130)
            .collect();
        assert!(wide.is_empty(), "{wide:?}");
    }
    let script = succeeds(&["completions", "bash"]);
    assert!(
        script.contains("--annotations") && script.contains("complete -F"),
        "{script}"
    );
    assert!(succeeds(&["--version"]).contains(env!("CARGO_PKG_VERSION")));
}

#[test]
fn mistakes_on_the_command_line_exit_with_2() {
    fails(&["train", "--bogus"], 2);
    fails(&["paint"], 2);
    let message = fails(&["train", "."], 2);
    assert!(message.contains("'--data DIR'"), "{message}");
    fails(&["render", "--scene", "x.ply"], 2);
    fails(&["train", "--resume", "a", "--out", "b"], 2);
    fails(&["train", "--set", "building.iterations"], 2);
    let message = fails(&["train", "--backend", "abacus"], 2);
    assert!(message.contains("wgpu, flex or ndarray"), "{message}");
    let render = [
        "render",
        "--scene",
        "x.ply",
        "--cameras",
        "y.json",
        "--out",
        "z",
        "--background",
    ];
    for color in ["1,2,3", "-1,0,0", "0,0", "0,0,0,0", "a,b,c", "nan,0,0"] {
        let message = fails(&[&render[..], &[color]].concat(), 2);
        assert!(message.contains("three numbers from 0 to 1"), "{message}");
    }
    // A negative number is a value, not an option.
    let numbers = [
        &["train", "--seed"][..],
        &["render", "--path", "orbit", "--radius"],
        &["render", "--alpha-max"],
        &["view", "--alpha-max"],
        &["query", "--threshold"],
        &["select", "--threshold"],
        &["separate", "--fewest"],
    ];
    for option in numbers {
        let message = fails(&[option, &["-1"]].concat(), 2);
        assert!(message.contains("invalid value '-1'"), "{message}");
    }
}

#[test]
fn bad_settings_exit_with_2_and_touch_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let train = ["train", "--out", utf8(&out), "--set"];
    for (set, word) in [
        ("building.iteratons=5", "did you mean building.iterations?"),
        ("segmentation.lr=-1", "segmentation.lr"),
    ] {
        let message = fails(&[&train[..], &[set]].concat(), 2);
        assert!(message.contains(word), "{message}");
    }
    assert!(!out.exists());
}

#[test]
fn bad_input_exits_with_1_and_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let message = fails(
        &["train", "--out", utf8(&out), "--data", "no/such/scene"],
        1,
    );
    assert!(message.contains("no/such/scene"), "{message}");
    let message = fails(&["train", "--resume", utf8(folder.path())], 1);
    assert!(message.contains("config.toml"), "{message}");
    let message = fails(&["eval", utf8(folder.path())], 1);
    assert!(message.contains("a run folder"), "{message}");

    let scene = scene(folder.path());
    let cameras = folder.path().join("transforms.json");
    let render = [
        "render",
        "--scene",
        utf8(&scene),
        "--cameras",
        utf8(&cameras),
        "--out",
        utf8(&out),
    ];
    let message = fails(&[&render[..], &["--alpha-max", "1.5"]].concat(), 2);
    assert!(
        message.contains("--alpha-max") && message.contains("1.5"),
        "{message}"
    );
    let whole = std::fs::read(&scene).unwrap();
    std::fs::write(&scene, &whole[..whole.len() - 30]).unwrap();
    let message = fails(&render, 1);
    assert!(message.contains("plates.ply"), "{message}");
    let (gaussians, _) = plates();
    ply::write(&scene, &gaussians, DVec3::ZERO, None).unwrap();
    let message = fails(&[&render[..], &["--labels"]].concat(), 1);
    assert!(message.contains("column label"), "{message}");
    assert!(
        !out.exists(),
        "nothing is written before input is known to be good"
    );
}

fn words<'a>(parts: &[&[&'a str]]) -> Vec<&'a str> {
    parts.concat()
}

#[test]
fn every_command_says_at_once_what_it_reads() {
    let folder = tempfile::tempdir().unwrap();
    let [absent, out] = ["absent", "out"].map(|name| folder.path().join(name));
    let [absent, out] = [&absent, &out].map(|path| utf8(path));
    let scene = ["--scene", absent];
    let data = ["--data", absent];
    let out = ["--out", out];
    let select = ["--frame", "a", "--pixel", "1,1", "--name", "b"];
    let query = ["--weights", absent, "--text", "a"];
    let commands = [
        words(&[&["train"], &data, &out]),
        words(&[&["label", "--model", absent], &data, &out]),
        words(&[&["from-photos", absent], &out]),
        words(&[&["data", "check", absent]]),
        words(&[&["data", "info", absent]]),
        words(&[&["data", "suggest", absent]]),
        words(&[&["eval", absent]]),
        words(&[&["render"], &scene, &out]),
        words(&[&["view"], &scene]),
        words(&[&["vote"], &scene, &data, &out]),
        words(&[&["associate"], &scene, &data, &out]),
        words(&[&["objects"], &scene]),
        words(&[&["select"], &select, &scene, &out]),
        words(&[&["query"], &query, &scene, &out]),
        words(&[&["separate"], &scene, &out]),
        words(&[&["edit", "--paint"], &scene, &out]),
        words(&[&["export"], &scene, &out]),
        words(&[&["prune", "--keep", "0.5"], &scene, &data, &out]),
        words(&[&["split", "--blocks", "2x1"], &data, &out]),
        words(&[&["merge", absent], &out]),
        words(&[&["bench", "--run", absent]]),
        words(&[&["compare", absent], &out]),
    ];
    for arguments in &commands {
        let message = fails(arguments, 1);
        let first = message.lines().next().unwrap();
        assert!(
            first.starts_with("reading ") && first.contains(absent),
            "{arguments:?}: {message}"
        );
    }
    let help = succeeds(&["--help"]);
    let listed = help.lines().skip_while(|line| *line != "Commands:");
    let listed = listed.take_while(|line| *line != "Options:");
    let names = listed.filter_map(|line| line.strip_prefix("  ")?.split(' ').next());
    for name in names.filter(|name| !["", "completions", "help"].contains(name)) {
        assert!(commands.iter().any(|words| words[0] == name), "{name}");
    }
    assert_eq!(warnings(&["completions", "bash"]), "");
}

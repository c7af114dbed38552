//! Tells the program which commit it was built from, for the tables of `coseg compare`.

use std::process::Command;

/// What the program is built from.
const SOURCES: [&str; 3] = ["src", "Cargo.toml", "Cargo.lock"];

fn main() {
    for path in SOURCES {
        println!("cargo::rerun-if-changed={path}");
    }
    let commit = commit().unwrap_or_else(|| "unknown".to_owned());
    println!("cargo::rustc-env=COSEG_COMMIT={commit}");
}

/// The last commit that changed the sources, with `+changes` where they differ from it. `None` without git.
fn commit() -> Option<String> {
    let commit = git(&["log", "-1", "--format=%h"]).filter(|commit| !commit.is_empty())?;
    let changes = git(&["status", "--porcelain"])?;
    Some(match &*changes {
        "" => commit,
        _ => format!("{commit}+changes"),
    })
}

/// What git prints about the sources.
fn git(command: &[&str]) -> Option<String> {
    let mut git = Command::new("git");
    let output = git.args(command).arg("--").args(SOURCES).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}

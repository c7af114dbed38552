//! Settings of a file and of `--set`.

use coseg::config::Config;

/// What a settings file and `--set` give.
pub fn load(toml: &str, sets: &[&str]) -> Result<Config, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.toml");
    std::fs::write(&path, toml).unwrap();
    let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
    Config::load(Some(&path), &sets).map_err(|e| e.to_string())
}

/// Asserts that the message contains all of `parts`.
#[track_caller]
pub fn assert_names(error: &str, parts: &[&str]) {
    for part in parts {
        assert!(error.contains(part), "expected {part:?} in: {error}");
    }
}

//! Changes of the `transforms.json` of a scene folder.

use crate::support::program::read_json;
use std::fs;
use std::path::Path;

/// Changes the scene's `transforms.json`.
pub fn edit(dir: &Path, change: impl Fn(&mut serde_json::Value)) {
    let path = dir.join("transforms.json");
    let mut value = read_json(&path);
    change(&mut value);
    fs::write(path, value.to_string()).unwrap();
}

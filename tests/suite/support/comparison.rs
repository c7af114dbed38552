//! A plan of `coseg compare` on the plates.

use std::path::{Path, PathBuf};

/// A plan of two rows and two seeds on the plates, a few seconds.
pub const PLAN: &str = r#"
title = "plates"
scenes = ["plates"]
seeds = 2

[settings]
building.iterations = 20
building.random_points = 300
segmentation.iterations = 8
segmentation.pixel_share = 0.5

[[labels]]
name = "swapped"
settings.data.raw_labels = "raw"

[[rows]]
name = "vote"
variant = "vote"

[[rows]]
name = "ours, count"
variant = "ours"
settings.unprojection.normalisation = "count"
"#;

/// Writes a plan into `dir`, beside the scene `plates`.
pub fn write_plan(dir: &Path, text: &str) -> PathBuf {
    if !dir.join("plates").exists() {
        std::fs::create_dir(dir.join("plates")).expect("a folder");
        crate::support::plates::scene(&dir.join("plates"));
    }
    let path = dir.join("plan.toml");
    std::fs::write(&path, text).expect("written");
    path
}

//! Short runs of `coseg train` on a scene folder.

use crate::support::program::{succeeds, utf8};
use std::path::Path;

/// The output of `coseg train` for a short run on the scene in `data` into `run`.
pub fn short_run(data: &Path, run: &Path) -> String {
    let small = [
        "--set",
        "building.iterations=40",
        "--set",
        "building.random_points=300",
    ];
    let rows = [
        "--set",
        "segmentation.iterations=20",
        "--set",
        "segmentation.rows=raw,vote,per_gaussian",
    ];
    let train = [
        "train",
        "--data",
        utf8(data),
        "--out",
        utf8(run),
        "--seed",
        "3",
    ];
    succeeds(&[&train[..], &small, &rows].concat())
}

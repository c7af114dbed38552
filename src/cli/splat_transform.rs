//! Formats that the program splat-transform writes.

use super::program;
use coseg::data::Classes;
use coseg::error::{Error, Result};
use coseg::files::atomic;
use coseg::splat::formats::{self, glb, sog};
use coseg::splat::{Gaussians, ply};
use glam::DVec3;
use serde_json::{Map, Value};
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

const PROGRAM: &str = "splat-transform";
/// What it says where it finds no GPU, in lower case: an adapter is missing, or a device cannot be made without one.
const WITHOUT_GPU: [&str; 2] = ["adapter", "webgpugraphicsdevice"];

/// Its calls by one command.
#[derive(Default)]
pub struct SplatTransform {
    /// It found no GPU.
    without_gpu: bool,
    /// The user knows that labels are lost.
    warned: bool,
}

impl SplatTransform {
    /// Writes `gaussians` to `path`, whose name ends in `suffix`. A .glb gets the `labels`, with their names in `classes`; a .sog
    /// gets them in a file beside it.
    pub fn write(
        &mut self,
        path: &Path,
        suffix: &str,
        (gaussians, origin): (&Gaussians, DVec3),
        labels: Option<&[u16]>,
        classes: &Classes,
    ) -> Result<()> {
        let failed = |e| Error::io(path, "convert", e);
        let folder = tempfile::tempdir().map_err(failed)?;
        let [from, to] =
            ["scene.ply".to_owned(), format!("scene{suffix}")].map(|name| folder.path().join(name));
        ply::write(&from, gaussians, origin, None)?;
        self.convert(&from, &to, suffix)?;
        let mut bytes = std::fs::read(&to).map_err(failed)?;
        let scene = (gaussians, origin);
        let mut beside = None;
        if let Some(labels) = labels {
            let found = if suffix == ".glb" {
                let names = names(labels, classes);
                glb::with_labels(path, &bytes, scene, labels, names).map(|found| bytes = found)
            } else {
                sog::labels_of(&to, scene, labels).map(|found| beside = Some(found))
            };
            if let Err(error) = found {
                self.warn(&format!("{} has no labels: {error}", path.display()));
            }
        }
        atomic::write_bytes(path, &bytes)?;
        formats::write_labels_beside(path, beside)
    }

    /// Calls the program, without a GPU where it finds none.
    fn convert(&mut self, from: &Path, to: &Path, suffix: &str) -> Result<()> {
        let missing = format!(
            "it writes {suffix} files: npm install -g @playcanvas/splat-transform, or name a .ply, .compressed.ply or .spz file"
        );
        loop {
            let mut command = Command::new(PROGRAM);
            command.args(["--quiet", "--overwrite"]);
            if self.without_gpu {
                command.args(["--gpu", "cpu"]);
            }
            let mut done = program::output(command.args([from, to]), &missing)?;
            let said = String::from_utf8_lossy(&done.stderr).into_owned();
            let lower = said.to_lowercase();
            let has_no_gpu = WITHOUT_GPU.iter().any(|part| lower.contains(part));
            if done.status.success() || self.without_gpu || !has_no_gpu {
                let lines = said.lines().filter(|line| !is_stack_line(line));
                done.stderr = lines.collect::<Vec<_>>().join("\n").into_bytes();
                let failed = "write a .ply file and convert that";
                return program::expect_success(&command, &done, failed);
            }
            tracing::warn!("{PROGRAM} finds no GPU; it continues with --gpu cpu, which is slow");
            self.without_gpu = true;
        }
    }

    /// Warns, once a command.
    fn warn(&mut self, warning: &str) {
        if !std::mem::replace(&mut self.warned, true) {
            tracing::warn!("{warning}");
        }
    }
}

/// Whether a line is one of a stack trace of Node, which tells a user nothing: `at write (cli.mjs:12:34)`, `at new Promise
/// (<anonymous>)`.
fn is_stack_line(line: &str) -> bool {
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|c| c.is_ascii_digit());
    let place = line.trim().strip_prefix("at ");
    place.is_some_and(|place| {
        let mut ends = place.trim_end_matches(')').rsplit(':');
        let has_column = ends.next().is_some_and(is_number) && ends.next().is_some_and(is_number);
        has_column || place.ends_with("(<anonymous>)")
    })
}

/// The names of the classes in `labels`, by their ids as text.
fn names(labels: &[u16], classes: &Classes) -> Map<String, Value> {
    let ids: BTreeSet<u16> = labels.iter().copied().collect();
    let name = |id: u16| Some((id.to_string(), classes.known_name(id)?.into()));
    ids.into_iter().filter_map(name).collect()
}

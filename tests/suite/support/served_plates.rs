//! Plates on a page that a server fills.

use super::plates::{camera, plates};
use crate::viewer::page::viewer;
use coseg::data::{Classes, NamedCamera, Split};
use coseg::splat::Gaussians;
use coseg::viewer::{Served, Viewer};
use glam::DVec3;
use serde_json::json;
use std::net::Ipv4Addr;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;

/// What the page of the plates has.
pub struct Plates {
    pub gaussians: Gaussians,
    pub labels: Vec<u16>,
    pub classes: Classes,
    pub cameras: [NamedCamera; 1],
}

impl Plates {
    pub fn new() -> Self {
        let (gaussians, labels) = plates();
        let names = [(1, "red"), (2, "green"), (3, "blue"), (4, "wall")];
        Self {
            gaussians,
            labels,
            classes: Classes::from_names(0, names),
            cameras: [NamedCamera {
                name: "v2".into(),
                split: Split::Test,
                camera: camera(2),
            }],
        }
    }

    pub fn viewer(&self) -> Viewer<'_> {
        Viewer {
            cameras: &self.cameras,
            origin: DVec3::ZERO,
            ..viewer(&self.gaussians, Some(&self.labels), &self.classes)
        }
    }

    /// Edits of them, as the page writes them.
    pub fn edits(&self) -> String {
        let rug = json!({"name": "rug", "color": [180, 60, 40]});
        json!({"version": 1, "scene": self.viewer().sha256, "operations": [
            {"op": "assign", "gaussians": [17, 18], "object": 5, "new": rug},
            {"op": "rename", "object": 1, "name": "mat"},
            {"op": "delete_gaussians", "gaussians": [3]},
        ]})
        .to_string()
    }

    /// Serves the plates in blocks of 20 while `act` uses the address.
    pub fn served<T>(&self, edits: &Path, act: impl FnOnce(&str) -> T) -> T {
        let served = Served {
            viewer: self.viewer(),
            edits: edits.to_owned(),
            block: 20,
            listen: Ipv4Addr::LOCALHOST.into(),
        };
        let is_over = AtomicBool::new(false);
        let (sender, address) = mpsc::channel();
        std::thread::scope(|scope| {
            let started = move |address: &str| sender.send(address.to_owned()).unwrap();
            let is_over = &is_over;
            scope.spawn(move || {
                served
                    .run(started, || is_over.load(Ordering::Relaxed))
                    .unwrap()
            });
            let _end = End(is_over);
            act(&address.recv().unwrap())
        })
    }
}

/// Ends a server, after a failure too.
struct End<'a>(&'a AtomicBool);

impl Drop for End<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

//! A scene as one offline HTML page: walk through it in a browser with WebGL 2, show labels, and edit them: name, colour, merge,
//! split, delete and move objects. The page saves this as a file that `coseg edit --edits` applies ([`crate::objects::Edits`]).
//!
//! Pictures equal those of [`crate::raster::render`] except for the rounding of `packing.rs`, half floats in blending, and
//! Gaussians behind a transmittance of 1e-4, which the page blends too.

mod packing;
#[cfg(feature = "serve")]
mod served;

use crate::data::labels::palette::UNLABELLED_COLOR;
use crate::data::{Class, Classes, NamedCamera, Split};
use crate::error::{Result, bail, ensure};
use crate::files::atomic;
use crate::objects::{Object, Regions, farthest, inventory};
use crate::splat::Gaussians;
use crate::splat::camera::{Camera, level_up};
use base64::Engine;
use glam::{DMat3, DVec3};
use serde_json::{Value, json};
use std::path::Path;

#[cfg(feature = "serve")]
pub use self::served::Served;

/// Largest page that a run makes of its scene without being asked, bytes of [`Viewer::bytes`]: 1.1 million Gaussians of SH degree 3.
pub const MAX_PAGE_BYTES: usize = 128_000_000;
/// Bytes of the columns in one element, a multiple of three: browsers limit the length of a text.
const PART_BYTES: usize = 3 << 25;
/// Cosine of 3 degrees: directions that close are equal.
const MIN_COSINE: f64 = 0.9986;

/// The parts of the page's program, in order.
const SCRIPT: [&str; 25] = [
    include_str!("page/vector.js"),
    include_str!("page/scene.js"),
    include_str!("page/state.js"),
    include_str!("page/palette.js"),
    include_str!("page/edits.js"),
    include_str!("page/camera.js"),
    include_str!("page/order.js"),
    include_str!("page/projection.js"),
    include_str!("page/pick.js"),
    include_str!("page/depth.js"),
    include_str!("page/growth.js"),
    include_str!("page/selection.js"),
    include_str!("page/renderer.js"),
    include_str!("page/navigation.js"),
    include_str!("page/command.js"),
    include_str!("page/list.js"),
    include_str!("page/details.js"),
    include_str!("page/tools.js"),
    include_str!("page/gizmo.js"),
    include_str!("page/toolbar.js"),
    include_str!("page/keys.js"),
    include_str!("page/hint.js"),
    include_str!("page/panel.js"),
    include_str!("page/editor.js"),
    include_str!("page/main.js"),
];

/// The content of a page.
#[derive(Clone, Copy, Debug)]
pub struct Viewer<'a> {
    /// Heading and title.
    pub title: &'a str,
    /// The value of `--scene` in the commands that the page writes.
    pub scene: &'a str,
    /// The value of `--classes` in them, where classes.json is not beside the scene.
    pub names: Option<&'a str>,
    /// SHA-256 of the scene file, see [`crate::files::sha256`]: saved edits name it.
    pub sha256: &'a str,
    /// The scene.
    pub gaussians: &'a Gaussians,
    /// The point that was subtracted from every position of the scene, world units.
    pub origin: DVec3,
    /// One label id for each Gaussian, where the scene has labels.
    pub labels: Option<&'a [u16]>,
    /// Main components of the image features of each Gaussian, which the wand compares too; or none, see [`Regions::new`].
    pub features: &'a [[f32; 3]],
    /// Names and colours of the labels; empty where none are known.
    pub classes: &'a Classes,
    /// Views to visit, in world units. The page starts at the first held-out one, or else at the first.
    pub cameras: &'a [NamedCamera],
    /// World direction that points up; `None` is that of the cameras, or -y without them.
    pub up: Option<DVec3>,
    /// Cap of a splat's opacity at a pixel, in (0, 1].
    pub alpha_max: f64,
}

/// The objects that a page lists.
struct Listed {
    /// All Gaussians as one object.
    all: Object,
    objects: Vec<Object>,
    /// The index of each Gaussian's object.
    places: Vec<u16>,
}

impl Viewer<'_> {
    /// Writes the page to `path`; it appears complete or not at all.
    ///
    /// # Errors
    /// As [`Viewer::page`]; [`crate::Error::Io`].
    pub fn write(&self, path: &Path) -> Result<()> {
        atomic::write_bytes(path, self.page()?.as_bytes())
    }

    /// Bytes of the page that depend on `gaussians`, without the tree of regions.
    pub fn bytes(gaussians: &Gaussians, has_labels: bool) -> usize {
        packing::bytes(gaussians, has_labels).div_ceil(3) * 4
    }

    /// The page: 116 bytes for each Gaussian of SH degree 3 (111 without labels), and about 145 kB. A scene with labels has the tree of
    /// its [`Regions`] too, 16 bytes for each.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] for no Gaussian, fields or labels of another length, or an `alpha_max` or `up` out of range;
    /// [`crate::Error::NonFinite`].
    pub fn page(&self) -> Result<String> {
        let regions = self
            .labels
            .map(|_| Regions::new(self.gaussians, self.features));
        self.page_with(&regions.transpose()?.unwrap_or_default())
    }

    /// A page on which nothing is selected, as it has no tree.
    ///
    /// # Errors
    /// As [`Viewer::page`].
    #[cfg(feature = "serve")]
    pub(crate) fn picture(&self) -> Result<String> {
        self.page_with(&Regions::default())
    }

    fn page_with(&self, regions: &Regions) -> Result<String> {
        let listed = self.listed()?;
        let mut columns = packing::tree(regions);
        columns.extend(packing::places(self.gaussians, &listed.places));
        columns.extend(packing::looks(self.gaussians, 0..self.gaussians.len()));
        let mut header = self.header(&listed);
        header["regions"] = regions.parents.len().into();
        header["bytes"] = columns.len().into();
        let parts: String = columns.chunks(PART_BYTES).map(part).collect();
        Ok(shell(&header, &parts))
    }

    /// The objects of the scene, after its checks.
    fn listed(&self) -> Result<Listed> {
        self.gaussians.check(self.labels)?;
        ensure!(!self.gaussians.is_empty(), argument "gaussians"; found "none"; expected "one or more";
            help "name a scene that is not empty");
        ensure!(self.alpha_max > 0.0 && self.alpha_max <= 1.0, argument "alpha_max"; found "{}", self.alpha_max;
            expected "a number in (0, 1]"; help "choose a value in that range");
        if let Some(up) = self.up.filter(|up| up.try_normalize().is_none()) {
            bail!(argument "up"; found "{up}"; expected "a direction";
                help "name one, such as 0,0,1");
        }
        let unlabelled = vec![0; self.gaussians.len()];
        let mut all = inventory(self.gaussians, &unlabelled);
        let objects = self
            .labels
            .map_or_else(|| all.clone(), |labels| inventory(self.gaussians, labels));
        let mut places = unlabelled;
        for (place, object) in (0..=u16::MAX).zip(&objects) {
            for &row in &object.rows {
                places[row as usize] = place;
            }
        }
        Ok(Listed {
            all: all.remove(0),
            objects,
            places,
        })
    }

    /// The input of the page's program besides the columns. Positions are relative to the origin.
    fn header(&self, listed: &Listed) -> Value {
        let Listed { all, objects, .. } = listed;
        let entry = |object: &Object| {
            let (name, color) = self.look(object.id, objects.len() == 1);
            // The single entry of a scene without labels has no id.
            let id = self.labels.map(|_| object.id);
            json!({
                "id": id, "name": name, "color": color, "gaussians": object.rows.len(),
                "low": object.low, "high": object.high,
            })
        };
        let moved = |named: &NamedCamera| named.camera.moved(-self.origin);
        let cameras: Vec<Camera> = self.cameras.iter().map(moved).collect();
        let up = match self.up.and_then(DVec3::try_normalize) {
            Some(up) => up,
            None if cameras.is_empty() => DVec3::NEG_Y,
            None => upright(level_up(&cameras)),
        };
        let start = self.without_cameras(all, up);
        // Classes that no Gaussian has.
        let is_absent = |class: &&Class| {
            self.labels.is_some() && objects.binary_search_by_key(&class.id, |o| o.id).is_err()
        };
        let absent = self.classes.entries.iter().filter(is_absent);
        let absent = absent.map(|c| json!({"id": c.id, "name": c.name, "color": c.color}));
        let views = self.cameras.iter().zip(&cameras);
        let views = views.map(|(named, camera)| camera_entry(&named.name, named.split, camera));
        json!({
            "title": self.title,
            "path": self.scene,
            "names": self.names,
            "sha256": self.sha256,
            "origin": self.origin,
            "gaussians": self.gaussians.len(),
            // Regions of the tree in the page; 0 without labels, and on watched pages.
            "regions": 0,
            // Bytes of the columns in the page.
            "bytes": 0,
            // Blocks of columns that a server sends instead.
            "blocks": 0,
            // The value of --edits in the commands that the page writes.
            "edits": "edits.json",
            "degree": self.gaussians.sh_degree,
            "alpha_max": self.alpha_max,
            "up": up,
            // The box of the scene without the outermost 1 % on each side.
            "extent": {"low": all.low, "high": all.high},
            // The longest move that `coseg edit` accepts; 0 is not a limit.
            "farthest": farthest(self.gaussians),
            "start": camera_entry("", Split::Train, &start),
            "objects": objects.iter().map(entry).collect::<Vec<_>>(),
            "absent": absent.collect::<Vec<_>>(),
            "ignore": self.classes.ignore,
            "cameras": views.collect::<Vec<_>>(),
        })
    }

    /// Name and colour of an object. Unlabelled Gaussians have the colour that they have in the report.
    fn look(&self, id: u16, is_alone: bool) -> (Option<&str>, [u8; 3]) {
        if self.labels.is_none() {
            return (None, [255; 3]);
        }
        let name = self.classes.known_name(id);
        // Beside other objects of a scene without classes, label 0 may be one too.
        let is_unlabelled = is_alone || !self.classes.is_empty();
        if id == self.classes.ignore && is_unlabelled {
            (name.or(Some("unlabelled")), UNLABELLED_COLOR)
        } else {
            (name, self.classes.legend_color(id))
        }
    }

    /// The start without cameras: in front of the box `all`, a little above it.
    fn without_cameras(&self, all: &Object, up: DVec3) -> Camera {
        let longest = |scales: &[f32; 3]| scales.iter().copied().fold(f32::MIN, f32::max).exp();
        // One Gaussian has no box.
        let scales = self.gaussians.log_scales.iter().map(longest);
        let least = 8.0 * scales.fold(0.0, f32::max).min(1.0);
        let distance = (1.2 * all.low.distance(all.high)).max(f64::from(least));
        // Along z, as COLMAP's first cameras look, but level.
        let ahead = DVec3::Z
            .reject_from_normalized(up)
            .try_normalize()
            .unwrap_or(up.any_orthonormal_vector());
        let center = all.center() - distance * (ahead - 0.3 * up).normalize();
        let forward = (all.center() - center).normalize();
        let right = forward.cross(up).normalize();
        let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        Camera {
            rotation,
            center,
            ..Camera::centred([480.0; 2], [640, 480])
        }
    }
}

/// An element with a part of the columns.
fn part(bytes: &[u8]) -> String {
    let text = base64::engine::general_purpose::STANDARD.encode(bytes);
    format!("<script type=\"text/plain\" class=\"columns\">{text}</script>\n")
}

/// The axis of the world nearest to `up` if it is close: handheld cameras only give a rough direction.
fn upright(up: DVec3) -> DVec3 {
    let axes = DVec3::AXES.into_iter().flat_map(|axis| [axis, -axis]);
    axes.into_iter()
        .find(|axis| axis.dot(up) > MIN_COSINE)
        .unwrap_or(up)
}

/// A camera for the page. Its rotation is transposed: matrices are written column by column, and the page reads them row by row.
fn camera_entry(name: &str, split: Split, camera: &Camera) -> Value {
    let camera = Camera {
        rotation: camera.rotation.transpose(),
        ..camera.clone()
    };
    let mut entry = json!(camera);
    entry["name"] = name.into();
    entry["split"] = json!(split);
    entry
}

/// A page with `header` and the elements `parts`.
fn shell(header: &Value, parts: &str) -> String {
    let shaders = text(&json!({
        "splatVertex": include_str!("page/splat.vert"),
        "splatFragment": include_str!("page/splat.frag"),
        "screenVertex": include_str!("page/screen.vert"),
        "screenFragment": include_str!("page/screen.frag"),
    }));
    let (network, server) = if header["blocks"] == 0 {
        ("", "")
    } else {
        ("connect-src 'self'; ", include_str!("page/served.js"))
    };
    format!(
        include_str!("page/shell.html"),
        version = env!("CARGO_PKG_VERSION"),
        style = include_str!("page/viewer.css"),
        header = text(header),
        shaders = shaders,
        network = network,
        columns = parts,
        script = [server, &SCRIPT.concat()].concat(),
    )
}

/// JSON for a page: no text in it can end its element.
fn text(value: &Value) -> String {
    value.to_string().replace('<', "\\u003c")
}

//! What a checkpoint was made from: settings and data. A run goes on from a checkpoint only when they are its own.

use super::segmentation_inputs::Inputs;
use crate::camera::Camera;
use crate::config::{Config, Row};
use crate::data::{Scene, Split, View};
use crate::error::{Error, Result};
use crate::gaussians::Gaussians;
use crate::mask::Mask;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::path::Path;

/// Settings that change when something is measured, saved or kept, or what becomes of a row after its training, and nothing else.
const WITHOUT_EFFECT: [&str; 9] = [
    "features.cache_dir",
    "segmentation.rows",
    "segmentation.weight_cache_mb",
    "segmentation.diffusion_steps",
    "segmentation.diffusion_strength",
    "segmentation.diffusion_temperature",
    "segmentation.diffusion_neighbours",
    "eval_every",
    "checkpoint_every",
];
/// What training did before a setting existed, where its default is not that.
const BEFORE: [(&str, &str); 3] =
    [("building.absgrad", "false"), ("segmentation.least_recall", "0.0"), ("unprojection.attendance_pixels", "0.0")];
/// How label maps are rendered.
const RENDER: &str = "segmentation.render";
/// Sections that training follows from.
const SECTIONS: [&str; 6] = ["building", "raster", "segmentation", "features", "unprojection", "spatial"];
/// Settings that are paths: files may move, so their names are compared.
const PATHS: [&str; 4] = ["building.gaussians", "features.weights", "features.import_dir", "spatial.weights"];

/// Settings and data that training follows from.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    /// Value of each setting as JSON, by dotted key.
    settings: BTreeMap<String, String>,
    /// SHA-256 of the data, by name.
    data: BTreeMap<String, String>,
}

impl Provenance {
    /// Of the building stage.
    ///
    /// # Errors
    /// A photo cannot be read.
    pub(super) fn building(config: &Config, scene: &Scene) -> Result<Self> {
        let views: Vec<&View> = scene.views.iter().collect();
        let mut photos = digest_views(&views, |view, hash| {
            hash.update(view.image.pixels()?.as_raw());
            // Without a mask the digest is the one that earlier versions made.
            view.mask.iter().flat_map(Mask::words).for_each(|word| hash.update(word.to_le_bytes()));
            Ok(())
        })?;
        photos.update(bytes(scene.points.positions.as_flattened()));
        photos.update(bytes(scene.points.colors.as_flattened()));
        Ok(Self {
            settings: settings(config, &["building", "raster"]),
            data: [("photos, cameras and points", photos)].map(named).into(),
        })
    }

    /// Of a building stage that takes these Gaussians as they are.
    ///
    /// # Errors
    /// A photo cannot be read.
    pub(super) fn given(config: &Config, scene: &Scene, gaussians: &Gaussians) -> Result<Self> {
        let mut provenance = Self::building(config, scene)?;
        provenance.data.extend([named(("Gaussians", digest_gaussians(gaussians)))]);
        Ok(provenance)
    }

    /// Of a trained row of stage two.
    pub(super) fn row(row: Row, inputs: &Inputs) -> Self {
        let sections: &[&str] = match row.is_fused() {
            true => &["raster", "segmentation", "features", "unprojection", "spatial"],
            false => &["raster", "segmentation"],
        };
        let views: Vec<&View> = inputs.scene.split(Split::Train).filter(|v| v.raw.is_some()).collect();
        let Ok(mut labels) = digest_views(&views, |view, hash| {
            let ids = view.raw.iter().flat_map(|raw| raw.map().ids);
            hash.update(ids.flat_map(u16::to_le_bytes).collect::<Vec<u8>>());
            Ok::<_, Infallible>(())
        });
        inputs.scene.classes.entries.iter().for_each(|class| labels.update(class.id.to_le_bytes()));
        let data = [("Gaussians", digest_gaussians(inputs.gaussians)), ("raw labels and cameras", labels)];
        Self { settings: settings(inputs.config, sections), data: data.map(named).into() }
    }

    /// Whether anything is known; not of states that were made in memory.
    pub(super) fn is_known(&self) -> bool {
        *self != Self::default()
    }

    /// Refuses a checkpoint, `stored` in `file`, that was made from other settings or data than these. A setting that it does
    /// not mention did not exist when it was written: it counts as what was done then, the default but for [`BEFORE`]. What
    /// training is `finished` may be scored by another rule of rendering, unless a rate was chosen by such scores.
    ///
    /// # Errors
    /// [`Error::Config`] naming the first setting that differs; [`Error::Input`] naming the data.
    pub(super) fn check(&self, stored: &Self, finished: bool, file: &Path) -> Result<()> {
        let none = || "nothing".to_owned();
        let mut defaults = settings(&Config::default(), &SECTIONS);
        defaults.extend(BEFORE.map(|(key, value)| (key.to_owned(), value.to_owned())));
        let then = |key: &str| stored.settings.get(key).or_else(|| defaults.get(key));
        let keys = self.settings.keys().chain(stored.settings.keys());
        let tried = self.settings.get("segmentation.lr_trials").is_some_and(|trials| trials != "[]");
        let keys = keys.filter(|key| *key != RENDER || tried || !finished);
        if let Some(key) = keys.into_iter().find(|key| self.settings.get(*key) != then(key)) {
            let found = self.settings.get(key).cloned().unwrap_or_else(none);
            let then = then(key).cloned().unwrap_or_else(none);
            let expected = format!("{then}, as when {} was written", file.display());
            let mend = "resume with that value, or train with this one into another folder";
            return Err(Error::config(key, found, expected, mend));
        }
        let names = self.data.keys().chain(stored.data.keys());
        if let Some(name) = names.into_iter().find(|name| self.data.get(*name) != stored.data.get(*name)) {
            let mend = "resume with the data, the data.max_side and the data.masks that the run began with, or train into another folder";
            return Err(Error::input(file, name, "those of other data", "those that the run has now", mend));
        }
        Ok(())
    }

    /// Whether label maps are rendered by the same rule as in `stored`.
    pub(super) fn renders_as(&self, stored: &Self) -> bool {
        let defaults = settings(&Config::default(), &SECTIONS);
        self.settings.get(RENDER) == stored.settings.get(RENDER).or_else(|| defaults.get(RENDER))
    }
}

/// The settings of some sections, and the seed.
fn settings(config: &Config, sections: &[&str]) -> BTreeMap<String, String> {
    // Settings are plain data: they always have a JSON form. By way of text, so that an f32 keeps its short form.
    let text = serde_json::to_string(config).unwrap_or_default();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    let mut out = BTreeMap::from([("seed".to_owned(), config.seed.to_string())]);
    for section in sections {
        collect(section, &json[*section], &mut out);
    }
    out
}

/// Adds the values of a section, and of those within it.
fn collect(section: &str, values: &serde_json::Value, out: &mut BTreeMap<String, String>) {
    for (name, value) in values.as_object().into_iter().flatten() {
        let key = format!("{section}.{name}");
        if WITHOUT_EFFECT.iter().any(|skipped| *skipped == key || skipped == name) {
            continue;
        }
        if value.is_object() {
            collect(&key, value, out);
            continue;
        }
        let file = value.as_str().filter(|_| PATHS.contains(&&*key)).and_then(|path| Path::new(path).file_name());
        out.insert(key, file.map_or_else(|| value.to_string(), |file| file.to_string_lossy().into_owned()));
    }
}

fn named((name, hash): (&str, Sha256)) -> (String, String) {
    (name.to_owned(), format!("{:x}", hash.finalize()))
}

/// Name, split, camera and some bytes of each view.
fn digest_views<E: Send>(
    views: &[&View],
    content: impl Fn(&View, &mut Sha256) -> Result<(), E> + Sync,
) -> Result<Sha256, E> {
    let one = |view: &&View| {
        let Camera { rotation, center, fx, fy, cx, cy, width, height } = &view.camera;
        let mut hash = Sha256::new();
        hash.update(format!("{} {:?} {width} {height}\n", view.name, view.split));
        let numbers = rotation.to_cols_array().into_iter().chain(center.to_array()).chain([*fx, *fy, *cx, *cy]);
        numbers.for_each(|v| hash.update(v.to_le_bytes()));
        content(view, &mut hash)?;
        Ok(hash.finalize())
    };
    let parts = views.par_iter().map(one).collect::<Result<Vec<_>, E>>()?;
    let mut hash = Sha256::new();
    parts.iter().for_each(|part| hash.update(part));
    Ok(hash)
}

fn digest_gaussians(g: &Gaussians) -> Sha256 {
    let mut hash = Sha256::new();
    hash.update(format!("{} {}\n", g.len(), g.sh_degree));
    let parts =
        [g.means.as_flattened(), g.log_scales.as_flattened(), g.rotations.as_flattened(), &g.opacity_logits, &g.sh];
    parts.into_iter().for_each(|part| hash.update(bytes(part)));
    hash
}

fn bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

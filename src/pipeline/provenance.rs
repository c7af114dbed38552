//! What a checkpoint was made from: settings and data. A run goes on from a checkpoint only when they are its own.

use super::segmentation_inputs::Inputs;
use crate::config::{Association, Config, Variant};
use crate::data::mask::Mask;
use crate::data::{Scene, Split, View};
use crate::error::{Error, Result};
use crate::segmentation::encoder::spatial_digest;
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::path::Path;

/// Settings that change when something is measured, saved or kept, or what becomes of a row after its training, and nothing
/// else.
const WITHOUT_EFFECT: [&str; 7] = [
    "data.raw_labels_note",
    "data.decoded_mb",
    "features.cache_dir",
    "segmentation.rows",
    "segmentation.weight_cache_mb",
    "eval_every",
    "checkpoint_every",
];
const SEED: &str = "seed";
/// How label maps are rendered.
const RENDER: &str = "segmentation.render";
/// Sections that training follows from.
const SECTIONS: [&str; 6] = [
    "building",
    "raster",
    "segmentation",
    "features",
    "unprojection",
    "spatial",
];
/// Settings that are paths: files may move, so their names are compared.
const PATHS: [&str; 5] = [
    "data.dir",
    "building.gaussians",
    "features.weights",
    "features.source.import",
    "spatial.source.pretrained",
];
/// Settings of `data` that only raw labels follow from.
const OF_RAW_LABELS: [&str; 4] = [
    "data.raw_labels",
    "data.raw_format",
    "data.association",
    "data.scannet_classes",
];
/// Settings that say which Gaussians stage two is left with.
const OF_PRUNING: [&str; 3] = [
    "unprojection.attendance",
    "unprojection.attendance_pixels",
    "unprojection.resolution",
];
/// The scene folder, whose name explains other data only where nothing else does.
const FOLDER: &str = "data.dir";

/// Names of data: what stage one is shown, photos by their files.
const SHOWN: &str = "photos, masks, cameras and points";
/// The same with the pixels of all photos, as earlier versions had it.
const PIXELS: &str = "photos, cameras and points";
const GAUSSIANS: &str = "Gaussians";
const LABELS: &str = "raw labels and cameras";
const IMAGE_FEATURES: &str = "image features";
const ENCODER: &str = "point encoder";
/// Data that earlier versions did not record: where a checkpoint has none of it, it may have been this.
const LATER: [&str; 2] = [IMAGE_FEATURES, ENCODER];

/// Settings and data that training follows from.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    /// Value of each setting as JSON, by dotted key.
    settings: BTreeMap<String, String>,
    /// SHA-256 of the data, by name.
    data: BTreeMap<String, String>,
    /// Settings that the data follows from, as `settings`. They are no obstacle by themselves, as other ones may stand for the
    /// same data; where it is another, they say why. Earlier versions had none.
    #[serde(default)]
    origin: BTreeMap<String, String>,
}

impl Provenance {
    /// Of the building stage.
    pub(crate) fn building(config: &Config, scene: &Scene) -> Self {
        let Ok(shown) = digest_shown(scene, |view, hash| {
            view.image.identify(hash);
            Ok::<_, Infallible>(())
        });
        let mut origin = origin(config, &["data"]);
        origin.retain(|key, _| !OF_RAW_LABELS.contains(&&**key));
        Self {
            settings: settings(config, &["building", "raster"]),
            data: [(SHOWN, shown)].map(named).into(),
            origin,
        }
    }

    /// Of a building stage that takes these Gaussians as they are.
    pub(crate) fn given(config: &Config, scene: &Scene, gaussians: &Gaussians) -> Self {
        let mut provenance = Self::building(config, scene);
        provenance
            .data
            .extend([named((GAUSSIANS, digest_gaussians(gaussians)))]);
        provenance
    }

    /// Of a trained row of stage two.
    ///
    /// # Errors
    /// [`Error::Io`] when the file of the point encoder's weights cannot be read.
    pub(crate) fn row(row: Variant, inputs: &Inputs) -> Result<Self> {
        let Inputs { scene, config, .. } = inputs;
        let sections: &[&str] = match row.trains_decoder() {
            true => &[
                "raster",
                "segmentation",
                "features",
                "unprojection",
                "spatial",
            ],
            false => &["raster", "segmentation"],
        };
        let views: Vec<&View> = scene
            .split(Split::Train)
            .filter(|v| v.raw.is_some())
            .collect();
        let Ok(mut labels) = digest_views(&views, |view, hash| {
            let ids = view.raw.iter().flat_map(|raw| raw.map().ids);
            hash.update(ids.flat_map(u16::to_le_bytes).collect::<Vec<u8>>());
            Ok::<_, Infallible>(())
        });
        scene
            .classes
            .entries
            .iter()
            .for_each(|class| labels.update(class.id.to_le_bytes()));
        let mut data = BTreeMap::from(
            [
                (GAUSSIANS, digest_gaussians(inputs.gaussians)),
                (LABELS, labels),
            ]
            .map(named),
        );
        // By what they are made from: on a GPU their sums need not have the same bits each time.
        if let (true, Some(seen)) = (
            row.trains_decoder() && row != Variant::NoImageFeatures,
            &inputs.seen,
        ) {
            data.insert(IMAGE_FEATURES.to_owned(), seen.content.clone());
        }
        if row.trains_decoder() && !matches!(row, Variant::NoSpatial | Variant::RandomSpatial) {
            data.extend(
                spatial_digest(&config.spatial)?.map(|digest| (ENCODER.to_owned(), digest)),
            );
        }
        let mut origin = match config.data.association {
            Association::None => origin(config, &["data", "unprojection"]),
            Association::Gaussians => origin(config, &["data", "unprojection", "association"]),
        };
        origin.retain(|key, _| !key.starts_with("unprojection.") || OF_PRUNING.contains(&&**key));
        Ok(Self {
            settings: settings(config, sections),
            data,
            origin,
        })
    }

    /// Whether anything is known; not of states that were made in memory.
    pub(crate) fn is_known(&self) -> bool {
        *self != Self::default()
    }

    /// Refuses a checkpoint, `stored` in `file`, that was made from other settings or data than these. A setting that it does
    /// not mention did not exist when it was written: it counts as what was done then, the default. What
    /// training is `finished` may be scored by another rule of rendering.
    ///
    /// # Errors
    /// [`Error::Config`] naming the first setting that differs, or the one that other data follows from; [`Error::Input`]
    /// naming the data.
    pub(crate) fn check(&self, stored: &Self, finished: bool, file: &Path) -> Result<()> {
        let none = || "nothing".to_owned();
        let defaults = settings(&Config::default(), &SECTIONS);
        let then = |key: &str| stored.settings.get(key).or_else(|| defaults.get(key));
        let keys = self.settings.keys().chain(stored.settings.keys());
        let keys = keys.filter(|key| *key != RENDER || !finished);
        if let Some(key) = keys
            .into_iter()
            .find(|key| self.settings.get(*key) != then(key))
        {
            let found = self.settings.get(key).cloned().unwrap_or_else(none);
            let then = then(key).cloned().unwrap_or_else(none);
            let expected = format!("{then}, as when {} was written", file.display());
            let help = "resume with that value, or train with this one into another folder";
            return Err(Error::config(key, found, expected, help));
        }
        let lacking = |name: &str| LATER.contains(&name) && !stored.data.contains_key(name);
        let differs =
            |name: &&String| self.data.get(*name) != stored.data.get(*name) && !lacking(name);
        let names = self.data.keys().chain(stored.data.keys()).filter(differs);
        // Given Gaussians are placed among the cameras: where these are others, so are they.
        match names.min_by_key(|name| ![SHOWN, PIXELS].contains(&&***name)) {
            Some(name) => Err(self.other_data(name, stored, file)),
            None => Ok(()),
        }
    }

    /// [`Provenance::check`] of a building stage of `scene`, which another version may have begun.
    ///
    /// # Errors
    /// As [`Provenance::check`]; for a checkpoint of a version that compared pixels those of [`crate::data::Photo::pixels`].
    pub(crate) fn check_built(&self, stored: &Self, scene: &Scene, file: &Path) -> Result<()> {
        if !stored.data.contains_key(PIXELS) {
            return self.check(stored, false, file);
        }
        let pixels = digest_shown(scene, |view, hash| {
            hash.update(view.image.pixels()?.as_raw());
            Ok::<_, Error>(())
        })?;
        let mut then = self.clone();
        then.data.remove(SHOWN);
        then.data.extend([named((PIXELS, pixels))]);
        then.check(stored, false, file)
    }

    /// The refusal of other data of this name: by the setting that made it another, where one is known to differ.
    fn other_data(&self, name: &str, stored: &Self, file: &Path) -> Error {
        let explains = |key: &&String| match name {
            GAUSSIANS => OF_PRUNING.contains(&&***key),
            SHOWN | PIXELS | LABELS => !OF_PRUNING.contains(&&***key),
            _ => false,
        };
        let mut keys: Vec<&String> = self.origin.keys().filter(explains).collect();
        keys.sort_by_key(|key| *key == FOLDER);
        for key in keys {
            if let (Some(found), Some(then)) = (self.origin.get(key), stored.origin.get(key))
                && found != then
            {
                let expected = format!("{then}, as when {} was written", file.display());
                let help = "resume with that value, or train with this one into another folder";
                return Error::config(key, found, expected, help);
            }
        }
        let begun = match name {
            GAUSSIANS => {
                "the Gaussians and the unprojection.attendance that it began with (earlier versions pruned nothing, as with 0, \
                 where no row had a decoder)"
            }
            IMAGE_FEATURES => {
                "the weights, or the maps in features.source.import, that it began with"
            }
            ENCODER => "the weights in spatial.source.pretrained that it began with",
            _ if stored.origin.is_empty() => {
                "the files and the settings of data and association that it began with"
            }
            _ => "the files that it began with, as its settings of data are the same",
        };
        let help = format!("resume with {begun}, or train into another folder");
        Error::input(
            file,
            name,
            "those of other data",
            "those that the run has now",
            help,
        )
    }

    /// Whether label maps are rendered by the same rule as in `stored`.
    pub(crate) fn renders_as(&self, stored: &Self) -> bool {
        let defaults = settings(&Config::default(), &SECTIONS);
        self.settings.get(RENDER) == stored.settings.get(RENDER).or_else(|| defaults.get(RENDER))
    }
}

/// The settings of some sections, and the seed.
fn settings(config: &Config, sections: &[&str]) -> BTreeMap<String, String> {
    // Settings are plain data: they always have a JSON form. By way of text, so that an f32 keeps its short form.
    let text = serde_json::to_string(config).unwrap_or_default();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    let mut out = BTreeMap::from([(SEED.to_owned(), config.seed.to_string())]);
    for section in sections {
        collect(section, &json[*section], &mut out);
    }
    out
}

/// The settings of some sections.
fn origin(config: &Config, sections: &[&str]) -> BTreeMap<String, String> {
    let mut origin = settings(config, sections);
    origin.remove(SEED);
    origin
}

/// Adds the values of a section, and of those within it.
fn collect(section: &str, values: &serde_json::Value, out: &mut BTreeMap<String, String>) {
    for (name, value) in values.as_object().into_iter().flatten() {
        let key = format!("{section}.{name}");
        if WITHOUT_EFFECT
            .iter()
            .any(|skipped| *skipped == key || skipped == name)
        {
            continue;
        }
        if value.is_object() {
            collect(&key, value, out);
            continue;
        }
        let file = value
            .as_str()
            .filter(|_| PATHS.contains(&&*key))
            .and_then(|path| Path::new(path).file_name());
        out.insert(
            key,
            file.map_or_else(
                || value.to_string(),
                |file| file.to_string_lossy().into_owned(),
            ),
        );
    }
}

fn named((name, hash): (&str, Sha256)) -> (String, String) {
    (name.to_owned(), format!("{:x}", hash.finalize()))
}

/// Points, and of all views name, split, camera, mask and what `photo` says of it.
fn digest_shown<E: Send>(
    scene: &Scene,
    photo: impl Fn(&View, &mut Sha256) -> Result<(), E> + Sync,
) -> Result<Sha256, E> {
    let views: Vec<&View> = scene.views.iter().collect();
    let mut shown = digest_views(&views, |view, hash| {
        photo(view, hash)?;
        // Without a mask the digest is the one that versions made that knew none.
        view.mask
            .iter()
            .flat_map(Mask::words)
            .for_each(|word| hash.update(word.to_le_bytes()));
        Ok(())
    })?;
    shown.update(bytes(scene.points.positions.as_flattened()));
    shown.update(bytes(scene.points.colors.as_flattened()));
    Ok(shown)
}

/// Name, split, camera and some bytes of each view.
fn digest_views<E: Send>(
    views: &[&View],
    content: impl Fn(&View, &mut Sha256) -> Result<(), E> + Sync,
) -> Result<Sha256, E> {
    let one = |view: &&View| {
        let Camera {
            rotation,
            center,
            fx,
            fy,
            cx,
            cy,
            width,
            height,
        } = &view.camera;
        let mut hash = Sha256::new();
        hash.update(format!("{} {:?} {width} {height}\n", view.name, view.split));
        let numbers = rotation
            .to_cols_array()
            .into_iter()
            .chain(center.to_array())
            .chain([*fx, *fy, *cx, *cy]);
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
    let parts = [
        g.means.as_flattened(),
        g.log_scales.as_flattened(),
        g.rotations.as_flattened(),
        &g.opacity_logits,
        &g.sh,
    ];
    parts.into_iter().for_each(|part| hash.update(bytes(part)));
    hash
}

fn bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

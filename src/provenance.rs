//! The settings and data that a checkpoint depends on. A run resumes only a checkpoint with the same ones.

use crate::checkpoint::Scalar;
use crate::config::{Config, LabelSource};
use crate::data::{LabelRuns, Scene, Split, View};
use crate::error::{Result, bail, in_order, invalid};
use crate::splat::Gaussians;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::path::Path;

/// Sections that a stage reads, of [`Config`] as JSON.
const STAGE_ONE: &[&str] = &["seed", "building", "raster"];
const PER_GAUSSIAN: &[&str] = &["seed", "raster", "pooling", "segmentation"];
const DECODER: &[&str] = &[
    "seed",
    "raster",
    "pooling",
    "segmentation",
    "features",
    "unprojection",
    "spatial",
];

/// JSON text of settings by dotted key.
type Values = BTreeMap<String, String>;

/// A kind of data that training depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Data {
    /// The input of stage one. First, since the Gaussians depend on the cameras too.
    Photos,
    Gaussians,
    Labels,
    ImageFeatures,
    PointEncoder,
    /// Labels of the held-out views, which scores compare with.
    HeldOut,
}

impl Data {
    /// Its name, and what to resume with, where this data differs and no setting explains it.
    fn words(self) -> [&'static str; 2] {
        const FILES: &str = "the original files, as the settings of data are the same";
        match self {
            Self::Photos => ["photos, masks, cameras and points", FILES],
            Self::Gaussians => ["Gaussians", "the original Gaussians"],
            Self::Labels => ["raw labels and cameras", FILES],
            Self::ImageFeatures => [
                "image features",
                "the original weights, or maps in features.source.import",
            ],
            Self::PointEncoder => [
                "point encoder",
                "the original weights in spatial.source.pretrained",
            ],
            Self::HeldOut => ["labels of held-out views", FILES],
        }
    }
}

/// A digest of data, and the settings that it depends on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Origin {
    /// SHA-256.
    digest: String,
    /// They explain a different digest. Other settings with the same digest are accepted.
    settings: Values,
}

/// The settings and data that training depends on. Empty for a state that was made in memory.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    settings: Values,
    data: BTreeMap<Data, Origin>,
    /// How label maps are rendered, in stage two. It affects held-out scores, not training.
    render: Option<LabelSource>,
}

impl Provenance {
    /// The provenance of stage one.
    pub fn stage_one(config: &Config, scene: &Scene) -> Self {
        let mut without_labels = config.clone();
        without_labels.data.raw_labels = String::new();
        without_labels.data.raw_format = Default::default();
        without_labels.data.association = Default::default();
        without_labels.data.labels_by = Default::default();
        without_labels.data.scannet_classes = Default::default();
        let provenance = Self {
            settings: values(config, STAGE_ONE),
            ..Self::default()
        };
        let settings = values(&without_labels, &["data"]);
        provenance.with(Data::Photos, digest_photos(scene), settings)
    }

    /// The provenance of a stage one that takes `gaussians` as they are.
    pub fn initial_scene(config: &Config, scene: &Scene, gaussians: &Gaussians) -> Self {
        let digest = digest_gaussians(gaussians);
        Self::stage_one(config, scene).with(Data::Gaussians, digest, Values::new())
    }

    /// The provenance of a variant of stage two; `of_features`: it learns from features of the Gaussians.
    ///
    /// # Errors
    /// [`crate::Error::Io`] when a file of scores cannot be read.
    pub fn stage_two(
        config: &Config,
        scene: &Scene,
        gaussians: &Gaussians,
        of_features: bool,
    ) -> Result<Self> {
        let sections = if of_features { DECODER } else { PER_GAUSSIAN };
        let mut pruning = config.clone();
        pruning.unprojection.normalisation = Default::default();
        let provenance = Self {
            settings: values(config, sections),
            render: Some(config.segmentation.render),
            ..Self::default()
        };
        let pruning = values(&pruning, &["unprojection"]);
        let labels = digest_labels(scene)?;
        Ok(provenance
            .with(Data::Gaussians, digest_gaussians(gaussians), pruning)
            .with(Data::Labels, labels, values(config, &["data"])))
    }

    /// The provenance of the held-out scores of a variant: that of its training, the photos, and the labels of held-out views.
    ///
    /// # Errors
    /// As [`Provenance::stage_two`].
    pub fn scores(
        config: &Config,
        scene: &Scene,
        gaussians: &Gaussians,
        trains_decoder: bool,
    ) -> Result<Self> {
        let settings = || values(config, &["data"]);
        let of_training = Self::stage_two(config, scene, gaussians, trains_decoder)?;
        Ok(of_training
            .with(Data::Photos, digest_photos(scene), settings())
            .with(Data::HeldOut, digest_held_out(scene), settings()))
    }

    /// Adds image features by what they are made from: on a GPU their sums need not have the same bits each time.
    pub fn with_image_features(self, content: &str) -> Self {
        let digest = Sha256::new().chain_update(content);
        self.with(Data::ImageFeatures, digest, Values::new())
    }

    /// Adds the point encoder by the digest of its weights.
    pub fn with_point_encoder(self, weights: &str) -> Self {
        let digest = Sha256::new().chain_update(weights);
        self.with(Data::PointEncoder, digest, Values::new())
    }

    fn with(mut self, data: Data, digest: Sha256, settings: Values) -> Self {
        let digest = format!("{:x}", digest.finalize());
        self.data.insert(data, Origin { digest, settings });
        self
    }

    /// Whether anything is known.
    pub fn is_known(&self) -> bool {
        *self != Self::default()
    }

    /// Refuses a `file` with the provenance `stored` of other settings or data. A `finished` training may be scored by another rule of
    /// rendering. The errors give `help`, or say how to resume.
    ///
    /// # Errors
    /// [`crate::Error::Config`] naming the first setting that differs, or the one that explains other data; [`crate::Error::Input`] naming
    /// the data.
    pub fn check(
        &self,
        stored: &Self,
        finished: bool,
        file: &Path,
        help: Option<&str>,
    ) -> Result<()> {
        let other_value = |key: &str, now: &str, then: &str| {
            let resume = "resume with that value, or train with this one into another folder";
            invalid!(setting "{key}"; found "{now}"; expected "{then}, as when {} was written", file.display();
                help "{}", help.unwrap_or(resume))
        };
        let check_settings = |now: &Values, then: &Values| match first_difference(now, then) {
            Some(key) => {
                let value = |values: &Values| values.get(key).cloned().unwrap_or("nothing".into());
                Err(other_value(key, &value(now), &value(then)))
            }
            None => Ok(()),
        };
        check_settings(&self.settings, &stored.settings)?;
        if !finished && self.render != stored.render {
            let text = |render| serde_json::json!(render).to_string();
            let (now, then) = (text(self.render), text(stored.render));
            return Err(other_value("segmentation.render", &now, &then));
        }
        let kinds = self.data.keys().chain(stored.data.keys());
        let digest = |of: &Self, data| of.data.get(data).map(|origin| origin.digest.clone());
        let Some(data) = kinds
            .filter(|data| digest(self, data) != digest(stored, data))
            .min()
        else {
            return Ok(());
        };
        if let (Some(now), Some(then)) = (self.data.get(data), stored.data.get(data)) {
            check_settings(&now.settings, &then.settings)?;
        }
        let [name, original] = data.words();
        let labels_alone = match data {
            Data::Labels => {
                "; `coseg train --data DIR --scene RUN --out NEW` keeps the Gaussians and trains the labels alone"
            }
            _ => "",
        };
        let resume = format!("resume with {original}, or train into another folder{labels_alone}");
        bail!(file, "{name}"; found "those of other data"; expected "those of this run";
            help "{}", help.unwrap_or(&resume))
    }

    /// Whether label maps are rendered by the same rule as in `stored`.
    pub fn renders_as(&self, stored: &Self) -> bool {
        self.render == stored.render
    }
}

/// The first key with different values. The scene folder does not count: a scene that was moved may have another name.
fn first_difference<'a>(now: &'a Values, then: &'a Values) -> Option<&'a String> {
    now.keys()
        .chain(then.keys())
        .filter(|key| *key != "data.dir" && now.get(*key) != then.get(*key))
        .min()
}

/// The settings of some sections, without those that do not affect results. Paths count by their file names, as files may move.
fn values(config: &Config, sections: &[&str]) -> Values {
    let mut config = config.clone();
    config.data.raw_labels_note = String::new();
    config.building.eval_every = 0;
    config.features.cache_dir = None;
    config.segmentation.rows = None;
    config.segmentation.render = LabelSource::Labels;
    config.segmentation.eval_every = 0;
    for path in config.paths() {
        *path = path.file_name().unwrap_or_default().into();
    }
    // Settings are plain data and always have a JSON form. Through text an f32 keeps its short form.
    let text = serde_json::to_string(&config).unwrap_or_default();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    let mut out = Values::new();
    for &section in sections {
        if let Some(fields) = json[section].as_object() {
            let fields = fields.iter();
            out.extend(fields.map(|(name, v)| (format!("{section}.{name}"), v.to_string())));
        } else {
            out.insert(section.to_owned(), json[section].to_string());
        }
    }
    out
}

/// Points, and of every view its name, split, camera, mask and photo.
fn digest_photos(scene: &Scene) -> Sha256 {
    let parts = scene.views.par_iter().map(|view| {
        digest_view(view, |hash| {
            view.image.identify(hash);
            digest_mask(view, hash);
        })
    });
    let mut digest = joined(&parts.collect::<Vec<_>>());
    digest.update(f32::to_bytes(scene.points.positions.as_flattened()));
    digest.update(f32::to_bytes(scene.points.colors.as_flattened()));
    digest
}

/// The pixels that the mask of a view uses, where it has one.
pub(crate) fn digest_mask(view: &View, hash: &mut Sha256) {
    let mask = view.mask.iter().flat_map(|mask| mask.words());
    mask.for_each(|word| hash.update(word.to_le_bytes()));
}

/// Class ids, and of every training view with raw labels its name, split, camera, labels, corrections and scores.
fn digest_labels(scene: &Scene) -> Result<Sha256> {
    let views: Vec<&View> = scene.labelled().collect();
    let parts = views.par_iter().map(|view| {
        let scores = view.scores.as_ref();
        let scores = scores.map(|scores| crate::files::read(scores.file()));
        let scores = scores.transpose()?;
        Ok(digest_view(view, |hash| {
            digest_map(view.raw.as_ref(), hash);
            digest_map(view.corrected.as_ref(), hash);
            hash.update(scores.unwrap_or_default());
        }))
    });
    let mut digest = joined(&in_order(parts)?);
    let classes = scene.classes.entries.iter();
    classes.for_each(|class| digest.update(class.id.to_le_bytes()));
    Ok(digest)
}

/// Digest of the held-out views: name, split, camera, true and raw labels, and instances of each.
fn digest_held_out(scene: &Scene) -> Sha256 {
    let views: Vec<&View> = scene.split(Split::Test).collect();
    let parts = views.par_iter().map(|view| {
        digest_view(view, |hash| {
            for map in [&view.truth, &view.raw, &view.instances] {
                hash.update([u8::from(map.is_some())]);
                digest_map(map.as_ref(), hash);
            }
        })
    });
    joined(&parts.collect::<Vec<_>>())
}

/// The ids of a map, if any.
fn digest_map(map: Option<&LabelRuns>, hash: &mut Sha256) {
    let ids = map.into_iter().flat_map(|runs| runs.map().ids);
    hash.update(ids.flat_map(u16::to_le_bytes).collect::<Vec<u8>>());
}

/// SHA-256 of the name, split and camera of a view, and of what `content` adds.
fn digest_view(view: &View, content: impl FnOnce(&mut Sha256)) -> [u8; 32] {
    let mut hash = Sha256::new();
    let name = &view.name;
    let split = view.split;
    let camera = &view.camera;
    // The debug form of a number has all of its digits.
    hash.update(format!("{name} {split:?} {camera:?}\n"));
    content(&mut hash);
    hash.finalize().into()
}

/// The digest of digests.
fn joined(parts: &[[u8; 32]]) -> Sha256 {
    Sha256::new().chain_update(parts.as_flattened())
}

/// All parameters of `g`.
pub(crate) fn digest_gaussians(g: &Gaussians) -> Sha256 {
    let mut hash = Sha256::new();
    hash.update(format!("{} {}\n", g.len(), g.sh_degree));
    let parts = [
        g.means.as_flattened(),
        g.log_scales.as_flattened(),
        g.rotations.as_flattened(),
        &g.opacity_logits,
        &g.sh,
    ];
    for part in parts {
        hash.update(f32::to_bytes(part));
    }
    hash
}

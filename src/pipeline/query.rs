//! Features of other programs on Gaussians, all channels of them, compared with phrases.

use crate::checkpoint::Checkpoint;
use crate::config::{Config, Normalisation};
use crate::data::{Scene, Split, View};
use crate::error::{Error, Result, bail, ensure};
use crate::features::{FeatureMap, import};
use crate::files::own;
use crate::objects::Similarities;
use crate::provenance::{digest_gaussians, digest_mask};
use crate::raster::Settings;
use crate::segmentation::unprojection::LiftedViews;
use crate::splat::Gaussians;
use burn::tensor::Device;
use sha2::Digest;
use std::ops::Range;
use std::path::Path;

/// Kind of the cached files, and part of their names. Raise its number when the arithmetic changes.
const KIND: &str = "lifted features 2";

/// Maps of the training views of a scene, in files of a folder, to be lifted onto Gaussians.
pub struct LiftedMaps<'a> {
    /// The folder of the maps, see [`crate::config::FeatureSource::Import`]. One to four scales are read.
    pub folder: &'a Path,
    /// The views, relative to the origin of the Gaussians.
    pub scene: &'a Scene,
    /// What the maps are lifted onto.
    pub gaussians: &'a Gaussians,
    /// Sections `unprojection` and `raster`.
    pub config: &'a Config,
    /// Where what was lifted is kept for the next query.
    pub cache: &'a Path,
    /// Where to compute.
    pub device: &'a Device,
    /// Lifted features that are in memory at once, bytes. More channels come in turns, for which the maps are read again.
    pub most_bytes: usize,
}

impl LiftedMaps<'_> {
    /// Similarities of the lifted features of each scale to `phrases`, which have as many channels as the maps. Each cell of a map
    /// counts by its direction alone. Calls `advance` with the parts done and all parts.
    ///
    /// # Errors
    /// [`Error::Argument`] for a scene without training views; [`Error::Input`] and [`Error::NonFinite`] for maps that cannot be used,
    /// or have other channels than the phrases; those of [`LiftedViews::add`]. A cache that cannot be written only gives a warning.
    pub fn similarities(
        &self,
        phrases: &[Vec<f32>],
        advance: &mut dyn FnMut(usize, usize),
    ) -> Result<Vec<Similarities>> {
        let views: Vec<&View> = self.scene.split(Split::Train).collect();
        let Some(first) = views.first() else {
            bail!(argument "data"; found "no training view in {}", self.scene.name; expected "one or more";
                help "correct the splits");
        };
        let channels = phrases.first().map_or(0, Vec::len);
        let scales = self.maps(first, channels, None)?.len();
        let key = self.key(&views)?;
        let row = 4 * scales * self.gaussians.len().max(1);
        let part = (self.most_bytes / row).clamp(1, channels.max(1));
        let starts: Vec<usize> = (0..channels).step_by(part).collect();
        let all = starts.len() * views.len();
        let mut similarities = vec![Similarities::new(self.gaussians.len(), phrases.len()); scales];
        for (turn, &start) in starts.iter().enumerate() {
            let range = start..(start + part).min(channels);
            let file = self.cache.join(format!("{key}_{start:04}.safetensors"));
            let extents = (scales, range.len());
            let known = file.exists().then(|| self.read(&file, extents));
            if let Some(Err(error)) = &known {
                tracing::warn!("features are lifted again: {error}");
            }
            let (lifted, is_new) = match known {
                Some(Ok(lifted)) => (lifted, false),
                _ => {
                    let done = turn * views.len();
                    let mut advance = |view| advance(done + view, all);
                    let lifted = self.lift(&views, (scales, channels), &range, &mut advance)?;
                    (lifted, true)
                }
            };
            let phrases: Vec<&[f32]> = phrases.iter().map(|p| &p[range.clone()]).collect();
            for (similarities, features) in similarities.iter_mut().zip(&lifted) {
                similarities.add(features, &phrases)?;
            }
            if is_new && let Err(error) = self.write(&file, lifted, range.len()) {
                tracing::warn!("lifted features are not kept: {error}");
            }
            advance((turn + 1) * views.len(), all);
        }
        Ok(similarities)
    }

    /// The channels `range` of each scale, `[N, range]`.
    fn lift(
        &self,
        views: &[&View],
        (scales, channels): (usize, usize),
        range: &Range<usize>,
        advance: &mut dyn FnMut(usize),
    ) -> Result<Vec<Vec<f32>>> {
        let settings = Settings::from(&self.config.raster);
        let parts = vec![range.len(); scales];
        let normalisation = Normalisation::Weight;
        let mut lifted = LiftedViews::new(self.gaussians, &parts, normalisation, self.device);
        for (number, view) in views.iter().enumerate() {
            let maps = self.maps(view, channels, Some(scales))?;
            let maps: Vec<FeatureMap> = maps.iter().map(|map| directions(map, range)).collect();
            let mask = view.mask.as_ref();
            lifted.add(&view.camera, &maps, mask, &settings)?;
            advance(number + 1);
        }
        lifted.features()
    }

    /// The maps of `view`, which must have `channels` channels at each scale, and `scales` scales if that is known.
    fn maps(&self, view: &View, channels: usize, scales: Option<usize>) -> Result<Vec<FeatureMap>> {
        let maps = import::read_found(self.folder, &view.name)?;
        let field = format!("view {}", view.name);
        if let Some(scales) = scales {
            ensure!(maps.len() == scales, self.folder, "{field}"; found "{} scales", maps.len();
                expected "{scales}, as the first view has"; help "write the maps of all views alike");
        }
        for (n, map) in (1..).zip(&maps) {
            ensure!(map.channels == channels, self.folder, "{field}, scale {n}"; found "{} channels", map.channels;
                expected "{channels}, as the text embeddings have";
                help "give the weights of the text encoder that belongs to the image encoder of the maps");
        }
        Ok(maps)
    }

    /// What the lifted features depend on. Maps count by name, length and time of their files: reading them takes as long as lifting.
    fn key(&self, views: &[&View]) -> Result<String> {
        let mut hash = digest_gaussians(self.gaussians);
        let settings = Settings::from(&self.config.raster);
        hash.update(format!("{KIND} {settings:?} {}\n", self.folder.display()));
        for view in views {
            hash.update(format!("{} {:?}\n", view.name, view.camera));
            for path in import::found(self.folder, &view.name) {
                let file = path.metadata();
                let file = file.map_err(|e| Error::io(&path, "look at", e))?;
                let size = file.len();
                let time = file.modified().ok();
                hash.update(format!("{:?} {size} {time:?}\n", path.file_name()));
            }
            digest_mask(view, &mut hash);
        }
        Ok(format!("{:x}", hash.finalize()))
    }

    fn read(&self, path: &Path, (scales, channels): (usize, usize)) -> Result<Vec<Vec<f32>>> {
        let mut file = Checkpoint::load(path, KIND)?;
        let shape = [self.gaussians.len(), channels];
        let scales = (1..=scales).map(|n| file.take(&format!("scale{n}"), &shape));
        scales.collect()
    }

    fn write(&self, path: &Path, lifted: Vec<Vec<f32>>, channels: usize) -> Result<()> {
        let mut file = Checkpoint::new(KIND);
        for (n, features) in (1..).zip(lifted) {
            let shape = [self.gaussians.len(), channels];
            file.put(format!("scale{n}"), &shape, features)?;
        }
        // A damaged file, and nothing else, has this name.
        own::allow(path);
        file.save(path)
    }
}

/// The channels `range` of a map whose cells get length 1. Cells without direction stay zero.
fn directions(map: &FeatureMap, range: &Range<usize>) -> FeatureMap {
    let mut out = FeatureMap {
        steps: map.steps,
        ..FeatureMap::zeros(map.height, map.width, range.len())
    };
    let cells = out.data.chunks_exact_mut(range.len());
    for (out, cell) in cells.zip(map.data.chunks_exact(map.channels)) {
        // In f64, where squares of f32 neither overflow nor vanish.
        let square: f64 = cell.iter().map(|v| f64::from(*v).powi(2)).sum();
        let length = square.sqrt();
        if length > 0.0 {
            let values = out.iter_mut().zip(&cell[range.clone()]);
            values.for_each(|(out, v)| *out = (f64::from(*v) / length) as f32);
        }
    }
    out
}

//! From a scene to reduced feature maps.

use super::{Extractor, FeatureMap, Moments, Pca, SCALES, cache};
use crate::config::{FeatureConfig, FeatureSource};
use crate::data::{Scene, Split, View};
use crate::error::{Result, bail, ensure};
use crate::random::{self, Purpose};
use crate::ranks;
use burn::tensor::Device;
use rayon::prelude::*;
use sha2::{Digest, Sha256};

/// Cells per scale that the PCA is fitted on at most, in equal seeded shares of all training views.
pub const PCA_CELLS: usize = 100_000;

/// Unreduced maps kept in memory between fitting and applying, bytes; views beyond it are extracted twice (or read from
/// the cache).
const MAX_KEPT_BYTES: usize = 1 << 30;

/// Views extracted side by side.
const BATCH: usize = 8;

/// Reduced maps of one view.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewFeatures {
    /// Name of the view.
    pub view: String,
    /// Fine to coarse, `dimensions` channels each, every cell of unit length (or zero where nothing varies).
    pub maps: Vec<FeatureMap>,
}

/// The extractor of a scene's features and the fitted reductions. A PCA per scale, fitted on all training views, reduces their maps;
/// then each cell is L2-normalised. The unreduced maps need not fit in memory together. [Ranks](crate::ranks) divide the training
/// views.
pub struct FeatureReduction<'a> {
    /// Where the features come from, see [`Extractor`].
    pub name: String,
    /// One a scale.
    pub reductions: Vec<Pca>,
    /// What the maps depend on besides the photos: arithmetic and weights, or a digest of the imported maps.
    pub content: String,
    extractor: Extractor,
    config: &'a FeatureConfig,
    /// The training views of this rank.
    train: Vec<&'a View>,
    /// Unreduced maps of those that were kept.
    kept: Vec<Option<Vec<FeatureMap>>>,
}

impl<'a> FeatureReduction<'a> {
    /// Fits a PCA per scale to the training views. It reads at most [`PCA_CELLS`] cells per scale, drawn with `seed`. Networks run
    /// on `device`. Calls `viewed` after each view.
    ///
    /// # Errors
    /// [`crate::Error::Config`] for unusable settings; [`crate::Error::Argument`] for a scene without training views; those of
    /// [`Extractor::open`], [`Extractor::maps`] and `viewed`. A cache that cannot be written only gives a warning.
    pub fn fit(
        scene: &'a Scene,
        config: &'a FeatureConfig,
        seed: u64,
        device: &Device,
        viewed: &mut dyn FnMut() -> Result<()>,
    ) -> Result<Self> {
        ensure!(config.dimensions != 0, setting "features.dimensions"; found "0"; expected "1 or more";
            help "64 is the usual choice");
        let extractor = Extractor::open(config, device)?;
        let quota = PCA_CELLS.div_ceil(scene.split(Split::Train).count().max(1));
        let numbered = ranks::share(scene.split(Split::Train).enumerate());
        let train: Vec<(usize, &View)> = numbered.collect();
        let seen = first_pass(&extractor, config, &train, quota, seed, viewed)?;
        let Some(mut moments) = seen.moments else {
            bail!(argument "data"; found "no training view in {}", scene.name;
                expected "one or more"; help "correct the splits");
        };
        moments.iter_mut().try_for_each(Moments::add_other_ranks)?;
        let again = seen.kept.iter().filter(|maps| maps.is_none()).count();
        if again > 0 && config.cache_dir.is_none() && matches!(config.source, FeatureSource::Dino) {
            tracing::warn!(
                "{again} of {} views are computed twice: set features.cache_dir",
                train.len()
            );
        }
        let reductions = moments
            .iter()
            .map(|m| Pca::fit(m, config.dimensions))
            .collect();
        let content = match &extractor.cache_key {
            Some(key) => key.clone(),
            None => {
                let digests = ranks::interleave(seen.digests)?;
                format!("imported {:x}", Sha256::digest(digests.concat()))
            }
        };
        Ok(Self {
            name: extractor.name.clone(),
            reductions,
            content,
            extractor,
            config,
            train: train.into_iter().map(|(_, view)| view).collect(),
            kept: seen.kept,
        })
    }

    /// Reduced maps of the training views in the scene's order, computed a few at a time. Releases the unreduced maps.
    pub fn training_views(&mut self) -> impl Iterator<Item = Result<ViewFeatures>> {
        let kept = std::mem::take(&mut self.kept);
        self.reduced(&self.train, kept)
    }

    /// Reduced maps of any views of the scene, computed a few at a time.
    pub fn views(&self, views: &[&View]) -> impl Iterator<Item = Result<ViewFeatures>> {
        self.reduced(views, Vec::new())
    }

    /// Reduced maps of `views`. `kept` has unreduced maps of the first of them, where they are in memory.
    fn reduced(
        &self,
        views: &[&View],
        kept: Vec<Option<Vec<FeatureMap>>>,
    ) -> impl Iterator<Item = Result<ViewFeatures>> {
        let mut kept = kept.into_iter();
        views.chunks(BATCH).flat_map(move |batch| {
            let kept: Vec<_> = batch.iter().map(|_| kept.next().flatten()).collect();
            let reduced = batch.par_iter().zip(kept).map(|(view, kept)| {
                let maps =
                    kept.map_or_else(|| cached_maps(&self.extractor, self.config, view), Ok)?;
                let scales = self.reductions.iter().zip(&maps).enumerate();
                let reduced = scales.map(|(n, (pca, map))| pca.apply(map, &map_name(view, n)));
                Ok(ViewFeatures {
                    view: view.name.clone(),
                    maps: reduced.collect::<Result<_>>()?,
                })
            });
            reduced.collect::<Vec<_>>()
        })
    }
}

/// What the first pass over the training views of this rank finds.
#[derive(Default)]
struct FirstPass {
    /// Of the cells that were drawn; absent without views.
    moments: Option<Vec<Moments>>,
    /// Unreduced maps of each view, while they fit in memory.
    kept: Vec<Option<Vec<FeatureMap>>>,
    /// Of imported maps, which do not depend on photos: it identifies them.
    digests: Vec<String>,
}

/// Extracts the maps of the training views `train`, each with its number among the views of all ranks.
fn first_pass(
    extractor: &Extractor,
    config: &FeatureConfig,
    train: &[(usize, &View)],
    quota: usize,
    seed: u64,
    viewed: &mut dyn FnMut() -> Result<()>,
) -> Result<FirstPass> {
    let mut seen = FirstPass::default();
    let mut kept_bytes = 0;
    for batch in train.chunks(BATCH) {
        let look = |(_, view): &(usize, &View)| {
            let maps = cached_maps(extractor, config, view)?;
            let is_imported = extractor.cache_key.is_none();
            Ok((is_imported.then(|| cache::digest(&maps)), maps))
        };
        let batch_maps: Vec<Result<_>> = batch.par_iter().map(look).collect();
        for (&(number, view), maps) in batch.iter().zip(batch_maps) {
            let (digest, maps) = maps?;
            seen.digests.extend(digest);
            let moments = seen
                .moments
                .get_or_insert_with(|| maps.iter().map(|map| Moments::new(map.channels)).collect());
            for (n, (map, moments)) in maps.iter().zip(moments).enumerate() {
                let index = (number * SCALES + n) as u64;
                let cells = subsample(map, quota, seed, index);
                moments.add(&cells, &map_name(view, n), map.channels)?;
            }
            kept_bytes += maps.iter().map(|m| 4 * m.data.len()).sum::<usize>();
            seen.kept
                .push((kept_bytes <= MAX_KEPT_BYTES).then_some(maps));
            viewed()?;
        }
    }
    Ok(seen)
}

/// The name of a map in errors.
fn map_name(view: &View, scale: usize) -> String {
    format!("features of view {}, scale {}", view.name, scale + 1)
}

/// At most `quota` cells of a map, in cell order.
fn subsample(map: &FeatureMap, quota: usize, seed: u64, index: u64) -> Vec<f32> {
    if map.cells() <= quota {
        return map.data.clone();
    }
    let mut rng = random::stream(seed, Purpose::PcaCells, index);
    let mut cells = rand::seq::index::sample(&mut rng, map.cells(), quota).into_vec();
    cells.sort_unstable();
    cells
        .iter()
        .flat_map(|&cell| &map.data[cell * map.channels..][..map.channels])
        .copied()
        .collect()
}

fn cached_maps(
    extractor: &Extractor,
    config: &FeatureConfig,
    view: &View,
) -> Result<Vec<FeatureMap>> {
    let (Some(dir), Some(key)) = (&config.cache_dir, &extractor.cache_key) else {
        return extractor.maps(view);
    };
    let pixels = view.image.pixels()?;
    let path = cache::entry(dir, &pixels, key);
    if let Some(maps) = cache::load(&path) {
        return Ok(maps);
    }
    let maps = extractor.maps_of(&view.name, || Ok(pixels))?;
    if let Err(error) = cache::store(&path, &maps) {
        tracing::warn!("features are not cached: {error}");
    }
    Ok(maps)
}

//! What stage two needs, checked before stage one starts: networks, imported maps, and memory.

use super::lift::reads_features;
use crate::config::{Association, Config, Variant};
use crate::data::{Scene, Split};
use crate::error::{Result, ensure};
use crate::features::Extractor;
use crate::memory;
use crate::ranks;
use crate::segmentation::encoder::load_spatial;
use burn::tensor::Device;

/// Opens what stage two reads beside the scene, so that nothing is missing after stage one: weights and imported maps.
pub(super) fn check_networks(config: &Config, scene: &Scene, device: &Device) -> Result<()> {
    if reads_features(config) {
        let extractor = Extractor::open(&config.features, device)?;
        let mut views = scene.split(Split::Train);
        views.try_for_each(|view| extractor.expect(&view.name))?;
    }
    let mut rows = config.segmentation.rows().iter();
    if rows.any(|row| row.trains_decoder()) {
        load_spatial(&config.spatial, config.seed, device)?;
    }
    Ok(())
}

/// Refuses more ranks than training photos, and variants that ranks cannot train together.
pub(super) fn check_ranks(scene: &Scene, config: &Config) -> Result<()> {
    let ranks = ranks::count();
    if ranks == 1 {
        return Ok(());
    }
    let photos = scene.split(Split::Train).count();
    ensure!(ranks <= photos, argument "mpirun"; found "{ranks} processes for {photos} training photos";
        expected "no more than one a photo"; help "start fewer");
    ensure!(!config.segmentation.rows().contains(&Variant::Distilled),
        setting "segmentation.rows"; found "distilled"; expected "variants that ranks share";
        help "train it without mpirun");
    Ok(())
}

/// Stage one usually keeps at least one in this many of its initial Gaussians.
const PRUNED_TO: usize = 8;

/// Gaussians that stage one leaves at least; 0 where they come from a file.
pub(super) fn least_count(scene: &Scene, config: &Config) -> usize {
    let building = &config.building;
    let points = match scene.points.positions.len() {
        _ if building.gaussians.is_some() => 0,
        0 => building.random_points,
        points => points,
    };
    let most = building.max_gaussians.limit().unwrap_or(usize::MAX);
    points.min(most) / PRUNED_TO
}

/// Refuses a stage two whose votes and identities exceed the memory. Objects have yet to be counted.
pub(super) fn check_scores(gaussians: usize, scene: &Scene, config: &Config) -> Result<()> {
    let is_known = config.data.association == Association::None && has_raw_labels(scene);
    if !is_known || config.segmentation.rows().is_empty() {
        return Ok(());
    }
    memory::check_scores(gaussians, scene.classes.len(), score_tables(config))
}

/// Variants that train a score for each Gaussian and class.
const FREE_SCORES: [Variant; 3] = [
    Variant::PerGaussian,
    Variant::PanopticLifting,
    Variant::NoDecoder,
];

/// Scores of each Gaussian for each class that are in memory together at most, as measured: votes of four quarters of the views, the table
/// that is counted, identities of each variant, and what training them takes.
pub(super) fn score_tables(config: &Config) -> usize {
    let rows = config.segmentation.rows();
    let has_decoder = rows.iter().any(|row| row.trains_decoder());
    let fine_tunes = has_decoder && config.segmentation.fine_tune != Some(false);
    let training = match rows {
        // Fine-tuning trains free scores too.
        _ if fine_tunes || rows.iter().any(|row| FREE_SCORES.contains(row)) => 6,
        _ if has_decoder => 3,
        _ => 0,
    };
    5 + rows.len() + training
}

/// Whether stage two has something to train on: a labelled pixel of a training view.
pub(super) fn has_raw_labels(scene: &Scene) -> bool {
    let maps = scene.labelled().flat_map(|view| &view.raw);
    let mut ids = maps.flat_map(|map| map.runs().map(|(id, _)| id));
    !scene.classes.is_empty() && ids.any(|id| id != scene.classes.ignore)
}

/// Whether there are segments of single views that the settings make objects of. Association refuses maps without any.
pub(super) fn has_segments(scene: &Scene, config: &Config) -> bool {
    config.data.association != Association::None && scene.labelled().next().is_some()
}

/// Warns that there is no second stage, as no training view has a labelled pixel.
pub(super) fn warn_of_no_labels(scene: &Scene) {
    if scene.labelled().next().is_some() {
        tracing::warn!(
            "the raw labels of the training views are unlabelled in every pixel: only the Gaussians are built. Look at the ids of the \
             label maps and at classes.json"
        );
        return;
    }
    tracing::warn!(
        "no training view has raw labels: only the Gaussians are built. raw_label_path in transforms.json or data.raw_labels names \
         them; set segmentation.rows = [] if there are none"
    );
}

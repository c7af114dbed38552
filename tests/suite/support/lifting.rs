//! Image features of all training views at once, and their lifting, for scenes that fit into memory.

use burn::tensor::Device;
use coseg::config::{FeatureConfig, Normalisation};
use coseg::data::{Scene, View};
use coseg::error::Result;
use coseg::features::{FeatureReduction, Pca, ViewFeatures};
use coseg::raster::Settings;
use coseg::segmentation::unprojection;
use coseg::splat::Gaussians;

/// Reduced features of a scene's training views.
#[derive(Clone, Debug)]
pub struct FeatureSet {
    pub name: String,
    pub reductions: Vec<Pca>,
    pub views: Vec<ViewFeatures>,
}

/// The reduced features of all training views.
pub fn extract(
    scene: &Scene,
    config: &FeatureConfig,
    seed: u64,
    device: &Device,
) -> Result<FeatureSet> {
    let mut reduction = FeatureReduction::fit(scene, config, seed, device, &mut || Ok(()))?;
    let views = reduction.training_views().collect::<Result<_>>()?;
    Ok(FeatureSet {
        name: reduction.name,
        reductions: reduction.reductions,
        views,
    })
}

/// Lifts the features `set` of `views`.
pub fn unproject<'a>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    set: &FeatureSet,
    normalisation: Normalisation,
    device: &Device,
) -> Result<Vec<Vec<f32>>> {
    let features = set.views.iter().map(Ok);
    let settings = &Settings::default();
    let go_on = &mut || Ok(());
    unprojection::unproject(
        gaussians,
        views,
        features,
        normalisation,
        settings,
        device,
        go_on,
    )
}

//! Gaussians as the views of a scene see them, beside their photos.

use crate::config::Config;
use crate::data::{LabelMap, Scene, Split, View};
use crate::error::Result;
use crate::metrics::ImageScores;
use crate::objects::{LabelMaps, RenderOptions, Renderer};
use crate::ranks;
use crate::splat::Gaussians;
use burn::tensor::Device;

/// Gaussians that are rendered for one view after the other with the settings of a run.
#[derive(Debug)]
pub struct Pictures {
    renderer: Renderer,
}

impl Pictures {
    /// Pictures of `gaussians`, rendered on `device`.
    ///
    /// # Errors
    /// As [`Renderer::new`].
    pub fn new(gaussians: &Gaussians, config: &Config, device: &Device) -> Result<Self> {
        let options = RenderOptions::from(config);
        Ok(Self {
            renderer: Renderer::new(gaussians.clone(), None, options, device)?,
        })
    }

    /// `view` in colour (`[H, W, 3]`, not clamped), and its scores against its photo.
    ///
    /// # Errors
    /// As [`Renderer::frame`] and [`crate::data::Photo::pixels`].
    pub fn of(&self, view: &View) -> Result<(Vec<f32>, ImageScores)> {
        let rgb = self.renderer.frame(&view.camera)?.rgb;
        let scores = ImageScores::of_view(&rgb, view)?;
        Ok((rgb, scores))
    }

    /// [`Pictures::of`], and what `view` shows of each of `maps`, whose identities are of the same Gaussians.
    ///
    /// # Errors
    /// As [`Pictures::of`] and [`LabelMaps::of`].
    ///
    /// # Panics
    /// If identities are of another number of Gaussians.
    pub fn labelled(
        &self,
        view: &View,
        maps: &[LabelMaps<'_>],
    ) -> Result<(Vec<f32>, ImageScores, Vec<LabelMap>)> {
        let (rgb, scores) = self.of(view)?;
        let projected = self.renderer.view(&view.camera);
        let maps = maps.iter().map(|maps| maps.of(&projected));
        Ok((rgb, scores, maps.collect::<Result<_>>()?))
    }

    /// Mean scores of `views`, which [ranks] divide.
    ///
    /// # Errors
    /// As [`Pictures::of`].
    pub fn score<'v>(&self, views: impl Iterator<Item = &'v View>) -> Result<ImageScores> {
        let scores = ranks::divided(views, |view| Ok(self.of(view)?.1))?;
        Ok(ImageScores::mean(&scores))
    }
}

/// Mean held-out PSNR and SSIM.
///
/// # Errors
/// As [`Pictures::of`].
pub fn score_images(
    gaussians: &Gaussians,
    scene: &Scene,
    config: &Config,
    device: &Device,
) -> Result<ImageScores> {
    Pictures::new(gaussians, config, device)?.score(scene.split(Split::Test))
}

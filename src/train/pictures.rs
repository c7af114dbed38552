//! Gaussians as the views of a scene see them, beside their photos.

use crate::config::Config;
use crate::data::{LabelMap, Scene, Split, View};
use crate::device::{in_host_memory, shortfall};
use crate::error::Result;
use crate::gaussians::Gaussians;
use crate::metrics::ImageScores;
use crate::objects::{LabelMaps, RenderOptions, Renderer};
use crate::raster::{Projected, Settings};
use burn::tensor::Device;

/// Gaussians that are rendered for one view after the other with the settings of a run, on a GPU where there is one.
#[derive(Debug)]
pub struct Pictures<'a> {
    settings: Settings,
    background: [f32; 3],
    place: Place<'a>,
}

#[derive(Debug)]
enum Place<'a> {
    Host(&'a Gaussians),
    Device(Box<Renderer>, Device),
}

impl<'a> Pictures<'a> {
    /// Of `gaussians`, rendered on `device`.
    ///
    /// # Errors
    /// As [`Renderer::new`].
    pub fn new(gaussians: &'a Gaussians, config: &Config, device: &Device) -> Result<Self> {
        let (settings, background) = (Settings::from(&config.raster), config.raster.background);
        let on_host = in_host_memory(device) || shortfall(device).is_some() || gaussians.is_empty();
        let place = match on_host {
            true => Place::Host(gaussians),
            false => {
                let options = RenderOptions { settings, background, ..RenderOptions::default() };
                Place::Device(Box::new(Renderer::new(gaussians.clone(), None, options, device)?), device.clone())
            }
        };
        Ok(Self { settings, background, place })
    }

    /// `view` in colour (`[H, W, 3]`, not clamped), and its scores against its photo.
    ///
    /// # Errors
    /// As [`Projected::new`] and [`crate::data::Photo::pixels`]; [`crate::Error::NonFinite`] for the SH coefficients; on a GPU as
    /// [`Renderer::frame`].
    pub fn of(&mut self, view: &View) -> Result<(Vec<f32>, ImageScores)> {
        let (rgb, scores, _) = self.labelled(view, &[])?;
        Ok((rgb, scores))
    }

    /// [`Pictures::of`], and what `view` shows of `maps`, whose identities are of the same Gaussians.
    ///
    /// # Errors
    /// As [`Pictures::of`]; on a GPU as [`crate::objects::DeviceLabelMaps::of`].
    ///
    /// # Panics
    /// If identities are of another number of Gaussians.
    pub fn labelled(&mut self, view: &View, maps: &[LabelMaps]) -> Result<(Vec<f32>, ImageScores, Vec<LabelMap>)> {
        let camera = &view.camera;
        let (rgb, maps) = match &mut self.place {
            Place::Host(gaussians) => {
                let projected = Projected::new(&gaussians.splats(), camera, &self.settings)?;
                let blended = projected.blend(&projected.colours(gaussians, camera)?, 3);
                (blended.over(self.background).image, maps.iter().map(|maps| maps.of(&projected)).collect())
            }
            Place::Device(renderer, device) => {
                let rgb = renderer.frame(camera)?.rgb;
                let seen = renderer.seen_by(camera);
                let of = |maps: &LabelMaps| seen.iter().map(|seen| maps.on(device).of(seen)).next();
                (rgb, maps.iter().filter_map(of).collect::<Result<_>>()?)
            }
        };
        let scores = ImageScores::of_view(&rgb, view)?;
        Ok((rgb, scores, maps))
    }

    /// Mean scores of `views`.
    ///
    /// # Errors
    /// As [`Pictures::of`].
    pub fn score<'v>(&mut self, views: impl Iterator<Item = &'v View>) -> Result<ImageScores> {
        let scores: Vec<_> = views.map(|view| Ok(self.of(view)?.1)).collect::<Result<_>>()?;
        Ok(ImageScores::mean(&scores))
    }
}

/// Mean held-out PSNR and SSIM.
///
/// # Errors
/// As [`Pictures::of`].
pub fn score_images(gaussians: &Gaussians, scene: &Scene, config: &Config, device: &Device) -> Result<ImageScores> {
    Pictures::new(gaussians, config, device)?.score(scene.split(Split::Test))
}

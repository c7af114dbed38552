//! Gaussians as the views of a scene see them, beside their photos.

use crate::backend::device::renders_on;
use crate::config::Config;
use crate::data::{LabelMap, Scene, Split, View};
use crate::error::Result;
use crate::metrics::ImageScores;
use crate::objects::{DeviceLabelMaps, LabelMaps, RenderOptions, Renderer};
use crate::raster::{Projected, Settings, render};
use crate::splat::Gaussians;
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
    Host(&'a Gaussians, Vec<&'a LabelMaps<'a>>),
    Device(Box<OnDevice<'a>>),
}

#[derive(Debug)]
struct OnDevice<'a> {
    renderer: Renderer,
    maps: Vec<DeviceLabelMaps<'a>>,
    device: Device,
}

impl<'a> Pictures<'a> {
    /// Of `gaussians`, rendered on `device`.
    ///
    /// # Errors
    /// As [`Renderer::new`].
    pub fn new(gaussians: &'a Gaussians, config: &Config, device: &Device) -> Result<Self> {
        let (settings, background) = (Settings::from(&config.raster), config.raster.background);
        let place = if !renders_on(device) || gaussians.is_empty() {
            Place::Host(gaussians, Vec::new())
        } else {
            let options = RenderOptions {
                settings,
                background,
                ..RenderOptions::default()
            };
            let renderer = Renderer::new(gaussians.clone(), None, options, device)?;
            Place::Device(Box::new(OnDevice {
                renderer,
                maps: Vec::new(),
                device: device.clone(),
            }))
        };
        Ok(Self {
            settings,
            background,
            place,
        })
    }

    /// With `maps`, whose identities are of the same Gaussians, for [`Pictures::labelled`].
    #[must_use]
    pub fn with_labels(mut self, maps: &'a [LabelMaps<'a>]) -> Self {
        match &mut self.place {
            Place::Host(_, shown) => *shown = maps.iter().collect(),
            Place::Device(on) => on.maps = maps.iter().map(|maps| maps.on(&on.device)).collect(),
        }
        self
    }

    /// `view` in colour (`[H, W, 3]`, not clamped), and its scores against its photo.
    ///
    /// # Errors
    /// As [`Projected::new`] and [`crate::data::Photo::pixels`]; [`crate::Error::NonFinite`] for the SH coefficients; on a GPU as
    /// [`Renderer::frame`].
    pub fn of(&mut self, view: &View) -> Result<(Vec<f32>, ImageScores)> {
        let rgb = match &mut self.place {
            Place::Host(gaussians, _) => {
                render(gaussians, &view.camera, &self.settings, self.background)?.rgb
            }
            Place::Device(on) => on.renderer.frame(&view.camera)?.rgb,
        };
        let scores = ImageScores::of_view(&rgb, view)?;
        Ok((rgb, scores))
    }

    /// [`Pictures::of`], and what `view` shows of each of the label maps.
    ///
    /// # Errors
    /// As [`Pictures::of`]; on a GPU as [`DeviceLabelMaps::of`].
    ///
    /// # Panics
    /// If identities are of another number of Gaussians.
    pub fn labelled(&mut self, view: &View) -> Result<(Vec<f32>, ImageScores, Vec<LabelMap>)> {
        let camera = &view.camera;
        let (rgb, maps) = match &mut self.place {
            Place::Host(gaussians, maps) => {
                let projected = Projected::new(&gaussians.splats(), camera, &self.settings)?;
                let blended = projected.blend(&projected.colours(gaussians, camera)?, 3);
                (
                    blended.over(self.background).image,
                    maps.iter().map(|maps| maps.of(&projected)).collect(),
                )
            }
            Place::Device(on) => {
                let rgb = on.renderer.frame(camera)?.rgb;
                let maps = match on.renderer.seen_by(camera) {
                    Some(seen) => on
                        .maps
                        .iter_mut()
                        .map(|maps| maps.of(&seen))
                        .collect::<Result<_>>()?,
                    None => Vec::new(),
                };
                (rgb, maps)
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
        let scores: Vec<_> = views
            .map(|view| Ok(self.of(view)?.1))
            .collect::<Result<_>>()?;
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

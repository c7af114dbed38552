//! Rendering of views; what rendered the last one is kept for the next.

use crate::view::View;
use coseg::backend::device::{self, BackendName};
use coseg::error::Result;
use coseg::objects::{RenderOptions, Renderer};
use coseg::runs;
use coseg::splat::camera::Camera;
use coseg::splat::ply::PlyScene;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// How a view is rendered, where not as the run was.
#[derive(Clone, Copy, PartialEq)]
pub struct Look {
    pub backend: Option<BackendName>,
    pub alpha_max: Option<f64>,
    pub background: Option<[f32; 3]>,
    /// Label of the pixels that hardly any Gaussian covers.
    pub unlabelled: u16,
}

/// The renderer of the last view of a scene.
#[derive(Default)]
pub struct LastRenderer(Mutex<Option<(Look, Renderer)>>);

impl LastRenderer {
    /// Renders `camera`, which is in world units, in the scene `ply` of the file `source`.
    pub fn render(
        &self,
        source: &Path,
        ply: &PlyScene,
        camera: &Camera,
        depth: bool,
        look: Look,
    ) -> Result<View> {
        let mut last = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (_, renderer) = match last.take().filter(|(of, _)| *of == look) {
            Some(fitting) => last.insert(fitting),
            None => last.insert((look, renderer(source, ply, look)?)),
        };
        let camera = camera.moved(-ply.origin);
        let frame = renderer.frame(&camera)?;
        let depth = depth.then(|| renderer.depth(&camera)).transpose()?;
        Ok(View { frame, depth })
    }
}

fn renderer(source: &Path, ply: &PlyScene, look: Look) -> Result<Renderer> {
    let mut config = runs::rendering_beside(source);
    let raster = &mut config.raster;
    raster.alpha_max = look.alpha_max.unwrap_or(raster.alpha_max);
    raster.background = look.background.unwrap_or(raster.background);
    config.validate()?;
    let device = device::open(look.backend)?;
    let gaussians = ply.gaussians.clone();
    let labels = ply.labels.clone();
    let options = RenderOptions {
        unlabelled: look.unlabelled,
        ..RenderOptions::from(&config)
    };
    Renderer::new(gaussians, labels, options, &device)
}

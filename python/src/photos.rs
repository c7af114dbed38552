//! What the photos of a scene folder say of its Gaussians: votes of their labels, and image features.

use crate::arguments::{backend, sets};
use crate::raised;
use crate::scene::{Features, Scene};
use coseg::backend::device::{self, BackendName};
use coseg::config::Config;
use coseg::data::Classes;
use coseg::error::Result;
use coseg::pipeline::LiftedFeatures;
use coseg::progress::Silent;
use coseg::runs;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::{Path, PathBuf};

/// Settings of a call.
struct Settings {
    file: Option<PathBuf>,
    sets: Vec<String>,
    backend: Option<BackendName>,
}

impl Settings {
    fn new(
        file: Option<PathBuf>,
        set: Option<&Bound<'_, PyDict>>,
        backend: Option<&str>,
    ) -> PyResult<Self> {
        Ok(Self {
            file,
            sets: sets(set)?,
            backend: self::backend(backend)?,
        })
    }

    /// Those for the scene folder `data`.
    fn load(&self, data: &Path) -> Result<Config> {
        Config::load_for(Some(data), self.file.as_deref(), &self.sets)
    }
}

/// Votes as `coseg vote` does.
#[pyfunction]
#[pyo3(signature = (scene, data, *, pooled=false, config=None, set=None, backend=None))]
pub fn vote(
    py: Python<'_>,
    scene: PathBuf,
    data: PathBuf,
    pooled: bool,
    config: Option<PathBuf>,
    set: Option<&Bound<'_, PyDict>>,
    backend: Option<&str>,
) -> PyResult<Scene> {
    let settings = Settings::new(config, set, backend)?;
    let voted = || -> Result<Scene> {
        let config = settings.load(&data)?;
        runs::check_vote(&config)?;
        let device = device::open(settings.backend)?;
        let (mut photos, mut ply) = runs::load_both(&data, &scene, &config, &device)?;
        photos.drop_unused_classes(&Classes::default());
        let identities = runs::vote(&photos, &ply.gaussians, pooled, &config, &device)?;
        ply.labels = Some(identities.ids(&photos.classes));
        let mut voted = Scene::of_photos(&scene, ply, photos)?;
        voted.identities = Some(identities);
        Ok(voted)
    };
    py.detach(voted).map_err(raised)
}

/// Lifts image features of the training photos onto the Gaussians.
#[pyfunction]
#[pyo3(signature = (scene, data, *, config=None, set=None, backend=None))]
pub fn lift(
    py: Python<'_>,
    scene: PathBuf,
    data: PathBuf,
    config: Option<PathBuf>,
    set: Option<&Bound<'_, PyDict>>,
    backend: Option<&str>,
) -> PyResult<Scene> {
    let settings = Settings::new(config, set, backend)?;
    let lifted = || -> Result<Scene> {
        let config = settings.load(&data)?;
        let device = device::open(settings.backend)?;
        let (photos, ply) = runs::load_both(&data, &scene, &config, &device)?;
        let gaussians = &ply.gaussians;
        let lifted = LiftedFeatures::of_views(&photos, gaussians, &config, &device, &mut Silent)?;
        let features = Features {
            scales: lifted.lifted,
            dimensions: lifted.dimensions,
        };
        let mut lifted = Scene::of_photos(&scene, ply, photos)?;
        lifted.features = Some(features);
        Ok(lifted)
    };
    py.detach(lifted).map_err(raised)
}

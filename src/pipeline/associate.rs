//! Association of a run: segments of the raw labels, whose ids differ from view to view, become objects.

use crate::config::Config;
use crate::data::Scene;
use crate::error::Result;
use crate::objects::{self, Association, Semantics};
use crate::progress::{Progress, Viewing};
use crate::raster::Settings;
use crate::splat::Gaussians;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// Result of the association.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Associated {
    /// Segments of the training views.
    pub segments: usize,
    /// Objects that they show.
    pub objects: usize,
    /// Segments without an object.
    pub dropped: usize,
    /// Segments divided among several objects.
    pub divided: usize,
    /// Seconds of the association.
    pub seconds: f64,
}

/// Replaces the raw labels of `scene` by objects, and its classes with them. Returns the counts, and what the classes of the
/// objects are scored against. None where `progress` stopped it. Nothing is stored: a resumed run makes the same objects again.
///
/// # Errors
/// As [`objects::associate`].
pub fn associate(
    gaussians: &Gaussians,
    scene: &mut Scene,
    config: &Config,
    progress: &mut dyn Progress,
) -> Result<Option<(Associated, Option<Semantics>)>> {
    let (clock, settings) = (Instant::now(), Settings::from(&config.raster));
    let steps = Association::steps(scene, &config.association);
    let mut viewing = Viewing::begin(progress, "association", steps);
    let advance = &mut |views| viewing.advance(views);
    let found = objects::associate(gaussians, scene, &config.association, &settings, advance)?;
    let Some(found) = found else {
        return Ok(None);
    };
    viewing.end();
    let counts = Associated {
        segments: found.segments,
        objects: found.groups.len(),
        dropped: found.dropped,
        divided: found.divided,
        seconds: 0.0,
    };
    // The true labels leave the scene below.
    let semantics = Semantics::of(scene);
    found.apply(scene);
    let seconds = clock.elapsed().as_secs_f64();
    Ok(Some((Associated { seconds, ..counts }, semantics)))
}

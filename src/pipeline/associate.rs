//! Association of a run: segments of the raw labels, whose ids differ from view to view, become objects.

use crate::config::Config;
use crate::data::Scene;
use crate::error::Result;
use crate::objects::{self, AssociatedObjects, Semantics};
use crate::progress::{Progress, Viewing};
use crate::raster::Settings;
use crate::splat::Gaussians;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::time::Instant;

/// Numbers of an association, as metrics.json stores them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AssociationCounts {
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

impl fmt::Display for AssociationCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} segments of training views joined into {} objects; {} segments are in no object, {} are divided among several",
            self.segments, self.objects, self.dropped, self.divided
        )
    }
}

/// The result of [`associate`].
#[derive(Clone, Debug)]
pub struct Associated {
    /// How many segments became how many objects.
    pub counts: AssociationCounts,
    /// What the classes of the objects are scored against, where the objects have classes.
    pub semantics: Option<Semantics>,
}

/// Finds the objects that the segments of `scene` show. They become its raw labels and its classes. Nothing is stored: a resumed
/// run finds the same objects again.
///
/// # Errors
/// As [`objects::associate`].
pub fn associate(
    gaussians: &Gaussians,
    scene: &mut Scene,
    config: &Config,
    progress: &mut dyn Progress,
) -> Result<Associated> {
    let clock = Instant::now();
    let settings = Settings::from(&config.raster);
    let steps = AssociatedObjects::steps(scene);
    let mut viewing = Viewing::begin(progress, "association", steps);
    let advance = &mut |views| viewing.advance(views);
    let found = objects::associate(gaussians, scene, &settings, advance)?;
    viewing.end();
    let mut counts = AssociationCounts {
        segments: found.segments,
        objects: found.classes.len(),
        dropped: found.dropped,
        divided: found.divided,
        seconds: 0.0,
    };
    // The true labels leave the scene below.
    let semantics = Semantics::of(scene);
    found.apply(scene);
    counts.seconds = clock.elapsed().as_secs_f64();
    Ok(Associated { counts, semantics })
}
